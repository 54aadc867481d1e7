"""Reading the virtual skin's log: one JSON object a line, written as things happen."""

import json
import time
from pathlib import Path
from typing import Any


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return the events so far; a line that is still being written is left out."""
    try:
        text = path.read_text()
    except FileNotFoundError:
        return []
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def script_start(path: Path, timeout_s: float = 120.0) -> dict[str, Any]:
    """Wait for the event at which the script began, the first START, and return it.

    Raises:
        TimeoutError: It did not come.
    """
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        for event in read_log(path):
            if event["event"] == "start":
                return event
        time.sleep(0.02)
    raise TimeoutError(f"the virtual skin was not started within {timeout_s:g} s")
