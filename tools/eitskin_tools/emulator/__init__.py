"""The device's own C code on this machine: as a library, and as firmware on an emulated board."""
