"""Measurements, published on request: the wire's frames, clouds, conditions, state."""
