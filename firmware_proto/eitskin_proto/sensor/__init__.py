"""The skin itself: the table of rows, the grid, the cloud, the normalisation, and the ids that name them."""
