"""Data sets: their content, and how they are made, stored and read."""
