"""Recordings made in this process: a device that is played, the tiny bundle, the real frame loop, the real recorder."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eitskin
from eitskin.messaging.frame import Frame, unpack_frame
from eitskin.messaging.frame_message import Demand
from eitskin.messaging.streams import envelope
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.publisher import StreamPublisher
from eitskin.messaging.streams.state import SkinState
from eitskin.model.bundle import Bundle
from eitskin.reference.captured import Reference
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire.frames import Frame as WireScan
from eitskin_proto.wire.messages import Hello
from eitskin_tools.recording.layout import CHANNELS
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.recorder import Recorder, RecorderOptions
from eitskin_tools.recording.replay import Player, RecordedLine, ReplayOptions
from eitskin_tools.recording.script import Script, Step
from eitskin_tools.recording.writer import Series

TINY = Path(__file__).parents[2] / "golden" / "tiny.eitskin"
VOLTS = 1e-9
PERIOD_NS = 5_000_000
STREAMS = {"wire": WireFrame, "cloud": CloudInUse, "conditions": Conditions, "state": SkinState}

CLOUD = PAPER.grid.flat_cloud_mm() + np.array([3.0, -200.0, 40.0])[:, None, None]
RATIO = np.linspace(0.97, 1.04, 104)


def hello() -> Hello:
    return Hello(
        firmware_version=(1, 0, 0), hardware_id=1, serial_number="TEST-1", configuration_digest=0xABCD, generation=0,
        configuration_name="paper", rate_mHz=200_000, rows=104, sample_bytes=4, volts_per_count=VOLTS,
    )  # fmt: skip


def counts() -> np.ndarray:
    size = np.geomspace(4e6, 1e4, 104)
    return size


def scans(frames: int, first: int = 100, seed: int = 3) -> list[Step]:
    """Return frames of a sheet that is touched in the middle third, with noise, 5 ms apart."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(frames):
        touch = 0.3 * np.cos(np.arange(104)) * (frames // 3 <= index < 2 * frames // 3)
        row = np.rint(counts() * (1.0 + touch + 1e-4 * rng.standard_normal(104))).astype(np.int32)
        payload = WireScan(first + index, 1000 + 5000 * index, row).pack()
        found.append(Step(WireFrame(payload, first + index, index * PERIOD_NS), 10**9 + index * PERIOD_NS))
    return found


def reference(stretch: float = 1.0) -> Reference:
    volts = stretch * counts() * VOLTS
    return Reference(volts, np.abs(volts) * 1e-4, 100, "TEST-1", 0xABCD, "paper", "2026-11-23T00:00:00Z")


class Taker:
    """Takes messages of frames and of streams in this process, as their subscribers get them."""

    wanted, short, asked = True, False, Demand()

    def __init__(self) -> None:
        self.items: list[Any] = []
        self.streams = StreamPublisher(self._send)
        self.streams.set_topics([b"\x86"])
        self._joiner = envelope.BodyJoiner()

    def send(self, message: memoryview) -> None:
        self.items.append(unpack_frame(bytes(message), 0))

    def _send(self, message: bytes) -> None:
        found = envelope.opened(message)
        body = self._joiner.add(found)
        if body is not None:
            self.items.append(replace(STREAMS[found.name].of(body), n=found.number, run=found.run))


def play(path: Path, bundle: Path = TINY, **options: Any) -> list[Any]:
    """Return what a program gets of a recording that is played."""
    taker = Taker()
    with Player(Script(path), ReplayOptions(paced=False, **options), bundle=bundle) as player:
        for _ in player.skin.publish(taker):
            pass
    return taker.items


def measured(
    frames: int = 150,
    steps: list[Step] | None = None,
    *,
    reference_at: int | None = None,
    touches: bool = False,
    bundle: Bundle | Path = TINY,
    **options: Any,
) -> list[Any]:
    """Return what streams and frames say of a played skin that gets a cloud after a while, and maybe a reference."""
    steps = scans(frames) if steps is None else steps
    line = RecordedLine("test", hello(), lambda: iter(steps), paced=False)
    taker = Taker()
    taker.asked = Demand(touches=touches)
    with eitskin.Skin(line, bundle=bundle, reference=reference(), **options) as skin:
        line.ended = skin.stop
        volts = counts() * VOLTS

        def before(step: Step) -> None:
            if step.frame.seq == 100 + frames // 2:
                skin.set_cloud(CLOUD, RATIO * volts, volts)
            if step.frame.seq == reference_at:
                skin.loop.source.deferred.do()  # streams tell of the frame before, by what held for it
                skin.loop.use_reference(reference(1.01))

        line.before = before
        for _ in skin.publish(taker):
            pass
    return list(_in_time(taker.items))


def _in_time(items: list[Any]) -> Iterator[Any]:
    """Yield items as from a device at its own pace, whatever pace this machine played it at."""
    now_ns = first_ns = next(item.read_ns for item in items if isinstance(item, WireFrame))
    for item in items:
        if isinstance(item, WireFrame):
            now_ns = first_ns + (item.n - 1) * PERIOD_NS
            yield replace(item, read_ns=now_ns)
        elif isinstance(item, CloudInUse) and item.taken_ns:
            yield replace(item, taken_ns=now_ns + PERIOD_NS // 2)
        elif isinstance(item, SkinState) and item.n > 1:
            yield replace(item, made_ns=now_ns)
        else:
            if isinstance(item, Frame):
                item.host_ns["read"] = first_ns + (item.number - 1) * PERIOD_NS
            yield item


def recorded(path: Path, items: list[Any], kept: RecorderOptions = RecorderOptions(), **options: Any) -> Recorder:  # noqa: B008
    """Write items into a file, and return what wrote them."""
    recorder = Recorder(lambda head: Series(path, head, **options), kept)
    for item in items:
        recorder.record(item)
    recorder.close()
    return recorder


def rewritten(
    file: Path,
    changed: Callable[[str, bytes, int], tuple[bytes, int] | None],
    attached: bool | dict[str, bytes] = True,
    head: dict[str, str] | None = None,
) -> Path:
    """Write a recording anew; ``changed(topic, data, log_ns)`` gives data and time, or None to leave one out.

    Attachments go without ``attached``, and are the given ones where it is a dictionary.
    """
    found = Recording(file)
    entries = list(found.entries())
    path = file.with_name("b.mcap")
    writer = Series(path, {**found.head, **(head or {})})
    for name, data in (found.attached if attached is True else attached or {}).items():
        writer.attach(name, "application/json", data, 0)
    channels = {channel.topic: channel for channel in CHANNELS}
    for one in entries:
        if (made := changed(one.topic, one.data, one.log_ns)) is not None:
            writer.add(channels[one.topic], *made, one.sequence)
    writer.close()
    return path


@pytest.fixture(scope="session")
def items() -> list[Any]:
    return measured(skip_unchanged=True)


@pytest.fixture
def file(tmp_path: Path, items: list[Any]) -> Path:
    path = tmp_path / "a.mcap"
    recorded(path, items)
    return path


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.mcap"
    recorded(path, measured(45))
    return path


class _Off:
    """A frame whose map differs from what was computed in one pixel's last bit."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self.map = frame.map.copy()
        self.map[0, 0] = np.nextafter(self.map[0, 0], np.float32(2))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._frame, name)


def recorded_off(path: Path, items: list[Any]) -> int:
    """Write items into a file, the first touched map as if it had been published otherwise; return that frame's seq."""
    touched: Frame = next(item for item in items if isinstance(item, Frame) and item.map.any())
    recorder = Recorder(lambda head: Series(path, head), RecorderOptions())
    for item in items:
        if item is touched:
            recorder._when_known(item.run, recorder._frame, _Off(item))
        else:
            recorder.record(item)
    recorder.close()
    return touched.sequence
