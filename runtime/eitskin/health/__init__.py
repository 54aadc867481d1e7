"""What the skin knows of itself: failed electrodes, missing rows, drift."""
