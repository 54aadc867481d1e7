"""Shared by both ends of the wire: the table of measurements, the grid, the normalisation, the messages."""
