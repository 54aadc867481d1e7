"""A virtual environment with the peer's own package, kept under the user's cache; never a dependency of ours."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Final

from eitskin_proto.errors import SkinError

PACKAGE: Final = "flexitac==0.3.1"
"""What is compared with, pinned: another version may have another format."""


def cache_folder() -> Path:
    """Return where the environment is kept."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "eitskin" / f"peer-{PACKAGE.replace('==', '-')}"


def peer_python(folder: Path | None = None) -> Path:
    """Return the interpreter of an environment that has the package, made if it is not there.

    Args:
        folder: Of the environment; None takes :func:`cache_folder`.

    Raises:
        SkinError: It cannot be made or the package cannot be installed.
    """
    where = folder or cache_folder()
    python, done = where / "bin" / "python", where / "installed"
    if done.exists() and python.exists():
        return python
    for command in (
        [sys.executable, "-m", "venv", "--clear", str(where)],
        [str(python), "-m", "pip", "--disable-pip-version-check", "--quiet", "install", PACKAGE],
    ):
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode:
            last = (result.stderr.strip().splitlines() or ["no output"])[-1]
            raise SkinError(
                f"{PACKAGE} cannot be installed into {where} ({last}); this benchmark needs a package index"
            )
    done.touch()
    return python
