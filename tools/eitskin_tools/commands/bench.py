"""``eitskin bench NAME``: one module a benchmark, imported only when it is named.

``BENCHMARKS`` is the whole table. A benchmark's module has ``add_arguments(parser)`` and ``run(arguments) -> int``,
as a subcommand's has, and prints one object under ``--json``.
"""

import argparse
import importlib
from types import ModuleType
from typing import Any, Final

from eitskin_tools.command_line import needs
from eitskin_tools.command_line.parser import Parser
from eitskin_tools.processes.threads import one_blas_thread

BENCHMARKS: Final[dict[str, str]] = {
    "frame": "from the wire to the subscriber, stage by stage, and other ways to infer the same map",
    "footprint": "memory, import time and size of the runtime",
    "skip": "what each skipped stage saves",
    "verify": "how often the verifier of touches is right, and whether its p-values are calibrated",
    "tradeoff": "accuracy against latency: networks, int8, classical solvers",
    "physics": "the sheet model against convergence and what must not change",
    "dataset": "samples a second of the data generators, beside one solve a sample",
    "stability": "the noise at which each solver breaks, and the same input twice",
    "electrodes": "how soon failing electrodes are named from the frames",
    "peer": "another tactile library beside ours: age of frames, damaged frames accepted",
}
"""Benchmarks, each with what it measures."""


class _Lazy(Parser):
    """A benchmark's parser, which asks its module for options when it is about to parse.

    Where packages are missing that the benchmark needs, it takes any words: what is missing is said afterwards.
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Declare the options, then parse."""
        name = self.prog.rsplit(" ", 1)[-1]
        if needs.missing(needs.NEEDS.get(f"bench {name}", ())):
            return super().parse_known_args([], namespace)
        if not self.get_default("benchmark_module"):
            self.set_defaults(benchmark_module=name)
            _module(name).add_arguments(self)
        return super().parse_known_args(args, namespace)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the benchmarks; each declares its own options when it is named."""
    subparsers = parser.add_subparsers(dest="benchmark", metavar="NAME", required=True, parser_class=_Lazy)
    for name, summary in BENCHMARKS.items():
        subparsers.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark that was named."""
    return int(_module(arguments.benchmark).run(arguments))


def _module(name: str) -> ModuleType:
    one_blas_thread()
    return importlib.import_module(f"eitskin_tools.bench.{name}")
