"""Diagnosis: what is connected and installed, what is wrong, and how to fix it."""
