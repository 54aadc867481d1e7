"""Whether physics agrees with a set of touches: residuals, chi-squared, nuisances, and the search for a better set."""
