"""The touch gate: its training data, its training and its error rates."""
