"""``eitskin bench skip``: for each skip of the frame loop, the CPU that it saves and the error that it makes.

::

    untouched        nothing touches: no inference         false alarms and misses at fresh deformations
    cloud_unchanged  no geometry graph                     the same map
    no_subscriber    the gate alone                        the same map for whoever comes
    unchanged        the map of an earlier frame           likeness to the map that was not computed
    idle             the device scans a few drives         false alarms and misses, and the time to the first full frame

Costs are CPU times of the runtime's own pipeline, with and without, in turns in one run. A skip that this bundle does
not have is left out, with the reason.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=2000, metavar="N", help="frames of each way (default 2000)")
    parser.add_argument("--bends", type=int, default=100, metavar="N", help="fresh bends of A and of B (default 100)")
    parser.add_argument(
        "--touches", type=int, default=20, metavar="N", help="touches of each kind to wake an idling skin (default 20)"
    )
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to run (default: the shipped one)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 20 or arguments.bends < 2 or arguments.touches < 1:
        raise UsageError("--frames must be at least 20, --bends at least 2 and --touches at least 1")
    found = measure(arguments.bundle, arguments.frames, arguments.bends, arguments.seed, touches=arguments.touches)
    if arguments.json:
        print(json.dumps({"rows": flat_rows(found["skips"]), "summary": summary(found["skips"]), **found}))
    else:
        _print(found)
    return 0


def measure(path: Path | None, frames: int, bends: int, seed: int = 0, *, touches: int = 20) -> dict[str, Any]:
    """Return the rows, what is missing, and what it was measured on.

    Args:
        path: Of the bundle; None for the shipped one.
        frames: Of each way.
        bends: Fresh bends of A and of B for false alarms; a tenth of it for motions and touches.
        seed: Of the noise.
        touches: Of each kind, that wake an idling skin.
    """
    import numpy as np

    from eitskin.model.bundle import load_bundle
    from eitskin_tools.bench.frame.bench import machine
    from eitskin_tools.bench.skip import gate_row, idle_row, rows
    from eitskin_tools.bench.skip.frames import Material

    rng = np.random.default_rng(seed)
    bundle = load_bundle(path)
    _say("solving what the pipelines are shown")
    shown = Material.of(rng)
    _say("what each skip saves")
    found = rows.costs(bundle, shown, frames)
    missing: dict[str, str] = {}
    if bundle.gate_arrays() is None:
        missing["untouched"] = "this bundle has no gate"
    else:
        _say("errors of the gate at fresh deformations")
        found["untouched"]["error"] = gate_row.errors_of(bundle, shown.reference_V, bends, rng)
    _say("idle acquisition")
    idle = idle_row.idle(bundle, shown, bends, touches, rng)
    if idle is None:
        missing["idle"] = "this bundle has no idle gate"
    else:
        found["idle"] = idle
    return {"skips": found, "missing": missing, "bundle": bundle.id, "bends": bends, "machine": machine()}


def flat_rows(skips: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each skip: its numbers, and the mean CPU time of a frame each way."""
    return [
        {
            "what": name,
            **{key: value for key, value in row.items() if isinstance(value, int | float | str)},
            **{f"{way}_us": times["cpu_mean"] for way, times in row.get("us", {}).items()},
        }
        for name, row in skips.items()
    ]


def summary(skips: dict[str, Any]) -> dict[str, float]:
    """Return which share of a frame's CPU time each skip leaves."""
    return {f"{name}_cpu_left": row["cpu_left"] for name, row in skips.items() if "cpu_left" in row}


def _say(text: str) -> None:
    print(f"eitskin bench skip: {text}", file=sys.stderr, flush=True)


def _print(found: dict[str, Any]) -> None:
    print(f"{'skip':18}{'CPU with':>10}{'without':>10}{'left':>8}   (us a frame, mean)")
    for name, row in found["skips"].items():
        if "us" in row:
            times = row["us"]
            with_us, without_us = times["with"]["cpu_mean"], times["without"]["cpu_mean"]
            print(f"{name:18}{with_us:10.1f}{without_us:10.1f}{row['cpu_left']:8.2f}")
    for name in ("untouched", "idle"):
        if name in found["skips"]:
            _print_errors(name, found["skips"][name])
    for name, reason in found["missing"].items():
        print(f"{name}: {reason}")


def _print_errors(name: str, row: dict[str, Any]) -> None:
    if "chosen_by" in row:
        shares = ", ".join(f"{entry['drives']} {entry['share_of_information']:.2f}" for entry in row["chosen_by"])
        print(f"idle drives {row['drives']}; best subsets and their share of the information: {shares}")
        print(f"idle times: {json.dumps(row['configuration'])}")
        for touch, met in row["touch_to_first_full_frame"].items():
            print(f"idle, {touch}: ms from the touch to the first full frame, measured: {json.dumps(met)}")
    for where, noises in row["error"]["false_alarms"].items():
        rates = ", ".join(
            f"{noise} {100 * entry['rate']:.2f} % ({100 * entry['interval_95'][0]:.2f} to "
            f"{100 * entry['interval_95'][1]:.2f})"
            for noise, entry in noises.items()
        )
        print(f"{name}, false alarms, {where}: {rates}")
    for touch, families in row["error"]["missed"].items():
        for family, noises in families.items():
            shares = ", ".join(
                f"{noise} {100 * entry['missed']:.1f} % "
                f"({100 * entry['told']:.1f} told, {100 * entry['untold']:.1f} untold)"
                for noise, entry in noises.items()
            )
            print(f"{name}, missed, {touch}, {family}: {shares}")
    for family, speeds in row["error"]["growing_10mm"].items():
        for speed, noises in speeds.items():
            text = ", ".join(f"{noise} {_seen(entry)}" for noise, entry in noises.items())
            print(f"{name}, touch growing over {speed}, {family}: {text}")


def _seen(entry: dict[str, Any]) -> str:
    if not entry["frames_until_seen"]:
        return "never"
    return f"frame {entry['frames_until_seen']['p50']:.0f}, contrast {entry['contrast_when_seen']['p50']:.1f}"
