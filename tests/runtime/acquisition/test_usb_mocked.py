"""USB with nothing of ours replaced: real pyusb, real libusb, the commands as a user runs them; the bus is mocked."""

import json
import subprocess
import sys

import pytest
from tests.faults.usb_skin import MockedUsb, missing

from ..command_line import wait_until_ready

LACKING = missing()
pytestmark = [pytest.mark.process, pytest.mark.skipif(bool(LACKING), reason=LACKING)]


@pytest.fixture(scope="module")
def usb():
    with MockedUsb("USB-9") as made:
        yield made


def command(usb, *words):
    done = subprocess.run(
        [sys.executable, "-m", "eitskin_tools.cli", *map(str, words), "--port", usb.port, "--json"],
        env=usb.environment, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_doctor_lists_the_device_and_asks_it(usb):
    found = command(usb, "doctor")
    [listed] = found["usb"]
    assert (listed["port"], listed["id"], listed["state"]) == ("usb:USB-9", "1209:0001", "usable")
    assert (found["device"]["serial_number"], found["device"]["rows"]) == ("USB-9", 104)
    assert found["device"]["answer_ms"] > 0
    assert any("flash write paper --port usb:USB-9" in problem for problem in found["problems"])


def test_flashing_survives_that_the_device_leaves_the_bus_when_it_restarts(usb):
    assert command(usb, "flash", "write", "paper")["generation"] == 1
    assert command(usb, "flash", "write", "fast")["generation"] == 2
    assert command(usb, "flash", "verify", "fast")["same"] is True
    assert command(usb, "flash", "rollback")["configuration"] == "paper"


def test_a_reference_is_captured_and_the_runtime_streams_over_usb(usb, tmp_path, tiny_path):
    reference = tmp_path / "flat.json"
    assert (
        command(usb, "reference", "--bundle", tiny_path, "--frames", 20, "--out", reference)["serial_number"] == "USB-9"
    )
    summary = command(
        usb, "run", "--reference", reference, "--frames", 100, "--bundle", tiny_path,
        "--publish", f"ipc://{tmp_path}/frames", "--control", f"ipc://{tmp_path}/control",
    )  # fmt: skip
    assert (summary["serial_number"], summary["frames"], summary["corrupt"]) == ("USB-9", 100, 0)


def test_the_runtime_goes_on_after_an_unplug(usb, tmp_path, tiny_path):
    words = [
        "run", "--port", usb.port, "--reconnect", 120, "--json", "--bundle", tiny_path,
        "--reference-frames", 20, "--frames", 300,
        "--publish", f"ipc://{tmp_path}/frames", "--control", f"ipc://{tmp_path}/control",
    ]  # fmt: skip
    with subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", *map(str, words)],
        env=usb.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as runtime:  # fmt: skip
        try:
            wait_until_ready(runtime)
            usb.tell("unplug 0.2")
            out, err = runtime.communicate(timeout=300)
        finally:
            runtime.kill()
    assert runtime.returncode == 0, err
    summary = json.loads(out)
    assert (summary["frames"], summary["recoveries"] >= 1, summary["corrupt"]) == (300, True, 0)  # silent if starved
    assert summary["lost"] >= 20, "0.2 s at 200 frames/s"
