"""Touches anywhere with parameters, their voltages, and the derivatives by each parameter."""
