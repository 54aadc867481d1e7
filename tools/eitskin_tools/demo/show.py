"""Runs the demonstration: starts the processes, looks on, and prints a summary at the end.

::

    virtual-skin --pty--> run --ipc--> this process --+
     |                     ^                          +--> summary
     |                     +-- control <--- scanner   |
     +-- log, wire times -----------------------------+

Nothing is left behind: the processes end in order, the sockets and files lie in one temporary folder that is removed.
"""

import json
import sys
import tempfile
import time
import webbrowser
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import to_toml
from eitskin_proto.skin.touch_kind import TouchKind, knows
from eitskin_tools.console.stream_view import StreamView
from eitskin_tools.console.terminal import has_display
from eitskin_tools.demo.recorder import Record, record
from eitskin_tools.demo.score import accuracy, timing
from eitskin_tools.processes.children import Child, process_group
from eitskin_tools.processes.skin_log import read_log, script_start

START_S: Final = 600.0
"""How long solving a script's keyframes may take: once for a new sheet, and longer on a busy machine."""

READY_S: Final = 120.0
"""How long the runtime may take for handshake and reference."""

CLOUDS_HZ: Final = 4.0
"""Clouds a second, as a robot's camera would give."""


EMULATED_SKIN: Final = "tests.emulator.emulated_skin"
"""Runs the firmware under QEMU; it belongs to the checkout, as the firmware's sources do, not to the wheel."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the demonstration is like."""

    seconds: float = 20.0
    rate_hz: float = 200.0
    bundle: Path | None = None
    solver: str | None = None
    """The most accurate solver to use, as for ``eitskin run``."""
    noise: str = "N2"
    device: str = "virtual"
    """"virtual" for eitskin virtual-skin, "qemu" for the firmware on an emulated board."""
    talk: bool = False
    """Say how far it is, and on a terminal what the newest frame shows."""
    clouds: bool = True
    """Send clouds while the sheet bends."""
    view: bool = False
    """Serve the page of ``eitskin view`` meanwhile, and say where."""
    touches: TouchKind = "raise"
    """"raise" or "lower": what touches the sheet; the bundle must know it."""


@dataclass(frozen=True, slots=True, eq=False)
class Streamed:
    """A stream that has ended, from both of its ends."""

    record: Record
    """What the subscriber noted."""
    wire_ns: npt.NDArray[np.int64]
    """When each sequence number went onto the wire."""
    start_us: int
    """Device clock when the script began."""
    sent: int | None
    """Frames that the virtual skin sent."""
    dropped: int | None
    """Scans that it could not send, by its own count."""
    runtime: dict[str, Any]
    """The runtime's own summary."""
    start_s: float
    """From nothing to the first frame."""


def stream(options: Options) -> Streamed:
    """Run all processes for a time and return what was streamed.

    Raises:
        SkinError: A process died, with what it said last.
        TimeoutError: A process was not ready in time.
    """
    with tempfile.TemporaryDirectory(prefix="eitskin-demo-") as name:
        folder = Path(name)
        publish, control = f"ipc://{folder}/frames", f"ipc://{folder}/control"
        log, begin_s = folder / "skin.log", time.monotonic()
        with process_group() as children:
            _start(options, folder, publish, control, children)
            found, first_s = _recorded(options, publish, children)
            skin, runtime = children[:2]
            runtime.stop()
            skin.stop()
            spoken = _last_object(runtime)
        start_us, wire_ns = script_start(log)["device_us"], np.load(folder / "wire.npy")
        return Streamed(found, wire_ns, start_us, _told(log, "sent"), _told(log, "dropped"), spoken, first_s - begin_s)


def summarise(options: Options, streamed: Streamed) -> dict[str, Any]:
    """Return what a stream that has ended was like.

    Raises:
        ValueError: Not one frame was recorded.
    """
    return {
        **timing(streamed.record, streamed.wire_ns),
        **asdict(accuracy(streamed.record, _script_of(options), streamed.start_us)),
        "sent": streamed.sent,
        "dropped_by_device": streamed.dropped,
        "late_subscriber": streamed.record.late,
        "withheld": streamed.record.withheld,
        "runtime_lost": streamed.runtime.get("lost"),
        "start_s": round(streamed.start_s, 2),
        "noise": options.noise,
        "bundle": str(options.bundle) if options.bundle else "shipped",
        "touches": f"{options.touches}{touches_in_words(_script_of(options))}",
        "solvers": streamed.runtime.get("solvers"),
    }


