"""What turns changes of voltage into maps: the bundle, its engines and its gate."""
