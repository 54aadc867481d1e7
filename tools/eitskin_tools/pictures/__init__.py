"""Maps as characters and colours."""
