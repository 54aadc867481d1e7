"""Two network namespaces as two machines, and a link between them that delays and loses packets, and can be cut.

Each namespace has a TUN device; a thread carries the packets from one to the other.
"""

import fcntl
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections import deque

SET_DEVICE, KIND, NAME = 0x400454CA, 0x1001, "eit{}{:x}"  # of <linux/if_tun.h>: IFF_TUN | IFF_NO_PI


class Link:
    """Two machines and the link; raises OSError or CalledProcessError where namespaces are not allowed.

    ``delay_s`` holds for each direction, ``loss`` is the share of packets that are dropped, ``cut`` drops all;
    ``carried`` counts those that were carried and those that were dropped.
    """

    def __init__(self, delay_s=0.0, loss=0.0):
        self.delay_s, self.loss, self.cut, self.carried = delay_s, loss, False, [0, 0]
        self.names = [NAME.format(side, os.getpid()) for side in "ab"]
        self.addresses = ["10.99.7.1", "10.99.7.2"]
        self._devices, self._ended = [], threading.Event()

    def command(self, side, *words):
        return ["ip", "netns", "exec", self.names[side], *words]

    def __enter__(self):
        try:
            for name, address in zip(self.names, self.addresses, strict=True):
                self._devices.append(os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK))
                fcntl.ioctl(self._devices[-1], SET_DEVICE, struct.pack("16sH22x", name.encode(), KIND))
                for words in (
                    f"netns add {name}", f"link set {name} netns {name}",
                    f"-n {name} addr add {address}/24 dev {name}", f"-n {name} link set {name} up",
                ):  # fmt: skip
                    subprocess.run(["ip", *words.split()], check=True, capture_output=True)
        except BaseException:
            self._remove()
            raise
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        self._remove()

    def _remove(self):
        for device in self._devices:
            os.close(device)
        for name in self.names:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)

    def _carry(self):
        waiting, draw = deque(), random.Random(1)
        while not self._ended.is_set():
            left_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 0.1
            for device in select.select(self._devices, [], [], min(left_s, 0.1))[0]:
                packet, other = os.read(device, 65536), self._devices[device == self._devices[0]]
                lost = self.cut or draw.random() < self.loss
                self.carried[lost] += 1
                if not lost:
                    waiting.append((time.monotonic() + self.delay_s, other, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, other, packet = waiting.popleft()
                os.write(other, packet)
