"""Random requests with power cuts between and within them, against SPEC.md as a state machine."""
