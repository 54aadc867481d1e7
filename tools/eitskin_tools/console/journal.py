"""Lines for systemd's journal: how grave each is, in front of it (``sd-daemon(3)``), where the journal reads us.

systemd names the device and inode of the stream that goes to the journal in ``JOURNAL_STREAM``. A stream that was
redirected since has others, and gets plain lines.
"""

import os
from collections.abc import Mapping
from typing import Final, TextIO

LEVELS: Final = {"error": 3, "warning": 4, "ready": 5, "info": 6, "status": 6}
"""syslog's levels by event: err, warning, notice, info."""


def goes_to_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Return whether a stream is the one that the journal reads."""
    device, _, inode = environment.get("JOURNAL_STREAM", "").partition(":")
    if not device.isdecimal() or not inode.isdecimal():
        return False
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or none of the system's
        return False
    return (found.st_dev, found.st_ino) == (int(device), int(inode))


def prefix(event: str) -> str:
    """Return what stands before a line of an event in the journal."""
    return f"<{LEVELS.get(event, 6)}>"
