"""A process that asks for verdicts and leaves again, in turns, so that one stream is measured with and without them."""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import eitskin
from eitskin_tools.processes.signals import Stopped, stop_when_told

PATIENCE_S = 300.0
"""How long the first model may take."""


def take_turns(endpoint: str, phase_s: float, path: Path) -> None:
    """Ask for verdicts in every other phase until told to stop, and write down when, and what came.

    Args:
        endpoint: Where the runtime publishes.
        phase_s: Of a phase.
        path: File to write: ``phases`` (n, 2) begin and end in ns; ``spent_ms``, ``behind_ms`` and ``flagged`` of
            verdicts; ``counts`` as of the last message.
    """
    phases, spent_ms, behind_ms, flagged = list[tuple[int, int]](), list[float](), list[float](), list[bool]()
    counts = [0, 0, 0]
    with eitskin.subscribe_verified(endpoint, "all", frames=False, timeout_s=PATIENCE_S) as verdicts:
        while (state := verdicts.next_verified().state) != "ready":
            if state == "failed":
                raise eitskin.SkinError("the verifier cannot make a model of this sheet")
    print("ready", flush=True)
    try:
        while True:
            time.sleep(phase_s)
            begin_ns = time.perf_counter_ns()
            with eitskin.subscribe_verified(endpoint, "all", frames=False) as verdicts:
                end_ns = begin_ns + round(phase_s * 1e9)
                while (left_s := (end_ns - time.perf_counter_ns()) * 1e-9) > 0:
                    try:
                        found = verdicts.next_verified(left_s)
                    except eitskin.NoFrame:
                        break
                    counts = list(found.counts.values())
                    if found.verified:
                        spent_ms.append(found.spent_s * 1e3)
                        behind_ms.append((found.received_ns - found.host_ns["publish"]) * 1e-6)
                        flagged.append(bool(found.flagged))
            phases.append((begin_ns, time.perf_counter_ns()))
    except Stopped:
        np.savez(
            path, phases=np.array(phases, dtype=np.int64).reshape(-1, 2), spent_ms=spent_ms, behind_ms=behind_ms,
            flagged=np.array(flagged, dtype=np.bool_), counts=counts,
        )  # fmt: skip


def main() -> int:
    """Run the process."""
    parser = argparse.ArgumentParser(description="Ask for verdicts in turns.")
    parser.add_argument("endpoint")
    parser.add_argument("path", type=Path)
    parser.add_argument("--phase", type=float, required=True)
    arguments = parser.parse_args()
    stop_when_told()
    try:
        take_turns(arguments.endpoint, arguments.phase, arguments.path)
    except eitskin.SkinError as error:
        print(f"{error}", file=sys.stderr)
        return 1
    except Stopped:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
