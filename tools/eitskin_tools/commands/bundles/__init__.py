"""Subcommands that make bundles, put them together and try them."""
