"""Who may look: by the address that a request names, by where the page that asks came from, and by a token.

A page of some other site can have its own name lead to 127.0.0.1 (DNS rebinding), and the browser then takes what we
serve for that site's own. It cannot change the name in the request: the Host must be an address written in digits,
``localhost``, or this machine's name.
"""

import errno
import hmac
import ipaddress
import secrets
import socket
from typing import Final

FROM_HERE: Final = ("same-origin", "none", "")
"""Sec-Fetch-Site of our own page, of an address that somebody typed, and of a browser that does not say."""


def is_loopback(host: str) -> bool:
    """Return whether an address to bind to can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """Return a token that nobody guesses: 128 bits."""
    return secrets.token_urlsafe(16)


def split_host(host: str) -> tuple[str, str]:
    """Return name and port of a Host header; the port is empty where there is none."""
    if host.startswith("["):
        name, _, rest = host[1:].partition("]")
        return name, rest.removeprefix(":")
    name, _, port = host.partition(":")
    return name, port


def host_allowed(host: str, bound: str, port: int) -> bool:
    """Return whether a Host header names this server and no site.

    Args:
        host: The header.
        bound: Address that the server is bound to.
        port: Its port.
    """
    name, stated = split_host(host.strip().lower())
    if stated != str(port):
        return False
    if is_loopback(bound):
        return name == "localhost" or is_loopback(name)
    own = socket.gethostname().lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name in {"localhost", own, f"{own.partition('.')[0]}.local"}
    return True


def came_from_here(site: str) -> bool:
    """Return whether a request comes from our own page, or from somebody who typed the address.

    Args:
        site: Its Sec-Fetch-Site; empty where the browser sends none.
    """
    return site in FROM_HERE


def token_given(authorization: str, token: str) -> bool:
    """Return whether a request has the token; any has where there is none.

    Args:
        authorization: The header.
        token: Expected, or empty.
    """
    given = authorization.removeprefix("Bearer ").encode("latin-1", "replace")
    return not token or hmac.compare_digest(given, token.encode())


def page_address(host: str, port: int, token: str) -> str:
    """Return what to type into a browser; the token stands behind the #, which no request carries.

    Args:
        host: Address that the server is bound to.
        port: Its port.
        token: What the page must know; empty for nothing.
    """
    name = socket.gethostname() if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/{f'#token={token}' if token else ''}"


def why_not_bound(host: str, port: int, error: OSError) -> str:
    """Return why a server cannot have an address, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return (
            f"port {port} of {host} is in use, perhaps by another 'eitskin view'; name another one with --port, "
            "or --port 0 for any that is free"
        )
    if error.errno == errno.EACCES:
        return f"port {port} of {host} is not yours to take; name one above 1023 with --port"
    return f"{host} port {port} cannot be bound ({error.strerror or error}); expected an address of this machine"
