"""Checks an address before it is bound: whether it is allowed, and whether it has what it needs.

- ``ipc:///path``: only the same user may connect.
- ``tcp://address:port``: clients with a CURVE key that the runtime lists, on this machine too: loopback is open to all
  of its users.
- Anything else is refused.

The path of an ipc socket is checked before it is bound: a living socket is "in use", a dead one is removed, and
anything else is refused and left in place.
"""

import errno
import os
import socket
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

import zmq

from eitskin.errors import EndpointError
from eitskin.messaging.curve_keys import ClientKeys, ServerKeys
from eitskin_proto.files.plain import quoted

LONGEST_PATH: Final = 100
"""Bytes of an ipc path; the kernel takes 107."""


FRAMES: Final = "frames"
"""Name of the default publishing socket in the runtime folder."""

CONTROL: Final = "control"
"""Name of the default control socket in the runtime folder."""

ROBOT: Final = "robot.json"
"""Name of what ``eitskin run --config`` tells of its skins, in their folder; each has a folder of its name in it, with
its sockets."""


def runtime_folders() -> list[Path]:
    """Return the default folders of sockets, the one in use first, without making them.

    The first is in ``XDG_RUNTIME_DIR``, where a session has one. The other replaces it under ``cron`` or ``sudo``: a
    runtime there and a subscriber on a desktop use different folders, and messages say so. Windows has none.
    """
    if not hasattr(os, "getuid"):
        return []
    base = os.environ.get("XDG_RUNTIME_DIR")
    session = Path(base) if base else Path(f"/run/user/{os.getuid()}")
    found = [session / "eitskin", Path(f"/tmp/eitskin-{os.getuid()}")]
    return found if base and session.is_dir() else found[::-1]


def runtime_folder() -> Path:
    """Return a folder that only this user can enter; make it if necessary.

    Raises:
        EndpointError: It exists and belongs to another user, or others may enter; or this is Windows.
    """
    if not (folders := runtime_folders()):
        raise EndpointError("this system has no default endpoint: name the runtime's tcp://address:port, with keys")
    folder = folders[0]
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise EndpointError(
            f"{folder} is not a private folder of this user (mode {stat.filemode(found.st_mode)}); remove it, or name "
            "endpoints"
        )
    return folder


def default_publish() -> str:
    """Return the default endpoint of frames."""
    return f"ipc://{runtime_folder() / FRAMES}"


def default_control() -> str:
    """Return the default endpoint of control requests."""
    return f"ipc://{runtime_folder() / CONTROL}"


def needs_keys(endpoint: str) -> bool:
    """Return whether an endpoint may be bound with CURVE keys only, as TCP may.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.

    Raises:
        EndpointError: It is neither, or has no path or port, or cannot be written as UTF-8.
    """
    scheme, separator, rest = endpoint.partition("://")
    if not separator or scheme not in ("ipc", "tcp"):
        raise EndpointError(f"endpoint {quoted(endpoint)}: expected ipc:///path or tcp://address:port")
    try:
        endpoint.encode()
    except UnicodeEncodeError as error:
        raise EndpointError(f"endpoint {quoted(endpoint)} is not UTF-8, which ZeroMQ requires; name another") from error
    if scheme == "ipc":
        if not rest.startswith("/"):
            raise EndpointError(f"endpoint {quoted(endpoint)}: expected an absolute path, such as ipc:///tmp/skin")
        if len(os.fsencode(rest)) > LONGEST_PATH:
            raise EndpointError(f"endpoint {quoted(endpoint)}: the path has more than {LONGEST_PATH} bytes")
        return False
    host, separator, port = rest.rpartition(":")
    if not separator or not host or not (port == "*" or (port.isdecimal() and int(port) < 65536)):
        raise EndpointError(f"endpoint {quoted(endpoint)}: expected tcp://address:port")
    return True


def check_allowed(endpoint: str, keys: ServerKeys | None) -> None:
    """Refuse an endpoint that others would reach without keys.

    Raises:
        EndpointError: It needs keys, or is none.
    """
    if needs_keys(endpoint) and keys is None:
        raise EndpointError(
            f"{endpoint}gives other users access, even on this machine: give CURVE keys with --curve-keys DIR "
            "('eitskin doctor --make-curve-keys DIR' makes them), or use ipc:///path"
        )


def check_client_keys(endpoint: str, keys: ClientKeys | None) -> None:
    """Refuse to connect where no runtime would answer.

    Raises:
        EndpointError: It is TCP, and there are no keys.
    """
    if endpoint.startswith("tcp://") and keys is None:
        raise EndpointError(
            f"{endpoint} needs CURVE keys, even on this machine: give --server-key FILE --client-key FILE, or "
            "keys=eitskin.load_client_keys(...); or use the runtime's ipc:///path"
        )


def bind_problem(endpoint: str, error: zmq.ZMQError | OSError) -> str:
    """Return the message for an endpoint that cannot be bound."""
    if error.errno in (errno.EADDRINUSE, errno.EEXIST):
        return f"{endpoint} is in use: stop the program that serves it, or name another endpoint"
    if error.errno == errno.ENOENT:
        return f"{endpoint}: its folder does not exist"
    return f"{endpoint} cannot be bound: {error.strerror or error}"


def clear_path(path: Path) -> None:
    """Remove a socket that was left behind at a path.

    Raises:
        EndpointError: A program listens there, or it is another file.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise EndpointError(f"ipc://{path}: another file is in the way; name another endpoint")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            with suppress(FileNotFoundError):
                path.unlink()
            return
        except BlockingIOError:
            pass  # its queue is full, so a program still listens
        except OSError as error:
            raise EndpointError(f"ipc://{path} cannot be replaced: {error.strerror or error}") from error
    raise EndpointError(f"ipc://{path} is in use: stop the program that serves it, or name another endpoint")
