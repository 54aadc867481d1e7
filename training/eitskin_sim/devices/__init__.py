"""Devices as a lab builds them: sheet, electrodes and front end that are not the nominal ones, and draws of them."""
