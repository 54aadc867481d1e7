"""Several skins on one robot: their list, their poses, and their frames in one iterator."""
