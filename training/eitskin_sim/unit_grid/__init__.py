"""Exact voltages of touched units of a skin's grid, thousands a second."""
