"""Fixtures of the runtime's tests: a virtual skin in its own process, the tiny bundle, and a runtime around them."""

import json
import threading
import zipfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from eitskin.messaging.control import ControlServer
from eitskin.messaging.publish import Publisher
from eitskin.model.bundle import load_bundle
from eitskin.skin import Skin, serve
from eitskin_proto.wire.messages import Hello

from .made_up_skin import begin_touches, virtual_skin

HERE = Path(__file__).parent
TINY = HERE.parent / "golden" / "tiny.eitskin"


def pytest_collection_modifyitems(items):
    """Mark tests that ask for a virtual skin, which is a process of its own."""
    for item in items:
        if "virtual_skin" in getattr(item, "fixturenames", ()):
            item.add_marker("process")


@pytest.fixture(name="virtual_skin")
def _virtual_skin():
    """Return a context manager that runs a virtual skin and gives its port."""
    return virtual_skin


@pytest.fixture(scope="session")
def tiny_path():
    return TINY


@pytest.fixture(scope="session")
def tiny():
    return load_bundle(TINY)


@pytest.fixture(scope="session")
def paired_path(tmp_path_factory):
    """Return the tiny bundle with a smaller network besides, which is its own int8 head and geometry once more."""
    with zipfile.ZipFile(TINY) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(parts.pop("manifest.json"))
    manifest["small"] = {"bias": manifest["head"]["bias"]}
    for name, own in (("small_geometry.onnx", "geometry.onnx"), ("small_head.onnx", "head_int8.onnx")):
        parts[name], manifest["files"][name] = parts[own], manifest["files"][own]
    path = tmp_path_factory.mktemp("paired") / "paired.eitskin"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {"manifest.json": json.dumps(manifest), **parts}.items():
            archive.writestr(name, data)
    return path


@pytest.fixture(scope="session")
def paired(paired_path):
    return load_bundle(paired_path)


@pytest.fixture
def hello():
    return Hello(
        firmware_version=(1, 0, 0),
        hardware_id=1,
        serial_number="TEST-1",
        configuration_digest=0xABCD,
        generation=0,
        configuration_name="paper",
        rate_mHz=200_000,
        rows=104,
        sample_bytes=4,
        volts_per_count=1e-9,
    )


@pytest.fixture
def counts():
    """Return (104,) counts of an untouched sheet, spanning a factor of 400."""
    return np.geomspace(4e6, 1e4, 104).astype(np.int32)


class Running:
    """A runtime in a thread of this process, with its endpoints."""

    def __init__(self, skin, publisher, control):
        self.skin, self.publisher, self.control = skin, publisher, control
        self.error = None
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()

    def _serve(self):
        try:
            serve(self.skin, self.publisher)
        except Exception as error:  # shown by the test that joins
            self.error = error

    def stop(self):
        self.skin.stop()
        self.thread.join(60)
        assert not self.thread.is_alive()


@contextmanager
def _running(port, folder, **options):
    with Skin(port, **{"bundle": TINY, **options}) as skin:
        skin.capture_reference(10)
        begin_touches(port)
        publisher = Publisher(f"ipc://{folder}/frames")
        control = ControlServer(f"ipc://{folder}/control", skin)
        runtime = Running(skin, publisher, control)
        try:
            yield runtime
        finally:
            runtime.stop()
            control.close()
            publisher.close()


@pytest.fixture
def running():
    """Return a context manager that runs a runtime on a port, with endpoints in a folder."""
    return _running


@pytest.fixture
def endpoints(tmp_path):
    return ["--publish", f"ipc://{tmp_path}/frames", "--control", f"ipc://{tmp_path}/control"]


@pytest.fixture
def streaming(virtual_skin, tiny_path):
    """Return a skin whose touches have begun."""
    with (
        virtual_skin(touches=[[0.1, 60, 0.3]], touches_wait=True, rate_hz=100.0) as port,
        Skin(port, bundle=tiny_path) as skin,
    ):
        skin.capture_reference(5)
        begin_touches(port)
        yield skin
