"""Reads messages to the page."""

import json
from typing import Any

from eitskin_tools.view.messages import HEAD


def unpacked(data: bytes) -> list[tuple[dict[str, Any], bytes]]:
    """Return the whole messages at the beginning of some bytes: head and body of each."""
    found, at = [], 0
    while at + HEAD.size <= len(data):
        rest, size = HEAD.unpack_from(data, at)
        end = at + 4 + rest
        if end > len(data):
            break
        found.append((json.loads(data[at + 8 : at + 8 + size]), data[at + 8 + size : end]))
        at = end
    return found
