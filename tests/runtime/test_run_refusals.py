"""What ends ``eitskin run`` before or while it runs: exit status 1 or 2, and one line that says why."""

import signal

import pytest

from .command_line import command, finished, wait_until_ready

pytestmark = pytest.mark.process


def test_a_reference_of_another_device_is_refused(virtual_skin, tiny_path, tmp_path, endpoints):
    stored = tmp_path / "skin.json"
    with virtual_skin(serial_number="FIRST") as port:
        assert finished("reference", "--port", port, "--out", stored, "--bundle", tiny_path)[0] == 0
    with virtual_skin(serial_number="SECOND") as port:
        code, out, err = finished("run", "--port", port, "--bundle", tiny_path, "--reference", stored, *endpoints)
    assert (code, out) == (1, "")
    assert "found FIRST, expected SECOND" in err.splitlines()[-1]


def test_a_missing_port_is_one_line_and_exit_1(tiny_path):
    code, out, err = finished("run", "--port", "/dev/ttyNONE9", "--bundle", tiny_path)
    assert (code, out) == (1, "")
    assert err.splitlines()[-1].startswith("eitskin run: no port /dev/ttyNONE9")
    assert "Traceback" not in err


def test_a_busy_port_is_one_line_and_exit_1(virtual_skin, tiny_path, endpoints):
    with virtual_skin() as port:
        first = command("run", "--port", port, "--bundle", tiny_path, *endpoints)
        wait_until_ready(first)
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path)
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=120)
    assert first.returncode == 0
    assert code == 1
    assert "open in another program" in err.splitlines()[-1]


def test_a_damaged_bundle_and_a_foreign_device_exit_1(virtual_skin, tiny_path, tmp_path, endpoints):
    broken = tmp_path / "broken.eitskin"
    broken.write_bytes(tiny_path.read_bytes()[:5000])
    code, _, err = finished("run", "--port", "/dev/null", "--bundle", broken)
    assert code == 1
    assert "not an intact bundle" in err
    with virtual_skin(faults=["foreign"]) as port:
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path, *endpoints)
    assert code == 1
    assert "protocol_id: found 00000000f0e1d2c3" in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--publish", "here"], "endpoint 'here': expected ipc:///path or tcp://address:port"),
        (["--publish", "tcp://127.0.0.1:7000"], "gives other users access, even on this machine: give CURVE keys with"),
        (["--control", "ipc://relative"], "expected an absolute path"),
        (["--curve-keys", "/nowhere"], "/nowhere/server.key_secret is not a CURVE key"),
    ],
)
def test_what_cannot_be_bound_is_refused_before_the_port_is_opened(words, said):
    code, out, err = finished("run", "--port", "/dev/ttyNONE9", *words)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert said in err
