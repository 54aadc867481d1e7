"""``eitskin pair BUNDLE OTHER --out FILE``: another network goes into a bundle.

A smaller one is its solver ``vd2t-small`` then. With ``--gentle`` it is one that draws faint touches.
"""

import argparse
from pathlib import Path

from eitskin_tools.console.terminal import answer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("bundle", metavar="BUNDLE", help="the bundle to extend")
    parser.add_argument("other", metavar="OTHER", help="a bundle of the same skin and touches, with a smaller network")
    parser.add_argument(
        "--out", required=True, type=Path, metavar="FILE", help="the bundle; its name should end in .eitskin"
    )
    parser.add_argument(
        "--gentle",
        action="store_true",
        help="use OTHER's network for touches that BUNDLE's hardly shows; it may have any size",
    )


def run(arguments: argparse.Namespace) -> int:
    """Put the one into the other, and report."""
    from eitskin.model.manifest import GENTLE, SMALL
    from eitskin_export.pair import pair
    from eitskin_tools.command_line import files, kinds

    bundle, other = (files.find(name, files.BUNDLE) for name in (arguments.bundle, arguments.other))
    files.writable(arguments.out, kinds.BUNDLE)
    found = pair(bundle, other, arguments.out, GENTLE if arguments.gentle else SMALL)
    if arguments.gentle:
        more = f"and {found['gentle_head_bytes'] / 1e6:.2f} MB where it shows faint touches alone"
    else:
        more = f"with vd2t-small {found['small_head_bytes'] / 1e6:.2f} MB"
    return answer(
        arguments,
        found,
        f"{found['path']}: bundle {found['bundle']}, {found['bytes'] / 1e6:.1f} MB; a frame reads "
        f"{found['large_head_bytes'] / 1e6:.2f} MB of weights, {more}",
    )
