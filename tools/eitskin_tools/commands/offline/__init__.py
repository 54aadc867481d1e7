"""Subcommands of simulation, training and evaluation."""
