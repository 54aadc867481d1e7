"""Leads a person through a calibration: says what to do, and waits for the sheet itself to show that it is done."""
