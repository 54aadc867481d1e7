"""Where a map is touched, on the flat sheet and on its surface, and which touch is which from frame to frame."""
