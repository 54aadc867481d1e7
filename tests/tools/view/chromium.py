"""A headless Chromium, driven over its debugging pipe: JSON ended by a zero byte, on descriptors 3 and 4.

Everything that the page writes to its console, throws, or asks the network for is kept, to be looked at.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

LONGEST_S = 90
PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Browser:
    """One browser with one page, until it is left."""

    def __init__(self, width=1280, height=720, dark=False):
        self.size, self.dark = (width, height), dark
        self._folder = tempfile.TemporaryDirectory(prefix="c", ignore_cleanup_errors=True)
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        home = self._folder.name
        try:
            self._process = subprocess.Popen(
                [PROGRAM, "--headless=new", "--no-sandbox", "--remote-debugging-pipe", f"--user-data-dir={home}",
                 "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
                 "--disable-default-apps", "--no-default-browser-check", "--hide-scrollbars", "--disable-dev-shm-usage",
                 "--enable-unsafe-swiftshader", f"--window-size={width},{height}", "about:blank"],
                preexec_fn=lambda: _onto_3_and_4(to_read, to_write),  # noqa: PLW1509 -- system calls alone
                close_fds=False, start_new_session=True,
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env={**os.environ, "HOME": home, "TMPDIR": home},
            )  # fmt: skip
        finally:
            os.close(to_read)
            os.close(to_write)
        self._waiting, self._number, self._session = b"", 0, None
        self.said, self.thrown, self.asked, self.failed = [], [], [], []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.resize(width, height)
        self.wear(dark)

    def call(self, method, **parameters):
        """Ask for something and return the answer's result."""
        self._number += 1
        request = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            request["sessionId"] = self._session
        os.write(self._write, json.dumps(request).encode() + b"\0")
        end = time.monotonic() + LONGEST_S
        while True:
            message = self._message(end)
            if message.get("id") == self._number:
                assert "error" not in message, f"{method}: {message['error']}"
                return message["result"]
            self._note(message)

    def _message(self, end):
        while b"\0" not in self._waiting:
            ready, _, _ = select.select([self._read], [], [], max(0.0, end - time.monotonic()))
            more = os.read(self._read, 1 << 20) if ready else b""
            if not more:
                raise TimeoutError("the browser does not answer")
            self._waiting += more
        text, _, self._waiting = self._waiting.partition(b"\0")
        return json.loads(text)

    def _note(self, event):
        method, details = event.get("method"), event.get("params", {})
        if method == "Runtime.consoleAPICalled" and details["type"] in ("error", "warning", "assert"):
            self.said.append(str([argument.get("value") for argument in details["args"]]))
        elif method == "Runtime.exceptionThrown":
            self.thrown.append(details["exceptionDetails"].get("exception", {}).get("description") or str(details))
        elif method == "Log.entryAdded" and details["entry"]["level"] in ("error", "warning"):
            if "GL Driver Message" in details["entry"]["text"]:
                return  # of the software renderer, about its own speed
            self.said.append(f"{details['entry']['text']} {details['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.asked.append(details["request"]["url"])
        elif method == "Network.loadingFailed":
            self.failed.append(details.get("errorText", ""))

    def open(self, address):
        """Go to an address."""
        self.call("Page.navigate", url=address)

    def evaluate(self, expression):
        """Return the value of an expression in the page; a promise's when it is kept."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, expression):
        """Wait until an expression is true in the page."""
        end = time.monotonic() + LONGEST_S
        while not (found := self.evaluate(f"Boolean({expression})")):
            assert time.monotonic() < end, f"never true: {expression}; {self.said} {self.thrown}"
            time.sleep(0.02)
        return found

    def resize(self, width, height, mobile=False):
        """Give the page another size."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def wear(self, dark):
        """Prefer dark or light, as a system does."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def press(self, key):
        """Press a key and let it go."""
        text = {"text": key} if len(key) == 1 else {}
        code = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Tab": 9, "Escape": 27}.get(key, 0)
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code,
                **(text if kind == "keyDown" else {}),
            )  # fmt: skip

    def click(self, x, y):
        """Click a place, in CSS pixels."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def move(self, x, y):
        """Point at a place, in CSS pixels."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def wheel(self, x, y, down, ctrl=False):
        """Turn the wheel over a place."""
        modifiers = 2 if ctrl else 0
        self.call(
            "Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=down, modifiers=modifiers
        )  # fmt: skip

    def drag(self, x, y, dx, dy):
        """Press, move and let go."""
        steps = (("mousePressed", x, y), ("mouseMoved", x + dx, y + dy), ("mouseReleased", x + dx, y + dy))
        for kind, px, py in steps:
            self.call("Input.dispatchMouseEvent", type=kind, x=px, y=py, button="left", buttons=1, clickCount=1)

    def picture(self):
        """Return what is on the screen, as a PNG file's bytes."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def save(self, path):
        """Write what is on the screen to a file."""
        Path(path).write_bytes(self.picture())

    def close(self):
        """End the browser."""
        os.close(self._write)
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._read)
        self._folder.cleanup()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def _onto_3_and_4(to_read, to_write):
    """Put the pipe's ends where Chromium looks for them."""
    one, other = os.dup(to_read), os.dup(to_write)  # neither may be 3 or 4 while the other is put there
    keep = [os.dup(one), os.dup(other)]
    while min(keep) <= 4:
        keep = [os.dup(fd) for fd in keep]
    os.dup2(keep[0], 3)
    os.dup2(keep[1], 4)
    for fd in (3, 4):
        os.set_inheritable(fd, True)
