"""One module a subcommand, each with ``add_arguments(parser)`` and ``run(arguments) -> int``; see :mod:`eitskin_tools.cli`."""
