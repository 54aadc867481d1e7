"""The runtime of an electronic skin: voltages in, tactile maps out.

::

    for frame in eitskin.subscribe("ipc:///run/user/1000/eitskin/frames"):
        frame.map          # (30, 45) float32

Names are imported when they are first used: a subscriber loads ZeroMQ and numpy, but neither ONNX Runtime nor
pyserial.
"""

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from eitskin.errors import (
        BadReference,
        BudgetError,
        BundleError,
        CloudWarning,
        ControlError,
        EndpointError,
        FrameError,
        HandshakeError,
        MismatchError,
        NoFrame,
        PortBusy,
        PortDenied,
        PortLost,
        PortMissing,
        ProtocolError,
        SkinError,
        StaleFrame,
        TransportError,
    )
    from eitskin.messaging.control_client import request, send_cloud
    from eitskin.messaging.curve_keys import ClientKeys, load_client_keys, make_keys
    from eitskin.messaging.frame import Frame
    from eitskin.messaging.subscription import Subscription, subscribe
    from eitskin.model.bundle import Bundle, load_bundle
    from eitskin.reference.captured import Reference
    from eitskin.skin import Skin

__all__ = [
    "BadReference",
    "BudgetError",
    "Bundle",
    "BundleError",
    "ClientKeys",
    "CloudWarning",
    "ControlError",
    "EndpointError",
    "Frame",
    "FrameError",
    "HandshakeError",
    "MismatchError",
    "NoFrame",
    "PortBusy",
    "PortDenied",
    "PortLost",
    "PortMissing",
    "ProtocolError",
    "Reference",
    "Skin",
    "SkinError",
    "StaleFrame",
    "Subscription",
    "TransportError",
    "load_bundle",
    "load_client_keys",
    "make_keys",
    "request",
    "send_cloud",
    "subscribe",
]

_HOMES: Final = {
    "Bundle": "model.bundle",
    "ClientKeys": "messaging.curve_keys",
    "Frame": "messaging.frame",
    "Reference": "reference.captured",
    "Skin": "skin",
    "Subscription": "messaging.subscription",
    "load_bundle": "model.bundle",
    "load_client_keys": "messaging.curve_keys",
    "make_keys": "messaging.curve_keys",
    "request": "messaging.control_client",
    "send_cloud": "messaging.control_client",
    "subscribe": "messaging.subscription",
}
"""Where each public name lives; the errors live in ``errors``."""


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'eitskin' has no attribute {name!r}")
    found = getattr(importlib.import_module(f"eitskin.{_HOMES.get(name, 'errors')}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
