"""Classical solvers: Tikhonov, l1 and structure-aware sparse Bayesian learning, on 1350 pixels or 126 units."""
