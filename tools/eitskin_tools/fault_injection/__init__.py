"""Scripted faults: power cuts, mutated frames, and the device's own C code to try them on."""
