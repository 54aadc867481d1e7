import os
import socket

import pytest

from eitskin_tools.service.supervisor import Supervisor


@pytest.fixture(params=["path", "abstract"])
def listening(request, tmp_path):
    """Return (what NOTIFY_SOCKET holds, a socket that hears what it is told)."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@eitskin-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(name.replace("@", "\0"))
        ear.settimeout(60)
        yield name, ear


def test_a_supervisor_is_told_what_it_expects(listening):
    name, ear = listening
    supervisor = Supervisor.of({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())})
    assert supervisor.listens
    assert supervisor.interval_s == 3.0
    supervisor.ready()
    supervisor.status("200 frames/s,\nuntouched")
    supervisor.alive()
    supervisor.stopping()
    heard = [ear.recv(1000) for _ in range(4)]
    assert heard == [b"READY=1", b"STATUS=200 frames/s, untouched", b"WATCHDOG=1", b"STOPPING=1"]
    supervisor.close()
    supervisor.close()
    supervisor.alive()  # to nobody


@pytest.mark.parametrize(
    ("environment", "interval_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "1000000"}, None),  # nobody to tell
        ({"NOTIFY_SOCKET": "/nobody", "WATCHDOG_USEC": "1000000"}, 1.0),
        ({"NOTIFY_SOCKET": "/nobody", "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}, None),  # meant for another
        ({"NOTIFY_SOCKET": "/nobody", "WATCHDOG_USEC": "-5"}, None),
        ({"NOTIFY_SOCKET": "/nobody", "WATCHDOG_USEC": "0"}, None),
    ],
)
def test_a_sign_of_life_is_given_where_it_is_wanted_of_us(environment, interval_s):
    supervisor = Supervisor.of(environment)
    supervisor.close()
    assert supervisor.interval_s == interval_s


def test_a_supervisor_that_reads_nothing_is_not_waited_for(listening):
    supervisor = Supervisor(listening[0], 1.0)
    for _ in range(10_000):  # its queue is full long before
        supervisor.alive()
    supervisor.close()
