"""Elements that the border of a touch runs through: sharp borders cut them, soft ones grade them."""
