"""``eitskin bench peer``: another tactile library's reader beside ours, on the same payloads, rate and kind of port.

The peer is flexitac 0.3.1, read by its own package in a virtual environment of its own. Ages count from the moment
before the sensor's write to the moment at which a reader returns the frame: ``read()`` and ``read_latest()`` as
flexitac's users call them, ours as far as an intact payload. Ours is also measured to the end, a subscriber in a third
process with a map inferred on the way ("stream"). The rows take turns in one run. Then 1000 frames with one inverted
bit each: how many come back as if they had been sent like that.
"""

import argparse
import json
import sys
from typing import Any

from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=2000, metavar="N", help="frames of each reader (default 2000)")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="frames a second (default 100)")
    parser.add_argument("--flipped", type=int, default=1000, metavar="N", help="frames with one flipped bit each")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    from eitskin_tools.bench.frame.bench import machine, stream
    from eitskin_tools.bench.peer.compare import ages, corruption, ours, theirs
    from eitskin_tools.bench.peer.environment import PACKAGE, peer_python

    if arguments.frames < 100 or arguments.flipped < 1 or not arguments.rate > 0:
        raise UsageError("--frames must be at least 100, --flipped at least 1 and --rate above 0")
    python = peer_python()
    readers = {
        "flexitac read()": theirs(python, "read"),
        "flexitac read_latest()": theirs(python, "read_latest"),
        "eitskin": ours(),
    }
    rows: dict[str, dict[str, Any]] = {}
    for name, reader in readers.items():
        print(f"eitskin bench peer: {name}, {arguments.frames} frames at {arguments.rate:g} Hz", file=sys.stderr)
        rows[name] = {
            **ages(reader, arguments.frames, arguments.rate),
            "flipped": corruption(reader, arguments.flipped, arguments.rate),
        }
    whole = stream(arguments.rate, arguments.frames, None)
    rows["eitskin, stream to a subscriber"] = {
        "sent": whole["frames"] + whole["lost"],
        "returned": whole["frames"],
        "returned_hz": whole["rate_hz"],
        "age_us": whole["latency_us"],
    }
    if arguments.json:
        told = {"rows": flat_rows(rows), "summary": summary(rows)}
        print(json.dumps({"peer": PACKAGE, "rate_hz": arguments.rate, **told, "machine": machine()}))
        return 0
    for name, row in rows.items():
        age, bad = row["age_us"], row.get("flipped")
        text = f"{name}: {row['returned']} of {row['sent']} frames, age p50 {age['p50']} us, p99 {age['p99']} us"
        print(text + (f"; of {bad['sent']} damaged ones {bad['corrupt_accepted']} accepted" if bad else ""))
    return 0


def flat_rows(readers: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each reader, with what each of its parts holds beside the rest."""
    found = []
    for name, row in readers.items():
        flat = {"what": name}
        for key, value in row.items():
            flat |= {f"{key}_{part}": one for part, one in value.items()} if isinstance(value, dict) else {key: value}
        found.append(flat)
    return found


def summary(readers: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return, by reader, the median age of its frames and how many damaged ones it took for intact."""
    return {
        name: {
            "age_p50_us": row["age_us"]["p50"],
            "corrupt_accepted": row["flipped"]["corrupt_accepted"] if "flipped" in row else None,
        }
        for name, row in readers.items()
    }
