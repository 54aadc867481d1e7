"""``eitskin build``: data, training, export and card from one file."""
