"""Which signals ask a command to end."""

import signal

from eitskin_tools.processes.signals import endings, met_by


def test_a_closed_terminal_asks_for_an_end_unless_whoever_started_us_said_that_it_may_close() -> None:
    with met_by(signal.SIG_DFL, signal.SIGHUP):
        assert endings() == (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with met_by(signal.SIG_IGN, signal.SIGHUP):
        assert endings() == (signal.SIGINT, signal.SIGTERM)
