"""How soon a robot's loop stops after a touch is on the wire: in Python, and in C++ or ROS 2 beside it in one run.

A virtual skin is touched again and again, at four places in turn. Each loop goes on when the skin has been untouched
for some frames, and stops at the next touch. A stop counts for the touch of the frame that caused it. A loop that is
blind, because no fresh frame came for 0.2 s, stands still before the touch or stops for that reason. A touch is missed
if the loop goes on. Build the loop in C++ first (docs/cpp.md), or install the ROS 2 package in an environment of its
own (docs/ros2.md).
"""

import argparse
import os
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin
from eitskin_tools.bench.harness import cpu_s, machine, program, report
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.children import Child, ChildDiedError, ChildProcess, process_group

RATE_HZ: Final = 200.0
PERIOD_NS: Final = 5_000_000
TOUCHED, CYCLE = 6, 20
"""Frames of a touch, and from one touch to the next: 10 touches a second."""

CALM_FRAMES: Final = 4
"""Untouched frames before a robot moves on."""

START_S: Final = 120.0
"""How long any process may take to be ready."""

PLACES_MM: Final = ((40.0, 35.0), (110.0, 30.0), (75.0, 60.0), (120.0, 75.0))
EXAMPLE: Final = Path(__file__).parents[2] / "docs/examples/ros2_stop.py"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--touches", type=int, default=2000, metavar="N", help="touches (default 2000)")
    parser.add_argument("--cpp", type=Path, metavar="FILE", help="the C++ example, such as build/stop")
    parser.add_argument("--ros", type=Path, metavar="DIR", help="environment with rclpy and the package eitskin_ros")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.touches < 100:
        raise UsageError("--touches must be at least 100: percentiles need values")
    with TemporaryDirectory(prefix="eitskin-stops-") as name, process_group() as children, ExitStack() as stack:
        folder = Path(name)
        words = [str(arguments.touches), str(folder)]
        skin = Child("skin", Path(__file__).stem, ["skin", *words], folder, {"PYTHONPATH": str(Path(__file__).parent)})
        children.append(skin)
        port = skin.line(skin.out, "/", START_S)
        endpoint, control = f"ipc://{folder}/frames", f"ipc://{folder}/control"
        words = ["run", f"--port={port}", f"--publish={endpoint}", f"--control={control}"]
        runtime = Child("run", "eitskin_tools.cli", words, folder)
        children.append(runtime)
        runtime.line(runtime.err, "ready ", START_S, children)
        robots = {"python": [sys.executable, __file__, "robot", endpoint]}
        helpers: dict[str, list[str]] = {}
        if arguments.cpp is not None:
            robots["cpp"] = [str(arguments.cpp), endpoint, str(CALM_FRAMES)]
        if arguments.ros is not None:
            helpers["ros node"] = [str(arguments.ros / "bin/skin"), "--ros-args", "-p", f"endpoint:={endpoint}"]
            calm = ["--ros-args", "-p", f"calm_frames:={CALM_FRAMES}"]
            robots["ros"] = [str(arguments.ros / "bin/python"), str(EXAMPLE), *calm]
        graph = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(os.getpid() % 100)}
        processes = {}
        for label, command in {**helpers, **robots}.items():
            processes[label] = ChildProcess(command)
            stack.callback(processes[label].stop)
            with (folder / label).open("wb") as out:
                options = {"stdout": out, "stderr": subprocess.STDOUT, "env": {**os.environ, "PYTHONPATH": "", **graph}}
                processes[label].start(**options)
        end_s = time.monotonic() + START_S
        while not all("go " in (folder / label).read_text() for label in robots):
            for label, process in processes.items():
                if process.status is not None or time.monotonic() > end_s:
                    raise ChildDiedError(f"{label} does not go: {(folder / label).read_text()[-300:]}")
            time.sleep(0.1)
        before = {label: cpu_s([process.pid]) for label, process in processes.items()}
        (folder / "begin").touch()
        skin.line(skin.out, "done", START_S + 3.0 * arguments.touches * CYCLE / RATE_HZ, children)
        time.sleep(1.0)
        spent = {label: cpu_s([process.pid]) - before[label] for label, process in processes.items()}
        sequence, scanned_ns = np.moveaxis(np.load(folder / "pressed.npy"), 2, 0)
        wire_ns = np.load(folder / "wire.npy")[sequence]
        there = (wire_ns > 0).all(axis=1)  # else the line was full, because the runtime did not read in time
        texts = {label: (folder / label).read_text() for label in robots}
        rows = [_row(label, text, scanned_ns[:, 0], wire_ns[:, 0], there) for label, text in texts.items()]
    frames = arguments.touches * CYCLE
    cpu = {f"{label} cpu_us_a_frame": round(1e6 * value / frames, 1) for label, value in spent.items()}
    return report(arguments, rows, cpu, machine=machine())


