"""What stands between the sheet and the numbers: noise, failing electrodes, how rows go together."""
