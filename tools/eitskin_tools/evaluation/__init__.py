"""Solvers by name, and tables and pictures of their accuracy."""
