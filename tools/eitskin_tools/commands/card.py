"""``eitskin card BUNDLE``: measures a bundle's network at deformations, touches and devices that it was not trained on.

``eitskin build`` ends with the same card; this command is for other bundles.
"""

import argparse
from pathlib import Path
from typing import Any

from eitskin_tools.command_line.parser import whole
from eitskin_tools.console.terminal import answer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("bundle", metavar="BUNDLE", help="a file, or a shipped one's name")
    parser.add_argument(
        "--deformations", type=whole(1), default=8, metavar="N", help="deformations not trained on (default: 8)"
    )
    parser.add_argument(
        "--each", type=whole(1), default=3, metavar="N", help="touches at each deformation (default: 3)"
    )
    parser.add_argument("--draws", type=whole(1), default=2, metavar="N", help="devices of each mismatch (default: 2)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the bundle with the card in its manifest")


def run(arguments: argparse.Namespace) -> int:
    """Try the bundle part by part, and report."""
    from eitskin.model.bundle import load_bundle
    from eitskin_tools.command_line import files, kinds
    from eitskin_tools.console.progress import Stages
    from eitskin_tools.evaluation import card, physics_card

    sizes = (arguments.deformations, arguments.each, arguments.draws)
    path = files.find(arguments.bundle, files.BUNDLE)
    if arguments.out is not None:
        files.writable(arguments.out, kinds.BUNDLE)
    if not load_bundle(path, lazily=True).has_network:
        whole = physics_card.card_of(path)
        return _report(arguments, path, whole, [physics_card.summary(whole), *physics_card.lines_of(whole)])
    found = {}
    with Stages() as tell:
        for name in card.parts(path):
            tell(name)
            found[name] = card.part(name, path, *sizes)
    whole = card.whole(found, path)
    return _report(arguments, path, whole, card.lines_of(whole))


def _report(arguments: argparse.Namespace, path: Path, whole: dict[str, Any], lines: list[str]) -> int:
    from eitskin_tools.build.steps import finish

    identity = None if arguments.out is None else finish(path, whole, arguments.out)
    if identity is not None:
        lines = [*lines, f"{arguments.out}: bundle {identity}, with this card"]
    return answer(arguments, {"bundle": identity, "path": str(arguments.out or path), "card": whole}, *lines)
