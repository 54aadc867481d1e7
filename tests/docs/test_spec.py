"""What SPEC.md and the pages say of the published frame is what the code has."""

import ast
import re

import msgpack
import pytest
import zmq

from eitskin.reference.judgement import Judgement

from .markdown import ROOT

SPEC = (ROOT / "firmware_proto/SPEC.md").read_text(encoding="utf-8")
FLAT = " ".join(SPEC.split())


def constant(name, files="**/*.py"):
    """Return what a constant of the runtime is, wherever it lives."""
    pattern = re.compile(rf"^{name}: Final = (\([^)]*\)|.+)(?:  # .*)?$", re.MULTILINE)
    paths = (ROOT / "runtime/eitskin").glob(files)
    (value,) = {found for path in paths for found in pattern.findall(path.read_text(encoding="utf-8"))}
    return ast.literal_eval(value)


def test_the_findings_of_a_reference_are_all_listed():
    found = Judgement(0.0, 0.0, None, None, None, (), ()).fields()
    pages = (FLAT, " ".join((ROOT / "docs/control.md").read_text(encoding="utf-8").split()))
    assert [name for name in found for page in pages if f"`{name}`" not in page] == []


@pytest.mark.parametrize("page", ["firmware_proto/SPEC.md", "docs/messages.md"])
def test_the_reasons_for_withholding_are_all_listed(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    listed = re.search(r"\| reason \|.*?\n\|[-|]+\n((?:\|.*\n)+)", text).group(1)
    assert tuple(re.findall(r"^\| `?(\w+)`? \|", listed, re.MULTILINE)) == constant("REASONS", "pipeline/*.py")


def test_limits_and_queues_are_those_of_the_code():
    publishing, control = "messaging/publish.py", "messaging/control*.py"
    assert f"{constant('QUEUE_FRAMES', publishing)} frames at least" in FLAT
    assert f"more than {constant('LARGEST_SUBSCRIPTION', publishing)} bytes" in FLAT
    assert f"{constant('MOST_SUBSCRIBERS', publishing)} subscribers are served" in FLAT
    assert f"at most {constant('LARGEST_MESSAGE', 'messaging/frame*.py')} bytes" in FLAT
    assert f"at most {constant('LARGEST_REQUEST', control)} bytes" in FLAT
    assert f"At most {constant('MOST_CONNECTIONS', control)} connections" in FLAT


@pytest.mark.process
def test_every_key_of_a_published_frame_is_listed(runtime):
    listed = re.findall(r"^\| (\w+) \|", SPEC.split("## 7.")[1].split("### The map")[0], re.MULTILINE)
    context = zmq.Context()
    socket = context.socket(zmq.SUB)
    try:
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        socket.connect(runtime.frames)
        assert socket.poll(120_000), "no frame came"
        keys = msgpack.unpackb(socket.recv()).keys()
    finally:
        socket.close(0)
        context.term()
    assert set(listed) - {"key"} == set(keys)


@pytest.mark.process
@pytest.mark.parametrize(
    ("page", "heading"), [("firmware_proto/SPEC.md", "- `status`:"), ("docs/control.md", "## status")]
)
def test_every_field_of_the_status_is_listed(runtime, page, heading):
    import eitskin

    text = (ROOT / page).read_text(encoding="utf-8").split(heading)[1].split("\n## ")[0].replace("`", "")
    text = text.split("\nThe map ")[0]  # what a field holds
    listed = re.findall(r"^\| ([\w, ]+) \|", text, re.MULTILINE)
    names = {name for entry in listed for name in entry.split(", ")} - {"field"}
    assert names == set(eitskin.request(runtime.control, "status"))
