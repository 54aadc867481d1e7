"""Solvers by name, tables and pictures of what they reach."""
