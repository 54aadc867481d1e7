"""The touch gate: what it learns from, its training and its error rates."""
