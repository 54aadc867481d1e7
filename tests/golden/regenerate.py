"""Writes the golden vectors: every message, frames of every sample width, a stored configuration, as hexadecimal.

Both decoders, the Python one and the C one, are held to these bytes. Run ``python tests/golden/regenerate.py`` after a
change that is meant to change the wire, and look at the difference before committing it.
"""

import json
from pathlib import Path

import numpy as np

from eitskin_proto.wire import codes, config_toml, framing, messages
from eitskin_proto.wire.frames import Frame, full_scale, quantise
from eitskin_proto.wire.scan_rows import row_count

WIRE = Path(__file__).parent / "wire.json"


def ramp_frame(rows_full: bool, drives: int, sample_bytes: int, **fields: int) -> Frame:
    """Return a frame whose counts run from one end of the scale to the other, with both ends saturated."""
    rows = row_count(rows_full, drives)
    step = 1.0 / full_scale(sample_bytes)
    counts, saturation = quantise(np.linspace(-1.0, 1.0, rows) * 1.01, step, sample_bytes)
    flags = fields.pop("flags", 0) | (codes.FrameFlag.FULL if rows_full else 0)
    return Frame(counts=counts, saturation=saturation, sample_bytes=sample_bytes, drives=drives, flags=flags, **fields)


def all_messages() -> dict[str, messages.Message]:
    """Return one of every message, with fields that differ from their defaults."""
    paper = config_toml.named("paper")
    blob = paper.to_blob()
    return {
        "hello_request": messages.HelloRequest(tag=1),
        "start": messages.Start(tag=2, frames=1000),
        "stop": messages.Stop(tag=3),
        "set_mode": messages.SetMode(tag=4, mode=codes.Mode.IDLE),
        "time_request": messages.TimeRequest(tag=5),
        "config_read": messages.ConfigRead(tag=6, slot=codes.Slot.OTHER, offset=32, length=32),
        "config_begin": messages.ConfigBegin(
            tag=7, token=0xDEADBEEF, size=len(blob), digest=paper.digest, hardware_id=paper.hardware_id,
            revision=paper.revision, format=1, allow_downgrade=1, name=paper.name,
        ),
        "config_write": messages.ConfigWrite(tag=8, token=0xDEADBEEF, offset=32, data=blob[32:64]),
        "config_verify": messages.ConfigVerify(tag=9, token=0xDEADBEEF),
        "config_commit": messages.ConfigCommit(tag=10, token=0xDEADBEEF, digest=paper.digest),
        "config_confirm": messages.ConfigConfirm(tag=11, generation=7, digest=paper.digest),
        "config_rollback": messages.ConfigRollback(tag=12, token=0xDEADBEEF, generation=7),
        "config_abort": messages.ConfigAbort(tag=13, token=0xDEADBEEF),
        "restart": messages.Restart(tag=14, token=0xDEADBEEF),
        "hello": messages.Hello(
            tag=15, firmware_version=(1, 2, 3), flags=codes.HelloFlag.TRIAL | codes.HelloFlag.STREAMING,
            hardware_id=paper.hardware_id, serial_number="EITSKIN-0001", configuration_digest=paper.digest,
            generation=7, configuration_name=paper.name, rate_mHz=paper.rate_mHz, rows=paper.frame_rows,
            sample_bytes=paper.sample_bytes, drives=paper.drives, idle_drives=paper.idle_drives, max_payload=64,
            uptime_ms=123456, line_bytes_per_s=92160, volts_per_count=2.0**-26,
        ),
        "ack": messages.Ack(tag=16, request=codes.MessageType.CONFIG_WRITE, code=codes.Code.BAD_OFFSET, detail=32),
        "config_data": messages.ConfigData(tag=17, slot=0, generation=7, offset=32, total=64, data=blob[32:64]),
        "event": messages.Event(code=codes.EventCode.ROLLED_BACK, device_us=0xFFFFFFFE, detail=8),
        "time": messages.Time(tag=18, device_us=0x01020304),
        "frame_16bit": ramp_frame(False, 0xFFFF, 2, sequence=1, device_us=5000, generation=7, flags=4),
        "frame_24bit": ramp_frame(False, 0xFFFF, 3, sequence=0xFFFFFFFF, device_us=0xFFFFFFFF, generation=7),
        "frame_32bit": ramp_frame(False, 0xFFFF, 4, sequence=2, device_us=10000, generation=7, device_dropped=3),
        "frame_full_24bit": ramp_frame(True, 0xFFFF, 3, sequence=3, device_us=15000, generation=8, flags=8),
        "frame_idle_24bit": ramp_frame(False, 0x0111, 3, sequence=4, device_us=20000, generation=7, flags=2),
    }  # fmt: skip


def build() -> dict[str, object]:
    """Return the content of wire.json."""
    vectors = {}
    for name, message in all_messages().items():
        payload = message.pack()
        vectors[name] = {"payload": payload.hex(), "wire": framing.encode(payload).hex()}
    blobs = {name: config_toml.named(name).to_blob().hex() for name in config_toml.NAMED}
    crc = {text: f"{framing.crc32c(text.encode()):08x}" for text in ("123456789", "a", "eitskin")}
    return {"crc32c": crc, "messages": vectors, "configurations": blobs}


def text() -> str:
    """Return wire.json as it should be on disk."""
    return json.dumps(build(), indent=1) + "\n"


if __name__ == "__main__":
    WIRE.write_text(text(), encoding="utf-8")
