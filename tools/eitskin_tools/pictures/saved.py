"""Figures in files: whole or not at all, in the format that the end of the name says."""

from pathlib import Path
from typing import Any

from eitskin_proto.files.writing import replacing


def save(figure: Any, path: str | Path, dpi: float = 100.0) -> None:
    """Write a figure of matplotlib; a name without an end becomes a PNG.

    Args:
        figure: It is left open.
        path: Whose end is among :data:`eitskin_tools.command_line.files.PICTURES`.
        dpi: Pixels an inch, where the format has pixels.

    Raises:
        OSError: It cannot be written.
    """
    with replacing(path) as stream:
        figure.savefig(stream, format=Path(path).suffix.lower().removeprefix(".") or "png", dpi=dpi)
