"""Subcommands that write or read recordings."""
