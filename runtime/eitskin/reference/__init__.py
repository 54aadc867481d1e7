"""What voltages are compared with: the one captured reference, and the predicted one of the bent sheet."""