def _row(
    label: str,
    text: str,
    scan_ns: npt.NDArray[np.int64],
    wire_ns: npt.NDArray[np.int64],
    there: npt.NDArray[np.bool_],
) -> dict[str, Any]:
    """Return how soon a robot stopped after each touch.

    Args:
        label: Of the robot.
        text: What it printed.
        scan_ns: When the first scan of each touch ended.
        wire_ns: When that was on the wire.
        there: Whether all scans of the touch were.
    """
    lines = [line.split() for line in text.splitlines() if line.startswith(("go ", "stop "))]
    times_ns = np.array([int(line[1]) for line in lines], dtype=np.int64)
    felt = np.array([float(line[3]) if line[2] == "touched" else np.nan for line in lines])  # ms since the scan
    found = np.flatnonzero(~np.isnan(felt))
    of = np.searchsorted(scan_ns - PERIOD_NS // 2, times_ns[found] - (1e6 * felt[found]).astype(np.int64)) - 1
    touch, first = np.unique(of, return_index=True)
    first, touch = first[(touch >= 0) & there[touch]], touch[(touch >= 0) & there[touch]]
    late_ms = 1e-6 * (times_ns[found][first] - wire_ns[touch])
    counts = {"stopped": len(touch), "blind": 0, "missed": 0}
    for at in np.searchsorted(times_ns, wire_ns[np.setdiff1d(np.flatnonzero(there), touch)]).tolist():
        stands = at == 0 or lines[at - 1][0] == "stop"
        counts["blind" if stands or (at < len(lines) and np.isnan(felt[at])) else "missed"] += 1
    figures = dict(zip(("p50_ms", "p99_ms", "max_ms"), np.percentile(late_ms, [50, 99, 100]).round(3), strict=True))
    return {"what": label, "touches": int(there.sum()), **counts, **{name: float(one) for name, one in figures.items()}}


class Presses:
    """Voltages of a sheet that is touched for ``TOUCHED`` of each ``CYCLE`` frames, once a file is there."""

    def __init__(self, touches: int, folder: Path) -> None:
        from eitskin_sim.scene.parts import Scene, Touch
        from eitskin_sim.scene.shapes import Disc
        from eitskin_tools.scripted_scene.keyframes import solve
        from eitskin_tools.scripted_scene.script import still
        from eitskin_tools.virtual_skin.process import Noise

        scenes = [Scene(), *(Scene(touches=(Touch((Disc(x, y, 8.0),)),)) for x, y in PLACES_MM)]
        self.flat, *self.touched = (solve(still(scene).scene_at(60.0)) for scene in scenes)
        self.noise = Noise(reference=self.flat)
        self.folder, self.touches, self.frame, self.begin = folder, touches, 0, -1
        self.pressed: list[tuple[int, float]] = []
        self.start_ns = sys.maxsize
        self.device: Any = None

    def voltages(self, time_s: float) -> npt.NDArray[np.float64]:
        """Return the (104,) V of the next frame."""
        frame, self.frame = self.frame, self.frame + 1
        self.start_ns = min(self.start_ns, time.perf_counter_ns() - int(1e9 * time_s))  # a scan may be late, not early
        if self.begin < 0 and frame % 20 == 0 and (self.folder / "begin").exists():
            self.begin = frame + CYCLE
        touch, at = divmod(frame - self.begin, CYCLE)
        if self.begin < 0 or not 0 <= touch < self.touches or at >= TOUCHED:
            if self.begin >= 0 and touch == self.touches and at == 0:
                pressed = [(sequence, self.start_ns + int(1e9 * at_s)) for sequence, at_s in self.pressed]
                np.save(self.folder / "pressed.npy", np.reshape(pressed, (-1, TOUCHED, 2)))
                print("done", flush=True)
            return self.noise.on(self.flat)
        self.pressed.append((self.device.sequence, time_s))
        return self.noise.on(self.touched[touch % len(self.touched)])


def _skin(touches: str, folder: str) -> None:
    """Serve a skin that is touched."""
    from eitskin_tools.processes.signals import Stopped, raise_stopped_on_signals
    from eitskin_tools.virtual_skin import server
    from eitskin_tools.virtual_skin.device import VirtualDevice
    from eitskin_tools.virtual_skin.faults import FaultPlayer
    from eitskin_tools.virtual_skin.process import WIRE_CAPACITY, configuration_for
    from eitskin_tools.virtual_skin.pty import PtyPort

    raise_stopped_on_signals()
    with suppress(Stopped), PtyPort() as port:
        source = Presses(int(touches), Path(folder))
        source.device = device = VirtualDevice(source, configuration_for(RATE_HZ), time.perf_counter_ns())
        wire_ns = server.wire_times(Path(folder) / "wire.npy", WIRE_CAPACITY)
        print(port.path, flush=True)
        server.SkinServer(device, port, FaultPlayer(), wire_ns).run()


def _robot(endpoint: str) -> None:
    """Do in Python what the other loops do."""
    moving, calm = False, 0
    with (
        suppress(KeyboardInterrupt),
        eitskin.subscribe(endpoint, "all", maps=False, timeout_s=0.2, max_age_s=0.2) as frames,
    ):
        while True:
            try:
                frame = frames.next_frame()
                touched, why = bool(frame.touches), f"touched {1e3 * frame.age_s:.2f} ms ago"
            except (eitskin.NoFrame, eitskin.StaleFrame) as error:
                touched, why = True, str(error)
            calm = 0 if touched else calm + 1
            if (moving and touched) or (not moving and calm >= CALM_FRAMES):
                moving = not touched
                print("stop" if touched else "go", time.perf_counter_ns(), why, flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["skin"]:
        _skin(*sys.argv[2:])
    elif sys.argv[1:2] == ["robot"]:
        _robot(sys.argv[2])
    else:
        sys.exit(program(__doc__, add_arguments, run))
