"""What a recorder and a viewer cost the stream: the same stream with and without them, and whether the file is whole.

A stream of frames goes on all the while ::

    virtual-skin --pty--> run --ipc--> subscriber: every frame, when it came
         |                 +---ipc---> record: a file        | in every other
         +-- wire times    +---ipc---> view --http--> pages  | part of the time

Each part lasts ``--seconds``; processes start and end between parts, in time that is not counted. A round has one part
without and one with ``eitskin record`` and ``eitskin view``, and rounds begin with each in turn. The pages are readers
in this process, and no browser draws. When the stream has ended, ``eitskin reinfer`` computes the files again.
"""

import argparse
import http.client
import json
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from eitskin.reference.captured import DEFAULT_FRAMES
from eitskin_tools.bench.harness import busy_s, cpu_s, machine, program, show
from eitskin_tools.demo.recorder import Record
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.children import Child, process_group

CASES: Final = {False: "alone", True: "beside"}
"""Names of the parts without and with recorder and viewer."""

MAX_PAGES: Final = 16

READY_S: Final = 120.0
"""How long a process may take to be ready, on a busy machine."""

UNTOUCHED_S: Final = 1.0
"""The reference is captured within it; the script leaves the sheet alone for twice as long."""

WARM_S: Final = 2.0
"""Between the last of them being ready, and the beginning of a part."""

MAX_RUN_S: Final = 1e6
"""Virtual skin and subscriber run for this long unless they are stopped, which happens earlier."""

REINFER_S: Final = 3600.0
"""How long a file may take to be computed again."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="of each part of a round (60)")
    parser.add_argument("--rounds", type=int, default=2, metavar="N", help="how often both take their turn (2)")
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="frames a second (200)")
    parser.add_argument("--pages", type=int, default=1, metavar="N", help="that look at the viewer (1)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, and return 0; 1 if a map came out as another one."""
    if not 1 <= arguments.seconds < 1e5 or not 10 <= arguments.rate <= 1000 or not 1 <= arguments.rounds <= 100:
        raise UsageError("--seconds must be at least 1, --rate 10 to 1000 and --rounds 1 to 100")
    if not 1 <= arguments.pages <= MAX_PAGES:
        raise UsageError(f"--pages is {arguments.pages}, expected 1 to {MAX_PAGES}")
    found = measure(arguments.seconds, arguments.rounds, arguments.rate, arguments.pages)
    show(arguments, found)
    return 1 if found["reinfer"]["differing"] else 0


def measure(seconds: float, rounds: int, rate_hz: float, pages: int) -> dict[str, Any]:
    """Return both cases, what their ratio is, and what the recordings are worth.

    Args:
        seconds: Of each part of a round.
        rounds: How often both take their turn.
        rate_hz: Frames a second.
        pages: That look at the viewer.
    """
    order = [beside for number in range(rounds) for beside in ((True, False) if number % 2 else (False, True))]
    print(f"recording: {len(order)} parts of {seconds:g} s", file=sys.stderr, flush=True)
    with tempfile.TemporaryDirectory(prefix="eitskin-recording-") as name:
        folder = Path(name)
        stream = streamed(order, seconds, rate_hz, pages, folder)
        print(f"recording: {len(stream.files)} files are computed again", file=sys.stderr, flush=True)
        again = summed([_again(number, file, folder) for number, file in enumerate(stream.files)])
    cases = {name: case(stream, pages, beside=beside) for beside, name in CASES.items()}
    alone, beside = cases["alone"], cases["beside"]
    ratios = {
        name: round(beside["latency_us"][name] / alone["latency_us"][name], 3) for name in ("p50", "p99")
    }  # fmt: skip
    runtime = {key: stream.runtime[key] for key in ("frames", "lost", "corrupt", "withheld")}
    return {**cases, "ratios": ratios, "reinfer": again, "runtime": runtime, "rate_hz": rate_hz, "machine": machine()}


def case(stream: Any, pages: int, *, beside: bool) -> dict[str, Any]:
    """Return what all parts of one kind were like together.

    Args:
        stream: That has ended.
        pages: That looked at the viewer.
        beside: Those with recorder and viewer, or those without.
    """
    from eitskin_tools.demo.score import timing

    parts = [part for part in stream.parts if part.beside == beside]
    records = [part_of(stream, part) for part in parts]
    each = [timing(record, stream.wire_ns) for record in records]
    every = timing(joined(records, [slice(None)] * len(records)), stream.wire_ns)
    seconds, frames = sum(part.seconds for part in parts), every["frames"]
    cpu_s = {name: sum(part.cpu_s[name] for part in parts) for name in parts[0].cpu_s}
    found = {
        "seconds": round(seconds, 3),
        "frames": frames,
        "lost": sum(one["lost"] for one in each),
        "latency_us": every["latency_us"],
        "stages_us": every["stages_us"],
        "each_us": [{name: one["latency_us"][name] for name in ("p50", "p99")} for one in each],
        "runtime_cpu_us_a_frame": round(1e6 * cpu_s["run"] / frames, 1),
        "core_percent": {name: round(100.0 * used / seconds, 2) for name, used in cpu_s.items()},
    }
    if beside:
        total = {key: sum(part.recorder[key] for part in parts) for key in ("frames", "missed", "dropped", "bytes")}
        found["recorder"] = total
        found["pictures_a_page_s"] = round(sum(part.pictures for part in parts) / seconds / pages, 2)
    return found


