"""What a device finds wrong with a configuration that was written to it: the order of SPEC.md, section 6."""

from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire import hardware
from eitskin_proto.wire.codes import Code
from eitskin_proto.wire.config import BLOB_BYTES, BLOB_MAGIC, FORMAT, HAS_SKIN, Configuration
from eitskin_proto.wire.framing import crc32c


def judge(blob: bytes) -> Code:
    """Return what is wrong with a blob of full length, in the order in which the firmware looks; OK if nothing is."""
    if blob[:4] != BLOB_MAGIC:
        return Code.DIGEST_MISMATCH
    if blob[4] != FORMAT:
        return Code.BAD_FORMAT
    if crc32c(blob[:-4]) != int.from_bytes(blob[-4:], "little"):
        return Code.DIGEST_MISMATCH
    if int.from_bytes(blob[6:8], "little") != BLOB_BYTES or blob[59] > HAS_SKIN:
        return Code.INVALID_CONFIGURATION
    if int.from_bytes(blob[8:12], "little") != hardware.EITSKIN_16.id:
        return Code.WRONG_HARDWARE
    try:
        found = Configuration.from_blob(blob)
    except ProtocolError:
        return Code.INVALID_CONFIGURATION
    try:
        found.check()
    except ValueError:
        modes = [(found.drives, found.rate_mHz), (found.idle_drives, found.idle_rate_mHz)]
        slow = any(drives and rate * found.scan_us(drives) > 10**9 for drives, rate in modes)
        return Code.RATE_TOO_HIGH if slow and _values_fit(found) else Code.INVALID_CONFIGURATION
    return Code.OK


def _values_fit(found: Configuration) -> bool:
    """Return whether the electronics have every value but the rates."""
    can = hardware.by_id(found.hardware_id)
    return (
        can.min_frequency_hz <= found.frequency_hz <= can.max_frequency_hz
        and found.current_ua <= can.max_current_ua
        and found.gain in can.gains
        and found.settle_us >= can.min_settle_us
    )
