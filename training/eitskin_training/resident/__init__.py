"""Training where the data lie: on a GPU batches are made in its memory, and a step is one captured graph."""
