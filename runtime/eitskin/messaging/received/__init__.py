"""What came in a message, checked before it is believed."""
