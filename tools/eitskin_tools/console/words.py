"""Plain words for the codes that frames, status and recordings carry; a code without words is shown as it is."""

from typing import Final

WITHHELD: Final = {
    "malformed": "not a frame of this device",
    "duplicate": "repeats a number",
    "configuration": "made under another configuration",
    "partial": "scans only some drives",
    "implausible": "values out of range",
    "no_signal": "almost no voltage",
    "stuck": "identical rows, front end stuck",
    "frozen": "repeats an earlier frame, front end hangs",
    "stale": "too late, a newer one came",
}
"""Why a frame is withheld."""

EVENTS: Final = {
    "lost": "frames lost before this one",
    "device_reset": "device restarted",
    "recovered": "device back after silence",
    "saturated": "a row exceeds the converter's range",
    "cloud": "new cloud in use",
    "reference": "new reference in use",
    "idle": "idle, scans a few drives",
    "awake": "scans all drives again",
    "gate_overruled": "the map shows a touch that the gate missed",
    "overrun": "over the latency budget",
    "electrodes:unclear": "rows fit no sheet and no single electrode failure",
    "drift:uneven": "uneven drift",
}
"""Events whose code says everything."""


def event_words(code: str) -> str:
    """Return an event of a frame in words."""
    if code in EVENTS:
        return EVENTS[code]
    kind, _, rest = code.partition(":")
    if kind == "withheld":
        return f"frame withheld: {WITHHELD.get(rest, rest)}"
    if kind == "electrode":
        return electrode_words(rest)
    if kind in ("drift", "verifier", "device"):
        return f"{kind} {rest.replace('_', ' ')}"
    return code


def electrode_words(entry: str) -> str:
    """Return an entry of ``electrodes`` in words, such as ``5:detached:imputed``."""
    number, _, state = entry.partition(":")
    if state == "back":
        return f"electrode {number} works again"
    state, _, replaced = state.partition(":")
    return f"electrode {number} {state}" + (f" (rows {replaced})" if replaced else "")
