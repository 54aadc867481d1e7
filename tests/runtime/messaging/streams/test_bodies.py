"""Bodies of streams: what goes in comes out, bit by bit, and nothing malformed is believed."""

import hashlib
import json
import re
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import msgpack
import numpy as np
import pytest

from eitskin.errors import FrameError
from eitskin.messaging.regions import Region
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin_proto.wire.messages import Hello

RNG = np.random.default_rng(3)

WIRE = WireFrame(
    payload=bytes(range(256)), seq=2**33, read_ns=2**60, device_us=7, frame=3, touched=True, gate_logit=-2.5,
    solver="vd2t", map_seq=2**33, conditions=4,
)  # fmt: skip

CLOUD = CloudInUse(
    revision=2, cloud=RNG.normal(size=(3, 5, 7)).astype(np.float32), predicted=RNG.normal(size=104),
    predicted_flat=RNG.normal(size=104), taken_ns=5, why="given",
    log_predicted=RNG.normal(size=928).astype(np.float32), seq=9, utc_ns=6,
)  # fmt: skip

CONDITIONS = Conditions(
    revision=3, seq=8, cloud=2, reference="ab" * 32, regions=(Region(0, 3, 1, 4), Region(5, 9, 0, 45)),
    gate_threshold=0.1, drift=RNG.normal(size=104).astype(np.float32),
    electrodes=((5, "detached", None), (7, "swapped", 8)), missing_rows=(0, 103), skip_unchanged=False,
    volts_per_count=1e-9,
)  # fmt: skip

HELLO = Hello(
    firmware_version=(1, 2, 3), hardware_id=1, serial_number="S", configuration_digest=2, generation=0,
    configuration_name="paper", rate_mHz=200_000, rows=104, sample_bytes=3, volts_per_count=1e-9,
)  # fmt: skip

STATE = SkinState(
    hello=HELLO.pack(), host="h", serial="S", configuration="paper/1", bundle="b", skin="paper/2", protocol_id="p",
    grid_id="g", version="0.1", solvers=("vd2t", "tikhonov"), status={"lost": 0, "drift": {"percent": None}},
    reference_sha256=hashlib.sha256(b"{}").hexdigest(), reference=b"{}", events=((3, "lost"),), made_ns=1, utc_ns=2,
)  # fmt: skip

ALL = pytest.mark.parametrize("item", [WIRE, CLOUD, CONDITIONS, STATE], ids=lambda item: type(item).__name__)


def same(one, other):
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    return type(one) is type(other) and one == other


@ALL
def test_what_goes_in_comes_out(item):
    item = replace(item, n=12, run="r", received_ns=5)
    found = replace(type(item).of(item.body()), n=12, run="r", received_ns=5)
    for field in fields(item):
        assert same(getattr(found, field.name), getattr(item, field.name)), field.name


@ALL
def test_the_specification_lists_its_keys(item):
    spec = (Path(__file__).parents[4] / "firmware_proto/SPEC.md").read_text(encoding="utf-8")
    name = {WireFrame: "wire", CloudInUse: "cloud", Conditions: "conditions", SkinState: "state"}[type(item)]
    (rows,) = re.findall(rf"^\*\*{name}\*\*[^|]*\| key \|.*\n\|[-|]+\n((?:\|.*\n)+)", spec, re.MULTILINE)
    listed = [key for keys in re.findall(r"^\| ([\w, ]+) \|", rows, re.MULTILINE) for key in keys.split(", ")]
    assert sorted(listed) == sorted(msgpack.unpackb(item.body()))


@ALL
def test_what_may_be_unknown_may_be_nil(item):
    optional = [field.name for field in fields(item) if "None" in str(field.type) and field.name != "electrodes"]
    assert optional
    for name in optional:
        body = replace(item, **{name: None}).body()
        assert getattr(type(item).of(body), name) is None


@ALL
def test_a_key_that_a_later_release_adds_is_left_alone(item):
    body = msgpack.packb(msgpack.unpackb(item.body()) | {"new": [1, {"x": b"y"}]})
    assert type(item).of(body)


@ALL
@pytest.mark.parametrize("wrong", [None, -1, 2**70, 1.5, float("nan"), "x" * 300, b"\0" * 3, [], ["x"], {}, {"a": b""}])
def test_a_field_of_another_kind_is_refused_or_means_something(item, wrong):
    """Every field is replaced by every wrong value: an error of ours, or a value that is allowed there."""
    whole = msgpack.unpackb(item.body())
    refused, texts = 0, []
    for key in whole:
        try:
            body = msgpack.packb(whole | {key: wrong})
        except OverflowError:
            continue
        try:
            found = type(item).of(body)
        except FrameError as error:
            refused += 1
            texts.append(str(error))
        else:
            assert same_kind(getattr(found, key), getattr(item, key), wrong)
    assert all(len(text) < 200 and "\n" not in text for text in texts)
    if wrong != 2**70:
        assert refused >= len(whole) / 2


def same_kind(found, before, wrong):
    return type(found) is type(before) or (found is None and wrong is None)


@ALL
def test_no_cut_or_altered_body_does_more_than_be_refused(item):
    body = item.body()
    for end in range(0, len(body), max(1, len(body) // 60)):
        with pytest.raises(FrameError):
            type(item).of(body[:end])
    for at in RNG.integers(0, len(body), 80):
        altered = bytearray(body)
        altered[at] ^= 1 << int(RNG.integers(8))
        with suppress(FrameError):
            type(item).of(bytes(altered))


@pytest.mark.parametrize(("name", "bad"), [("cloud", np.nan), ("predicted", np.inf), ("log_predicted", np.nan)])
def test_numbers_that_are_not_finite_are_refused(name, bad):
    values = getattr(CLOUD, name).copy()
    values.flat[3] = bad
    with pytest.raises(FrameError, match=name):
        CloudInUse.of(replace(CLOUD, **{name: values}).body())


def test_the_state_as_plain_values_can_be_written_as_json():
    found = json.loads(json.dumps(STATE.as_dict(), allow_nan=False))
    assert found["hello"]["serial_number"] == "S"
    assert bytes.fromhex(found["hello_hex"]) == HELLO.pack()
    assert found["status"] == {"lost": 0, "drift": {"percent": None}}
    assert found["events"] == [[3, "lost"]]
