"""The emulated board: the real firmware under QEMU, its line on a pseudo-terminal, its storage and voltages in a file.

::

    file offset   what (firmware_proto/board/mps2.c)
    0x000000      slot 0, 0x001000 slot 1
    0x080000      power: cut at this change, changes so far, seed of the torn word, 0xdead once cut
    0x100000      recording: "EITV", frames u32, volts a count f64, rate u32 mHz, 0, frames x 208 int32

Killing the process is the power cut: what the file holds then is what the next boot finds.
"""

import mmap
import re
import signal
import struct
import subprocess
from pathlib import Path
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from tests.emulator.firmware import build, missing_tools

from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.table import N_FULL_ROWS

STORAGE_BYTES: Final = 16 << 20
POWER_AT: Final = 0x80000
RECORDING_AT: Final = 0x100000
RECORDING_HEAD: Final = struct.Struct("<4sIdII")
IS_CUT: Final = 0xDEAD
INT32_SHARE: Final = 2**30
"""A recording's largest voltage is stored as this count, so that a gain of 1 never saturates."""


def new_storage(path: Path) -> None:
    """Write the file of a fresh board: every bit erased."""
    with path.open("wb") as file:
        for _ in range(STORAGE_BYTES >> 20):
            file.write(b"\xff" * (1 << 20))


def record(path: Path, voltages: npt.NDArray[np.floating], gain: int = 1, rate_hz: float = 0.0) -> None:
    """Put voltages into a storage file; the front end plays them over and over from the first scan on.

    Args:
        path: The storage file, of a board that does not run.
        voltages: (frames, 208) V, in the order of the full table.
        gain: Gain of the configuration that will run; the recording is scaled so that it just does not saturate.
        rate_hz: Plays by the board's clock, so that a scan that is late sees what is due then; 0 plays one a scan.

    Raises:
        ValueError: Wrong shape, not finite, or too long for the board's memory.
    """
    volts = np.asarray(voltages, dtype=np.float64)
    room = (STORAGE_BYTES - RECORDING_AT - RECORDING_HEAD.size) // (4 * N_FULL_ROWS)
    if volts.ndim != 2 or volts.shape[1] != N_FULL_ROWS or not 1 <= len(volts) <= room:
        raise ValueError(f"voltages have shape {volts.shape}, expected (1 to {room}, {N_FULL_ROWS})")
    largest = float(np.abs(volts).max())
    if not 0.0 < largest < float("inf"):
        raise ValueError(f"the largest voltage is {largest}, expected a finite number above 0")
    volts_per_count = largest * gain / INT32_SHARE
    counts = np.rint(volts / volts_per_count).astype("<i4")
    with path.open("r+b") as file:
        file.seek(RECORDING_AT)
        head = RECORDING_HEAD.pack(b"EITV", len(volts), volts_per_count, round(1000 * rate_hz), 0)
        file.write(head + counts.tobytes())


class Board:
    """A running board; leaving the context kills it, as a power cut would.

    Args:
        storage: Its storage file; made if it does not exist.
        cut_at: Stop at this change of storage from now, half done; 0 for never.
        seed: 0 stops just before the change, 1 just after it, any other number tears the word.

    Raises:
        SkinError: QEMU or the compiler is missing, or QEMU did not start.
    """

    def __init__(self, storage: Path, cut_at: int = 0, seed: int = 0) -> None:
        missing = missing_tools("qemu")
        if missing:
            raise SkinError(
                f"{', '.join(missing)} not found: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi "
                "qemu-system-arm"
            )
        image = build("firmware")
        if not storage.exists():
            new_storage(storage)
        with storage.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), STORAGE_BYTES)
        self._set_power(cut_at, 0, seed, 0)
        self._process = subprocess.Popen(
            ["qemu-system-arm", "-machine", "mps2-an385,memory-backend=r0", "-m", "16M", "-object",
             f"memory-backend-file,id=r0,size=16M,mem-path={storage},share=on", "-kernel", str(image),
             "-display", "none", "-monitor", "none", "-serial", "pty"],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        port = re.search(r"/dev/\S+", line)
        if port is None:
            self.kill()
            raise SkinError(f"qemu-system-arm did not start: {line.strip() or 'no output'}")
        self.port: str = port[0]
        """The pseudo-terminal that is the board's line."""

    def _set_power(self, *words: int) -> None:
        self._memory[POWER_AT : POWER_AT + 16] = struct.pack("<4I", *words)

    def cut_power_at(self, change: int, seed: int) -> None:
        """Stop at a change of storage from now, half done; 0 for never. The board must not be changing storage."""
        self._memory[POWER_AT + 8 : POWER_AT + 12] = struct.pack("<I", seed)
        self._memory[POWER_AT : POWER_AT + 4] = struct.pack("<I", self.changes + change if change else 0)

    @property
    def changes(self) -> int:
        """Changes of storage since this board was started."""
        return int(struct.unpack_from("<I", self._memory, POWER_AT + 4)[0])

    @property
    def stopped(self) -> bool:
        """Whether the board reached the change at which it was to stop."""
        return bool(struct.unpack_from("<I", self._memory, POWER_AT + 12)[0] == IS_CUT)

    def kill(self) -> None:
        """Cut the power: SIGKILL, without warning."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        if not self._memory.closed:
            self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
