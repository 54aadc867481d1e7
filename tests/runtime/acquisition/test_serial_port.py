import contextlib
import os
import pty
import threading
import time
import tty

import pytest

from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import PortBusy, PortLost, TransportError


@pytest.fixture
def line():
    """Return (master fd, path of the other side) of a raw pseudo-terminal."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    with contextlib.suppress(OSError):  # the test may have pulled the plug
        os.close(master)


def test_bytes_arrive_in_whatever_pieces_they_come(line):
    master, path = line
    port = SerialPort(path)
    os.write(master, b"abc")
    assert port.read(1.0) == b"abc"
    os.write(master, bytes(300))
    assert port.read(1.0) == bytes(300)
    port.write(b"out")
    assert os.read(master, 10) == b"out"
    port.close()


def test_reading_waits_as_long_as_asked_and_soon_ends(line):
    port = SerialPort(line[1])
    for asked_s in (0.05, 0.0003):
        start = time.perf_counter()
        assert port.read(asked_s) == b""
        assert asked_s <= time.perf_counter() - start < 30.0
    port.close()


def test_another_thread_can_wake_a_read_that_waits_for_ever(line):
    port = SerialPort(line[1])
    timer = threading.Timer(0.05, port.cancel)
    timer.start()
    assert port.read(None) == b""
    timer.join()
    port.cancel()
    assert port.read(None) == b""  # a cancel before the read is not lost
    port.close()


def test_a_port_that_is_open_elsewhere_is_busy_until_it_is_closed(line):
    first = SerialPort(line[1])
    with pytest.raises(PortBusy, match=r"open in another program"):
        SerialPort(line[1])
    first.close()
    SerialPort(line[1]).close()


def test_a_file_that_is_no_port_is_refused(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"")
    with pytest.raises(TransportError, match="cannot be opened as a serial port"):
        SerialPort(str(path))
    with pytest.raises(TransportError):
        SerialPort(str(tmp_path))


def test_a_port_that_vanishes_while_it_is_read_is_lost():
    master, slave = pty.openpty()
    port = SerialPort(os.ttyname(slave))
    os.close(slave)
    timer = threading.Timer(0.05, os.close, [master])
    timer.start()
    with pytest.raises(PortLost, match=r"vanished.*cable"):
        port.read(2.0)
    timer.join()
    with pytest.raises(PortLost):
        port.write(b"x")
    port.close()
    port.close()
