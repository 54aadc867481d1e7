"""Verification in the stream: a process that checks published frames, and its connection to the runtime."""
