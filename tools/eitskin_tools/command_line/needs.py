"""Packages that a command needs beyond the runtime's own, checked before it starts, with the extra that brings them."""

import argparse
import sys
from collections.abc import Iterable
from importlib.util import find_spec
from typing import Final

from eitskin.errors import require_linux
from eitskin_proto.errors import SkinError

EXTRAS: Final[dict[str, str]] = {
    "scipy": "sim", "torch": "train", "onnx": "train", "onnxscript": "train", "matplotlib": "plot",
    "distributed": "cluster", "mcap": "record", "zstandard": "record", "lz4": "record",
    "pyarrow": "parquet", "rosbags": "ros",
}  # fmt: skip
"""Extra of ``pip install 'eitskin[EXTRA]'`` by the module that it brings, as in pyproject.toml."""

TORCH: Final = "torch==2.13.0"
"""What the Makefile installs alone and before anything else, and constraints.txt holds."""

RECORDINGS: Final = ("mcap", "zstandard")
"""What reads and writes recordings."""

NEEDS: Final[dict[str, tuple[str, ...]]] = {
    "demo": ("scipy",),
    "virtual-skin": ("scipy",),
    "surface": ("scipy",),
    "simulate": ("scipy",),
    "dataset": ("scipy",),
    "evaluate": ("scipy",),
    "calibrate": ("scipy",),
    "record": RECORDINGS,
    "replay": RECORDINGS,
    "reinfer": RECORDINGS,
    "plot": (*RECORDINGS, "matplotlib"),
    "convert": RECORDINGS,
    "adapt-skin": ("scipy", "torch", "onnx", "onnxscript"),
    "build": ("scipy", "torch", "onnx", "onnxscript"),
    "card": ("scipy",),
    "train": ("scipy", "torch"),
    "export": ("scipy", "torch", "onnx", "onnxscript"),
    **{
        f"bench {name}": ("scipy",)
        for name in ("frame", "skip", "verify", "tradeoff", "physics", "dataset", "stability", "electrodes", "peer")
    },
}
"""Modules by command; those that are not here need none."""

LINUX: Final = ("demo", "run", "virtual-skin", "reference", "flash", "service", "doctor", "replay")
"""Commands that read a device or publish."""

LEAST_MB: Final = 256
"""Address space that a command needs, and twice as much for scipy; with less, libraries abort or wait forever."""

OPTION_NEEDS: Final[dict[tuple[str, str], tuple[str, ...]]] = {
    ("bench tradeoff", "plot"): ("matplotlib",), ("dataset", "scheduler"): ("distributed",),
    ("teach", "picture"): ("matplotlib",), ("view", "file"): RECORDINGS,
}  # fmt: skip
"""Modules by command and what it was given."""


class MissingExtraError(SkinError):
    """Packages are not installed; the text says which, and how to install them."""


def check(arguments: argparse.Namespace) -> None:
    """Refuse a command whose packages are not all installed, or that may use too little memory for them.

    Raises:
        MissingExtraError: Some are missing.
        SkinError: The memory is limited, or the command needs Linux.
    """
    if arguments.command in LINUX:
        require_linux(arguments.command)
    name = " ".join(str(part) for part in (arguments.command, getattr(arguments, "benchmark", None)) if part)
    modules = ("scipy",) if getattr(arguments, "physics", False) else NEEDS.get(name, ())
    require(name, modules)
    for (command, option), more in OPTION_NEEDS.items():
        if command == name and (value := getattr(arguments, option)) is not None:
            require(f"{name} {value}", more)
    if sys.platform != "linux":
        return
    import resource

    allowed, least_mb = resource.getrlimit(resource.RLIMIT_AS)[0], LEAST_MB * (2 if "scipy" in modules else 1)
    if 0 <= allowed < least_mb << 20:
        raise SkinError(
            f"only {allowed >> 20} MB of memory are allowed, expected at least {least_mb} MB: allow more with "
            f"'ulimit -v {least_mb << 10}'"
        )


def require(who: str, modules: Iterable[str]) -> None:
    """Raise an error if a feature needs modules that are not installed.

    Args:
        who: What needs them.
        modules: Names, each with an entry in ``EXTRAS``.

    Raises:
        MissingExtraError: Some are missing.
    """
    absent = missing(modules)
    if absent:
        raise MissingExtraError(f"{who} needs {', '.join(absent)}: {install(absent)}")


def missing(modules: Iterable[str]) -> list[str]:
    """Return those of some modules that are not installed."""
    return [module for module in modules if find_spec(module) is None]


def install(modules: Iterable[str]) -> str:
    """Return the command that installs some modules, and why it is two where torch is among them.

    Args:
        modules: By name, parts of packages too; of one in no extra, what is installed with eitskin itself.
    """
    names = {module.partition(".")[0] for module in modules}
    extras = {EXTRAS[name] for name in names if name in EXTRAS}
    if extras & {"train", "cluster", "dev"}:
        extras -= {"sim"}  # they bring it along
    command = f"pip install 'eitskin[{','.join(sorted(extras))}]'" if extras else "pip install eitskin"
    if "torch" not in names:
        return command
    return f"pip install {TORCH} && {command} (torch alone and first: any other way may bring gigabytes of CUDA)"
