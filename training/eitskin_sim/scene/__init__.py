"""Scenes: sheet, electrodes, bends and touches, and the files that describe them."""
