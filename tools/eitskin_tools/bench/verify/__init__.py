"""What the verifier of touches survives, and whether its p-values keep their word."""
