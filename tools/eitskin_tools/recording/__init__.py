"""Recordings: what a skin sent, and what it was taken for, in a file that survives power cuts."""
