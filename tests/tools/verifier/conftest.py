"""A runtime in a thread of this process, whose frames a scripted verifier in a process of its own checks."""

import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from tests.runtime.made_up_skin import virtual_skin

import eitskin
from eitskin.messaging.publish import Publisher
from eitskin.skin import Skin, serve
from eitskin_tools.processes.children import Backoff
from eitskin_tools.verifier.child import Placement, VerifierProcess
from eitskin_tools.verifier.feed import VerifierFeed

HERE = Path(__file__).parent
TESTS = HERE.parents[1]
SCRIPTED = (sys.executable, str(HERE / "scripted_verifier.py"))
PATIENCE_S = 60.0
TOUCHED = [[0.5, 600.0, 0.3]]


def until(condition):
    """Wait for something that happens elsewhere."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


class Stream:
    """What runs, and where it publishes."""

    def __init__(self, skin, publisher, process, feed, script):
        self.skin, self.publisher, self.process, self.feed = skin, publisher, process, feed
        self.script = script
        self.go = threading.Event()
        """While it is not set, the frame loop waits behind its frame."""
        self.go.set()
        skin.loop.verifier_status = feed.status
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self):
        serve(self.skin, self.publisher, behind=self._behind)

    def _behind(self, record):
        self.go.wait(PATIENCE_S)
        self.feed.after_frame(record)

    def subscribed(self, **options):
        """Subscribe to every verdict."""
        options = {"timeout_s": PATIENCE_S, "mode": "all", **options}
        return eitskin.subscribe_verified(self.publisher.endpoint, **options)

    @property
    def taken(self):
        """Numbers of the frames that the verifier has taken."""
        path = self.script / "taken"
        return [int(line.split()[0]) for line in path.read_text().splitlines()] if path.exists() else []

    def tell(self, word, *, off=False):
        """Have the verifier do something."""
        (self.script / word).unlink() if off else (self.script / word).touch()

    def stop(self):
        """End the frame loop."""
        self.go.set()
        self.skin.stop()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()


@pytest.fixture
def streaming(tmp_path, monkeypatch):
    """Return a context manager that streams with a verifier."""
    monkeypatch.setenv("VERIFIER_SCRIPT", str(tmp_path))

    @contextmanager
    def run(mode="always", *, cloud="scan", max_failures=5, every_map=False, source=None, **device):
        with ExitStack() as stack:
            port = None if source else stack.enter_context(virtual_skin(**{"touches": TOUCHED, **device}))
            bundle = TESTS / "golden" / "tiny.eitskin"
            skin = stack.enter_context(Skin(port, bundle=bundle, skip_unchanged=not every_map, source=source))
            skin.capture_reference(10)
            publisher = Publisher(f"ipc://{tmp_path}/frames")
            stack.callback(publisher.close)
            place = Placement(nice=5, program=SCRIPTED)
            backoff = Backoff(0.1, 0.2, 60.0)
            process = stack.enter_context(VerifierProcess(place, backoff, max_failures))
            feed = VerifierFeed(skin, publisher, process, mode, cloud=cloud)
            stream = Stream(skin, publisher, process, feed, tmp_path)
            stack.callback(stream.stop)
            yield stream

    return run
