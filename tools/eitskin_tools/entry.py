"""The command ``eitskin`` as it is installed: :mod:`eitskin_tools.cli`, with Ctrl-C met before it and behind it.

While modules are imported, and while the interpreter ends, there is nothing to close: Ctrl-C ends the process at once,
without a traceback.
"""

import sys


def main() -> int:
    """Run one subcommand and return its exit status."""
    try:
        _end_at_once()
        from eitskin_tools import cli
    except KeyboardInterrupt:
        return 130
    status = cli.main()
    _end_at_once()
    return status


def _end_at_once() -> None:
    """Let Ctrl-C end the process, unless the parent process has it ignored, as a script's ``&`` does."""
    import signal  # here, since Ctrl-C may come amid it

    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
