import json
import runpy
from pathlib import Path

import pytest

from eitskin_proto.wire import config, framing, messages
from eitskin_proto.wire.frames import Frame

FOLDER = Path(__file__).parents[2] / "golden"
STORED = json.loads((FOLDER / "wire.json").read_text())
MAKER = runpy.run_path(str(FOLDER / "regenerate.py"))


def test_regenerating_gives_the_stored_vectors():
    assert MAKER["text"]() == (FOLDER / "wire.json").read_text()


def test_every_message_has_a_vector():
    types = {bytes.fromhex(vector["payload"])[0] for vector in STORED["messages"].values()}
    assert types == {int(kind.LAYOUT.type) for kind in messages.PLAIN} | {0x82}


@pytest.mark.parametrize("name", STORED["messages"])
def test_stored_bytes_give_the_message_that_they_were_made_from(name):
    vector, expected = STORED["messages"][name], MAKER["all_messages"]()[name]
    [payload] = framing.Deframer().feed(bytes.fromhex(vector["wire"]))
    assert payload.hex() == vector["payload"]
    message = messages.unpack(payload)
    if isinstance(message, Frame):
        assert message.pack() == expected.pack()
        assert message.counts.tolist() == expected.counts.tolist()
    else:
        assert message == expected


@pytest.mark.parametrize("name", STORED["messages"])
def test_every_single_bit_flip_is_rejected_and_the_next_packet_still_arrives(name):
    wire = bytes.fromhex(STORED["messages"][name]["wire"])
    intact = framing.encode(b"intact")
    for bit in range(8 * (len(wire) - 1)):
        damaged = bytearray(wire)
        damaged[bit // 8] ^= 1 << bit % 8
        deframer = framing.Deframer()
        assert deframer.feed(b"\0" + damaged + intact) == [b"intact"], f"bit {bit}"
        assert deframer.corrupt >= 1
    for bit in range(8):  # the delimiter itself: the two packets become one, which is rejected; then all is well
        deframer = framing.Deframer()
        assert deframer.feed(wire[:-1] + bytes([1 << bit]) + intact + intact) == [b"intact"]


def test_stored_configurations_read_back_and_every_bit_flip_is_refused():
    for name, text in STORED["configurations"].items():
        blob = bytes.fromhex(text)
        assert config.Configuration.from_blob(blob).name == name
        for bit in range(8 * len(blob)):
            damaged = bytearray(blob)
            damaged[bit // 8] ^= 1 << bit % 8
            with pytest.raises(config.ProtocolError):
                config.Configuration.from_blob(bytes(damaged))


def test_stored_checks_are_those_of_the_library():
    assert {text: f"{framing.crc32c(text.encode()):08x}" for text in STORED["crc32c"]} == STORED["crc32c"]
