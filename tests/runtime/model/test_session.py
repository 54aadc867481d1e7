"""A session of ONNX Runtime is made without telemetry: nothing is written into the user's folders, nobody is called."""

import os
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

SESSION = """
import time
from eitskin.model.bundle import load_bundle
bundle = load_bundle({bundle!r})
{make}
time.sleep(0.5)
"""

OURS = "from eitskin.model.session import open_session\nopen_session(bundle, 'head.onnx', bundle.files['head.onnx'])"

THEIRS = (
    "import onnxruntime\nonnxruntime.InferenceSession(bundle.files['head.onnx'], providers=['CPUExecutionProvider'])"
)


def made(home, bundle, make, wrapper=()):
    """Make a session in a process with an empty home folder, and return what lies in that folder afterwards."""
    home.mkdir()
    quiet = ("ORT_DISABLE_TELEMETRY", "CI")  # either keeps the library from telling anybody
    kept = {name: value for name, value in os.environ.items() if name not in quiet}
    environment = kept | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(home)}
    code = SESSION.format(bundle=str(bundle), make=make)
    command = [*wrapper, sys.executable, "-c", code]
    subprocess.run(command, check=True, env=environment, cwd=home, capture_output=True, timeout=120)
    return sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())


def test_a_session_leaves_no_file_in_the_users_folders(tmp_path, tiny_path):
    assert made(tmp_path / "home", tiny_path, OURS) == []


def test_the_library_left_to_itself_would_write_there(tmp_path, tiny_path):
    if not made(tmp_path / "home", tiny_path, THEIRS):
        pytest.skip("this build of ONNX Runtime keeps no telemetry of its own accord")


CALL = "import socket\nsocket.socket().connect_ex(('127.0.0.1', 9))"


def calls(tmp_path, bundle, make):
    """Return the lines of strace that connect or send to an internet address, a name server's included."""
    traced = tmp_path / "strace.txt"
    strace = ("strace", "-f", "-qq", "-e", "trace=connect,sendto,sendmmsg,sendmsg", "-o", str(traced))
    try:
        made(tmp_path / "home", bundle, make, strace)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"strace cannot trace here: {error.stderr.decode(errors='replace')[:200]}")
    return [line for line in traced.read_text().splitlines() if "AF_INET" in line]


@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
def test_a_session_calls_nobody(tmp_path, tiny_path):
    assert calls(tmp_path, tiny_path, OURS) == []


@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
def test_a_call_would_be_seen(tmp_path, tiny_path):
    assert calls(tmp_path, tiny_path, CALL)
