"""The device as it is: in what a real sheet's layer differs from the ideal one, and how files say so."""
