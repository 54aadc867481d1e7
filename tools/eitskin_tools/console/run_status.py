"""Reports the state of a running stream: rate, losses, withheld frames and why, touch, electrodes.

A thread of its own reads the skin's counters in 15 us a second, so no frame waits for it. On a terminal it rewrites a
line every second. Elsewhere it writes a line when something went wrong, and once a minute otherwise.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.words import WITHHELD, electrode_words, event_words
from eitskin_tools.processes.periodic_thread import PeriodicThread

if TYPE_CHECKING:
    from eitskin.model.bundle import Bundle
    from eitskin_proto.skin.skin import Skin

PERIOD_S: Final = 1.0
"""Between two looks, and the least time between two lines."""

SILENT_S: Final = 60.0
"""Longest time without a line where none is rewritten."""

END_S: Final = 0.2
"""How long the last line may take at the end: its reader may have stopped."""

REPORTED_COUNTERS: Final = ("lost", "corrupt", "withheld_by_reason", "electrodes", "frozen_rows", "touch_doubt",
                            "recoveries", "trouble", "resets", "overruns", "level")  # fmt: skip
"""Fields of ``Skin.status()`` of which any change is worth a line."""


COUNTED: Final = {
    "overruns": "over the latency budget", "resets": "device restarts", "recoveries": "recoveries after silence",
}  # fmt: skip
"""Counters that are shown unless they are 0, in words."""


@dataclass(frozen=True, slots=True)
class Status:
    """A skin's counters at a moment, with rates since the last look."""

    rate_hz: float
    """Frames a second since then."""
    touched: bool | None
    """Whether anything touched the sheet since then; None where the skin does not count it."""
    counters: Mapping[str, Any]
    """As ``Skin.status()`` returned them."""

    def fields(self) -> dict[str, object]:
        """Return the status as plain values for a log line."""
        shown = ("frames", "published", *REPORTED_COUNTERS, "cloud", "idle", "drift", "verifier")
        return {
            "rate_hz": round(self.rate_hz, 1),
            "touched": self.touched,
            **{name: self.counters[name] for name in shown if name in self.counters},
        }

    def text(self) -> str:
        """Return the status as one line for people."""
        counters = self.counters
        parts = [f"{self.rate_hz:.1f} frames/s"]
        if self.touched is not None:
            parts.append("touched" if self.touched else "untouched")
        if doubt := counters.get("touch_doubt"):
            parts.append(event_words(f"touches:{doubt}"))
        parts += [f"{counters.get('lost', 0)} lost", f"{counters.get('corrupt', 0)} corrupt"]
        reasons = {name: count for name, count in dict(counters.get("withheld_by_reason", {})).items() if count}
        if reasons:
            listed = "; ".join(f"{WITHHELD.get(name, name)}: {count}" for name, count in reasons.items())
            parts.append(f"{sum(reasons.values())} withheld ({listed})")
        parts += [f"{counters[name]} {words}" for name, words in COUNTED.items() if counters.get(name)]
        if counters.get("idle"):
            parts.append("idle, scanning a few drives")
        electrodes, trouble = counters.get("electrodes"), counters.get("trouble")
        if trouble:
            parts.append(f"no usable frames: {WITHHELD.get(trouble, trouble)}")
        if electrodes:
            parts += [electrode_words(one) for one in electrodes]
        elif not trouble:
            watched = counters.get("drift") != {}  # which a bundle without statistics of frames has
            parts.append("all electrodes work" if watched else "electrodes are not checked")
        if shape := counters.get("shape"):
            parts.append(f"shape {shape}")
        if rows := counters.get("frozen_rows"):
            parts.append(f"{len(rows)} rows frozen (estimated)")
        if drift := drift_text(counters.get("drift")):
            parts.append(drift)
        if verifier := verifier_text(counters.get("verifier")):
            parts.append(verifier)
        return ", ".join(parts)


def drift_text(drift: Mapping[str, Any] | None) -> str:
    """Return the drift since the reference in a few words; nothing if it was never measured.

    Args:
        drift: As ``Skin.status()`` has it.
    """
    if not drift or drift.get("percent") is None:
        return ""
    if not drift["followed"]:
        return "drift unknown while touched or bent"
    uneven = "" if drift["uneven_percent"] is None else f", uneven {drift['uneven_percent']:.1f} %"
    return f"drift {drift['percent']:+.1f} +- {drift['sd_percent']:.1f} %{uneven}"


def verifier_text(verifier: Mapping[str, Any] | None) -> str:
    """Return the verifier's state and counts in a few words; nothing without a verifier.

    Args:
        verifier: As ``Skin.status()`` has it.
    """
    if not verifier:
        return ""
    why = f" ({verifier['why']})" if verifier["why"] else ""
    times = f", p50 {verifier['frame_ms_p50']:.1f} p99 {verifier['frame_ms_p99']:.1f} ms" if verifier["checked"] else ""
    again = f", restarted {verifier['restarts']} times" if verifier["restarts"] else ""
    return (
        f"verifier {verifier['state']}{why}: {verifier['checked']} checked, {verifier['flagged']} "
        f"flagged, {verifier['skipped']} skipped{times}{again}"
    )


