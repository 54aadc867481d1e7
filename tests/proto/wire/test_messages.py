from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.second_skin import SECOND

from eitskin_proto.errors import MismatchError, ProtocolError
from eitskin_proto.skin.parts import Touches
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named
from eitskin_proto.wire import codes, messages

STRATEGY = {
    "u8": st.integers(0, 0xFF),
    "u16": st.integers(0, 0xFFFF),
    "u32": st.integers(0, 0xFFFFFFFF),
    "f64": st.floats(allow_nan=False, allow_infinity=False),
    "id": st.binary(min_size=8, max_size=8).map(bytes.hex),
    "version": st.tuples(*[st.integers(0, 255)] * 3),
    "text16": st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=16),
}


def any_message(kind):
    strategies = {}
    for name, code in kind.LAYOUT.fields:
        if code == "tail":
            strategies[name] = st.binary(max_size=kind.LAYOUT.max_tail)
        elif name == "protocol_major" and kind is messages.Hello:
            strategies[name] = st.just(codes.PROTOCOL_MAJOR)
        elif code != "magic":
            strategies[name] = STRATEGY[code]
    return st.builds(kind, **strategies)


HELLO = messages.Hello(
    firmware_version=(1, 0, 0), hardware_id=1, serial_number="S1", configuration_digest=5, generation=1,
    configuration_name="paper", rate_mHz=200_000, rows=104, sample_bytes=3, volts_per_count=1e-6,
)  # fmt: skip


@pytest.mark.parametrize("kind", messages.PLAIN, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_every_message_survives_the_wire(kind, data):
    message = data.draw(any_message(kind))
    payload = message.pack()
    assert payload[0] == kind.LAYOUT.type
    assert messages.unpack(payload) == message


@pytest.mark.parametrize("kind", messages.PLAIN, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=5, deadline=None)
def test_every_wrong_length_is_refused_with_both_lengths(kind, data):
    payload = data.draw(any_message(kind)).pack()
    size, tail = kind.LAYOUT.size, kind.LAYOUT.max_tail
    for length in range(1, size):
        with pytest.raises(ProtocolError, match=f"{kind.LAYOUT.type.name} has {length} bytes, expected {size}"):
            kind.LAYOUT.unpack(payload[:length])
    with pytest.raises(ProtocolError, match=f"expected {size}"):
        kind.LAYOUT.unpack(payload[:size] + bytes(tail + 1))


def test_every_request_and_every_answer_carries_a_tag_right_after_the_type():
    for kind in messages.PLAIN:
        if kind is not messages.Event:
            assert kind.LAYOUT.fields[0] == ("tag", "u8")


def test_another_major_version_is_named_whatever_follows():
    payload = bytearray(HELLO.pack())
    payload[6], payload[7] = 3, 4
    for content in (payload, payload[:8], payload + b"more"):
        with pytest.raises(ProtocolError, match=r"speaks protocol 3\.4, expected 1\.x"):
            messages.unpack(bytes(content))


def test_a_later_minor_version_may_have_appended_fields_but_not_the_present_one():
    payload = bytearray(HELLO.pack()) + b"new field"
    with pytest.raises(ProtocolError, match="HELLO has 109 bytes, expected 100"):
        messages.unpack(bytes(payload))
    payload[7] = codes.PROTOCOL_MINOR + 1
    assert messages.unpack(bytes(payload)) == replace(HELLO, protocol_minor=codes.PROTOCOL_MINOR + 1)
    with pytest.raises(ProtocolError, match="HELLO has 99 bytes"):
        messages.unpack(bytes(payload[:99]))


def test_a_wrong_magic_is_no_eitskin_device():
    payload = bytearray(HELLO.pack())
    payload[2:6] = b"ABCD"
    with pytest.raises(ProtocolError, match="not an eitskin device"):
        messages.unpack(bytes(payload))


def test_a_device_with_another_table_is_refused_with_both_ids():
    HELLO.check()
    with pytest.raises(MismatchError, match=f"HELLO.protocol_id: found {'ab' * 8}, expected .*; install") as caught:
        replace(HELLO, protocol_id="ab" * 8).check()
    assert caught.value.found == "ab" * 8
    assert caught.value.expected == HELLO.protocol_id


def test_a_device_that_states_another_skin_is_refused_and_one_that_states_none_is_taken():
    for skin in (PAPER, SECOND):
        assert HELLO.skin_digest == ""
        HELLO.check_skin(skin)
        replace(HELLO, grid_id=skin.digest).check_skin(skin)
        replace(HELLO, grid_id=skin.digest).check_skin(replace(SECOND, calibrated_from=skin.digest))
        replace(HELLO, grid_id=skin.grid_id).check_skin(replace(skin, touches=Touches(kind="both")))
    for one, other in ((PAPER, named("lab")), (named("hydrogel"), named("lab"))):
        replace(HELLO, grid_id=one.digest).check_skin(other)  # shipped descriptions of one sheet
    with pytest.raises(MismatchError, match=named("lab").digest):
        replace(HELLO, grid_id=named("lab").digest).check_skin(SECOND)
    stated = replace(HELLO, grid_id=SECOND.digest)
    with pytest.raises(
        MismatchError, match=rf"skin: found {SECOND.digest}, expected {PAPER.grid_id} \(paper\); .*flash"
    ):
        stated.check_skin(PAPER)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (messages.Stop(tag=256), "tag is 256, but the wire carries 0 to 255"),
        (messages.Start(frames=-1), "frames is -1, but the wire carries 0 to 4294967295"),
        (replace(HELLO, serial_number="x" * 17), "expected at most 16 printable ASCII"),
        (replace(HELLO, serial_number="tab\t"), "expected at most 16 printable ASCII"),
        (replace(HELLO, volts_per_count=float("nan")), "volts_per_count is nan, expected a finite"),
        (replace(HELLO, protocol_id="12"), "protocol_id is '12', expected 16 hex digits"),
        (replace(HELLO, firmware_version=(1, 2, 256)), "three numbers from 0 to 255"),
        (
            messages.ConfigWrite(token=1, offset=0, data=bytes(33)),
            "data has 33 bytes.* at most 32",
        ),
    ],
)
def test_a_field_that_does_not_fit_is_refused_with_its_bound(message, text):
    with pytest.raises(ValueError, match=text):
        message.pack()
