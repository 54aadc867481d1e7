"""The skin's readings: the table of rows, the normalisation, and the id that names them."""
