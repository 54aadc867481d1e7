"""A recording from any moment on, without going through what comes before it."""
