"""Files from anywhere, read within bounds and written whole; and texts from anywhere, made fit for a terminal."""
