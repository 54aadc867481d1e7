"""Evaluation of maps: phantoms, drawn trials, metrics, and the harness that runs solvers on them."""
