"""The description of a skin, which data, bundles, references and solvers follow, and its digest."""
