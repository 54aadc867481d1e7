"""Exact voltages of touches anywhere on the sheet, thousands a second."""
