"""``tools/cpp/eitskin.hpp``, installed as a CMake package, reads the stream that Python reads, and says when it is
blind.
"""

import random
import shutil
import struct
import subprocess
import threading
from contextlib import contextmanager
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq

import eitskin
from eitskin.messaging.regions import TOUCHES

from ..runtime.conftest import _running
from ..runtime.made_up_skin import virtual_skin

pytestmark = [pytest.mark.slow, pytest.mark.process]  # a compiler reads all of zmq.hpp, twice

ROOT = Path(__file__).parents[2]
FRAMES = 150
PATIENCE_S = 120


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The folder of the programs ``check`` and ``stop``."""
    if not all(map(shutil.which, ("cmake", "g++"))):
        pytest.skip("cmake or g++ is not installed: tools/system-packages.sh")
    folder = tmp_path_factory.mktemp("built")
    package = ["cmake", "-S", ROOT / "tools/cpp", "-B", folder / "package"]
    found = subprocess.run(package, capture_output=True, text=True, check=False)
    if "cppzmq" in found.stderr:
        pytest.skip("cppzmq-dev is not installed: tools/system-packages.sh")
    assert found.returncode == 0, found.stderr
    consumer = ["cmake", "-S", ROOT / "tests/clients/cpp", "-B", folder, f"-DCMAKE_PREFIX_PATH={folder / 'prefix'}"]
    for command in (
        ["cmake", "--build", folder / "package"],
        ["cmake", "--install", folder / "package", "--prefix", folder / "prefix"],
        consumer,
        ["cmake", "--build", folder],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def check(built):
    """Return a function that runs ``check`` and gives its lines, or what it says of an error."""

    def run(*words):
        command = [built / "check", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
        return (done.stdout if done.returncode == 0 else done.stderr).splitlines()

    return run


@pytest.fixture(scope="module")
def runtime(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stream")
    touches = [[0.1 * at, 0.1 * at + 0.05, 0.3] for at in range(3000)]
    with virtual_skin(touches=touches, touches_wait=True, rate_hz=200.0) as port, _running(port, folder) as running:
        running.where = f"ipc://{folder}/frames", f"ipc://{folder}/control"
        yield running


@contextmanager
def publisher(folder):
    """A socket that publishes whatever a test sends, and its endpoint."""
    with zmq.Context() as context, context.socket(zmq.XPUB) as socket:
        socket.linger = 0
        endpoint = f"ipc://{folder}/made-up"
        socket.bind(endpoint)
        yield socket, endpoint


@pytest.fixture(scope="module")
def messages(runtime):
    """Published messages with touches: one with its map, one without."""
    found = {}
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.linger = 0
        for topic in (TOUCHES, b"\xde", b"\xdf"):
            socket.subscribe(topic)
        socket.connect(runtime.where[0])
        while len(found) < 2:
            message = socket.recv()
            if msgpack.unpackb(message).get("touches"):
                found[message[:1]] = message
    return [found[b"\xde"], found[b"\xdf"]]


@pytest.mark.parametrize("kind", ["maps", "touches"])
def test_every_frame_is_that_which_python_reads_and_nothing_is_allocated(check, runtime, kind):
    ours, ready = {}, threading.Event()

    def read():
        with eitskin.subscribe(runtime.where[0], "all", touches=True, maps=kind == "maps") as frames:
            for frame in frames:
                ours[frame.number] = frame
                ready.set()
                if done.is_set() and frame.number > last[0]:
                    return

    done, last = threading.Event(), [0]
    reader = threading.Thread(target=read)
    reader.start()
    assert ready.wait(PATIENCE_S)
    *lines, end = check("frames", runtime.where[0], FRAMES, "all", kind, 0)
    theirs = [line.split()[1:] for line in lines if line.startswith("frame ")]
    last[0] = int(theirs[-1][0])
    done.set()
    reader.join()
    assert end == "allocations 0 lost 0"
    assert len(theirs) == FRAMES
    listed = {(int(one[0]), int(one[1])): one[2:] for line in lines if (one := line.split()[1:]) and line[0] == "t"}
    touched = 0
    for number, sequence, flag, cloud, read_ns, pixels, total, solver, events in theirs:
        frame = ours[int(number)]
        assert (int(sequence), int(flag), int(cloud)) == (frame.sequence, frame.touched, frame.cloud)
        assert (int(read_ns), solver, int(events)) == (frame.host_ns["read"], frame.solver, len(frame.events))
        assert (int(pixels), float(total)) == (frame.map.size, pytest.approx(float(frame.map.sum(dtype=float))))
        assert {at[1] for at in listed if at[0] == frame.number} == {touch.id for touch in frame.touches}
        for touch in frame.touches:
            touched += 1
            values = (touch.age_s, *touch.centre_mm, touch.area_mm2, touch.peak, touch.place_mm[2], touch.normal[2])
            expected = [f"{np.float32(value):.9g}" for value in (*values, touch.surface_mm2)]
            assert listed[frame.number, touch.id] == expected
    assert touched > FRAMES / 5


def test_a_slow_program_gets_the_newest_frame(check, runtime):
    *lines, end = check("frames", runtime.where[0], 10, "newest", "touches", 100)
    numbers = [int(line.split()[1]) for line in lines if line.startswith("frame ")]
    assert min(np.diff(numbers)) > 0
    assert max(np.diff(numbers)) > 1
    assert int(end.split()[-1]) == numbers[-1] - numbers[0] - len(numbers) + 1


def test_a_cloud_is_taken_and_a_wrong_one_is_refused_with_the_runtimes_words(check, runtime):
    (line,) = check("cloud", runtime.where[1], 1350)
    with eitskin.subscribe(runtime.where[0], touches=True) as frames:
        frame = next(frame for frame in frames if frame.cloud == int(line.split()[1]) and frame.touches)
    assert frame.touches[0].place_mm[2] == pytest.approx(7.0)
    assert "cloud" in check("cloud", runtime.where[1], 1349)[0]


def test_the_example_goes_stops_when_touched_and_is_blind_when_the_runtime_ends(built, tmp_path):
    with (
        virtual_skin(touches=[[at, at + 0.5, 0.3] for at in range(200)], touches_wait=True, rate_hz=200.0) as port,
        _running(port, tmp_path) as running,
        subprocess.Popen(
            [built / "package/stop", f"ipc://{tmp_path}/frames"], stdout=subprocess.PIPE, text=True
        ) as robot,
    ):
        try:
            lines = iter(robot.stdout.readline, "")
            for wanted in ("go ", " touched ", "go "):  # on a busy machine it is blind in between
                assert next(line for line in lines if wanted in line)
            running.stop()
            assert next(line for line in lines if "is `eitskin run` running" in line)
        finally:
            robot.terminate()
            robot.wait()


def test_silence_another_version_and_old_frames_are_blind_and_bring_no_touch(built, messages, tmp_path):
    new = msgpack.unpackb(messages[1])
    fresh = {"host": "elsewhere", "age_us": 1000}

    def packed(**changed):
        fields = {**new, **fresh, **changed}
        body = b"".join(msgpack.packb(key) + msgpack.packb(value) for key, value in fields.items())
        return b"\xdf" + struct.pack(">I", len(fields)) + body

    steps = [
        (packed(), "seen"),
        (packed(v=9), "another version than this header reads"),
        (packed(), "seen"),
        (packed(age_us=10**6), "s old, more than 0.1 s"),
        (packed(), "seen"),
        (None, "within 0.1 s: is `eitskin run` running there?"),
    ]
    current, done = [None], threading.Event()
    with publisher(tmp_path) as (socket, endpoint):
        command = [built / "check", "blind", endpoint, "0.1", str(len(steps) + 1)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            assert socket.recv() == b"\x01\xdf"
            assert "no frame" in program.stdout.readline()
            sender = threading.Thread(
                target=lambda: [socket.send(one) for one in iter(lambda: done.wait(0.01) or current[0], True) if one]
            )
            sender.start()
            for current[0], expected in steps:
                assert expected in program.stdout.readline()
            done.set()
            sender.join()


def test_tcp_without_keys_is_refused(check):
    assert "needs CURVE keys" in check("blind", "tcp://127.0.0.1:9", "0.1", "1")[0]


def test_no_damaged_message_is_a_frame_with_touches(check, messages, tmp_path):
    rng = random.Random(1)
    whole = [message + b"" for message in messages]
    cut = [message[:size] for message in messages for size in range(0, len(message), 1 if len(message) < 2000 else 7)]
    flipped = []
    for _ in range(3000):
        message = bytearray(rng.choice(messages))
        message[rng.randrange(min(len(message), 400))] ^= 1 << rng.randrange(8)
        flipped.append(bytes(message))
    path = tmp_path / "messages"
    path.write_bytes(b"".join(struct.pack("<I", len(one)) + one for one in (*whole, *cut, *flipped)))
    lines = [line for line in check("load", path) if not line.startswith("touch ")]
    assert len(lines) == len(whole) + len(cut) + len(flipped)
    assert all(line.startswith("frame ") for line in lines[: len(whole)])
    assert not any("touches" in line and "with" in line and "without" not in line for line in lines)
    assert not any(line.startswith("frame ") for line in lines[len(whole) : len(whole) + len(cut)])
