"""Places, names, topics and numbers that SPEC.md states are the code's: neither moves alone.

Each sentence below is made of the code's own constants, and must stand in SPEC.md as it is made.
"""

from itertools import pairwise

import numpy as np
import pytest

from eitskin import frame_loop, frame_record, stream_source
from eitskin.acquisition import greeting
from eitskin.health import drift, electrodes
from eitskin.messaging import control, control_commands, curve_keys, endpoints, frame, publish, regions
from eitskin.messaging.control_commands import REFERENCE_FRAMES
from eitskin.messaging.streams import envelope, state, verified
from eitskin.model import stillness
from eitskin.reference import captured, normaliser
from eitskin.touches import moments, pieces, touch, tracking
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.verification import verdict
from eitskin_tools.recording import layout, reader

from .test_spec import FLAT


def code(raw):
    """Return bytes as SPEC.md writes them."""
    return raw.hex(" ")


PATIENT, PATIENT_TOUCHES = frame.patient_topics(frame.FIRST_BYTE), frame.patient_topics(frame.TOUCH_FIRST_BYTE)
ROWS, COLUMNS = PAPER.grid.shape
PITCH_MM = PAPER.grid.pixel_mm
ARC = np.asarray(PAPER.electrodes.arc_length_mm.value)

PLACES = [
    f"`eitskin run` publishes at `ipc://FOLDER/{endpoints.FRAMES}` and takes control requests at "
    f"`ipc://FOLDER/{endpoints.CONTROL}`.",
    "FOLDER is `$XDG_RUNTIME_DIR/eitskin`, or `/tmp/eitskin-UID` if that variable names no folder.",
    "a client needs the runtime's public key (`server.key`) and a secret key of its own, whose public half is in the "
    "runtime's folder `clients/`",
    'a line `public-key = "KEY"` and, in a secret one, `secret-key = "KEY"`, 40 characters of Z85 each',
]

TOPICS = [
    f"no topic (subscribe to the bytes {code(frame.EVERY_FRAME)})",
    f"The two bytes {code(frame.EVERY_FRAME)} are the prefix of every frame",
    f"the byte 0x{frame.FIRST_BYTE.hex()}, with which every frame begins",
    f"`{regions.WHOLE.decode()}`, which runtimes of earlier releases need",
    f"`{regions.UNCHANGED.decode()}` if it does without `shape` and `map`",
    f"else `{regions.ALWAYS.decode()}`",
    f"to a fourth one, `{regions.TOUCHES.decode()}`",
    f"the twelve prefixes {code(PATIENT[0])} to {code(PATIENT[-1])} in place of the byte de",
    f"a frame has {frame.KEYS.start} to {frame.KEYS.stop - 1}",
    f"For touches without maps these are {code(PATIENT_TOUCHES[0])} to {code(PATIENT_TOUCHES[-1])}.",
    f"a subscriber to the byte 0x{frame.TOUCH_FIRST_BYTE.hex()} alone gets touch messages",
    *(f"| {name} | {code(topic)} |" for name, topic in envelope.TOPICS.items()),
    f"The byte {envelope.FIRST_BYTE.hex()} alone selects all four.",
    f"Subscribe to the bytes {code(verified.TOPIC)} (hexadecimal)",
]

VERSIONS = [
    f"| v | int | version of this map: {frame.VERSION} |",
    f"and its `v` is {frame.TOUCH_VERSION}.",
    f"| v | int | version of these messages: {envelope.VERSION} |",
    f"| v | int | version of these messages: {verified.VERSION} |",
    f"| `format`, `version` | `{layout.FORMAT}`, `{layout.VERSION}` |",
]