class RunStatus(PeriodicThread):
    """Reports from when it is entered to when it is left.

    Args:
        read: ``Skin.status``; may be called from any thread.
        log: Where lines go.
        now_s: The clock.
        tell: Takes every status, as a line.
    """

    def __init__(
        self,
        read: Callable[[], Mapping[str, Any]],
        log: RunLog,
        now_s: Callable[[], float] = time.monotonic,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__("run-status", PERIOD_S, END_S)
        self._read = read
        self._log = log
        self._tell = tell
        self._now_s = now_s
        self._before: Mapping[str, Any] = {}
        self._before_s = 0.0
        self._said: Mapping[str, Any] = {}
        self._said_s = 0.0

    def check(self) -> None:
        """Read the counters, and write a line if it is time or something changed."""
        counters, now_s = dict(self._read()), self._now_s()
        elapsed_s = now_s - self._before_s
        before, self._before, self._before_s = self._before, counters, now_s
        if not before:  # nothing to compare with yet
            self._said, self._said_s = counters, now_s
            return
        rate_hz = (counters["frames"] - before["frames"]) / max(elapsed_s, 1e-9)
        touched = counters["touched"] > before["touched"] if "touched" in counters else None
        status = Status(rate_hz, touched, counters)
        self._tell(status.text())
        changed = any(counters.get(name) != self._said.get(name) for name in REPORTED_COUNTERS)
        states = [(one.get("verifier") or {}).get("state") for one in (counters, self._said)]
        changed |= states[0] != states[1]
        if self._log.live or changed or now_s - self._said_s >= SILENT_S:
            self._said, self._said_s = counters, now_s
            self._log.status(status.text(), status.fields())

    def _run(self) -> None:
        self.check()
        super()._run()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self._log.end()


def report(skin: Any, log: RunLog, said_by: str) -> None:
    """Log the device, the bundle, the expected touches, the skin and the gate, a line each.

    Args:
        skin: An open one.
        log: Where lines go.
        said_by: What says which touches are expected.
    """
    from eitskin_proto.skin.skin import PAPER
    from eitskin_proto.wire.volts import DriverHello

    hello = skin.device.hello
    for line in skin.transport.report():
        log.say(line)
    version = ".".join(map(str, hello.firmware_version))
    driven = isinstance(hello, DriverHello)
    if not driven:  # the lines above describe a driver's device
        log.say(
            f"device: {hello.serial_number}, firmware {version}, protocol {hello.protocol_major}."
            f"{hello.protocol_minor}, configuration {skin.device.configuration}, {hello.rate_mHz / 1000:g} frames/s of "
            f"{hello.rows} rows"
        )
    solvers = ", ".join(f"{name} {span / 1000:.0f} us" for name, span in skin.pipeline.maps.engine_ns.items())
    bundle = skin.bundle
    log.say(f"bundle: {bundle.path.name} {bundle.id}, labels {bundle.labels}; {solvers}")
    kind = {"lower": "that lower", "raise": "that raise", "both": "that raise or lower"}[bundle.touch_kind]
    log.say(f"touches: expecting those {kind} conductance, by {said_by}; if yours differ, choose with --touches")
    rows, columns = skin.description.grid.shape
    log.say(f"skin: {skin.description.name} {skin.description.digest}, map of {rows} x {columns} pixels")
    for line in bundle_doubts(bundle, skin.description):
        log.warn(line)
    if not driven and not hello.skin_digest and skin.description.grid_id != PAPER.grid_id:
        log.warn(
            f'the device does not name its skin: write skin = "{skin.description.grid_id}" into its configuration '
            "with 'eitskin flash write'"
        )
    gate = skin.bundle.manifest.get("gate") or {}
    rate = gate.get("false_alarm_rate")
    stated = f"{rate:.2%}" if isinstance(rate, float) else "unknown"
    log.say(f"gate: false-alarm rate {stated}" if gate else "gate: this bundle has none")


def bundle_doubts(bundle: "Bundle", description: "Skin") -> list[str]:
    """Return warnings about a skin and its bundle that do not stop the runtime."""
    from eitskin_proto.skin.touch_kind import knows

    touches = description.touch_kind
    if description is bundle.skin or knows(bundle.touch_kind, touches):
        return []
    return [
        f"skin {description.name} is for touches {touches!r}, the bundle for {bundle.touch_kind!r}: choose with "
        "--touches"
    ]


def closing(summary: dict[str, Any]) -> str:
    """Return the line that a run ends with."""
    latency = summary["latency_us"]
    return (
        f"{summary['frames']} frames at {summary['rate_hz']:.1f}/s, {summary['lost']} lost, "
        f"{summary['corrupt']} corrupt, {summary['withheld']} withheld; latency from read to publish: "
        f"{latency['p50']:.0f} us median, {latency['p99']:.0f} us p99, {latency['max']:.0f} us at most"
    )
