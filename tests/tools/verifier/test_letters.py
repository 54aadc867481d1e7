"""What stands in the packets between the runtime and its verifier."""

import dataclasses

import numpy as np
import pytest

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml
from eitskin_tools.verifier.letters import FRAME, LARGEST_PACKET, REST, SETUP, FrameLetter, RestLetter, Setup, unpack

SETUP_OF_PAPER = Setup(
    bundle="b", labels="units", touches="raise", skin=to_toml(PAPER), skin_digest=PAPER.digest, cloud=3,
    cloud_mm=PAPER.grid.flat_cloud_mm().astype("<f4").tobytes(), reference_V=np.ones(104).tobytes(),
    spread_V=np.full(104, 1e-3).tobytes(), budget_s=0.0,
)  # fmt: skip


def test_a_frame_comes_back_as_it_was():
    rng = np.random.default_rng(1)
    missing = rng.random(104) < 0.2
    change, values = rng.standard_normal(104).astype("f4"), rng.random(1350).astype("f4")
    kind, *items = unpack(FrameLetter(7, 2**40, 5, 6, 8, 2, missing, change, values).packed())
    found = FrameLetter.of(*items)
    assert kind == FRAME
    assert (found.setup, found.seq, found.device_us, found.read_ns, found.publish_ns, found.cloud) == (
        7, 2**40, 5, 6, 8, 2,
    )  # fmt: skip
    for one, other in zip((found.missing, found.change, found.map), (missing, change, values), strict=True):
        assert np.array_equal(one, other)


def test_what_the_sheet_reads_at_rest_comes_back():
    change = np.random.default_rng(1).standard_normal(104)
    kind, *items = unpack(RestLetter(3, 50, change).packed())
    found = RestLetter.of(*items)
    assert (kind, found.setup, found.frames) == (REST, 3, 50)
    assert np.array_equal(found.change, change)


def test_a_setup_comes_back_and_another_skin_is_refused():
    packet = SETUP_OF_PAPER.packed(4)
    assert len(packet) < LARGEST_PACKET
    kind, number, fields = unpack(packet)
    assert (kind, number, Setup(**fields)) == (SETUP, 4, SETUP_OF_PAPER)
    assert SETUP_OF_PAPER.described() == PAPER
    with pytest.raises(MismatchError, match="verifier: skin"):
        dataclasses.replace(SETUP_OF_PAPER, skin_digest="0123456789abcdef").described()
