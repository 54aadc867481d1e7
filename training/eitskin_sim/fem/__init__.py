"""The complete electrode model on biquadratic finite elements."""
