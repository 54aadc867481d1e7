"""Two network namespaces as two machines: a thread carries packets from one's TUN device to the other's."""

import fcntl
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections import deque
from contextlib import contextmanager

SET_DEVICE, KIND = 0x400454CA, 0x1001  # of <linux/if_tun.h>: IFF_TUN | IFF_NO_PI

ADDRESSES = ("10.99.7.1", "10.99.7.2")


class Link:
    """Delays packets in each direction and drops a share of them, or all while ``cut``; counts (carried, dropped)."""

    def __init__(self, delay_s, loss):
        self.delay_s, self.loss, self.cut, self.counts, self.ended = delay_s, loss, False, [0, 0], False
        self.names, self.devices = [f"eit{side}{os.getpid():x}" for side in "ab"], []

    def command(self, side, *words):
        return ["ip", "netns", "exec", self.names[side], *words]

    def make(self):
        for name, address in zip(self.names, ADDRESSES, strict=True):
            self.devices.append(os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK))
            fcntl.ioctl(self.devices[-1], SET_DEVICE, struct.pack("16sH22x", name.encode(), KIND))
            for words in (f"netns add {name}", f"link set {name} netns {name}",
                          f"-n {name} addr add {address}/24 dev {name}", f"-n {name} link set {name} up"):  # fmt: skip
                subprocess.run(["ip", *words.split()], check=True, capture_output=True)

    def carry(self):
        waiting, draw = deque(), random.Random(1)
        while not self.ended:
            left_s = waiting[0][0] - time.monotonic() if waiting else 0.1
            for device in select.select(self.devices, [], [], min(max(left_s, 0.0), 0.1))[0]:
                packet, other = os.read(device, 65536), self.devices[device == self.devices[0]]
                dropped = self.cut or draw.random() < self.loss
                self.counts[dropped] += 1
                if not dropped:
                    waiting.append((time.monotonic() + self.delay_s, other, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, other, packet = waiting.popleft()
                os.write(other, packet)


@contextmanager
def linked(delay_s, loss):
    """Give two machines' link; raises OSError or CalledProcessError where namespaces are not allowed."""
    link = Link(delay_s, loss)
    thread = threading.Thread(target=link.carry)
    try:
        link.make()
        thread.start()
        yield link
    finally:
        link.ended = True
        if thread.ident:
            thread.join()
        for device in link.devices:
            os.close(device)
        for name in link.names:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)
