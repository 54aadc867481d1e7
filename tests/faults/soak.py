"""A long stream from the emulated board: every sequence number must arrive, or be counted where it was lost.

``python -m tests.faults.soak --seconds S [--port PORT]``. The board says in each frame how many scans
it could not send; a gap that it did not count was lost on the line, and must show as corrupt packets, of which each
explains two frames at most (a damaged delimiter joins two packets). With ``--port`` a device that is there is soaked
instead. One JSON line comes last; the exit status is 1 if a number is missing without account.
"""

import argparse
import json
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from tests.emulator.board import Board
from tests.emulator.patience import patient

from eitskin.acquisition.ports import open_line
from eitskin.acquisition.transport import Transport
from eitskin_proto.wire import framing, messages
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FrameView, StreamCounter


def soak(seconds: float, port: str | None = None) -> dict[str, float]:
    """Stream for a while and return the figures.

    Args:
        seconds: How long.
        port: A port that is there, ``usb:SERIAL`` too; the emulated board if None.
    """
    with ExitStack() as stack:
        if port is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            port = stack.enter_context(Board(Path(folder) / "storage.bin")).port
        line = open_line(port)
        stack.callback(line.close)
        rate_hz = patient(line).hello().rate_mHz / 1000
        line.write(framing.encode(messages.Start().pack()))
        figures = _follow(line, seconds)
        line.write(framing.encode(messages.Stop().pack()))
        return {"asked_rate_hz": rate_hz, **figures}


def _follow(line: Transport, seconds: float) -> dict[str, float]:
    deframer, counter, view = framing.Deframer(), StreamCounter(), FrameView()
    frames = others = first = last = dropped = dropped_wire = 0
    started_s, cpu_s = time.perf_counter(), time.process_time()
    while time.perf_counter() - started_s < seconds:
        for payload in deframer.feed(line.read(1.0)):
            if payload[0] != MessageType.FRAME:
                others += 1
                continue
            view.load(payload)
            step = counter.step(view.sequence, view.device_us)
            first = step.sequence if frames == 0 else first
            frames, last = frames + 1, step.sequence
            dropped += (view.device_dropped - dropped_wire) % (1 << 16)
            dropped_wire = view.device_dropped
    elapsed_s = time.perf_counter() - started_s
    missing = last + 1 - first - frames if frames else 0
    return {
        "seconds": round(elapsed_s, 1),
        "frames": frames,
        "rate_hz": round(frames / elapsed_s, 2),
        "missing": missing,
        "counted_by_device": dropped,
        "corrupt": deframer.corrupt,
        "resets": counter.resets,
        "other_messages": others,
        "unaccounted": unaccounted(missing, dropped, deframer.corrupt),
        "host_cpu_s": round(time.process_time() - cpu_s, 1),
    }


def unaccounted(missing: int, counted_by_device: int, corrupt: int) -> int:
    """Return how many missing frames neither the device nor a damaged packet explains."""
    return max(0, missing - counted_by_device - 2 * corrupt)


def main(argv: list[str] | None = None) -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1200.0)
    parser.add_argument("--port", help="soak the device on this port instead of an emulated board")
    arguments = parser.parse_args(argv)
    figures = soak(arguments.seconds, arguments.port)
    wrong = figures["frames"] == 0 or figures["unaccounted"] != 0 or figures["resets"] != 0
    print(json.dumps({"soak": figures}))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
