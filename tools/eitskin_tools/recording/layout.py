"""The names in a recording: one MCAP file with channels (firmware_proto/SPEC.md describes it for other programs).

::

    metadata    eitskin            format, version, ids, HELLO, host, clock offset
    attachment  reference-SHA.json the reference, as ``eitskin reference`` writes it
    /eitskin/wire        msgpack   frames of the wire as they came, and their processing
    /eitskin/cloud       msgpack   the cloud in use, with its predictions
    /eitskin/conditions  msgpack   what else affects a map
    /eitskin/state       JSON      the device, the runtime and their status
    /eitskin/frame       JSON      each published frame, with a digest of its map
    /eitskin/map         msgpack   maps, if requested
    /eitskin/grid        JSON      foxglove.Grid: the flat map, at most 30 a second
    /eitskin/surface     JSON      foxglove.PointCloud: the bent surface, coloured by the map

The first three are the bodies of the streams of their names. ``log_time`` is the wall clock in ns; the clock of the
runtime's machine, on which frames are stamped, is ``log_time`` less ``wall_minus_host_ns`` of the metadata.
"""

import json
from dataclasses import dataclass
from typing import Any, Final

from eitskin_proto.errors import SkinError

FORMAT: Final = "eitskin-recording"
VERSION: Final = 1
"""Of the layout; a reader refuses a newer one, and takes unknown channels and keys for nothing."""

HEAD: Final = "eitskin"
"""Name of the metadata."""

REFERENCE: Final = "reference-"
"""How the names of attached references begin."""

JSON_MEDIA: Final = "application/json"


class RecordingError(SkinError):
    """A recording that cannot be used, or not be written."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a recording."""

    topic: str
    encoding: str
    """Of its messages: ``json`` or ``msgpack``."""
    schema_name: str
    schema: str = ""
    """A JSON schema; empty for MessagePack."""
    lasts: bool = False
    """Its last message holds until the next: each file of a series begins with it."""


def _schema(properties: dict[str, Any], required: tuple[str, ...], **more: Any) -> str:
    """Return the text of a JSON schema of one object."""
    return json.dumps({"type": "object", "properties": properties, "required": list(required), **more})


NUMBER: Final = {"type": "number"}
WHOLE: Final = {"type": "integer"}
TEXT: Final = {"type": "string"}
TEXTS: Final = {"type": "array", "items": TEXT}

STATE_SCHEMA: Final = _schema(
    {
        "serial": TEXT, "configuration": TEXT, "bundle": TEXT, "skin": TEXT, "solvers": TEXTS, "utc_ns": WHOLE,
        "reference_sha256": TEXT, "hello": {"type": "object"}, "status": {"type": "object"},
        "events": {"type": "array", "items": {"type": "array"}},
    },
    (),
    title="Who measures, by what, and how it goes",
)  # fmt: skip

FRAME_SCHEMA: Final = _schema(
    {
        "seq": WHOLE, "number": WHOLE, "map_seq": WHOLE, "touched": {"type": "boolean"}, "gate_logit": NUMBER,
        "solver": TEXT, "cloud": WHOLE, "digest": TEXT, "peak": NUMBER, "age_us": WHOLE, "latency_us": NUMBER,
        "skipped": TEXTS, "events": TEXTS, "electrodes": TEXTS, "drift": NUMBER, "drift_sd": NUMBER,
        "drift_uneven": NUMBER, "host_ns": {"type": "object", "additionalProperties": WHOLE},
        "counts": {"type": "object", "additionalProperties": WHOLE},
    },
    ("seq", "map_seq", "touched", "solver"),
    title="What was published of a frame, its map left out",
)  # fmt: skip

WIRE: Final = Channel("/eitskin/wire", "msgpack", "eitskin.Wire")
CLOUD: Final = Channel("/eitskin/cloud", "msgpack", "eitskin.Cloud", lasts=True)
STATE: Final = Channel("/eitskin/state", "json", "eitskin.State", STATE_SCHEMA, lasts=True)
CONDITIONS: Final = Channel("/eitskin/conditions", "msgpack", "eitskin.Conditions", lasts=True)
FRAME: Final = Channel("/eitskin/frame", "json", "eitskin.Frame", FRAME_SCHEMA)
MAP: Final = Channel("/eitskin/map", "msgpack", "eitskin.Map")


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


_TIME: Final = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}
_WHOLE: Final = {"type": "integer", "minimum": 0}
_BYTES: Final = {"type": "string", "contentEncoding": "base64"}
_POSE: Final = _object(
    "foxglove.Pose",
    position=_object("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER),
    orientation=_object("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER),
)
_FIELDS: Final = {
    "type": "array",
    "items": _object("foxglove.PackedElementField", name=TEXT, offset=_WHOLE, type=_WHOLE),
}

GRID: Final = Channel(
    "/eitskin/grid",
    "json",
    "foxglove.Grid",
    json.dumps(
        _object(
            "foxglove.Grid", timestamp=_TIME, frame_id=TEXT, pose=_POSE, column_count=_WHOLE,
            cell_size=_object("foxglove.Vector2", x=NUMBER, y=NUMBER), row_stride=_WHOLE, cell_stride=_WHOLE,
            fields=_FIELDS, data=_BYTES,
        )
    ),
)  # fmt: skip

SURFACE: Final = Channel(
    "/eitskin/surface",
    "json",
    "foxglove.PointCloud",
    json.dumps(
        _object(
            "foxglove.PointCloud", timestamp=_TIME, frame_id=TEXT, pose=_POSE, point_stride=_WHOLE, fields=_FIELDS,
            data=_BYTES,
        )
    ),
)  # fmt: skip

CHANNELS: Final = (WIRE, CLOUD, STATE, CONDITIONS, FRAME, MAP, GRID, SURFACE)
"""In the order of their numbers; every file has all of them, so that a number means the same channel in each, even
where the chunk that says so is lost."""

TOPICS: Final = {number: channel.topic for number, channel in enumerate(CHANNELS, start=1)}
"""Topic by number."""
