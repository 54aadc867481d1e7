"""What was measured, published on request: the wire's frames, clouds, conditions, state."""
