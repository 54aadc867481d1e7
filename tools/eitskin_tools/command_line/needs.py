"""Packages that a command needs beyond the runtime's own, checked before it starts, with the extra that brings them."""

import argparse
from collections.abc import Iterable
from importlib.util import find_spec
from typing import Final

from eitskin_proto.errors import SkinError

EXTRAS: Final[dict[str, str]] = {
    "scipy": "sim", "torch": "train", "onnx": "train", "onnxscript": "train", "matplotlib": "plot",
    "distributed": "cluster", "skfem": "dev", "mcap": "record", "pyarrow": "parquet", "rosbags": "ros",
}  # fmt: skip
"""Extra of ``pip install 'eitskin[EXTRA]'`` by the module that it brings."""

NEEDS: Final[dict[str, tuple[str, ...]]] = {
    "demo": ("scipy",),
    "virtual-skin": ("scipy",),
    "surface": ("scipy",),
    "simulate": ("scipy",),
    "dataset": ("scipy",),
    "evaluate": ("scipy",),
    "calibrate": ("scipy",),
    "record": ("mcap",),
    "replay": ("mcap",),
    "reinfer": ("mcap",),
    "convert": ("mcap",),
    "adapt-skin": ("scipy", "torch", "onnx", "onnxscript"),
    "build": ("scipy", "torch", "onnx", "onnxscript"),
    "card": ("scipy",),
    "train": ("scipy", "torch"),
    "curves": ("torch",),
    "adapt": ("scipy", "torch"),
    "export": ("scipy", "torch", "onnx", "onnxscript"),
    "bench frame": ("scipy",),
    "bench memory": ("scipy",),
    "bench recording": ("scipy", "mcap"),
    "bench skins": ("scipy",),
    "bench skip": ("scipy", "torch"),
    "bench tradeoff": ("scipy",),
    "bench physics": ("scipy", "skfem"),
    "bench surface": ("scipy",),
    "bench touches": ("scipy",),
    "bench view": ("scipy",),
    "bench dataset": ("scipy",),
    "bench ablation": ("scipy", "torch"),
    "bench stability": ("scipy",),
    "bench electrodes": ("scipy",),
    "bench twins": ("scipy", "torch", "onnx", "onnxscript"),
    "bench peer": ("scipy",),
    "bench gate": ("scipy", "torch"),
    "bench verify": ("scipy",),
}
"""Modules by command; those that are not here need none."""

OPTION_NEEDS: Final[dict[str, tuple[str, ...]]] = {
    "plot": ("matplotlib",), "picture": ("matplotlib",), "scheduler": ("distributed",),
}  # fmt: skip
"""Modules by option, whichever command has it."""

PART_NEEDS: Final[dict[str, dict[str, tuple[str, ...]]]] = {"bench electrodes": {"gate": ("torch",)}}
"""Modules by part, of benchmarks of which ``--only`` leaves parts out."""


class MissingExtraError(SkinError):
    """Packages are not installed; the text says which, and how to install them."""


def check(arguments: argparse.Namespace) -> None:
    """Refuse a command whose packages are not all installed, before it does anything.

    Raises:
        MissingExtraError: Some are missing.
    """
    name = " ".join(str(part) for part in (arguments.command, getattr(arguments, "benchmark", None)) if part)
    require(name, NEEDS.get(name, ()))
    for option, modules in OPTION_NEEDS.items():
        if getattr(arguments, option, None):
            require(f"--{option}", modules)
    asked = {part for given in getattr(arguments, "only", None) or () for part in given}
    for part, modules in PART_NEEDS.get(name, {}).items():
        if not asked or part in asked:
            require(f"part {part} of {name}", modules)


def require(who: str, modules: Iterable[str]) -> None:
    """Refuse what needs modules that are not installed.

    Args:
        who: What needs them.
        modules: Names, each with an entry in ``EXTRAS``.

    Raises:
        MissingExtraError: Some are missing.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise MissingExtraError(f"{who} needs {', '.join(missing)}: {install(missing)}")


def install(modules: Iterable[str]) -> str:
    """Return the command that installs some modules."""
    extras = {EXTRAS.get(module, "sim") for module in modules}
    if extras & {"train", "cluster", "dev"}:
        extras -= {"sim"}  # they bring it along
    return f"pip install 'eitskin[{','.join(sorted(extras))}]'"
