"""What a true device is, from its own readings: parameters with priors, standard errors, a better skin."""
