"""A small model of one bent sheet: voltages of any set of touched units in microseconds, to 1e-4 of each."""
