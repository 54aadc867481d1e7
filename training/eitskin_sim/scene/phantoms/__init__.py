"""Phantoms by content: the published ones, and any phantom moved by a part of a pixel."""
