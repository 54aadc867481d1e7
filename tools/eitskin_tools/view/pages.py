"""The files of the page: a short list, read once; nothing else is served."""

from importlib import resources
from typing import Final

TYPES: Final = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
"""Content type by suffix."""

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy: the page's own files and no other, and nothing written into it."""

HEADERS: Final = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer."""


def pages() -> dict[str, tuple[str, bytes]]:
    """Return {path: (content type, bytes)} of the page's files; ``/`` is ``index.html``."""
    found = {}
    for entry in resources.files("eitskin_tools.view").joinpath("static").iterdir():
        if kind := TYPES.get(entry.name.rpartition(".")[2]):
            path = "/" if entry.name == "index.html" else f"/{entry.name}"
            found[path] = (kind, entry.read_bytes())
    return found
