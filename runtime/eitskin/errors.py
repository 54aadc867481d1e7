"""The errors that the runtime raises on purpose. All derive from ``SkinError``.

::

    SkinError
    ├── ProtocolError          bytes, a file or a device of another protocol (eitskin_proto)
    │   ├── MismatchError      made for another protocol_id or grid_id: found, expected, the command that fixes it
    │   └── FrameError         a published message that is no tactile frame
    ├── TransportError         the line to the device
    │   ├── PortMissing        no such port
    │   ├── PortBusy           another program has it
    │   ├── PortDenied         no permission
    │   ├── PortLost           it vanished while open
    │   └── PortReturned       it vanished and is open again: shake hands anew
    ├── HandshakeError         the device did not answer, or refused
    │   └── NotReady           it did not answer, refused for now or sends no frames: try again
    ├── BundleError            a bundle that is damaged or incomplete
    ├── BadReference           a reference that cannot be used
    ├── CalibrationError       a force table that cannot be used
    ├── EndpointError          an address that may not or cannot be bound or reached
    ├── ControlError           the runtime refused a request
    ├── BudgetError            a latency budget that cannot be met
    ├── RobotError             a list of skins that cannot be used    (also ValueError)
    ├── Closed                 the subscription was stopped or closed
    ├── NoFrame                no frame came in time                 (also TimeoutError)
    │   └── SilentSkin         from one of several skins, which it names
    └── StaleFrame             the newest frame is too old           (also TimeoutError)

Bad arguments raise ``ValueError``, with the value and the bound. A doubtful cloud that is used all the same gives a
``CloudWarning``.
"""
# ruff: noqa: N818 - a lost port is called PortLost; the root already says that it is an error

import sys

from eitskin_proto.errors import MismatchError, ProtocolError, SkinError

__all__ = [
    "BadReference",
    "BudgetError",
    "BundleError",
    "Closed",
    "CloudWarning",
    "ControlError",
    "EndpointError",
    "FrameError",
    "HandshakeError",
    "MismatchError",
    "NoFrame",
    "NotReady",
    "PortBusy",
    "PortDenied",
    "PortLost",
    "PortMissing",
    "PortReturned",
    "ProtocolError",
    "RobotError",
    "SilentSkin",
    "SkinError",
    "StaleFrame",
    "TransportError",
]


class FrameError(ProtocolError):
    """A published message is not a tactile frame."""


class TransportError(SkinError):
    """The line to the device failed."""


class PortMissing(TransportError):
    """There is no such port."""


class PortBusy(TransportError):
    """Another program has the port."""


class PortDenied(TransportError):
    """This user may not open the port."""


class PortLost(TransportError):
    """The port vanished while it was open."""


class PortReturned(TransportError):
    """The port vanished and is open again; repeat the handshake."""


class HandshakeError(SkinError):
    """The device did not answer, or refused."""


class NotReady(HandshakeError):
    """The device did not answer, refused for now, or sends no usable frames; try again."""


class BundleError(SkinError):
    """A bundle is damaged, incomplete or unreadable."""


class BadReference(SkinError):
    """A reference cannot be used; the builtin ``ReferenceError`` is about weak references."""


class CalibrationError(SkinError):
    """A table from strength to force cannot be used."""


class EndpointError(SkinError):
    """An endpoint is not allowed, or cannot be bound or reached."""


class ControlError(SkinError):
    """The runtime refused a control request, or did not answer it."""


class BudgetError(SkinError):
    """No solver of the bundle meets the latency budget."""


class RobotError(SkinError, ValueError):
    """A robot's list of skins cannot be used."""


class Closed(SkinError):
    """The subscription was stopped or closed, here or by another thread."""


class NoFrame(SkinError, TimeoutError):
    """No frame came within the subscriber's timeout."""


class SilentSkin(NoFrame):
    """One of several skins sends nothing.

    Args:
        skin: The skin's name.
        text: The message: how long the subscriber waited, and the likely cause.
    """

    def __init__(self, skin: str, text: str) -> None:
        super().__init__(text)
        self.skin = skin


class StaleFrame(SkinError, TimeoutError):
    """The newest frame is older than the subscriber allows."""


class CloudWarning(UserWarning):
    """A cloud is in use, but something about it is doubtful."""


def require_linux(who: str) -> None:
    """Refuse what reads a device or publishes on a system where it was never tried.

    Args:
        who: The command or the class.

    Raises:
        SkinError: The system is another one.
    """
    if sys.platform != "linux":
        raise SkinError(
            f"{who} needs Linux, found {sys.platform}: start the runtime on a Linux machine, and subscribe from here "
            "with its tcp://address:port and keys"
        )
