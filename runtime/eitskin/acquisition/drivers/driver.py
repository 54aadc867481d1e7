"""What a driver of somebody's electronics is, and how a port's name finds one.

A driver yields volts in the order of its table; everything behind it is the same as for the project's own devices.
It is one class, registered by a package under the entry-point group ``eitskin.devices``::

    [project.entry-points."eitskin.devices"]
    mine = "mypackage:open_mine"        # eitskin run --port mine:/dev/ttyUSB0?rate=50

The function takes what is behind the colon and returns a :class:`Driver`, which has a file descriptor to wait on, or a
:class:`PolledDriver`, whose ``measure`` blocks. :func:`parse_rest` takes such a text apart.
"""

import re
from collections.abc import Iterable, Mapping
from importlib import import_module, metadata
from typing import Any, Final, NamedTuple, Protocol
from urllib.parse import parse_qsl

import numpy as np
import numpy.typing as npt

from eitskin.errors import SkinError, TransportError
from eitskin_proto.fields import Fields
from eitskin_proto.sensor.row_table import RowTable

GROUP: Final = "eitskin.devices"

SHIPPED: Final = {
    "cn0565": "eitskin.acquisition.drivers.cn0565:open_cn0565",
    "line": "eitskin.acquisition.drivers.text_line:open_text_line",
    "sciospec": "eitskin.acquisition.drivers.sciospec:open_sciospec",
}
"""Drivers that come along; they need no entry point."""

_PORT: Final = re.compile(r"([a-z][a-z0-9_-]*):(.*)", re.DOTALL)


class Scan(NamedTuple):
    """One scan."""

    voltages: npt.NDArray[np.number]
    """(rows,) V, real or complex."""
    device_us: int | None = None
    """The device's clock at its end, in microseconds; None if it has none."""
    lost: int = 0
    """Scans before it that did not come whole."""


class Described(Protocol):
    """What every driver says of its device."""

    @property
    def name(self) -> str:
        """Kind of device, at most 16 ASCII characters."""

    @property
    def serial_number(self) -> str:
        """At most 16 ASCII characters; a reference belongs to one serial number."""

    @property
    def settings(self) -> Mapping[str, object]:
        """All settings that change voltages; a reference belongs to one set of them."""

    @property
    def table(self) -> RowTable:
        """Rows of a scan."""

    @property
    def rate_hz(self) -> float:
        """Scans per second; 0 if unknown."""

    @property
    def step_V(self) -> float:
        """Step of the converter; 0 if unknown."""

    @property
    def full_scale_V(self) -> float:
        """Voltage that the converter does not exceed; 0 if unknown."""

    @property
    def signed(self) -> bool:
        """Whether voltages have a sign. Amounts have none, nor have complex voltages, which are projected."""

    def start(self) -> None:
        """Set the device up and let it scan.

        Raises:
            SkinError: It does not take a setting, or is gone; in one line, with what to do.
        """

    def stop(self) -> None:
        """Let it rest."""

    def close(self) -> None:
        """Give it back; a second call does nothing."""


class Driver(Described, Protocol):
    """A device that sends scans by itself."""

    def fileno(self) -> int:
        """Return a file descriptor that is readable when there is something to take."""

    def scans(self) -> Iterable[Scan]:
        """Return the scans that are complete, without waiting.

        Raises:
            PortLost: The device is gone.
        """


class PolledDriver(Described, Protocol):
    """A device that measures when it is asked."""

    def measure(self) -> npt.NDArray[np.number]:
        """Return (rows,) V of a scan made now."""


def driver_name(port: str) -> str:
    """Return the name of the driver that a port names; "" for a serial path or ``usb:``."""
    found = _PORT.fullmatch(port)
    return "" if found is None or found[1] == "usb" else found[1]


def device_path(port: str) -> str:
    """Return the path in a port's name: ``/dev/ttyACM0`` of ``line:/dev/ttyACM0?numbers=256``."""
    name = driver_name(port)
    return port[len(name) + 1 :].partition("?")[0] if name else port


def open_driver(port: str) -> Driver | PolledDriver:
    """Return the driver of a port ``NAME:REST``.

    Raises:
        TransportError: There is no driver of this name, or it cannot be opened, with the reason.
    """
    name = driver_name(port)
    others = {one.name: one for one in metadata.entry_points(group=GROUP)}
    if name not in SHIPPED and name not in others:
        raise TransportError(
            f"no driver is called {name!r}; there are {', '.join(sorted({*SHIPPED, *others}))}; a package adds one by "
            f"the entry-point group {GROUP}"
        )
    try:
        if name in SHIPPED:
            module, _, function = SHIPPED[name].partition(":")
            opened = getattr(import_module(module), function)
        else:
            opened = others[name].load()
        found: Driver | PolledDriver = opened(port[len(name) + 1 :])
    except SkinError:
        raise
    except Exception as error:  # somebody else's code
        raise TransportError(f"{port} cannot be opened: {str(error) or type(error).__name__}") from error
    return found


def parse_rest(rest: str, where: str) -> tuple[str, Fields]:
    """Return the path and the options of ``PATH?name=value&name=value``; ``options.close()`` refuses unknown ones.

    Args:
        rest: What is behind the driver's name.
        where: The driver's name, for messages.

    Raises:
        ValueError: An option is there twice.
    """
    path, _, query = rest.partition("?")
    found: dict[str, Any] = {}
    for name, value in parse_qsl(query, keep_blank_values=True):
        if name in found:
            raise ValueError(f"{where} has {name} twice, expected it once")
        found[name] = _number(value)
    return path, Fields(found, where)


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
