"""Between the sheet and the numbers: noise, faults of electrodes, and the correlation of rows."""
