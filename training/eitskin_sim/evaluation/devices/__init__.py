"""Trials on devices that are not what solvers take them for."""
