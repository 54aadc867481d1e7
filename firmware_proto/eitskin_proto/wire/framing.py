"""Packets on a byte stream: COBS keeps 0x00 out of the packet, 0x00 ends it, CRC-32C detects damage.

::

    payload | crc32c(payload), u32 little-endian        --COBS-->   no zero inside   | 0x00

Whatever happens to the bytes, the next 0x00 starts afresh: a damaged packet is dropped and counted, never shifted into
its neighbour. Memory is bounded by the largest packet, since a line that never sends 0x00 must not fill the host.
"""

from typing import Final

import google_crc32c
from cobs import cobs

MAX_PAYLOAD: Final = 1024
"""Largest payload in bytes; a full frame of 208 rows at 32 bit has 878."""

CRC_BYTES: Final = 4

RESIDUE: Final = 0x48674BC7
"""CRC-32C of anything intact with its own CRC-32C behind it: the check takes one pass and no comparison of parts."""


def crc32c(data: bytes) -> int:
    """Return the CRC-32C (Castagnoli) of some bytes; 0xE3069283 for b"123456789"."""
    return int(google_crc32c.value(data))


def wire_bytes(payload_bytes: int) -> int:
    """Return the most bytes that a payload of this length takes on the wire: check, stuffing and delimiter included."""
    inside = payload_bytes + CRC_BYTES
    return inside + max(1, -(-inside // 254)) + 1


def encode(payload: bytes, max_payload: int = MAX_PAYLOAD) -> bytes:
    """Return the packet of a payload, delimiter included.

    Args:
        payload: Type byte first.
        max_payload: Bytes that the other side accepts.

    Raises:
        ValueError: The payload is empty or longer than ``max_payload``.
    """
    if not 1 <= len(payload) <= max_payload:
        raise ValueError(f"a payload of {len(payload)} bytes cannot be sent; expected 1 to {max_payload}")
    stuffed: bytes = cobs.encode(payload + crc32c(payload).to_bytes(CRC_BYTES, "little"))
    return stuffed + b"\0"


class Deframer:
    """Cuts a byte stream into intact payloads and counts dropped pieces.

    The piece before the first 0x00 may be the tail of a packet whose beginning was sent before anyone listened: if it
    is no packet it counts as discarded bytes, not as corrupt.

    Args:
        max_payload: Longest payload accepted; nothing longer is ever buffered.
    """

    __slots__ = (
        "_flooded",
        "_limit",
        "_max_payload",
        "_pending",
        "_synchronised",
        "corrupt",
        "discarded_bytes",
        "packets",
    )

    def __init__(self, max_payload: int = MAX_PAYLOAD) -> None:
        self._max_payload = max_payload
        self._limit = wire_bytes(max_payload)
        self._pending = b""
        self._flooded = False
        self._synchronised = False
        self.packets = 0
        """Intact packets so far."""
        self.corrupt = 0
        """Pieces between two delimiters that were no intact packet."""
        self.discarded_bytes = 0
        """Bytes of everything that was dropped, delimiters not counted."""

    @property
    def pending_bytes(self) -> int:
        """Bytes that wait for their delimiter; never more than the largest packet."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads that these bytes complete, in order.

        Args:
            data: Bytes from the line, of any length.
        """
        data = bytes(data)
        if self._synchronised and not self._pending and not self._flooded and data.find(0) == len(data) - 1:
            payload = _open(data[:-1])  # exactly one packet: what a paced stream delivers
            if payload is not None and len(payload) <= self._max_payload:
                self.packets += 1
                return [payload]
        pieces = data.split(b"\0")
        payloads = []
        for piece in pieces[:-1]:
            payload = self._close(piece)
            if payload is not None:
                payloads.append(payload)
        self._hold(pieces[-1])
        return payloads

    def reset(self) -> None:
        """Forget a half-received packet, as after reopening a line; the counters stay."""
        self.discarded_bytes += len(self._pending)
        self._pending = b""
        self._flooded = False
        self._synchronised = False

    def _hold(self, piece: bytes) -> None:
        if self._flooded or len(self._pending) + len(piece) > self._limit:
            self.discarded_bytes += len(self._pending) + len(piece)
            self._pending = b""
            self._flooded = True
        else:
            self._pending += piece

    def _close(self, piece: bytes) -> bytes | None:
        self._hold(piece)
        packet, flooded, synchronised = self._pending, self._flooded, self._synchronised
        self._pending, self._flooded, self._synchronised = b"", False, True
        if not packet and not flooded:
            return None  # two delimiters in a row: how a sender makes sure that the line is clean
        payload = None if flooded else _open(packet)
        if payload is not None and len(payload) <= self._max_payload:
            self.packets += 1
            return payload
        self.discarded_bytes += len(packet)
        self.corrupt += synchronised
        return None


def _open(packet: bytes) -> bytes | None:
    try:
        inside: bytes = cobs.decode(packet)
    except cobs.DecodeError:
        return None
    if len(inside) <= CRC_BYTES or google_crc32c.value(inside) != RESIDUE:
        return None
    return inside[:-CRC_BYTES]
