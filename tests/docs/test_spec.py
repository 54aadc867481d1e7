"""What SPEC.md and the pages say of the published frame is what the code has."""

import re

import pytest

from eitskin.messaging import control, frame, publish, regions
from eitskin.pipeline.frame_pipeline import REASONS

from .markdown import ROOT

SPEC = (ROOT / "firmware_proto/SPEC.md").read_text(encoding="utf-8")
FLAT = " ".join(SPEC.split())


@pytest.mark.parametrize("page", ["firmware_proto/SPEC.md", "docs/messages.md"])
def test_the_reasons_for_withholding_are_all_listed(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    listed = re.search(r"\| reason \|.*?\n\|[-|]+\n((?:\|.*\n)+)", text).group(1)
    assert tuple(re.findall(r"^\| `?(\w+)`? \|", listed, re.M)) == REASONS


def test_every_key_of_a_frame_is_listed():
    packer = frame.FramePacker(configuration="paper/0", bundle="0", serial_number="S", run="r")
    packer.put_texts("none", (), ())
    keys = frame.msgpack.unpackb(bytes(packer.message())).keys()
    listed = re.findall(r"^\| (\w+) \|", SPEC.split("## 7.")[1].split("### The map")[0], re.M)
    assert set(listed) - {"key"} == set(keys)


def test_limits_and_queues_are_those_of_the_code():
    assert f"up to {publish.QUEUE_FRAMES} frames wait" in FLAT
    assert f"more than {publish.LARGEST_SUBSCRIPTION} bytes" in FLAT
    assert f"More than {publish.MOST_TOPICS} subscriptions or {publish.MOST_CONNECTIONS} connections" in FLAT
    assert f"{publish.MOST_AT_ONCE} subscription messages" in FLAT
    assert f"at most {frame.LARGEST_MESSAGE} bytes" in FLAT
    assert f"at most {control.LARGEST_REQUEST} bytes" in FLAT
    assert f"At most {control.MOST_CONNECTIONS} connections" in FLAT
    assert f"more than {regions.MOST}" in FLAT
