"""Data sets: what they hold, how they are made, stored and read."""
