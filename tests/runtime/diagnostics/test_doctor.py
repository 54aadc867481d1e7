"""What the doctor finds on machines that have something wrong with them, and what it says to do."""

from types import SimpleNamespace

import pytest

from eitskin.acquisition import usb_port
from eitskin.acquisition.usb_port import Found
from eitskin.diagnostics import doctor
from eitskin.errors import TransportError
from eitskin.messaging.publish import Publisher


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """Return a machine with nothing plugged in; a test adds to its lists."""
    made = SimpleNamespace(ports=[], usb=[], denied=set(), adapters=tmp_path / "adapters", uarts=tmp_path / "tty")
    monkeypatch.setattr("eitskin.acquisition.ports.list_ports.comports", lambda: made.ports)
    monkeypatch.setattr(usb_port, "devices", lambda: made.usb)
    monkeypatch.setattr(doctor, "ADAPTERS", made.adapters)
    monkeypatch.setattr(doctor, "UART_TYPES", made.uarts)
    monkeypatch.setattr(doctor, "SYSTEM_RULES", (tmp_path / "rules.d",))
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: path not in made.denied)
    return made


class Info(SimpleNamespace):
    def __lt__(self, other):
        return self.device < other.device


def serial(name, **more):
    fields = {"device": f"/dev/{name}", "description": "UART", "vid": 0x0403, "pid": 0x6014, "serial_number": "FT1"}
    return Info(**{**fields, **more})


def todo(found, word):
    return [problem for problem in found["problems"] if word in problem]


def test_a_machine_without_any_skin_is_told_to_plug_one_in_or_start_a_virtual_one(machine):
    found = doctor.examine()
    assert (found["ports"], found["usb"]) == ([], [])
    assert found["verdict"].startswith("No skin found.")
    assert "eitskin virtual-skin" in found["verdict"]


def test_a_port_without_hardware_is_not_called_usable_and_a_usb_port_is_ready(machine):
    no_usb = {"description": "n/a", "vid": None, "pid": None, "serial_number": None}
    machine.ports = [serial("ttyS0", **no_usb), serial("ttyS1", **no_usb)]
    for name, kind in (("ttyS0", "0"), ("ttyS1", "4")):
        (machine.uarts / name).mkdir(parents=True)
        (machine.uarts / name / "type").write_text(f"{kind}\n")
    found = doctor.examine()
    assert [one["state"] for one in found["ports"]] == ["no hardware", "built-in UART"]
    assert found["verdict"].startswith("No skin found.")
    assert "eitskin doctor --port /dev/ttyS1" in found["verdict"]
    machine.ports.append(serial("ttyACM0"))
    assert doctor.examine()["verdict"].startswith("Ready: one USB device, /dev/ttyACM0.")
    machine.denied = {"/dev/ttyACM0"}
    assert doctor.examine()["verdict"].startswith("Not ready: no permission to open /dev/ttyACM0.")


def test_a_runtime_that_publishes_by_default_is_listed(machine, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    endpoint = f"ipc://{tmp_path}/eitskin/frames"
    assert endpoint not in doctor.examine()["runtimes"]
    publisher = Publisher(endpoint)
    try:
        assert endpoint in doctor.examine()["runtimes"]
    finally:
        publisher.close()


def test_a_port_that_may_not_be_opened_names_the_group(machine):
    machine.ports, machine.denied = [serial("ttyUSB0")], {"/dev/ttyUSB0"}
    found = doctor.examine()
    assert found["ports"][0]["state"] == "no permission"
    assert todo(found, "/dev/ttyUSB0: run 'sudo usermod -aG dialout $USER'")


@pytest.mark.parametrize(("waits_ms", "problems"), [(16, 1), (1, 0)])
def test_a_latency_timer_that_holds_bytes_back_is_a_problem_with_its_remedy(machine, waits_ms, problems):
    machine.ports = [serial("ttyUSB0")]
    timer = machine.adapters / "ttyUSB0" / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text(f"{waits_ms}\n")
    found = doctor.examine()
    assert found["ports"][0]["state"] == f"usable, latency timer {waits_ms} ms"
    assert len(todo(found, f"echo 1 | sudo tee {timer}")) == problems


def test_usb_devices_are_listed_and_missing_permissions_name_the_rule(machine):
    machine.usb = [Found("SKIN-1", "/dev/bus/usb/001/004", True), Found("", "/dev/bus/usb/001/005", False)]
    found = doctor.examine()
    assert [(one["port"], one["state"]) for one in found["usb"]] == [
        ("usb:SKIN-1", "usable"),
        ("usb:", "no permission"),
    ]
    assert todo(found, "/dev/bus/usb/001/005: run sudo cp")
    assert found["verdict"].startswith("Ready: one USB device, usb:SKIN-1.")


def test_a_machine_without_libusb_is_told_what_to_install(machine, monkeypatch):
    def none():
        raise TransportError("libusb is not installed: apt-get install libusb-1.0-0")

    monkeypatch.setattr(usb_port, "devices", none)
    assert todo(doctor.examine(), "apt-get install libusb-1.0-0")


def test_a_device_is_greeted_and_what_it_lacks_is_said(virtual_skin):
    with virtual_skin() as port:
        found = doctor.greet(port)
    assert (found["serial_number"], found["rows"], found["flags"]) == ("VIRTUAL-0001", 104, ["FACTORY"])
    assert 0 < found["answer_ms"] < 1000
    assert any("exclusive" in line for line in found["line"])
    assert todo(found, f"'eitskin flash write paper --port {port}'")
