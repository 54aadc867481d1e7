"""What both ends of the wire must agree on: the table of measurements, the grid, the normalisation, the messages."""