FRAMES = [
    f"a MessagePack map with string keys, at most {frame.LARGEST_MESSAGE} bytes",
    f"[{ROWS}, {COLUMNS}] for the paper's skin, at most [{regions.MOST_PIXELS[0]}, {regions.MOST_PIXELS[1]}]",
    f"A text has at most {frame.MAX_TEXT} characters and a list at most {frame.MAX_TEXTS}.",
    f"time at the end of {', '.join(f'`{name}`' for name in frame_record.STAGES)}",
    f"totals since the runtime started: {', '.join(f'`{name}`' for name in frame.COUNTS)}",
    f"list of 1 to {regions.MAX_REGIONS} [int, int, int, int]",
    f"{publish.QUEUE_FRAMES} frames at least (and up to {publish.MOST_WAITING}) wait for a subscriber at the runtime",
    f"all do at least every {stillness.REFRESH_FRAMES} frames",
    f"has a dV that is not finite or beyond {normaliser.LARGEST_CHANGE:.0e}".replace("+0", ""),
    "has no row that reaches a thousandth of its reference",
    f"they have moved for {electrodes.HEALTHY} frames and are used again",
    f"they have moved unevenly: by more than {100 * drift.MIN_UNEVEN:g} % rms",
]

TOUCHES = [
    f"at most {moments.MOST_TOUCHES} touches",
    f"| touch_bytes | int | {touch.LAYOUT.size};",
    f"| touch_events | bin | {touch.EVENT_LAYOUT.size} bytes an event |",
    ", ".join(f"{kind} {name}" for kind, name in touch.KINDS.items()),
    "of pixels of at least 1/2",
    "leads down by 1/4 at least from the lower one",
    f"A map of more than {pieces.MOST_RUNS} runs of such pixels",
    f"the nearest of the next frame within {tracking.GATE_MM:g} mm",
    f"listed at once if it rises to {tracking.BIRTH}",
    f"once that holds for more than {tracking.HOLD_FRAMES} frames",
    f"one that is not listed for {tracking.HOLD_FRAMES + 1} frames has ended",
]

STREAMS = [
    f"within {1e-9 * stream_source.JOIN_NS:g} s after a program subscribes, and again every second",
    f"changes of the state at most {1e9 / stream_source.LEAST_NS:g} times a second",
    f"when its subscribers have had {1e3 * frame_loop.GIVE_WAY_S:g} ms to take it",
    f"a MessagePack map of six keys in this order, at most {frame.LARGEST_MESSAGE} bytes",
    f"| parts | int | 1 to {envelope.MOST_PARTS}:",
    f"| body | bin | at most {envelope.PIECE} bytes;",
    "at first, when it changes, in each tenth state",
    f"`seq` of a frame and what happened at it; the last {state.MOST_EVENTS} since the state before",
]

CONTROL = [
    f"one MessagePack map of at most {control_commands.LARGEST_REQUEST} bytes, and 12 more for each pixel beyond the "
    f"paper's {PAPER.grid.n_pixels}",
    f"At most {control.MOST_CONNECTIONS} connections at once.",
    f"before the delimiter, {control.MOST_PARTS - 1} parts at most",
    f"| reference | optional `frames`: int, {REFERENCE_FRAMES[0]} to {REFERENCE_FRAMES[1]}, by default "
    f"{captured.DEFAULT_FRAMES};",
    f"wait for frames / rate, and at most {frame_loop.CAPTURE_S:g} s beyond",
    f"`electrodes`: list of at most {electrodes.MAX_OUT} ints, 0 to 15",
    f"{12 * PAPER.grid.n_pixels} bytes for the paper's skin",
    f"bin, {8 * N_ROWS} bytes each, float64 little-endian ({N_ROWS}) V",
]

MAP = [
    f"Pixel `map[row][column]` has its centre at x = (column + 1/2) * {3 * PITCH_MM[0]:.0f}/3 mm, y = (row + 1/2) * "
    f"{3 * PITCH_MM[1]:.0f}/3 mm on the flat sheet",
    f"x along its {PAPER.grid.size_mm[0]:g} mm, y along its {PAPER.grid.size_mm[1]:g} mm, both from the corner (0, 0)",
    f"at the arc lengths {ARC[0]:g} + {ARC[1] - ARC[0]:g} k mm, k = 0 .. {len(ARC) - 1}, counter-clockwise",
]

