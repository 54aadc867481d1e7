"""CURVE keys: they authenticate both sides of a TCP endpoint and encrypt its traffic.

A folder of keys, as made by :func:`make_keys`; the format of the files is ZeroMQ's own. ::

    DIR/server.key_secret     the runtime's, mode 0600
    DIR/server.key            for subscribers, to authenticate the runtime
    DIR/clients/NAME.key      public keys of the only clients that may connect
    DIR/client.key_secret     a first client's own key, to be carried to its machine

The runtime accepts only clients whose public key is in ``clients``: knowing the server's key is not enough. So it
refuses a folder or a key that other users can write to. It reads keys once, when it starts.
"""

import os
import re
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import zmq

from eitskin.errors import EndpointError
from eitskin_proto.files.reading import FileError, read_bytes

LARGEST_KEY: Final = 4096
"""Bytes of a key's file, which has some hundreds."""

KEY: Final = re.compile(rb'^\s*(public|secret)-key\s*=\s*"([0-9a-zA-Z.:+=^!/*?&<>()\[\]{}@%$#-]{40})"', re.MULTILINE)
"""A key in a file, in Z85."""

MAKE: Final = "'eitskin doctor --make-curve-keys DIR' makes keys"

DOMAIN: Final = "eitskin"
"""ZAP domain of the runtime's sockets."""


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """The runtime's keys, and the clients that may connect."""

    public: bytes
    secret: bytes
    admitted: frozenset[bytes]
    """Public keys of clients, in Z85."""

    def apply(self, socket: Any) -> None:
        """Make a ZeroMQ socket a CURVE server; before it is bound."""
        socket.curve_publickey = self.public
        socket.curve_secretkey = self.secret
        socket.curve_server = True
        socket.zap_domain = DOMAIN.encode()


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """A client's own keys and the server that it trusts."""

    public: bytes
    secret: bytes
    server: bytes

    def apply(self, socket: Any) -> None:
        """Set up a ZeroMQ socket as a CURVE client; call this before it connects."""
        socket.curve_publickey = self.public
        socket.curve_secretkey = self.secret
        socket.curve_serverkey = self.server


def make_keys(folder: str | Path) -> list[Path]:
    """Make keys for a server and a first client, and return their files.

    Raises:
        EndpointError: Keys exist already; they are not overwritten.
        OSError: The files cannot be written.
    """
    where = Path(folder)
    clients = where / "clients"
    made = [where / f"{name}.{kind}" for name in ("server", "client") for kind in ("key", "key_secret")]
    made.append(clients / "client.key")
    if there := [path for path in made if os.path.lexists(path)]:
        raise EndpointError(f"{where} already holds keys, {there[0]}: name another folder, or remove them")
    before = os.umask(0o077)
    try:
        clients.mkdir(parents=True, exist_ok=True)
        names = (*_auth().create_certificates(where, "server"), *_auth().create_certificates(where, "client"))
        (where / "client.key").rename(clients / "client.key")
    except BaseException:
        for path in made:  # none of them was there
            path.unlink(missing_ok=True)
        raise
    finally:
        os.umask(before)
    return [path if path.exists() else clients / path.name for path in map(Path, names)]


def load_server_keys(folder: str | Path) -> ServerKeys:
    """Return the runtime's keys.

    Raises:
        EndpointError: They are missing, unreadable, readable by others, or could have been put there by others.
    """
    where = Path(folder)
    secret_file, clients = where / "server.key_secret", where / "clients"
    public, secret = _pair(secret_file)
    if secret_file.stat().st_mode & 0o077:
        raise EndpointError(f"{secret_file} can be read by others; run: chmod 600 {secret_file}")
    listed = sorted(clients.glob("*.key"))
    admitted = frozenset(_keys_of(path)["public"] for path in listed)
    for path in (where, secret_file, *([clients] if clients.is_dir() else []), *listed):
        _refuse_if_others_write(path, path.stat())
    if not admitted:
        raise EndpointError(f"{clients} holds no client's public key, so no client could connect: put NAME.key there")
    return ServerKeys(public, secret, admitted)


def _refuse_if_others_write(path: Path, found: os.stat_result) -> None:
    """Refuse a file that another user could have changed and so choose the clients."""
    if found.st_mode & 0o022:
        raise EndpointError(
            f"{path} can be written to by others, who could give themselves access; run: chmod go-w {path}"
        )
    if found.st_uid not in (os.geteuid(), 0):
        raise EndpointError(
            f"{path} belongs to another user (number {found.st_uid}), who could give themselves access; run: sudo "
            f"chown {os.geteuid()} {path}"
        )


def load_client_keys(server_key: str | Path, client_secret: str | Path) -> ClientKeys:
    """Return a client's keys.

    Args:
        server_key: Path of the runtime's ``server.key``.
        client_secret: Path of the client's own ``.key_secret`` file.

    Raises:
        EndpointError: A file is missing or holds no key.
    """
    return ClientKeys(*_pair(Path(client_secret)), _keys_of(Path(server_key))["public"])


class CurveAuthenticator:
    """Admits the clients whose keys are in the folder; ZeroMQ asks it once a connection (ZAP, RFC 27).

    Its thread blocks until there is a question and ends when the context is terminated.

    Args:
        context: The ZeroMQ context whose sockets it guards.
        keys: The runtime's.
    """

    def __init__(self, context: Any, keys: ServerKeys) -> None:
        self._authenticator = _auth().Authenticator(context)
        self._authenticator.certs[DOMAIN] = dict.fromkeys(keys.admitted, True)
        self._authenticator.start()
        self._thread = threading.Thread(target=self._serve, name="eitskin-curve", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        socket = self._authenticator.zap_socket
        with suppress(zmq.ContextTerminated):
            while True:
                # The questions come from libzmq itself; a malformed one would be a fault here, not of a client.
                _answer(self._authenticator, socket.recv_multipart())
        self._authenticator.stop()

    def join(self) -> None:
        """Wait for the thread, after the context was terminated."""
        self._thread.join()


def _answer(authenticator: Any, question: list[bytes]) -> None:
    handling = authenticator.handle_zap_message(question)
    with suppress(StopIteration):  # a coroutine that never waits: one step runs it to its end
        handling.send(None)


def _auth() -> Any:
    """Return pyzmq's keys module, imported late because it loads logging and hashing."""
    from zmq import auth  # noqa: PLC0415

    return auth


def _keys_of(path: Path) -> dict[str, bytes]:
    """Return the keys of a file in Z85: ``public`` and, of a secret one, ``secret``.

    Raises:
        EndpointError: It cannot be read, or holds no public key.
    """
    try:
        found = {kind.decode(): key for kind, key in KEY.findall(read_bytes(path, LARGEST_KEY))}
    except (OSError, FileError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise EndpointError(f"{path} is not a CURVE key: {why}; {MAKE}") from error
    if "public" not in found:
        raise EndpointError(f"{path} is not a CURVE key: it holds no public key; copy it there again, or remove it")
    return found


def _pair(path: Path) -> tuple[bytes, bytes]:
    """Return the public and the secret key of a file."""
    found = _keys_of(path)
    if "secret" not in found:
        raise EndpointError(f"{path} holds no secret key; expected a file that ends in .key_secret")
    return found["public"], found["secret"]
