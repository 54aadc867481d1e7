"""A long stream from the emulated board: every sequence number must arrive, or be counted by whoever lost it.

``python -m eitskin_tools.faults.soak --seconds S``. The board says in each frame how many scans it could not send; a
gap that it did not count was lost on the line, and must show as a corrupt packet. One JSON line comes last; the exit
status is 1 if a number is missing without account.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from eitskin.serial_port import SerialPort
from eitskin_proto import framing, messages
from eitskin_proto.codes import MessageType
from eitskin_proto.frames import FrameView
from eitskin_proto.unwrap import StreamCounter
from eitskin_tools.faults.board import Board
from eitskin_tools.flash.exchange import Exchange


def soak(seconds: float) -> dict[str, float]:
    """Stream for a while and return the figures."""
    with tempfile.TemporaryDirectory() as folder, Board(Path(folder) / "storage.bin") as board:
        port = SerialPort(board.port)
        try:
            exchange = Exchange(port, timeout_s=2.0)
            rate_hz = exchange.hello().rate_mHz / 1000
            port.write(framing.encode(messages.Start().pack()))
            return {"asked_rate_hz": rate_hz, **_follow(port, seconds)}
        finally:
            port.close()


def _follow(port: SerialPort, seconds: float) -> dict[str, float]:
    deframer, counter, view = framing.Deframer(), StreamCounter(), FrameView()
    frames = events = first = last = 0
    started_s = time.perf_counter()
    while time.perf_counter() - started_s < seconds:
        for payload in deframer.feed(port.read(1.0)):
            if payload[0] != MessageType.FRAME:
                events += 1
                continue
            view.load(payload)
            step = counter.step(view.sequence, view.device_us)
            first = step.sequence if frames == 0 else first
            frames, last = frames + 1, step.sequence
    elapsed_s = time.perf_counter() - started_s
    missing = last + 1 - first - frames if frames else 0
    return {
        "seconds": round(elapsed_s, 1),
        "frames": frames,
        "rate_hz": round(frames / elapsed_s, 2),
        "lost": counter.lost,
        "counted_by_device": view.device_dropped,
        "corrupt": deframer.corrupt,
        "resets": counter.resets,
        "other_messages": events,
        "unaccounted": max(0, missing - view.device_dropped) if deframer.corrupt == 0 else 0,
    }


def main(argv: list[str] | None = None) -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1200.0)
    arguments = parser.parse_args(argv)
    figures = soak(arguments.seconds)
    wrong = figures["frames"] == 0 or figures["unaccounted"] != 0 or figures["resets"] != 0
    print(json.dumps({"soak": figures}))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
