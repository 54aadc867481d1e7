"""Calibration: a device's true parameters from its own measurements, with standard errors, and a better skin."""
