"""From a touch to the first whole frame of an idling skin, measured: a virtual skin, its pty, the runtime, no sums.

A virtual skin (a process of its own) is touched now and then, at moments that fall anywhere into the idle period::

    untouched ............ touch ............. release ...........    HELD_S of EVERY_S, the runtime idles after AFTER_S
                           |-- idle frame --> gate --> SET_MODE --> whole scan --> map --> published
                           |<--------------- what is measured ------------------->|

The touch begins at a known time of the skin's script, and the script at a time on the host's clock that the skin
writes down, so both ends are on one clock.
"""

import json
import signal
import sys
import tempfile
from pathlib import Path
from time import perf_counter_ns
from types import FrameType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin_tools.processes.children import Child, process_group
from eitskin_tools.processes.skin_log import read_log

EVERY_S: Final = 1.1
"""From touch to touch, at least."""

SPREAD_S: Final = 0.05
"""An idle period of configuration "paper": touches are moved by parts of it, so that they fall anywhere into it."""

GOLDEN: Final = 0.6180339887
"""Parts of a period in steps of this fill it evenly, however many there are."""

HELD_S: Final = 0.3
AFTER_S: Final = 0.25
"""The skin idles after so long without a touch."""

FIRST_S: Final = 2.0
"""Untouched before the first touch: the reference is captured then."""

RATE_HZ: Final = 200.0
REFERENCE_FRAMES: Final = 100
READY_S: Final = 60.0

IDLE: Final = "acquisition:idle"

Array = npt.NDArray[np.float64]


def begins_s(count: int) -> Array:
    """Return (count,) script times at which touches begin."""
    number = np.arange(count)
    return np.asarray(FIRST_S + EVERY_S * number + SPREAD_S * (number * GOLDEN % 1.0))


class Touched:
    """A source of voltages: one set of rows while touched, another between.

    Args:
        untouched: (n, 104) V, noisy frames.
        touched: (m, 104) V, likewise.
        touches: How many, at :func:`begins_s`.
    """

    def __init__(self, untouched: Array, touched: Array, touches: int) -> None:
        self._rows = (untouched, touched)
        self._begins = begins_s(touches)
        self._next = 0

    def voltages(self, time_s: float) -> Array:
        """Return (104,) V at a time since the first START."""
        self._next += 1
        begun = self._begins[self._begins <= time_s]
        rows = self._rows[bool(len(begun) and time_s - begun[-1] < HELD_S)]
        row: Array = rows[self._next % len(rows)]
        return row


def measure(bundle: Bundle, untouched_V: Array, touched_V: Array, touches: int) -> dict[str, Any]:
    """Return how many ms passed from each touch to the first whole frame that shows it.

    Args:
        bundle: With an idle gate.
        untouched_V: (n, 104) V of noisy untouched frames.
        touched_V: (m, 104) V of noisy touched frames.
        touches: How many.

    Raises:
        SkinError: The virtual skin or the runtime failed.
    """
    from eitskin.skin import Skin

    with tempfile.TemporaryDirectory(prefix="eitskin-waking-") as name, process_group() as children:
        folder = Path(name)
        np.savez(folder / "rows.npz", untouched=untouched_V, touched=touched_V)
        child = Child(
            "virtual-skin", __name__, [str(folder / "rows.npz"), str(folder / "skin.log"), str(touches)], folder
        )
        children.append(child)
        port = json.loads(child.line(child.out, "{", READY_S))["port"]
        with Skin(port, bundle=bundle, idle_after_s=AFTER_S) as skin:
            skin.capture_reference(REFERENCE_FRAMES)
            seen = [
                (frame.host_ns["publish"], frame.touched, IDLE in frame.skipped)
                for frame in skin.frames(timeout_s=FIRST_S + EVERY_S * touches + SPREAD_S)
            ]
        begin_ns = next(event["host_ns"] for event in read_log(folder / "skin.log") if event["event"] == "start")
    return waits(np.array(seen, dtype=np.int64).reshape(-1, 3), begin_ns, begins_s(touches))


def waits(seen: npt.NDArray[np.int64], begin_ns: int, begins: Array) -> dict[str, Any]:
    """Return what a stream says of every touch.

    Args:
        seen: (n, 3) when each frame was published in ns, whether it is touched, whether it is of the idle mode.
        begin_ns: When the script began.
        begins: (m,) s, script times of the touches.
    """
    published_ns, touched, idle = seen.T
    found, late = [], []
    missed = awake = 0
    for begin in begins:
        start = begin_ns + int(begin * 1e9)
        before = np.flatnonzero(published_ns < start)
        if not len(before) or not idle[before[-1]]:
            awake += 1  # it had not fallen asleep: another question
            continue
        during = (published_ns >= start) & (published_ns < start + int(HELD_S * 1e9))
        whole = np.flatnonzero(during & (touched == 1) & (idle == 0))
        if not len(whole):
            missed += 1
            continue
        found.append((published_ns[whole[0]] - start) / 1e6)
        late.append(int(np.count_nonzero(during[: whole[0]] & (touched[: whole[0]] == 0))))
    return {
        "touches": len(begins),
        "awake_already": awake,
        "never_met": missed,
        "ms": None
        if not found
        else {
            "mean": round(float(np.mean(found)), 2),
            "p50": round(float(np.median(found)), 2),
            "largest": round(max(found), 2),
        },
        "frames_that_missed_it": int(np.sum(late)),
    }


def _stop(number: int, frame: FrameType | None) -> None:
    sys.exit(0)


def main(rows: Path, log: Path, touches: int) -> None:
    """Serve a virtual skin until terminated.

    Args:
        rows: Where ``untouched`` and ``touched`` are.
        log: Where events are written.
        touches: How many.
    """
    from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
    from eitskin_tools.virtual_skin.process import configuration_for
    from eitskin_tools.virtual_skin.pty import PtyPort
    from eitskin_tools.virtual_skin.server import SkinServer

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    with np.load(rows) as arrays:
        source = Touched(arrays["untouched"], arrays["touched"], touches)
    with PtyPort() as port, log.open("w", buffering=1) as lines:
        device = VirtualDevice(source, configuration_for(RATE_HZ, "paper"), perf_counter_ns(), Identity("WAKING"))
        print(json.dumps({"port": str(port.path)}), flush=True)

        def write(event: dict[str, Any]) -> None:
            lines.write(json.dumps(event) + "\n")

        SkinServer(device, port, log=write).run()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
