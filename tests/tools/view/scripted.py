"""A runtime that only publishes: frames of a known scene, with touches as the runtime lists them."""

import threading
import time
from dataclasses import dataclass, field

import numpy as np

from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.publish import Publisher
from eitskin.touches.surface import Surface
from eitskin.touches.watch import TouchWatch
from eitskin_proto.skin.skin import PAPER

STAGES = ("read", "decode", "normalise", "gate", "infer", "pack", "publish")


def disc(x_mm, y_mm, radius_mm=8.0):
    """Return the (30, 45) map of a disc that is touched, its border within a pixel."""
    y, x = np.meshgrid(*(np.arange(n) for n in PAPER.grid.shape), indexing="ij")
    away = np.hypot((x + 0.5) * 10 / 3 - x_mm, (y + 0.5) * 10 / 3 - y_mm)
    return np.clip((radius_mm - away) / (10 / 3) + 0.5, 0.0, 1.0).astype(np.float32)


def cylinder(angle_deg=120.0):
    """Return the (3, 30, 45) cloud of the sheet bent about y."""
    x, y = np.meshgrid(*(axis.astype(np.float64) for axis in _axes()))
    radius = 150.0 / np.deg2rad(angle_deg)
    turn = (x - 75.0) / radius
    return np.stack([75.0 + radius * np.sin(turn), y, radius * np.cos(turn) - radius]).astype(np.float32)


def flat():
    """Return the (3, 30, 45) cloud of the flat sheet."""
    x, y = np.meshgrid(*_axes())
    return np.stack([x, y, np.zeros_like(x)]).astype(np.float32)


def _axes():
    return (np.arange(45) + 0.5) * 10 / 3, (np.arange(30) + 0.5) * 10 / 3


@dataclass
class Scene:
    """What is published from now on."""

    map: np.ndarray = field(default_factory=lambda: np.zeros(PAPER.grid.shape, np.float32))
    cloud: int = 0
    cloud_mm: np.ndarray = field(default_factory=flat)
    skipped: tuple = ("geometry:cloud_unchanged",)
    events: tuple = ()
    electrodes: tuple = ()
    drift: tuple = (0.4, 0.1, 0.2)
    counts: tuple = (0, 0, 0, 0)
    spans_us: tuple = (40, 20, 30, 250, 25, 15)


class Runtime:
    """Publishes a scene from when it is entered to when it is left.

    Args:
        endpoint: Where.
        scene: What.
        rate_hz: Frames a second.
        run: Differs from one start to the next.
    """

    def __init__(self, endpoint, scene=None, rate_hz=60.0, run="one"):
        self.endpoint, self.scene, self._every_s, self._run_id = endpoint, scene or Scene(), 1 / rate_hz, run
        self.sent = 0
        self.topics = frozenset()
        self.touches_asked = False
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        packer = FramePacker(
            configuration="paper/1", bundle="b", serial_number="TEST-0001", run=self._run_id, shape=PAPER.grid.shape
        )
        watch = TouchWatch(PAPER.grid)
        publisher = Publisher(self.endpoint)
        surface, made_of = None, None
        try:
            due_s = time.perf_counter()
            while not self._left.wait(max(0.0, due_s - time.perf_counter())):
                due_s = max(due_s + self._every_s, time.perf_counter())
                scene = self.scene
                publisher.update()
                self.topics, self.touches_asked = publisher.topics, publisher.asked.touches
                self.sent += 1
                if made_of is not scene.cloud_mm:
                    surface, made_of = Surface(scene.cloud_mm, PAPER.grid), scene.cloud_mm
                device_us = time.perf_counter_ns() // 1000
                touches = watch.update(scene.map.ravel().astype(float), id(scene.map), surface, device_us)
                self._put(packer, scene, device_us, touches if publisher.asked.touches else None)
                publisher.send(packer.message())
        finally:
            publisher.close()

    def _put(self, packer, scene, device_us, touches):
        stamp = time.perf_counter_ns() - 1000 * sum(scene.spans_us)
        stamps = [stamp]
        for span_us in scene.spans_us:
            stamps.append(stamps[-1] + 1000 * span_us)
        touched = bool(scene.map.max() >= 0.5)
        packer.put_map(memoryview(scene.map.astype("<f4").tobytes()))
        packer.put_texts("vd2t" if touched else "none", scene.skipped, scene.events, scene.electrodes)
        packer.put_touches(touches)
        packer.put_numbers(
            (self.sent, self.sent, device_us, 900, 0xC3 if touched else 0xC2, 3.0, scene.cloud, 0, self.sent,
             *scene.drift, 1, *stamps, *scene.counts)
        )  # fmt: skip

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._left.set()
        self._thread.join()
