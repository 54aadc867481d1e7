"""The verifier of touches off the unit grid: shapes fitted to a frame, and whether they explain it."""
