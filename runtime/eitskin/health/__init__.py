"""The state of the skin: failed electrodes, missing rows, drift."""