VERIFIED = [
    f"A message is a MessagePack map of {verified.FIRST_BYTE[0] - 0x80} keys, `{verified.NAME}` first",
    f"p_value is below {verdict.LEVEL}",
    f"those that explain it best, at most {verified.MOST_TOUCHES}",
    ", ".join(f"`{name}`" for name in verified.COUNTS[:1])
    + " frames, those of them `flagged`, changed frames `skipped`",
]

RECORDINGS = [
    f"**Metadata** `{layout.HEAD}`, once, before all messages",
    f"**Attachments** `{layout.REFERENCE}*.json`",
    f"with the same numbers in every file, 1 to {len(layout.CHANNELS)} in this order",
    *(f"| `{channel.topic}` | {channel.encoding} |" for channel in layout.CHANNELS),
]

DEVICE = [
    f"whose `rate_mHz` is not {greeting.RATE_MHZ[0]} to {greeting.RATE_MHZ[1]:,}",
    f"`volts_per_count` is not {greeting.VOLTS_PER_COUNT[0]:g} to 1e3",
]

STATED = {
    "places": PLACES, "topics": TOPICS, "versions": VERSIONS, "frames": FRAMES, "touches": TOUCHES,
    "streams": STREAMS, "control": CONTROL, "map": MAP, "verified": VERIFIED, "recordings": RECORDINGS,
    "device": DEVICE,
}  # fmt: skip


@pytest.mark.parametrize("group", STATED)
def test_what_the_code_does_is_what_is_stated(group):
    assert [sentence for sentence in STATED[group] if sentence not in FLAT] == []


def test_numbers_that_are_written_in_words_are_the_codes():
    assert (pieces.HALF, pieces.SADDLE) == (1 / 2, 1 / 4)
    assert normaliser.NO_SIGNAL == 1e-3
    assert len(PATIENT) == 12
    assert stream_source.REPEAT_NS == 1e9
    assert stream_source.FILE_REPEATS == 10
    assert greeting.VOLTS_PER_COUNT[1] == 1e3
    assert reader.MAGIC[1:5] == b"MCAP"


def test_the_electrodes_lie_on_the_sides_that_are_stated():
    assert "0 to 4 on y = 0, 5 to 7 on x = 150, 8 to 12 on y = 100, 13 to 15 on x = 0" in FLAT
    length, width = PAPER.grid.size_mm
    corners = np.cumsum([0.0, length, width, length, width])
    sides = [np.flatnonzero((low < ARC) & (high > ARC)).tolist() for low, high in pairwise(corners)]
    assert sides == [[0, 1, 2, 3, 4], [5, 6, 7], [8, 9, 10, 11, 12], [13, 14, 15]]


def test_the_channels_are_numbered_in_the_order_of_their_table():
    assert list(layout.TOPICS) == list(range(1, len(layout.CHANNELS) + 1))
    at = [FLAT.index(f"| `{topic}` |") for topic in layout.TOPICS.values()]
    assert at == sorted(at)


def test_the_files_of_keys_are_called_and_look_as_stated(tmp_path):
    curve_keys.make_keys(tmp_path / "keys")
    found = {str(path.relative_to(tmp_path / "keys")) for path in (tmp_path / "keys").rglob("*") if path.is_file()}
    assert found == {"server.key", "server.key_secret", "client.key_secret", "clients/client.key"}
    for name, keys in (("server.key", ["public"]), ("server.key_secret", ["public", "secret"])):
        text = (tmp_path / "keys" / name).read_text()
        for kind in keys:
            (line,) = (line.strip() for line in text.splitlines() if line.strip().startswith(f"{kind}-key"))
            assert line.startswith(f'{kind}-key = "')
            assert len(line.split('"')[1]) == 40
