"""Subcommands around a running skin."""
