import subprocess
import sys
from importlib import metadata

import pytest

import eitskin

pytestmark = pytest.mark.process


def modules_after(statement):
    code = f"{statement}\nimport sys\nprint(' '.join(sorted(sys.modules)))"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


def test_importing_eitskin_pulls_in_nothing_heavy():
    loaded = modules_after("import eitskin")
    assert not loaded & {"torch", "scipy", "numpy", "onnxruntime", "zmq", "serial"}


def test_a_subscriber_loads_neither_inference_nor_serial_ports():
    loaded = modules_after("import eitskin; eitskin.subscribe; eitskin.send_cloud")
    assert not loaded & {"torch", "scipy", "onnxruntime", "serial", "usb", "importlib.metadata"}
    assert "zmq" in loaded  # the check above would hold for a name that imports nothing at all


def test_the_whole_runtime_loads_neither_torch_nor_scipy():
    loaded = modules_after(
        "import eitskin; eitskin.Skin; import eitskin.skin, eitskin.diagnostics.doctor, eitskin.diagnostics.realtime"
    )
    assert not loaded & {"torch", "scipy", "onnx", "eitskin_sim"}
    assert "onnxruntime" in loaded


def test_the_version_is_that_of_the_installed_distribution():
    try:
        expected = metadata.version("eitskin")
    except metadata.PackageNotFoundError:
        expected = eitskin.UNKNOWN_VERSION
    assert eitskin.__version__ == expected


def test_every_public_name_exists_and_a_wrong_one_is_an_attribute_error():
    code = (
        "import eitskin\n"
        "for name in eitskin.__all__: assert getattr(eitskin, name) is not None, name\n"
        "import eitskin.skin\n"
        "assert callable(eitskin.subscribe) and callable(eitskin.serve)\n"
        "assert eitskin.pixel_centres_mm().shape == (30, 45, 2)\n"
        "assert {'read', 'write', 'cancel', 'report', 'close'} <= set(dir(eitskin.Transport))\n"
        "try: eitskin.nothing\n"
        "except AttributeError as error: assert 'nothing' in str(error)\n"
        "else: raise SystemExit('no error')\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
