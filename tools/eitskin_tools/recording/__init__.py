"""Recordings: a skin's measurements and published frames, in a file that survives power cuts."""
