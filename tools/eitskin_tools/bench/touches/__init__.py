"""What the list of touches costs, and how right it is."""
