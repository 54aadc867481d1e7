"""How good maps are: phantoms, drawn trials, metrics, and the harness that runs solvers on them."""
