"""What stands between the sheet and the numbers: noise, faults of electrodes, how rows go together."""
