"""What is known of the sheet on one deformation: a model of its scan, and how far that may be off."""
