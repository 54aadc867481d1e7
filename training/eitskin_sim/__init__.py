"""Numerics on numpy and scipy: the bent sheet, its forward model, touches, data, classical solvers and metrics."""
