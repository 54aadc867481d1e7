"""Finds out why a subscriber got nothing: whether any program is at the endpoint.

A ZeroMQ socket connects to an empty address without an error, so silence has many causes that look alike. This module
distinguishes them by connecting once more, without ZeroMQ, and leaving at once.
"""

import os
import socket
from pathlib import Path
from typing import Final

from eitskin.messaging.endpoints import CONTROL, FRAMES, ROBOT, runtime_folders

LONGEST_PROBE_S: Final = 0.3
"""How long connecting to a TCP address may take; a process on this machine answers at once."""

START: Final = "start a runtime with 'eitskin run --port PORT', or name the endpoint that it publishes on"

KINDS: Final = {FRAMES: ("publishes", "eitskin subscribe"), CONTROL: ("takes requests", "eitskin status")}
"""For each name of a socket: a runtime's activity on it, and the command that shows a runtime by it."""


def explain_silence(endpoint: str, waited_s: float, what: str = "frame", likely: str = "") -> str:
    """Return why nothing may have come from an endpoint, and advice, without a full stop.

    Args:
        endpoint: The endpoint of the subscription: ``ipc:///path`` or ``tcp://address:port``.
        waited_s: Time waited; the check takes at most a quarter of that, and 0.3 s.
        what: The expected item.
        likely: The likeliest cause if a program listens, as a clause.
    """
    found = _nobody(endpoint, min(LONGEST_PROBE_S, waited_s / 4))
    if found is None:
        first = f"{likely}, or " if likely else ""
        return (
            f"a program listens there, but sends no {what}: {first}it is not the runtime's publishing endpoint, or the "
            "runtime is still capturing its reference, or has no room for another subscriber, or CURVE keys are "
            "missing or wrong; 'eitskin run' prints the endpoint in its line 'ready publishing on ...'"
        )
    return f"{found}; {other_runtimes(endpoint, FRAMES) or START}"


def other_runtimes(endpoint: str, name: str) -> str:
    """Return which of this user's runtimes run at other endpoints, and how to see one, as a clause; empty if none does.

    Args:
        endpoint: The unused endpoint.
        name: Of its kind of socket, ``FRAMES`` or ``CONTROL``.
    """
    does, command = KINDS[name]
    found = {other: skin for other, skin in running(name).items() if other != endpoint}
    for other, skin in found.items():
        if not skin:
            return f"a runtime {does} on {other}: use that endpoint"
    if found:
        return (
            f"skins run: {', '.join(found.values())}; see one with '{command} {next(iter(found))}', or all with "
            "'eitskin status --all'"
        )
    if any((folder / ROBOT).exists() for folder in runtime_folders()):
        return "'eitskin run --config' runs skins: 'eitskin status --all' lists them"
    return ""


def running(name: str) -> dict[str, str]:
    """Return where this user's runtimes can be reached in the runtime folders: {endpoint: its skin's name}.

    The name is empty for a runtime of ``eitskin run --port``. One whose sockets lie elsewhere is not found.

    Args:
        name: Of the sockets, ``FRAMES`` or ``CONTROL``.
    """
    sockets = {folder / name: "" for folder in runtime_folders()}
    for folder in runtime_folders():
        sockets |= {path: path.parent.name for path in sorted(folder.glob(f"*/{name}"))}
    return {f"ipc://{path}": skin for path, skin in sockets.items() if _nobody_at_path(path) is None}


def _nobody(endpoint: str, patience_s: float) -> str | None:
    """Return why no program listens at an endpoint; None if one does, or if that is unknown."""
    scheme, _, rest = endpoint.partition("://")
    if scheme == "ipc":
        return _nobody_at_path(Path(rest))
    host, _, port = rest.rpartition(":")
    if scheme != "tcp" or not port.isdecimal():
        return None
    try:
        socket.create_connection((host.strip("[]"), int(port)), max(patience_s, 1e-3)).close()
    except TimeoutError:
        return f"{host} does not answer on port {port}"
    except OSError as error:
        return f"nothing listens there ({error.strerror or error})"
    return None


def _nobody_at_path(path: Path) -> str | None:
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(path))
        except FileNotFoundError:
            return "no runtime listens there (the socket does not exist)"
        except ConnectionRefusedError:
            return "no runtime listens there any more (its socket is left over)"
        except PermissionError:
            return "the socket belongs to another user"
        except OSError:
            return None  # its queue is full: it lives
    return None
