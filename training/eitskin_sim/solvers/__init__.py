"""Classical solvers: Tikhonov, l1 and structure-aware sparse Bayesian learning, on a map's pixels or units."""
