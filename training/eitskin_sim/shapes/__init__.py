"""Touches off the unit grid with parameters of their own, their voltages and how these change with each parameter."""
