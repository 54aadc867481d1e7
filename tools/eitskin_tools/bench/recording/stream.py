"""One stream of frames that goes on all the while, now by itself, now with recorder and viewer beside.

::

    virtual-skin --pty--> run --ipc--> subscriber: every frame, when it came
         |                 +---ipc---> record: a file        | in every other
         +-- wire times    +---ipc---> view --http--> pages  | part of the time

A part is so many seconds of it; what begins and ends between parts is counted in none of them.
"""

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.reference.captured import DEFAULT_FRAMES
from eitskin_tools.bench.skins.bench import busy_s, cpu_s
from eitskin_tools.bench.view.pages import readers
from eitskin_tools.demo.recorder import Record
from eitskin_tools.processes.children import Child, process_group

READY_S: Final = 120.0
"""How long a process may take to be ready, on a busy machine."""

UNTOUCHED_S: Final = 1.0
"""The reference is captured within it; the script leaves the sheet alone for twice as long."""

WARM_S: Final = 2.0
"""Between the last of them being ready, and the beginning of a part."""

LONGEST_S: Final = 1e6
"""Virtual skin and subscriber end when they are told to, which is before."""


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
    words = ["virtual-skin", "--json", f"--rate={rate_hz:g}", f"--seconds={LONGEST_S:g}"]
    skin = Child("virtual-skin", "eitskin_tools.cli", [*words, f"--wire-times={folder}/wire.npy"], folder)
    children.append(skin)
    port = json.loads(skin.line(skin.out, "{", READY_S))["port"]
    publish = f"ipc://{folder}/frames"
    words = ["run", f"--port={port}", f"--publish={publish}", f"--control=ipc://{folder}/control", "--json"]
    words.append(f"--reference-frames={min(DEFAULT_FRAMES, int(UNTOUCHED_S * rate_hz))}")
    runtime = Child("run", "eitskin_tools.cli", words, folder)
    children.append(runtime)
    runtime.line(runtime.err, "ready ", READY_S, children)
    words = [publish, f"{folder}/record.npz", f"--seconds={LONGEST_S:g}", f"--capacity={int(longest_s * rate_hz)}"]
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
