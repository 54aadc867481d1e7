"""Several skins on one robot: which they are, where they sit on it, and their frames in one iterator."""
