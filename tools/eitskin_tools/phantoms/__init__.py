"""The paper's eight phantoms, on the unit grid and in mm."""
