"""Outlines that are no rectangle: maps onto the rectangle that meshes, grids and solvers know."""
