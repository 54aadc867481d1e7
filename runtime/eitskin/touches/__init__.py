"""Finds touches in a map, on the flat sheet and on its surface, and follows them from frame to frame."""
