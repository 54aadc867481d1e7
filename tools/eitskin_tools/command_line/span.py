"""``--from`` and ``--to``: the part of a recording that a command takes."""

import argparse
from typing import Final

from eitskin_tools.errors import UsageError

LONGEST_S: Final = 1e9
"""Thirty years: nothing was recorded for longer."""


def add_span(parser: argparse.ArgumentParser) -> None:
    """Declare ``--from`` and ``--to``."""
    parser.add_argument("--from", type=float, dest="from_s", metavar="S", help="begin S seconds after the first frame")
    parser.add_argument("--to", type=float, dest="to_s", metavar="S", help="end S seconds after the first frame")


def check_span(arguments: argparse.Namespace) -> None:
    """Refuse a part that no recording has.

    Raises:
        UsageError: A bound is no time after the first frame, or the part ends before it begins.
    """
    begin_s, end_s = arguments.from_s, arguments.to_s
    for option, value in (("--from", begin_s), ("--to", end_s)):
        if value is not None and not 0 <= value < LONGEST_S:
            raise UsageError(f"{option} is {value:g}, expected 0 or more seconds after the first frame")
    if begin_s is not None and end_s is not None and begin_s >= end_s:
        raise UsageError(f"--from {begin_s:g} is not before --to {end_s:g}")
