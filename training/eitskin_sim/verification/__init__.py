"""Checks a set of touches against the forward model: residuals, nuisances, and the search for a better set."""