def _recorded(options: Options, publish: str, children: list[Child]) -> tuple[Record, float]:
    """Return what was streamed, and when the first frame came; on a terminal, show the newest frame in a line."""
    first_s = 0.0
    line = StreamView(sys.stdout, grid=skin_of(options.bundle, options.touches).grid)
    live = options.talk and not options.view and sys.stdout.isatty()

    def look() -> None:
        for child in children:
            child.check()

    def show(frame: Any) -> None:
        nonlocal first_s
        if not first_s:
            first_s = time.monotonic()
            if options.talk:
                print(f"the first frame is here; streaming for {options.seconds:g} s", file=sys.stderr)
        if live:
            line.show(frame)

    capacity = int(options.seconds * options.rate_hz * 1.1) + 1000
    found = record(publish, options.seconds, capacity, look, show)
    line.end()
    return found, first_s


def _start(options: Options, folder: Path, publish: str, control: str, children: list[Child]) -> None:
    """Start everything."""
    # The skin ends this much after the demonstration if it was not stopped, which should never happen.
    longest = options.seconds + START_S + READY_S
    sheet = list[str]()
    if (described := skin_of(options.bundle, options.touches)) != PAPER:
        (description := folder / "skin.toml").write_text(to_toml(described), encoding="utf-8")
        sheet = ["--skin", str(description)]
    module, command, environment = ("eitskin_tools.cli", ["virtual-skin"], None)
    if options.device == "qemu":
        module, command, environment = (EMULATED_SKIN, [], {"PYTHONPATH": str(checkout())})
    skin = Child(
        "virtual-skin", module,
        [*command, "--json", f"--rate={options.rate_hz:g}", f"--noise={options.noise}", *sheet,
         f"--seconds={longest:g}", f"--log={folder / 'skin.log'}", f"--wire-times={folder / 'wire.npy'}"], folder,
        environment,
    )  # fmt: skip
    children.append(skin)
    port = json.loads(skin.line(skin.out, "{", START_S))["port"]
    chosen = ["--bundle", str(options.bundle)] if options.bundle else []
    chosen += ["--solver", options.solver] if options.solver else []
    # No front end is without noise; and an emulated board whose scan is late plays a frame of its recording twice.
    chosen += ["--force-reference"] if options.noise == "none" or options.device == "qemu" else []
    runtime = Child(
        "run", "eitskin_tools.cli",
        ["run", f"--port={port}", f"--publish={publish}", f"--control={control}", "--json", *chosen], folder,
    )  # fmt: skip
    children.append(runtime)
    if options.clouds:
        children.append(_scanner(options, control, folder, sheet))
    if options.view:
        runtime.line(runtime.err, "ready ", READY_S, children)
        words = ["view", f"--endpoint={publish}", "--port=0", "--no-open", *sheet]
        children.append(viewer := Child("view", "eitskin_tools.cli", words, folder))
        show_page(viewer.line(viewer.out, "viewing ", READY_S, children).rpartition(" at ")[2].split()[0])


def show_page(address: str) -> None:
    """Print the page's address, and open it on a desktop."""
    print(f"watch it at {address}", file=sys.stderr, flush=True)
    if has_display(sys.stderr):
        webbrowser.open(address)


