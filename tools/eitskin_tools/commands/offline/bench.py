"""``eitskin bench NAME``: one module a benchmark, imported only when it is named.

``BENCHMARKS`` is the whole table. A benchmark's module has ``add_arguments(parser)`` and ``run(arguments) -> int``,
as a subcommand's has, and prints one object under ``--json``.
"""

import argparse
import importlib
from types import ModuleType
from typing import Any, Final

from eitskin_tools.command_line.parser import Parser

BENCHMARKS: Final[dict[str, str]] = {
    "frame": "from the wire to the subscriber, stage by stage, and other ways to infer the same map",
    "footprint": "memory, import time and size of the runtime",
    "memory": "whether the runtime's memory stays flat over minutes at 1000 frames a second",
    "skins": "what a skin takes of a core, and how many skins lose no frame",
    "skip": "what each skipped stage saves",
    "touches": "what the list of touches takes for a frame, and how far off it is",
    "view": "what the live page costs, with 0, 1 and 3 pages open, and that the stream loses nothing by it",
    "recording": "what recorder and viewer cost the stream, with and without them, and that the file is whole",
    "verify": "what the verifier of touches survives, and whether its p-values keep their word",
    "tradeoff": "accuracy against latency: networks, int8, classical solvers",
    "physics": "the sheet model against closed forms, convergence and an independent 3-D slab",
    "surface": "measured points to a cloud, V_pred and operators, and what the classical solvers take",
    "dataset": "samples a second of the data generators, beside one solve a sample and pyEIT",
    "ablation": "what each input of the network is worth, and how many deformations it needs",
    "stability": "what breaks a skin, at which level, and why",
    "gate": "faint presses that a bundle's gate finds, and what an ideal observer would",
    "electrodes": "failing electrodes and drift: named from the frames, and what is left without them",
    "twins": "what calibrating a device, and adapting a bundle to it, is worth on that device",
    "peer": "another tactile library beside ours: age of frames, damaged frames accepted",
}
"""Benchmarks, each with what it measures."""


def available() -> dict[str, str]:
    """Return the benchmarks that this installation has."""
    return {name: text for name, text in BENCHMARKS.items() if _exists(name)}


def _exists(name: str) -> bool:
    from importlib.util import find_spec

    return find_spec(f"eitskin_tools.bench.{name}.bench") is not None


class _Lazy(Parser):
    """A benchmark's parser, which asks its module for options when it is about to parse."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Declare the options, then parse."""
        name = self.prog.rsplit(" ", 1)[-1]
        if not self.get_default("benchmark_module"):
            self.set_defaults(benchmark_module=name)
            _module(name).add_arguments(self)
        return super().parse_known_args(args, namespace)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the benchmarks; each declares its own options when it is named."""
    subparsers = parser.add_subparsers(dest="benchmark", metavar="NAME", required=True, parser_class=_Lazy)
    for name, summary in available().items():
        subparsers.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark that was named."""
    return int(_module(arguments.benchmark).run(arguments))


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"eitskin_tools.bench.{name}.bench")