def _again(number: int, file: Path, folder: Path) -> dict[str, Any]:
    """Return what ``eitskin reinfer`` says of a recording."""
    from eitskin_tools.processes.children import ChildDiedError

    child = Child(f"reinfer-{number}", "eitskin_tools.cli", ["reinfer", str(file), "--json", "--quiet"], folder)
    try:
        if child.wait(REINFER_S) is None:
            raise TimeoutError(f"{file.name} was not computed again within {REINFER_S:g} s")
    finally:
        child.stop()
    text = child.out.read_text()
    if not text:
        raise ChildDiedError(f"{child.name} ended with status {child.status}: {child.last_words()}")
    found: dict[str, Any] = json.loads(text)
    return found


def summed(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what several recordings came to."""
    total = {
        key: sum(one.get(key, 0) for one in found)
        for key in ("frames", "withheld", "published", "equal", "unknown", "recorded_s", "elapsed_s", "cpu_s")
    }
    return {
        **{key: round(value, 3) for key, value in total.items()},
        "unknown_why": dict(sum((Counter(one.get("unknown_why", {})) for one in found), Counter())),
        "differing": sum(sum(one.get("differing", {}).values()) for one in found),
        "times_real_time": round(total["recorded_s"] / total["elapsed_s"], 2),
        "times_real_time_cpu": round(total["recorded_s"] / total["cpu_s"], 2),
    }


@dataclass(slots=True, eq=False)
class Part:
    """Some seconds of the stream.

    Attributes:
        beside: Whether recorder and viewer were running.
        begin_ns: ``perf_counter_ns`` at its beginning.
        end_ns: The same at its end.
        cpu_s: CPU time of each process in it, and of all ``others`` of this machine.
        pictures: Frames that all pages were sent.
        recorder: What the recorder said in the end, of all that it wrote.
    """

    beside: bool
    begin_ns: int
    end_ns: int
    cpu_s: dict[str, float]
    pictures: int = 0
    recorder: dict[str, Any] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """How long it was."""
        return (self.end_ns - self.begin_ns) * 1e-9


@dataclass(slots=True, eq=False)
class Streamed:
    """A stream that has ended.

    Attributes:
        parts: In the order of time.
        record: What the subscriber noted of all of it.
        wire_ns: (capacity,) when each sequence number went onto the wire.
        runtime: What the runtime said in the end.
        files: Recordings, one of each part that had a recorder.
    """

    parts: list[Part]
    record: Record
    wire_ns: npt.NDArray[np.int64]
    runtime: dict[str, Any]
    files: list[Path]


def streamed(order: list[bool], seconds: float, rate_hz: float, pages: int, folder: Path) -> Streamed:
    """Run a stream through its parts.

    Args:
        order: Of each part whether recorder and viewer are beside.
        seconds: Of each part.
        rate_hz: Frames a second.
        pages: That look at the viewer.
        folder: For what the processes write; the recordings are left there.

    Raises:
        SkinError: A process ended before its time, with what it said last.
        TimeoutError: One was not ready in time.
    """
    with process_group() as children:
        runtime, taker, publish = _started(len(order) * (seconds + READY_S), rate_hz, folder, children)
        parts, files = [], list[Path]()
        for number, beside in enumerate(order):
            with ExitStack() as stack:
                counts, file = [0], folder / f"part{number}.mcap"
                onlookers: list[Child] = []
                if beside:
                    onlookers, counts = stack.enter_context(_onlookers(publish, file, pages, folder, children))
                    files.append(file)
                part = _part(seconds, children, counts, beside=beside)
            if beside:
                part.recorder = json.loads(onlookers[0].out.read_text())
            parts.append(part)
        for child in (taker, runtime, children[0]):  # each while those live that it reads from
            child.stop()
        spoken = json.loads(runtime.out.read_text())
    return Streamed(parts, Record.load(folder / "record.npz"), np.load(folder / "wire.npy"), spoken, files)


def _started(longest_s: float, rate_hz: float, folder: Path, children: list[Child]) -> tuple[Child, Child, str]:
    """Start skin, runtime and subscriber; return the last two, and where frames are published."""
    words = ["virtual-skin", "--json", f"--rate={rate_hz:g}", f"--seconds={MAX_RUN_S:g}"]
    skin = Child("virtual-skin", "eitskin_tools.cli", [*words, f"--wire-times={folder}/wire.npy"], folder)
    children.append(skin)
    port = json.loads(skin.line(skin.out, "{", READY_S))["port"]
    publish = f"ipc://{folder}/frames"
    words = ["run", f"--port={port}", f"--publish={publish}", f"--control=ipc://{folder}/control", "--json"]
    words.append(f"--reference-frames={min(DEFAULT_FRAMES, int(UNTOUCHED_S * rate_hz))}")
    runtime = Child("run", "eitskin_tools.cli", words, folder)
    children.append(runtime)
    runtime.line(runtime.err, "ready ", READY_S, children)
    words = [publish, f"{folder}/record.npz", f"--seconds={MAX_RUN_S:g}", f"--capacity={int(longest_s * rate_hz)}"]
    taker = Child("subscriber", "eitskin_tools.demo.recorder", words, folder)
    children.append(taker)
    taker.line(taker.out, "first", READY_S, children)
    return runtime, taker, publish


@contextmanager
def _onlookers(
    publish: str, file: Path, pages: int, folder: Path, children: list[Child]
) -> Iterator[tuple[list[Child], list[int]]]:
    """Have a recorder and a viewer run, with pages; give them, and how many frames each page has taken."""
    found = [
        Child("record", "eitskin_tools.cli", ["record", publish, f"--out={file}", "--json", "--quiet"], folder),
        Child("view", "eitskin_tools.cli", ["view", f"--endpoint={publish}", "--port=0", "--no-open"], folder),
    ]
    children += found
    try:
        recorder, viewer = found
        address = viewer.line(viewer.out, "viewing ", READY_S, children).rpartition(" at ")[2].split()[0]
        with readers(address, pages) as counts:
            deadline_s = time.monotonic() + READY_S
            while not (file.exists() and all(counts)):
                recorder.check()
                viewer.check()
                if time.monotonic() > deadline_s:
                    raise TimeoutError(f"recorder and {pages} pages had not begun within {READY_S:g} s")
                time.sleep(0.02)
            yield found, counts
    finally:
        for child in found:
            child.stop()
            children.remove(child)


def _part(seconds: float, children: list[Child], counts: list[int], *, beside: bool) -> Part:
    """Let the stream go on for some seconds, and say what that took."""
    time.sleep(WARM_S)
    before, shown, begin_ns = _spent(children), sum(counts), time.perf_counter_ns()
    while (left_s := seconds - (time.perf_counter_ns() - begin_ns) * 1e-9) > 0.0:
        for child in children:
            child.check()
        time.sleep(min(left_s, 0.5))
    end_ns, after, shown = time.perf_counter_ns(), _spent(children), sum(counts) - shown
    used = {name: after[name] - before[name] for name in after}
    used["others"] = used.pop("machine") - sum(used.values())
    return Part(beside, begin_ns, end_ns, used, shown)


def _spent(children: list[Child]) -> dict[str, float]:
    """Return the CPU time of each process so far, of this one (``pages``), and of the whole machine."""
    found = {child.name: cpu_s([child.pid]) for child in children}
    return {**found, "pages": time.process_time(), "machine": busy_s()}


def part_of(streamed: Streamed, part: Part) -> Record:
    """Return what was noted of the frames that went onto the wire in a part.

    Raises:
        ValueError: There were none.
    """
    record, wire_ns = streamed.record, streamed.wire_ns
    written = wire_ns[record.sequence % len(wire_ns)]
    (inside,) = np.nonzero((written >= part.begin_ns) & (written < part.end_ns))
    if not len(inside):
        raise ValueError(f"not one frame came within {part.seconds:g} s")
    return joined([record], [slice(inside[0], inside[-1] + 1)])


def joined(records: list[Record], slices: list[slice]) -> Record:
    """Return parts of records as one, without their maps."""
    names = ("sequence", "device_us", "received_ns", "host_ns", "touched", "inferred", "cloud")
    found: dict[str, Any] = {
        name: np.concatenate([getattr(one, name)[part] for one, part in zip(records, slices, strict=True)])
        for name in names
    }
    return replace(records[0], **found, maps=records[0].maps[:0])


@contextmanager
def readers(address: str, pages: int) -> Iterator[list[int]]:
    """Read the viewer's stream as ``pages`` pages would; yield the number of frames that each has taken.

    Args:
        address: Of the page, as ``eitskin view`` says it.
        pages: How many.
    """
    counts, lines, threads = [0] * pages, [], []
    for page in range(pages):
        connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
        token = urlsplit(address).fragment.removeprefix("token=")
        connection.request("GET", "/stream", headers={"Authorization": f"Bearer {token}"})
        lines.append(connection.sock)  # the answer takes it over
        threads.append(threading.Thread(target=_read, args=(connection.getresponse(), counts, page), daemon=True))
        threads[-1].start()
    try:
        yield counts
    finally:
        for line in lines:
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join(30)


def _read(answer: http.client.HTTPResponse, counts: list[int], page: int) -> None:
    from eitskin_tools.view.messages import packed, unpacked

    waiting = b""
    try:
        while data := answer.read1(65536):
            waiting += data
            for head, body in unpacked(waiting):
                waiting = waiting[len(packed(head, body)) :]
                counts[page] += head["kind"] == "frame"
    except (OSError, http.client.HTTPException, ValueError, AttributeError):
        return  # the other end has gone, or this one was closed


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
