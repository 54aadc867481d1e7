"""The wire, byte by byte: packets, messages, frames and the stored configuration."""
