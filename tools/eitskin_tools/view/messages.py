"""Messages to the page: a JSON head and bytes after it, each with its length.

::

0   u32 little-endian   bytes of the rest
4   u32 little-endian   bytes of the head
8   head                UTF-8 JSON with a ``kind``, and ``of``: the number of the skin
..  body                of a frame: (rows, columns) u8, the map times 255
                        of a skin, flat, and of a surface: (3, rows, columns) f32, mm

Positions in space are in the robot's frame: poses are applied here, not in the page.
"""

import json
import math
import struct
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.frame_record import STAGES
from eitskin.messaging.frame import Frame
from eitskin.messaging.streams.state import SkinState
from eitskin.robot.pose import Pose
from eitskin.touches.touch import Touch
from eitskin_proto.skin.skin import Skin
from eitskin_tools.console.words import capital, electrode_parts, event_words, skipped_words
from eitskin_tools.pictures import palette

HEAD: Final = struct.Struct("<II")

UNLISTED_EVENTS: Final = ("lost", "overrun", "cloud")
"""Events that the page counts, or shows on the surface."""


def packed(head: dict[str, Any], body: bytes = b"") -> bytes:
    """Return a message.

    Args:
        head: JSON values; numbers are finite.
        body: The bytes after it.
    """
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    return HEAD.pack(4 + len(text) + len(body), len(text)) + text + body


def frame_message(frame: Frame, of: int, pose: Pose) -> bytes:
    """Return the message of a frame: its numbers, its touches, and its map in 256 levels from 0 to 1.

    Args:
        frame: As a subscriber receives it.
        of: Number of the skin.
        pose: Of the skin on the robot.
    """
    stamps = [frame.host_ns[stage] for stage in STAGES]
    head = {
        "kind": "frame",
        "of": of,
        "n": frame.number,
        "seq": frame.sequence,
        "t_ms": frame.received_ns / 1e6,
        "run": frame.run,
        "serial": frame.serial_number,
        "configuration": frame.configuration,
        "bundle": frame.bundle,
        "touched": frame.touched,
        "solver": frame.solver,
        "age_us": frame.age_us,
        "stages_us": [max(end - begin, 0) / 1000 for begin, end in pairwise(stamps)],
        "skipped": [capital(skipped_words(code)) for code in frame.skipped],
        "events": event_list(frame.events),
        "electrodes": [electrode_parts(entry) for entry in frame.electrodes],
        "drift": [None, None] if frame.touched else [frame.drift_percent, frame.drift_sd_percent],
        "cloud": frame.cloud,
        "counts": dict(frame.counts),
        "shape": frame.map.shape,
        "touches": [_touch(pose.touch(touch)) for touch in frame.touch_list.touches] if frame.touch_list else [],
        "touch_events": [(e.kind, e.id, e.other) for e in frame.touch_list.events] if frame.touch_list else [],
        "more": frame.touch_list.more if frame.touch_list else 0,
    }
    levels = np.rint(np.clip(frame.map, 0.0, 1.0) * 255.0).astype(np.uint8)
    return packed(head, levels.tobytes())


def event_list(codes: Iterable[str]) -> list[str]:
    """Return in words the events that the page lists."""
    return [capital(event_words(code)) for code in codes if code not in UNLISTED_EVENTS]


def _touch(touch: Touch) -> dict[str, Any]:
    return {
        "id": touch.id,
        "parent": touch.parent,
        "age_s": round(touch.age_s, 3),
        "centre": _short(touch.centre_mm),
        "axes": _short(touch.axes_mm),
        "angle": round(touch.angle_rad, 4),
        "area": round(touch.area_mm2, 1),
        "peak": round(touch.peak, 3),
        "place": _short(touch.place_mm),
        "normal": [round(value, 4) for value in touch.normal],
    }


def _short(values: Sequence[float]) -> list[float]:
    return [round(value, 2) for value in values]


def skin_message(skin: Skin, of: int, pose: Pose, about: dict[str, Any]) -> bytes:
    """Return the message that describes a skin: its sheet, its electrodes and its flat surface.

    Args:
        skin: The runtime's.
        of: Number of the skin.
        pose: Of the skin on the robot.
        about: More for the page, such as its name.
    """
    head = {
        "kind": "skin",
        "of": of,
        "outline": skin.outline.kind,
        "size_mm": skin.outline.size_mm,
        "thickness_mm": float(skin.layer.thickness_mm.nominal(1)[0]),
        "shape": skin.grid.shape,
        "electrodes": electrode_places_mm(skin).round(2).tolist(),
        "palette": palette().tolist(),
        **about,
    }
    return packed(head, _placed(skin.grid.flat_cloud_mm(), pose))


def surface_message(revision: int, cloud_mm: npt.NDArray[np.floating], run: str, of: int, pose: Pose) -> bytes:
    """Return the message of a surface.

    Args:
        revision: As frames name it in ``cloud``.
        cloud_mm: (3, rows, columns) mm.
        run: Of the runtime.
        of: Number of the skin.
        pose: Of the skin on the robot.
    """
    head = {"kind": "surface", "of": of, "revision": revision, "shape": cloud_mm.shape[1:], "run": run}
    return packed(head, _placed(cloud_mm, pose))


def _placed(cloud_mm: npt.NDArray[np.floating], pose: Pose) -> bytes:
    """Return a (3, rows, columns) cloud in the robot's frame, as a message has it."""
    return np.ascontiguousarray(np.moveaxis(pose.place(np.moveaxis(cloud_mm, 0, -1)), -1, 0), dtype="<f4").tobytes()


def state_message(state: SkinState, of: int) -> bytes:
    """Return the message of the events since the previous state, and of the runtime's bundle, skin and version."""
    head = {
        "kind": "state",
        "of": of,
        "n": state.n,
        "run": state.run,
        "events": event_list(code for _, code in state.events),
        "bundle": state.bundle,
        "skin": state.skin,
        "version": state.version,
        "labels": str(state.status.get("labels", "")),
    }
    return packed(head)


def status_message(state: str, text: str, of: int = 0, **more: Any) -> bytes:
    """Return the message of a feed's state: ``live``, or ``silent`` and why."""
    return packed({"kind": "status", "of": of, "state": state, "text": text, **more})


def electrode_places_mm(skin: Skin) -> npt.NDArray[np.float64]:
    """Return (16, 2): x and y of the electrodes' centres on the flat sheet's border."""
    length, width = skin.outline.size_mm
    arc = skin.arc_length_mm
    if skin.outline.kind == "disc":
        angle = 2.0 * arc / length
        return np.stack([np.cos(angle) + 1.0, np.sin(angle) + 1.0], axis=1) * (length / 2.0)
    corners = np.array([0.0, length, length + width, 2.0 * length + width, 2.0 * (length + width)])
    x = np.interp(arc, corners, [0.0, length, length, 0.0, 0.0])
    y = np.interp(arc, corners, [0.0, 0.0, width, width, 0.0])
    if not math.isfinite(float(x.sum() + y.sum())):
        raise ValueError("electrodes: found places that are not finite")
    return np.stack([x, y], axis=1)
