"""Fakes of other makers' devices behind a pseudo-terminal, in a thread: a Sciospec EIT device and printers of lines."""

import os
import pty
import struct
import threading
import time
import tty

import numpy as np

from eitskin_proto.sensor.table import FULL_TABLE

K, M = FULL_TABLE[:, 0].astype(int), FULL_TABLE[:, 1].astype(int)


class Fake:
    """A device; ``with Fake(...) as port``.

    Args:
        voltages: Returns the (208,) V of scan n.
        rate_hz: Of its scans; it never waits for its reader.
    """

    def __init__(self, voltages, rate_hz=200.0):
        self.voltages, self.rate_hz = voltages, rate_hz
        self.master, self.slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self.slave)
        self.sent = 0
        self.streaming = True
        self.over = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()
        self.vanish()

    def vanish(self):
        """Pull the cable."""
        self.over.set()
        for name in ("master", "slave"):
            file = getattr(self, name)
            setattr(self, name, -1)
            if file >= 0:
                os.close(file)

    def run(self):
        due = time.monotonic()
        while not self.over.wait(max(0.0, due - time.monotonic())):
            due = max(due + 1.0 / self.rate_hz, time.monotonic())
            try:
                self.listen()
                if self.streaming:
                    self.send(self.scan(self.voltages(self.sent)))
                    self.sent += 1
            except OSError:
                return

    def listen(self):
        """Take what the host says."""

    def send(self, data):
        while data and not self.over.is_set():
            try:
                data = data[os.write(self.master, data) :]
            except BlockingIOError:
                self.over.wait(0.001)


class Lines(Fake):
    """Prints a scan a line.

    Args:
        form: Makes the text of (208,) V.
    """

    def __init__(self, voltages, form, rate_hz=200.0):
        super().__init__(voltages, rate_hz)
        self.form = form

    def scan(self, voltages):
        return self.form(voltages).encode() + b"\r\n"


class FakeSciospec(Fake):
    """Answers commands, and sends a scan as 16 messages of complex potentials with a phase of 12 degrees."""

    def __init__(self, voltages, rate_hz=40.0):
        super().__init__(voltages, rate_hz)
        self.streaming = False
        self.commands = []
        self.buffer = b""
        self.skip = set()
        """Numbers of scans that lack a message."""

    def listen(self):
        try:
            self.buffer += os.read(self.master, 4096)
        except BlockingIOError:
            return
        while len(self.buffer) >= 2 and len(self.buffer) >= self.buffer[1] + 3:
            end = self.buffer[1] + 3
            command, self.buffer = self.buffer[:end], self.buffer[end:]
            self.commands.append(command)
            if command[0] == 0xB4:
                self.streaming = command[2] == 1
            self.send(b"\x18\x01\x83\x18")
        return

    def run(self):
        while not self.over.is_set() and not self.streaming:  # answers come at once, scans at their rate
            try:
                self.listen()
            except OSError:
                return
            self.over.wait(0.0005)
        super().run()

    def scan(self, voltages):
        potentials = np.zeros((16, 16))
        for k, m, volts in zip(K, M, voltages, strict=True):  # drive by drive, in the order round the ring
            potentials[k, (m + 1) % 16] = potentials[k, m] - volts
        turned = (potentials + 0.4) * np.exp(1j * np.deg2rad(12.0))
        messages = []
        for k in range(16):
            if self.sent in self.skip and k == 7:
                continue
            head = bytes([0xB4, 0x89, 1, k + 1, (k + 1) % 16 + 1]) + struct.pack(">HI", 1, 25 * self.sent)
            pairs = np.stack([turned[k].real, turned[k].imag], axis=1).astype(">f4")
            messages.append(head + pairs.tobytes() + b"\xb4")
        return b"".join(messages)
