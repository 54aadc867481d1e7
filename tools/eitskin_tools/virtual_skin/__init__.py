"""The virtual skin: a device that speaks the wire exactly, behind a pseudo-terminal, with faults on demand."""
