"""The references of voltages: the captured one of the flat sheet, and the predicted one of the bent sheet."""
