"""A client in C++, written from SPEC.md alone, reads what Python published: streams and status.

``test_header`` tests frames and touches.
"""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import eitskin
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.messages import Hello

pytestmark = [pytest.mark.slow, pytest.mark.process]  # a compiler reads all of zmq.hpp

SOURCE = Path(__file__).parent / "cpp" / "client.cpp"
BUILD = ("-std=c++17", "-O0", "-Wall", "-Wextra", "-Werror", "-DMSGPACK_NO_BOOST")
CLOUD = PAPER.grid.flat_cloud_mm() + np.array([3.0, -200.0, 40.0])[:, None, None]
FRAMES = 80


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("g++ is not installed: tools/system-packages.sh")
    headers = "#include <zmq.hpp>\n#include <msgpack.hpp>\n"
    looked = subprocess.run(
        [compiler, "-E", "-DMSGPACK_NO_BOOST", "-xc++", "-"], input=headers, capture_output=True, text=True, check=False
    )
    if looked.returncode:
        pytest.skip("cppzmq-dev or libmsgpack-cxx-dev is not installed: tools/system-packages.sh")
    program = tmp_path_factory.mktemp("client") / "client"
    subprocess.run([compiler, *BUILD, SOURCE, "-o", program, "-lzmq"], check=True)
    return program


def fnv(data):
    """Return the 64-bit FNV-1a of bytes, as the client prints it."""
    value = 0xCBF29CE484222325
    for byte in data:
        value = (value ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
    return f"{value:x}"


def single(value):
    """Return a number as C prints a float32 with %.9g."""
    return f"{np.float32(value):.9g}"


def lines_of(output):
    """Return {kind: [{word: value}]} of the client's lines; the first value stands under the line's kind."""
    found = {}
    for line in output.splitlines():
        kind, *words = line.split()
        found.setdefault(kind, []).append(words)
    return found


def named(words, first=1):
    """Return {name: value} of the words behind the first ones, which come in pairs."""
    return dict(zip(words[first::2], words[first + 1 :: 2], strict=True))


@pytest.fixture(scope="module")
def both(client, tmp_path_factory):
    """What the client printed of a stream, and what Python had of the same one."""
    from tests.runtime.conftest import _running
    from tests.runtime.made_up_skin import virtual_skin

    folder = tmp_path_factory.mktemp("stream")
    with (
        virtual_skin(touches=[[0.5, 600, 0.3]], touches_wait=True, rate_hz=100.0) as port,
        _running(port, folder) as running,
    ):
        publish, control = f"ipc://{folder}/frames", f"ipc://{folder}/control"
        with (
            eitskin.subscribe(publish, "all", touches=True) as frames,
            eitskin.subscribe_streams(publish) as streams,
        ):
            reference, command = running.skin.reference.flat().voltages_V, [client, publish, control, str(FRAMES)]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
                output = process.stdout.readline()  # it has subscribed
                eitskin.send_cloud(control, CLOUD, 1.01 * reference, reference)
                output += process.stdout.read()
            assert process.returncode == 0
            theirs = lines_of(output)
            last = int(theirs["frame"][-1][0])
            ours = {}
            while not ours or max(ours) < last:
                frame = next(frames)
                ours[frame.number] = frame
            items = {kind: {} for kind in (WireFrame, CloudInUse, Conditions, SkinState)}
            while not items[WireFrame] or max(item.frame or 0 for item in items[WireFrame].values()) < last:
                item = next(streams)
                items[type(item)][item.n] = item
        assert frames.lost == 0
        assert sum(streams.lost.values()) == 0
    return theirs, ours, items


def test_the_wire_is_read_alike_and_belongs_to_the_frames(both):
    theirs, ours, items = both
    volts = Hello.unpack(next(iter(items[SkinState].values())).hello).volts_per_count
    view, frames = FrameView(), 0
    for words in theirs["wire"]:
        wire, found = items[WireFrame][int(words[0])], named(words)
        assert (int(found["seq"]), int(found["read"])) == (wire.seq, wire.read_ns)
        assert found["hash"] == fnv(wire.payload)
        assert (found["solver"], found["withheld"]) == (wire.solver, wire.withheld or "-")
        assert int(found["conditions"]) == wire.conditions
        view.load(wire.payload)
        assert float(found["volts"]) in (0.0, pytest.approx(np.abs(view.counts.astype(float)).sum() * volts, rel=1e-12))
        if (frame := ours.get(wire.frame)) is not None:
            frames += 1
            assert (frame.sequence, frame.solver, frame.map_sequence) == (wire.seq, wire.solver, wire.map_seq)
    assert frames > FRAMES / 2
    assert len(theirs["wire"]) > FRAMES / 2
    assert float(named(theirs["wire"][-1])["volts"]) > 0.0


def test_clouds_are_read_alike(both):
    theirs, _, items = both
    for words in theirs["cloud"]:
        cloud, found = items[CloudInUse][int(words[0])], named(words[:-4])
        assert (int(found["revision"]), found["why"]) == (cloud.revision, cloud.why)
        assert int(found["seq"]) == (-1 if cloud.seq is None else cloud.seq)
        assert (int(found["taken"]), int(found["utc"])) == (cloud.taken_ns, cloud.utc_ns)
        assert found["hash"] == fnv(cloud.cloud.astype("<f4").tobytes())
        assert found["log_predicted"] == fnv(cloud.log_predicted.astype("<f4").tobytes())
        for name in ("predicted", "predicted_flat"):
            values = getattr(cloud, name)
            assert found[name] == ("0" if values is None else fnv(values.astype("<f8").tobytes()))
        assert words[-3:] == [single(value) for value in cloud.cloud[:, 0, 0]]
    assert {words[2] for words in theirs["cloud"]} >= {"1"}


def test_conditions_and_state_are_read_alike(both):
    theirs, _, items = both
    for words in theirs["conditions"]:
        one, found = items[Conditions][int(words[0])], named(words)
        assert [int(found[name]) for name in ("revision", "seq", "cloud")] == [one.revision, one.seq, one.cloud]
        assert (found["reference"], float(found["threshold"])) == (one.reference, one.gate_threshold)
        assert float(found["volts_per_count"]) == one.volts_per_count
        assert [int(found[name]) for name in ("regions", "electrodes", "missing")] == [1, 0, 0]
    files = 0
    for words in theirs["state"]:
        state, found = items[SkinState][int(words[0])], named(words)
        assert (found["serial"], found["configuration"], found["bundle"]) == (
            state.serial, state.configuration, state.bundle
        )  # fmt: skip
        assert (found["skin"], found["host"], found["solvers"]) == (state.skin, state.host, state.solvers[0])
        assert found["reference"] == state.reference_sha256
        assert int(found["rate_mHz"]) == Hello.unpack(state.hello).rate_mHz
        assert int(found["frames"]) == state.status["frames"]
        assert (int(found["made"]), int(found["events"])) == (state.made_ns, len(state.events))
        if found["file"] != "0":
            files += 1
            assert found["file"] == fnv(state.reference)
    assert files
    assert len(theirs["conditions"]) >= 2


def test_the_status_is_asked_for_by_its_command(both):
    theirs, ours, _ = both
    ((*words,),) = theirs["status"]
    found, frame = named(words, 0), next(iter(ours.values()))
    assert (found["serial"], found["bundle"]) == (frame.serial_number, frame.bundle)
    assert found["configuration"] == frame.configuration
