"""``eitskin pair BUNDLE SMALL --out FILE``: a smaller network goes into a bundle, as its solver ``vd2t-small``.

With ``--replace`` the other's network takes the place of the bundle's own.
"""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("bundle", metavar="BUNDLE", help="the larger one; everything of it stays")
    parser.add_argument("small", metavar="SMALL", help="a bundle of the same skin and touches with a smaller network")
    parser.add_argument(
        "--out", required=True, type=Path, metavar="FILE", help="the bundle; its name should end in .eitskin"
    )
    parser.add_argument(
        "--replace", action="store_true", help="SMALL's network takes the place of BUNDLE's; its gate and all else stay"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Put the one into the other, and report."""
    from eitskin_export.pair import pair, replaced
    from eitskin_tools.command_line import files

    large, small = (files.find(name, files.BUNDLE) for name in (arguments.bundle, arguments.small))
    files.writable(arguments.out)
    found = (replaced if arguments.replace else pair)(large, small, arguments.out)
    if arguments.json:
        print(json.dumps(found))
        return 0
    small_too = "" if arguments.replace else f", with vd2t-small {found['small_head_bytes'] / 1e6:.2f} MB"
    print(
        f"{found['path']}: bundle {found['bundle']}, {found['bytes'] / 1e6:.1f} MB; a frame reads "
        f"{found['large_head_bytes'] / 1e6:.2f} MB of weights{small_too}"
    )
    return 0
