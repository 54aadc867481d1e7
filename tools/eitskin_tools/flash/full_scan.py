"""Switches a device to all 208 rows for a calibration, and back.

::

    show -> [its own, if that is built in] -> the same with 208 rows -> ... work ... -> rollback -> its own

Both ways are those of :mod:`eitskin_tools.flash.procedure`, so the device has one whole configuration or the other at
every instant, and its own stays in the other slot: a host that dies in between leaves a device that scans 208 rows, and
``eitskin flash rollback``, or the next calibration, brings its own back.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Final

from eitskin.acquisition.transport import Transport
from eitskin.errors import SkinError
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS
from eitskin_proto.wire.codes import HelloFlag
from eitskin_proto.wire.config import Configuration, largest_line_rate_hz
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange
from eitskin_tools.flash.procedure import FlashError, show
from eitskin_tools.processes.signals import met_by

NAME: Final = "calib208"
"""Of the configuration that is written for the while; short enough to stand beside a skin."""

ENDINGS: Final = (signal.SIGTERM, signal.SIGHUP)
"""A terminal that is closed, or a service that is stopped, ends the work as Ctrl-C does: not without going back."""

Opened = Callable[[], Transport]
Tell = Callable[[str], None]


def full_scan(configuration: Configuration, line_bytes_per_s: int = 0) -> Configuration:
    """Return a configuration of all 208 rows that is like another one in all else, slower where it must be.

    Args:
        configuration: What the device runs.
        line_bytes_per_s: What the line carries; 0 if it is no limit.
    """
    full = replace(
        configuration, name=NAME, revision=1, rows=N_FULL_ROWS, drives=ALL_DRIVES, idle_drives=0, idle_rate_mHz=0
    )
    line_mHz = 1000.0 * largest_line_rate_hz(N_FULL_ROWS, full.sample_bytes, line_bytes_per_s)
    return replace(full, rate_mHz=max(int(min(full.rate_mHz, 1e9 / full.scan_us(), line_mHz)), 1))


@contextmanager
def scanning_all_rows(opened: Opened, tell: Tell) -> Iterator[None]:
    """Have a device scan all 208 rows while something is done; nothing is written where it does so anyway.

    Args:
        opened: Opens the line to the device; each is closed again, so that the work may open one of its own.
        tell: Takes what is going on, for people.

    Raises:
        FlashError: The device could not be flashed, or not be brought back; the text says what it is left with.
        SkinError: It did not answer, or refused; it is as it was.
        TransportError: There is no line.
    """
    with met_by(signal.default_int_handler, *ENDINGS):
        changed = _begin(opened, tell)
        try:
            yield
        except BaseException as error:
            if changed and (failure := _back(opened, tell)):
                said = str(error) or "stopped"
                raise FlashError(f"{said}; {failure}") from error
            raise
        if changed and (failure := _back(opened, tell)):
            raise FlashError(failure)


def _begin(opened: Opened, tell: Tell) -> bool:
    """Return whether there is something to go back to."""
    exchange = Exchange(opened())
    try:
        shown = show(exchange)
        own = shown.active.configuration
        if own.name == NAME and shown.other is not None:
            tell(f"it scans {N_FULL_ROWS} rows since a calibration that ended early; it goes back after this one")
            return True
        if own.full:
            return False
        limits = [one for one in (shown.hello.line_bytes_per_s, exchange.transport.line_bytes_per_s) if one]
        full = full_scan(own, min(limits, default=0))
        tell(
            f"flashing: {N_FULL_ROWS} rows at {full.rate_hz:g}/s instead of {N_ROWS} at {own.rate_hz:g}/s, until the "
            f"recording is over; if this ends early, 'eitskin flash rollback' brings {own.name} back"
        )
        with _deaf():  # a Ctrl-C just before it returns would leave it as it is now
            if shown.hello.flags & HelloFlag.FACTORY:  # what is built in cannot be rolled back to
                procedure.write(exchange, own, allow_downgrade=True, reopen=opened)
            procedure.write(exchange, full, allow_downgrade=True, reopen=opened)
        return True
    finally:
        exchange.transport.close()


def _back(opened: Opened, tell: Tell) -> str:
    """Go back, and return what went wrong; "" if nothing did."""
    try:
        with _deaf():
            exchange = Exchange(opened())
            try:
                hello = procedure.rollback(exchange, opened)
            finally:
                exchange.transport.close()
    except SkinError as error:
        return f"the device still scans {N_FULL_ROWS} rows ({error}); bring its own back with 'eitskin flash rollback'"
    tell(f"the device scans {hello.rows} rows again, as {hello.configuration_name} says")
    return ""


def _deaf() -> AbstractContextManager[None]:
    """Hear no Ctrl-C."""
    return met_by(signal.SIG_IGN, signal.SIGINT, *ENDINGS)
