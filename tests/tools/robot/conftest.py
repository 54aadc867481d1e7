"""The supervising process around stand-ins of skins, whose events are read one by one."""

import json
import os
import select
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest

from eitskin.robot.described import read_states

HERE = Path(__file__).parent
PATIENCE_S = 60.0


class Family:
    """The supervising process, whose events are read one by one."""

    def __init__(self, folder, skins, *words, **environment):
        text = f'format = "eitskin-robot"\nversion = 1\nfolder = "{folder}/r"\n'
        for one in skins:
            text += "[[skins]]\n" + "".join(f'{key} = "{value}"\n' for key, value in one.items())
        (folder / "robot.toml").write_text(text)
        self.folder = folder / "r"
        self.process = subprocess.Popen(
            [sys.executable, HERE / "family_process.py", folder / "robot.toml", *map(str, words)],
            stderr=subprocess.PIPE, text=True, env={**os.environ, **environment},
        )  # fmt: skip
        self.heard = []

    def until(self, wanted):
        """Return the next event of which a condition holds."""
        timer = threading.Timer(PATIENCE_S, self.process.kill)
        timer.start()
        try:
            for line in self.process.stderr:
                self.heard.append(json.loads(line))
                if wanted(self.heard[-1]):
                    return self.heard[-1]
        finally:
            timer.cancel()
        raise AssertionError(f"it was not said, but: {self.heard}")

    def ready(self):
        return self.until(lambda event: event["event"] == "ready" and "of" in event)

    def states(self):
        return {one.skin.name: one for one in read_states(self.folder)}

    def ended(self):
        """Read all that is still said, and return the exit status."""
        self.heard += [json.loads(line) for line in self.process.stderr]
        return self.process.wait(PATIENCE_S)


@pytest.fixture
def family(tmp_path):
    """Return a context manager that supervises stand-ins, by name."""

    @contextmanager
    def run(restart="never", grace_s=PATIENCE_S, hang_s=PATIENCE_S, environment=None, **kinds):
        (tmp_path / "ref.json").touch()
        common = {"reference": "ref.json", "restart": restart}
        skins = [{"name": name, "port": f"{kind}@{tmp_path}", **common} for name, kind in kinds.items()]
        found = Family(tmp_path, skins, grace_s, hang_s, **(environment or {}))
        try:
            yield found
        finally:
            found.process.terminate()
            found.process.communicate()

    return run


def gone(pid):
    """Wait for the end of a process that is no child of ours."""
    try:
        handle = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    poll = select.poll()
    poll.register(handle, select.POLLIN)
    found = bool(poll.poll(int(PATIENCE_S * 1000)))
    os.close(handle)
    return found
