"""Verdicts of physics on published frames: their message, and who takes them."""
