"""A recording played back: a line to a device that is no longer there."""
