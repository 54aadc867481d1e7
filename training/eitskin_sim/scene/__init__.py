"""What is simulated: sheet, electrodes, bends and touches, and the files that describe them."""
