"""Lists of mismatches that are shipped: ``eitskin evaluate --devices NAME``."""
