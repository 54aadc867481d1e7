"""What ``eitskin run --config`` says: each line of each skin, with its name before it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.run_status import Status


class RobotLog:
    """Writes events of several skins.

    Args:
        log: Where they go.
    """

    def __init__(self, log: RunLog) -> None:
        self._log = log

    def event(self, name: str, event: Mapping[str, Any]) -> None:
        """Report what a skin said: an object of its log."""
        kind = str(event["event"])
        fields = {key: value for key, value in event.items() if key not in ("event", "time_utc")}
        self._log.event(kind, f"eitskin run: {name}: {_text(kind, fields)}", {"skin": name, **fields})

    def warn(self, name: str, text: str) -> None:
        """Report something that is wrong and stops no skin."""
        self._log.event("warning", f"eitskin run: {name}: {text}", {"skin": name, "text": text})

    def failed(self, name: str, text: str) -> None:
        """Report that a skin's process ended before its time."""
        self._log.event("error", f"eitskin run: {name}: {text}", {"skin": name, "text": text})

    def ready(self, folder: Path, names: Sequence[str], count: int) -> None:
        """Report that every skin was ready or has failed once."""
        text = f"ready {len(names)} of {count} skins publish, folder {folder}: {', '.join(names) or 'none'}"
        self._log.event("ready", text, {"folder": str(folder), "skins": list(names), "of": count})


def _text(kind: str, fields: Mapping[str, Any]) -> str:
    """Return what people read of an event."""
    if kind == "ready":
        return f"publishing on {fields.get('publish')} control {fields.get('control')}"
    if kind == "status" and isinstance(rate := fields.get("rate_hz"), int | float):
        return Status(float(rate), fields.get("touched"), fields).text()
    stacks = fields.get("stacks")
    more = "".join(f" | {line}" for line in stacks) if isinstance(stacks, list) else ""
    return f"{fields.get('text', '')}{more}"
