"""What one skin is: a description that data, bundles, references and solvers follow, and the digest that names it."""
