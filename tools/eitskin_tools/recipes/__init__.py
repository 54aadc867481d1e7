"""Recipes that come with the package: one for each shipped bundle, and a tiny one."""
