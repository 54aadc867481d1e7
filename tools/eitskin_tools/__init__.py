"""The command line, the benchmarks and the pictures; it may use every other package, inside the subcommand that needs it."""
