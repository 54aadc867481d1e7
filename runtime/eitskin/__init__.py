"""The runtime of an electronic skin: voltages in, tactile maps out.

While a runtime publishes (``eitskin run``, ``eitskin demo``), a program subscribes::

    for frame in eitskin.subscribe():
        frame.map          # (30, 45) float32: 0 untouched, 1 touched

    for frame in eitskin.subscribe(maps=False, timeout_s=0.5, max_age_s=0.2):  # a robot stops where these raise
        for touch in frame.touches:
            touch.place_mm, touch.normal  # its place on the bent surface, and the surface's direction there

Begin with:

* ``subscribe``, ``subscribe_all``: the frames of one skin, of all skins of a robot.
* ``Frame``, ``Touch``: their content.
* ``send_cloud``: how the sheet is bent now; until then it counts as flat.
* ``request``: status, a new reference, excluded electrodes, stop.
* ``Skin``: a skin read in this process, without ``eitskin run``.
* ``reconstruct``: maps of voltages in an array.
* ``NoFrame``, ``StaleFrame``: no frame came in time, or only an old one; both are ``TimeoutError``.

Other failures of a skin, a file or a line raise a ``SkinError`` that says in one line what to do.

Names are imported when they are first used: a subscriber loads ZeroMQ and numpy, but neither ONNX Runtime nor
pyserial.
"""

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from eitskin.acquisition.drivers.feed import Feed
    from eitskin.acquisition.transport import Transport
    from eitskin.errors import (
        BadReference,
        BudgetError,
        BundleError,
        CalibrationError,
        Closed,
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
        RobotError,
        SilentSkin,
        SkinError,
        StaleFrame,
        TransportError,
    )
    from eitskin.messaging.control import ControlServer
    from eitskin.messaging.control_client import RuntimeClock, measure_clock, request, send_cloud
    from eitskin.messaging.curve_keys import ClientKeys, load_client_keys, make_keys
    from eitskin.messaging.frame import Frame
    from eitskin.messaging.publish import Publisher
    from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
    from eitskin.messaging.streams.state import SkinState
    from eitskin.messaging.streams.subscription import StreamSubscription, subscribe_streams
    from eitskin.messaging.streams.verified import VerifiedFrame, VerifiedTouch
    from eitskin.messaging.streams.verified_subscription import VerifiedSubscription, subscribe_verified
    from eitskin.messaging.subscription import Subscription, subscribe, subscribe_async
    from eitskin.model.bundle import Bundle, load_bundle
    from eitskin.reconstruction import Reconstruction, reconstruct
    from eitskin.reference.captured import Reference
    from eitskin.robot.all_frames import RobotSubscription, SkinFrame, subscribe_all
    from eitskin.robot.config import Robot, RobotSkin, load_robot
    from eitskin.robot.described import robot_skins
    from eitskin.robot.pose import Pose
    from eitskin.skin import Skin, serve
    from eitskin.touches.force import ForceTable
    from eitskin.touches.touch import Touch, TouchEvent, TouchList
    from eitskin_proto.skin.cloud import pixel_centres_mm

    __version__: str

__all__ = [
    "BadReference",
    "BudgetError",
    "Bundle",
    "BundleError",
    "CalibrationError",
    "ClientKeys",
    "Closed",
    "CloudInUse",
    "CloudWarning",
    "Conditions",
    "ControlError",
    "ControlServer",
    "EndpointError",
    "Feed",
    "ForceTable",
    "Frame",
    "FrameError",
    "HandshakeError",
    "MismatchError",
    "NoFrame",
    "PortBusy",
    "PortDenied",
    "PortLost",
    "PortMissing",
    "Pose",
    "ProtocolError",
    "Publisher",
    "Reconstruction",
    "Reference",
    "Robot",
    "RobotError",
    "RobotSkin",
    "RobotSubscription",
    "RuntimeClock",
    "SilentSkin",
    "Skin",
    "SkinError",
    "SkinFrame",
    "SkinState",
    "StaleFrame",
    "StreamSubscription",
    "Subscription",
    "Touch",
    "TouchEvent",
    "TouchList",
    "Transport",
    "TransportError",
    "VerifiedFrame",
    "VerifiedSubscription",
    "VerifiedTouch",
    "WireFrame",
    "__version__",
    "load_bundle",
    "load_client_keys",
    "load_robot",
    "make_keys",
    "measure_clock",
    "pixel_centres_mm",
    "reconstruct",
    "request",
    "robot_skins",
    "send_cloud",
    "serve",
    "subscribe",
    "subscribe_all",
    "subscribe_async",
    "subscribe_streams",
    "subscribe_verified",
]

_HOMES: Final = {
    "eitskin.acquisition.drivers.feed": ("Feed",),
    "eitskin.acquisition.transport": ("Transport",),
    "eitskin.messaging.control": ("ControlServer",),
    "eitskin.messaging.control_client": ("RuntimeClock", "measure_clock", "request", "send_cloud"),
    "eitskin.messaging.curve_keys": ("ClientKeys", "load_client_keys", "make_keys"),
    "eitskin.messaging.frame": ("Frame",),
    "eitskin.messaging.publish": ("Publisher",),
    "eitskin.messaging.streams.measured": ("CloudInUse", "Conditions", "WireFrame"),
    "eitskin.messaging.streams.state": ("SkinState",),
    "eitskin.messaging.streams.subscription": ("StreamSubscription", "subscribe_streams"),
    "eitskin.messaging.streams.verified": ("VerifiedFrame", "VerifiedTouch"),
    "eitskin.messaging.streams.verified_subscription": ("VerifiedSubscription", "subscribe_verified"),
    "eitskin.messaging.subscription": ("Subscription", "subscribe", "subscribe_async"),
    "eitskin.model.bundle": ("Bundle", "load_bundle"),
    "eitskin.reconstruction": ("Reconstruction", "reconstruct"),
    "eitskin.reference.captured": ("Reference",),
    "eitskin.robot.all_frames": ("RobotSubscription", "SkinFrame", "subscribe_all"),
    "eitskin.robot.config": ("Robot", "RobotSkin", "load_robot"),
    "eitskin.robot.described": ("robot_skins",),
    "eitskin.robot.pose": ("Pose",),
    "eitskin.skin": ("Skin", "serve"),
    "eitskin.touches.force": ("ForceTable",),
    "eitskin.touches.touch": ("Touch", "TouchEvent", "TouchList"),
    "eitskin_proto.skin.cloud": ("pixel_centres_mm",),
}
"""The public names of each module; the errors live in ``eitskin.errors``."""

_LINUX: Final = ("eitskin.messaging.control", "eitskin.messaging.publish", "eitskin.skin")
"""Modules of the runtime itself, which exist on Linux alone."""

UNKNOWN_VERSION: Final = "0+unknown"
"""The version of a source tree that was never installed."""


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'eitskin' has no attribute {name!r}")
    if name == "__version__":
        found: object = _version()
    else:
        home = next((module for module, names in _HOMES.items() if name in names), "eitskin.errors")
        if home in _LINUX:
            importlib.import_module("eitskin.errors").require_linux(f"eitskin.{name}")
        found = getattr(importlib.import_module(home), name)
    globals()[name] = found
    return found


def _version() -> str:
    """Return the version of the installed distribution."""
    from importlib import metadata  # noqa: PLC0415 -- it loads more than a subscriber needs

    try:
        return metadata.version("eitskin")
    except metadata.PackageNotFoundError:
        return UNKNOWN_VERSION


def __dir__() -> list[str]:
    return sorted(__all__)
