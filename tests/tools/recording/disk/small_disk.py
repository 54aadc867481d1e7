"""A real file system with little room: a tmpfs that one process alone sees, and that is gone when it ends."""

import shutil
import subprocess
from functools import cache
from pathlib import Path

INSIDE = 'mount -t tmpfs -o size="$1" small "$2" || exit 99; out="$3"; disk="$2"; shift 3; "$@"; found=$?; '
INSIDE += 'cp -a "$disk/." "$out" || exit 98; exit $found'


@cache
def unsharing() -> list[str] | None:
    """Return the command that lets a process mount for itself, or None where neither way is permitted."""
    if shutil.which("unshare") is None:
        return None
    for options in ("-m", "-rm"):
        command = ["unshare", options]
        probe = [*command, "mount", "-t", "tmpfs", "-o", "size=64k", "probe", "/mnt"]
        if subprocess.run(probe, capture_output=True, timeout=60, check=False).returncode == 0:
            return command
    return None


def on_small_disk(size: int, disk: Path, out: Path, words: list[str]) -> list[str]:
    """Return the command that runs another with so many bytes of room, and then copies what it left.

    Args:
        size: Of the file system, in bytes; the kernel rounds it up to pages.
        disk: Folder on which it lies.
        out: Folder, elsewhere, for what is left.
        words: The other command; its status is the status.
    """
    command = unsharing()
    assert command is not None
    for folder in (disk, out):
        folder.mkdir(exist_ok=True)
    return [*command, "sh", "-c", INSIDE, "sh", str(size), str(disk), str(out), *words]
