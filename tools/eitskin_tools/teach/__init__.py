"""Touches learned from presses at known places."""
