"""``eitskin bench view``."""
