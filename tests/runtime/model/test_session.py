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
from eitskin.model.session import open_session
bundle = load_bundle({bundle!r})
open_session(bundle, 'head.onnx', bundle.files['head.onnx'])
time.sleep(0.5)
"""


def made(home, bundle, wrapper=()):
    """Make a session in a process with an empty home folder, and return what lies in that folder afterwards."""
    home.mkdir()
    quiet = ("ORT_DISABLE_TELEMETRY", "CI")  # either keeps the library from telling anybody
    kept = {name: value for name, value in os.environ.items() if name not in quiet}
    environment = kept | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(home)}
    code = SESSION.format(bundle=str(bundle))
    command = [*wrapper, sys.executable, "-c", code]
    subprocess.run(command, check=True, env=environment, cwd=home, capture_output=True, timeout=120)
    return sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())


@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
def test_a_session_calls_nobody_and_leaves_no_file_in_the_users_folders(tmp_path, tiny_path):
    traced = tmp_path / "strace.txt"
    strace = ("strace", "-f", "-qq", "-e", "trace=connect,sendto,sendmmsg,sendmsg", "-o", str(traced))
    try:
        left = made(tmp_path / "home", tiny_path, strace)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"strace cannot trace here: {error.stderr.decode(errors='replace')[:200]}")
    assert left == []
    assert [line for line in traced.read_text().splitlines() if "AF_INET" in line] == []
