"""The command line, the benchmarks and the pictures; heavy imports stay inside the subcommand that needs them."""
