"""``cn0565:URI``: Analog Devices' EVAL-CN0565-ARDZ, read by their library pyadi-iio (``pip install pyadi-iio``).

The board measures one row after another when it is asked, drive by drive, each with all measurements that leave out the
drive's electrodes. URI is libiio's, such as ``serial:/dev/ttyACM0,230400,8n1`` or ``ip:192.168.1.7``. Options:
``electrodes`` (8 to 24, default 16), ``frequency`` (Hz, default 10000), ``drive`` (``adjacent`` or ``opposite``),
``scale`` (volts of a count, default 1e-6), ``serial`` (a name that the reference belongs to).
"""

from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.drivers.driver import parse_rest
from eitskin.errors import TransportError
from eitskin_proto.sensor.row_table import RowTable


class Cn0565:
    """A driver of the board (:class:`eitskin.acquisition.drivers.driver.PolledDriver`).

    Args:
        board: pyadi-iio's.
        options: Of the port's name.

    Raises:
        ValueError: An option is wrong.
    """

    name = "cn0565"
    signed, rate_hz, full_scale_V = False, 0.0, 0.0

    def __init__(self, board: Any, options: Any) -> None:
        self._board = board
        board.electrode_count = n = options.whole("electrodes", 16, low=8, high=24)
        board.excitation_frequency = frequency_hz = options.number("frequency", 1e4, low=1.0, high=2e5)
        drive = options.choice("drive", ("adjacent", "opposite"), "adjacent")
        board.force_distance = 1 if drive == "adjacent" else n // 2
        self.step_V = options.number("scale", 1e-6, above=0.0)
        self.serial_number = str(options.value("serial", "CN0565"))[:16]
        options.close()
        board.magnitude_mode = False
        self.table = RowTable.of(np.asarray(board.switch_sequence)[:, [0, 3, 1, 2]], f"cn0565-{drive}")
        self.settings = {"frequency_Hz": frequency_hz, "scale": self.step_V}

    def measure(self) -> npt.NDArray[np.complex128]:
        """Return (rows,) V of a scan made now."""
        counts = np.asarray(self._board.all_voltages, dtype=np.float64)
        return np.asarray(self.step_V * (counts[:, 0] + 1j * counts[:, 1]))

    def start(self) -> None:
        """Do nothing: each scan is asked for."""

    def stop(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Close the connection; a second call does nothing."""
        self._board.close()


def open_cn0565(rest: str) -> Cn0565:
    """Return the driver of a port ``cn0565:REST``.

    Raises:
        TransportError: pyadi-iio is missing.
        ValueError: An option is wrong.
    """
    uri, options = parse_rest(rest, "cn0565")
    try:
        library = import_module("adi")
    except ImportError as error:
        raise TransportError(f"cn0565 needs pyadi-iio and libiio ({error}): pip install pyadi-iio") from error
    return Cn0565(library.cn0565(uri=uri), options)
