"""Every page's ``sh`` blocks, typed in order by a reader who has no hardware.

A page's ``text`` blocks are output, or commands that need hardware, hours or an administrator: nobody types them here.
A command that runs until Ctrl-C gets a terminal of its own, and the next one is typed once it has said that it works.
``PORT`` and serial ports are a virtual skin's. ``pytest tests/docs/test_tour.py -m slow -s`` prints what each took.
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from .markdown import ROOT, code_blocks

PAGES = sorted(path for path in [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"] if code_blocks(path, "sh"))
GOES_ON = {"virtual-skin": "ttySKIN", "run": "ready ", "replay": "ready ", "view": "viewing ", "subscribe": "frame"}
"""Commands that run until Ctrl-C, and what they say once they work; of an example, its first line."""

A_PORT = re.compile(r"\bPORT\b|/dev/tty(?:ACM|USB)\d")
PATIENCE_S = 1200.0
"""A command that says nothing for so long is stuck, however busy the machine is."""


def typed(block: str) -> list[str]:
    """Return a block's commands: a backslash joins lines, and a here-document belongs to its command.

    A block without an ``eitskin`` command is one script.
    """
    if not any(subcommand(line) for line in block.splitlines()):
        return [block]
    commands, joined, end = [], "", None
    for line in block.splitlines():
        joined += line
        if end is None and (match := re.search(r"<<-?\s*['\"]?(\w+)", line)):
            end = match[1]
        if (end and line != end) or line.endswith("\\"):
            joined += "\n"
            continue
        if joined.strip() and not joined.lstrip().startswith("#"):
            commands.append(joined)
        joined, end = "", None
    return commands


def subcommand(command: str) -> str:
    """Return which ``eitskin`` command this is; empty for another program."""
    match = re.match(r"\s*eitskin ([\w-]+)", command)
    return match[1] if match else ""


class Reader:
    """Somebody who types one command after the other in a folder of their own."""

    def __init__(self, folder: Path, python: str) -> None:
        self._folder, self._open = folder, {}
        runtime = folder / "run"
        runtime.mkdir(mode=0o700)
        for name in ("docs", "tools"):
            (folder / name).symlink_to(ROOT / name)
        path = f"{Path(python).parent}:{os.environ['PATH']}"
        self._environment = {**os.environ, "PATH": path, "PYTHONUNBUFFERED": "1", "XDG_RUNTIME_DIR": str(runtime)}
        self._environment["BROWSER"] = "true"
        self._port, self._ports = "", {}

    def types(self, command: str) -> None:
        """Run a command until it has said that it works, or has ended well."""
        name = subcommand(command)
        if A_PORT.search(command):
            if not self._port:
                self.types("eitskin virtual-skin")
            command = A_PORT.sub(self._port, command)
        for number, port in self._ports.items():
            command = command.replace(f"/dev/serial/by-id/usb-eitskin_{number}-if00", port)
        if name in ("run", "replay") and "--check" not in command:
            self._end("run", "replay")  # one runtime at a time, as the pages say
        if name == "view":
            command += " --port 0"
        process = subprocess.Popen(
            ["bash", "-c", command], cwd=self._folder, env=self._environment, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self._open.setdefault(name, []).append(process)
        wanted = "" if command.lstrip().startswith("python docs/examples/") else GOES_ON.get(name)
        watchdog = threading.Timer(PATIENCE_S, process.kill)
        watchdog.start()
        said = []
        for line in process.stdout:
            said.append(line.rstrip())
            if wanted is not None and wanted in line:
                break
        else:
            assert process.wait() == 0, f"{command}\n" + "\n".join(said)
        watchdog.cancel()
        if name == "virtual-skin":
            self._port = next(word for word in said[-1].split() if "ttySKIN" in word)
            self._ports[command.split()[-1]] = self._port  # of --serial-number NUMBER

    def _end(self, *names: str) -> None:
        for process in [process for name in names for process in self._open.pop(name, [])]:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
            process.stdout.close()
            process.wait(PATIENCE_S)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end(*[name for name in self._open if name != "virtual-skin"], "virtual-skin")


@pytest.mark.process
@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_can_be_pasted_from_top_to_bottom(page, tmp_path):
    with Reader(tmp_path, sys.executable) as reader:
        for command in [command for block in code_blocks(page, "sh") for command in typed(block)]:
            begin = time.monotonic()
            reader.types(command)
            print(f"{time.monotonic() - begin:6.1f} s  {command.strip()}")


def test_backslashes_and_here_documents_belong_to_their_command():
    assert typed("a=1\necho $a") == ["a=1\necho $a"]
    block = "# first\neitskin run \\\n    --port PORT\ncat > a <<'EOF'\nx\n\nEOF\neitskin status  # is it there?"
    wanted = [["eitskin", "run"], ["cat", ">"], ["eitskin", "status"]]
    assert [command.split()[:2] for command in typed(block)] == wanted