def checkout() -> Path:
    """Return the folder of the checkout that holds the emulated skin.

    Raises:
        SkinError: This is an installed wheel.
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / "tests" / "emulator" / "emulated_skin.py").is_file():
        raise SkinError(
            f"the emulated board is not in {root}: --device qemu needs a source checkout of eitskin; "
            "without one, leave --device out"
        )
    return root


def _scanner(options: Options, control: str, folder: Path, sheet: list[str]) -> Child:
    predict = ["--predict"] if uses_prediction(options.bundle) else []
    return Child(
        "scanner", "eitskin_tools.demo.scanner",
        [control, str(folder / "skin.log"), f"--rate={CLOUDS_HZ}", *sheet, *predict], folder,
    )  # fmt: skip


def _script_of(options: Options) -> Any:
    """Return the script that the virtual skin plays."""
    from eitskin_tools.scripted_scene.script import demonstration

    return demonstration(skin_of(options.bundle, options.touches))


def _last_object(child: Child) -> dict[str, Any]:
    try:
        found = json.loads(child.out.read_text() or "{}")
    except json.JSONDecodeError as error:
        raise SkinError(f"{child.name} did not end its output with one JSON object: {error}") from error
    return found if isinstance(found, dict) else {}


def _told(log: Path, what: str) -> int | None:
    """Return a count that the skin wrote down when it stopped."""
    return next((int(event[what]) for event in read_log(log) if event["event"] == "stop"), None)


def choose(bundle: Path | None, touches: TouchKind | None) -> tuple[Path | None, TouchKind]:
    """Return the bundle and the touches to show: presses as a finger's, where nothing is said and they are known.

    Args:
        bundle: What was named; None for a shipped one.
        touches: What was named.

    Raises:
        BundleError: It cannot be read, or no shipped one knows these touches.
        MismatchError: The named one knows others.
    """
    from eitskin.model.bundle import default_path, load_bundle
    from eitskin.model.skin_in_use import knowing

    if touches is not None:
        return knowing(touches, bundle).path, touches
    if bundle is None:
        pressed = default_path("area", "lower")
        return (pressed, "lower") if pressed.exists() else (None, "raise")
    return bundle, "raise" if load_bundle(bundle, lazily=True).touch_kind == "raise" else "lower"


def skin_of(bundle: Path | None, touches: TouchKind = "raise") -> Skin:
    """Return the sheet that is played on: the paper's ideal one where the bundle is for it, else the bundle's own.

    Args:
        bundle: A bundle; None for the shipped one.
        touches: "raise" or "lower"; a bundle knows both, or these.

    Raises:
        BundleError: It cannot be read.
        MismatchError: It knows other touches.
    """
    from eitskin.model.bundle import load_bundle

    found = load_bundle(bundle, lazily=True)
    if not knows(found.touch_kind, touches):
        hint = "choose the touches that it detects with --touches"
        raise MismatchError(f"{found.path}: touches", found=found.touch_kind, expected=touches, hint=hint)
    return (PAPER if found.skin.grid_id == PAPER.grid_id else found.skin).touched(touches)


def uses_prediction(bundle: Path | None) -> bool:
    """Return whether a bundle's network takes V_pred."""
    from eitskin.model.bundle import load_bundle

    return bool(load_bundle(bundle, lazily=True).uses_prediction)


def touches_in_words(script: Any) -> str:
    """Return for people what the demonstration's touches do to conductance."""
    from eitskin_tools.scripted_scene.choreography import LOWERED_CONTRAST, RAISED_CONTRAST

    if script.skin.touch_kind == "raise":
        return f", where conductance is {RAISED_CONTRAST:g} times as high"
    return f", as of a finger: conductance falls to {100 * LOWERED_CONTRAST:g} %"


def lines_of(summary: dict[str, Any]) -> list[str]:
    """Return a summary for people."""
    latency, alone = summary["latency_us"], summary["latency_inferred_us"]

    def ms(value: float) -> str:
        return f"{value / 1000:.2f}"

    def shown(form: str, **names: str) -> str:
        """Return those figures of the summary that there are, each with its name."""
        return ", ".join(f"{name.replace('_', ' ')} {form.format(summary[key])}" for name, key in names.items()
                         if summary[key] is not None)  # fmt: skip

    verdict = "Frames are missing" if summary["lost"] or summary["corrupt"] else "The skin works"
    lines = [
        f"{verdict}: {summary['frames']} frames at {summary['rate_hz']:g} frames/s, {summary['lost']} lost, "
        f"{summary['corrupt']} corrupt",
        f"latency, wire to subscriber: p50 {ms(latency['p50'])} ms, p99 {ms(latency['p99'])} ms, "
        f"max {ms(latency['max'])} ms",
    ]
    if alone:
        lines.append(f"  with a solver ({summary['inferred']} frames): p50 {ms(alone['p50'])} ms, "
                     f"p99 {ms(alone['p99'])} ms")  # fmt: skip
    parts = [f"{name} {spans['p50']:.0f}/{spans['p99']:.0f}" for name, spans in summary["stages_us"].items() if spans]
    lines.append(f"stages in us, p50/p99: {', '.join(parts)}")
    if summary["cc_median"] is not None:
        split = shown("{:.3f}", flat="cc_median_flat", bent="cc_median_bent")
        lines.append(f"maps: correlation with the truth {summary['cc_median']:.3f}, median of {summary['scored']} "
                     f"touched frames ({split})")  # fmt: skip
    gate = shown("{:.2%}", missed_touches="missed", false_alarms="false_alarms").replace("%", " %")
    return [*lines, f"touches: {summary['touches']}", f"touch detection: {gate}; clouds used: {summary['clouds']}"]
