"""Where the firmware's sources are, and how to build the library and the image that the fault tests use."""

import fcntl
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eitskin_proto.errors import SkinError

FOLDER = Path(__file__).resolve().parents[2] / "firmware_proto"
"""The sources, in a checkout."""


def missing_tools(target: str) -> list[str]:
    """Return the programs that a target needs and that are not installed: ``host``, ``firmware`` or ``qemu``."""
    needed = {
        "host": ["make", "cc"],
        "firmware": ["make", "arm-none-eabi-gcc"],
        "qemu": ["make", "arm-none-eabi-gcc", "qemu-system-arm"],
    }[target]
    return [program for program in needed if shutil.which(program) is None]


def build(target: str) -> Path:
    """Build ``host`` or ``firmware`` and return the file; processes that ask at once build one after the other.

    Raises:
        SkinError: Not a checkout, a program is missing, or the compiler refused.
    """
    if not (FOLDER / "core").is_dir():
        raise SkinError(f"the firmware's sources are not in {FOLDER}: this needs a source checkout of eitskin")
    missing = missing_tools(target)
    if missing:
        raise SkinError(
            f"{', '.join(missing)} not found: apt-get install build-essential gcc-arm-none-eabi "
            "libnewlib-arm-none-eabi qemu-system-arm"
        )
    with _alone():
        done = subprocess.run(["make", "-s", "-C", str(FOLDER), target], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SkinError(f"make {target} failed: {(done.stderr or done.stdout).strip()[-500:]}")
    return FOLDER / ".build" / {"host": "libeit.so", "firmware": "eitskin.elf"}[target]


@contextmanager
def _alone() -> Iterator[None]:
    """Hold the build folder: two compilers that write one file leave neither whole."""
    folder = FOLDER / ".build"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield
