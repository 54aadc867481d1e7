"""Plain words for the codes of frames, status and recordings, on a terminal and on the page of ``eitskin view``."""

from typing import Final

WITHHELD: Final = {
    "malformed": "not a frame of this device",
    "duplicate": "repeats a number",
    "configuration": "made under another configuration",
    "partial": "scans only some drives",
    "implausible": "values out of range",
    "no_signal": "almost no voltage",
    "stuck": "identical rows, front end stuck",
    "frozen": "repeats earlier readings, front end hangs",
    "reversed": "rows changed their sign",
    "unlike": "rows do not fit each other, wires exchanged?",
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
    "cloud:fitted": "the network uses the shape that physics found",
    "cloud:unlike_training:stretch": "the surface is stretched beyond what the network learned: add --verify idle",
    "cloud:unlike_training:bend": "the surface is bent beyond what the network learned: add --verify idle",
    "cloud:unlike_training:dent": "the surface has a dent or bump, unlike what the network learned: add --verify idle",
    "touches:lower": "touches seem to lower conductance: start with --touches lower",
    "touches:raise": "touches seem to raise conductance: start with --touches raise",
    "touches:unlisted": "touched for 3 s, nothing on the map: send a cloud, renew the reference, try other --touches",
    "overrun": "over the latency budget",
    "electrodes:unclear": "rows fit no sheet and no single electrode failure",
    "drift:uneven": "uneven drift",
    "verifier:starting": "verifier starts",
    "verifier:preparing": "verifier prepares its model of the surface",
    "verifier:ready": "verifier ready, checks frames",
    "verifier:waiting": "verifier stopped and will restart, frames are not checked",
    "verifier:failed": "verifier failed, frames are not checked",
    "device:restarting": "device restarts",
    "device:configuration_changed": "device has a new configuration",
    "device:rolled_back": "device returned to its previous configuration",
    "device:overrun": "device skipped scans, too slow for its rate",
    "device:front_end_failed": "the device's front end does not answer",
}
"""Events whose code says everything."""

SKIPPED: Final = {
    "inference:untouched": "no map computed: nothing touches",
    "inference:unchanged": "last map kept: only noise changed",
    "inference:idle": "no map computed: few drives scanned",
    "acquisition:idle": "few drives scanned: nothing touches",
    "map:region": "only a part of the map computed",
    "map:unchanged": "map not sent again: unchanged",
    "map:untouched": "untouched, confirmed by a map",
    "geometry:cloud_unchanged": "surface kept: no new cloud",
}
"""What the runtime left out for a frame."""

STATES: Final = {"back": "works again", "not reciprocal": "inconsistent", "excluded": "switched off"}
"""Of electrodes, whose other states are words."""

REPAIRS: Final = {"imputed": "estimated", "rearranged": "reordered"}
"""How an electrode's rows are replaced."""


def event_words(code: str) -> str:
    """Return an event of a frame in words."""
    kind, _, rest = code.partition(":")
    if code in EVENTS:
        return EVENTS[code]
    if kind == "withheld":
        return f"frame withheld: {WITHHELD.get(rest, rest)}"
    if kind == "electrode":
        return electrode_words(rest)
    if kind == "rows":
        rows, _, what = rest.partition(":")
        return f"rows {rows} frozen (estimated)" if what == "frozen" else f"rows {rows} work again"
    if kind == "drift":
        return f"drift of {rest.replace('%', ' %')}, or a long touch"
    return readable(code)


def skipped_words(code: str) -> str:
    """Return an entry of ``skipped`` in words."""
    return SKIPPED.get(code) or readable(code)


def electrode_parts(entry: str) -> tuple[str, str, str]:
    """Return an entry of ``electrodes``, such as ``5:detached:imputed``: number, state and repair in words."""
    number, state, repair = (*entry.split(":"), "", "")[:3]
    return number, STATES.get(state, state), REPAIRS.get(repair, repair)


def electrode_words(entry: str) -> str:
    """Return an entry of ``electrodes`` in words."""
    number, state, repair = electrode_parts(entry)
    return f"electrode {number} {state}" + (f" (rows {repair})" if repair else "")


def readable(code: str) -> str:
    """Return a code without words as readable text."""
    return code.replace("_", " ").replace(":", ": ")


def capital(words: str) -> str:
    """Return words that begin with a capital letter, for a list on a page."""
    return words[:1].upper() + words[1:]
