"""The disturbances, a module a family."""
