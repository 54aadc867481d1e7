"""Digests of contents: SHA-256, and its first 16 hex digits as an id.

Everything that is named or vouched for by its contents takes its digest from here.
"""

import hashlib
import json
from typing import Final

ID_DIGITS: Final = 16
"""Hex digits of an id, 64 bits."""


def sha256_of(data: bytes) -> str:
    """Return the 64 hex digits of bytes' SHA-256."""
    return hashlib.sha256(data).hexdigest()


def sha256_of_values(content: object) -> str:
    """Return the 64 hex digits of plain values: of their JSON with sorted keys."""
    return sha256_of(json.dumps(content, sort_keys=True).encode())


def id_of(data: bytes) -> str:
    """Return the id of bytes, 16 hex digits."""
    return sha256_of(data)[:ID_DIGITS]


def id_of_values(content: object) -> str:
    """Return the id of plain values, 16 hex digits."""
    return sha256_of_values(content)[:ID_DIGITS]
