"""Exact voltages of touched units of the 9 x 14 grid, thousands a second."""
