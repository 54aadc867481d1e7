"""Files of the formats that eitskin reads, as they should be, to be damaged."""

import io
import json
import zipfile
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.errors import SkinError

ROOT: Final = Path(__file__).parents[3]
TINY: Final = ROOT / "tests" / "golden" / "tiny.eitskin"
VOLTS: Final = np.linspace(0.1, 1.0, 104)

ROBOT: Final = b"""format = "eitskin-robot"
version = 1
folder = "/nowhere/eitskin"
[[skins]]
name = "left-arm"
port = "/dev/serial/by-id/usb-left"
baud = 2000000
skin = "paper"
touches = "lower"
reference_frames = 100
solver = "tikhonov"
budget_ms = 4.0
every_map = true
idle_after_s = 2.5
exclude_electrodes = [3, 11]
compensate_drift = false
reconnect_s = 60.0
restart = "never"
[skins.pose]
translation_mm = [0, 120.5, 340]
quaternion_wxyz = [0.7071, 0.7071, 0, 0]
[skins.realtime]
sched_fifo = 10
affinity = [0]
mlock = true
[skins.verify]
mode = "idle"
budget_ms = 20.0
nice = 5
[[skins]]
name = "hand"
port = "usb:SKIN-2"
publish = "ipc:///nowhere/hand/frames"
control = "ipc:///nowhere/hand/control"
[skins.pose]
translation_mm = [120, 0, 610]
rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
"""
"""Every key of a robot's list of skins that needs no other file."""


class Refused(SkinError):
    """A command ended with status 1 and a line that says why."""


def commanded(folder: Path, *words: str) -> None:
    """Run a command of ``eitskin`` within this process.

    Args:
        folder: For what it prints.
        words: Of the command.

    Raises:
        Refused: It ended with status 1, and a line.
        AssertionError: It printed something else than lines for people, or ran out of memory.
    """
    from eitskin_tools.cli import main

    with (folder / "err").open("w+") as err, (folder / "out").open("w+") as out:
        with redirect_stderr(err), redirect_stdout(out):
            status = main(words)
        for file in (err, out):
            file.seek(0)
        lines, results = err.read().splitlines(), out.read().splitlines()
    for line in (*lines, *results):
        if not line.isprintable():
            raise AssertionError(f"a line that a terminal could obey: {line[:200]!r}")
    if status == 0 or (status == 1 and results):
        return
    last = lines[-1] if lines else ""
    if status != 1 or not last.startswith(f"eitskin {words[0]}: ") or "enough memory" in last:
        raise AssertionError(f"{words[0]} ended with {status} and said {last[:200]!r}")
    raise Refused(last)


def scene() -> dict[str, Any]:
    """Return a scene with every key."""
    return {
        "sheet": {
            "size_mm": [150, 100], "thickness_mm": 2.0, "conductivity_S_per_m": 1.0, "gauge_factor": 1.0,
            "field": {"rms": 0.05, "correlation_mm": 40, "seed": 3},
            "late": {"factor": 1.1, "gradient_rms": 0.02, "seed": 1},
        },
        "electrodes": {"contact": "patch", "size_mm": 4.0, "contact_impedance_ohm_m2": [1e-4] * 16},
        "bend": {"angle_deg": 60, "axis_deg": 5, "skew": 0.1, "stretch_along": 1.02, "bumps_mm": [[70, 50, 1, 20]]},
        "touches": [
            {"rect_mm": [20, 20, 40, 40], "conductivity_S_per_m": 50},
            {"disc_mm": [80, 50, 10]},
            {"polygon_mm": [[100, 60], [130, 60], [120, 85]]},
            {"units": [[0, 0], [1, 0]]},
        ],
        "current_A": 1.0,
        "element_size_mm": 10.0,
    }  # fmt: skip


def reference() -> dict[str, Any]:
    """Return a reference's fields, without its checksum."""
    from eitskin.reference.captured import FORMAT, VERSION
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.skin import PAPER

    return {
        "format": FORMAT, "version": VERSION, "protocol_id": PROTOCOL_ID, "grid_id": PAPER.grid_id,
        "serial_number": "VIRTUAL-0001", "configuration_digest": "0011aaff", "configuration_name": "paper",
        "captured_utc": "2026-01-01T00:00:00Z", "frames": 100,
        "voltages_V": VOLTS.tolist(), "spread_V": (1e-3 * VOLTS).tolist(),
    }  # fmt: skip


def sealed(fields: Any) -> bytes:
    """Return a reference's file; one that was tampered with by somebody who can make checksums."""
    from eitskin_proto.files.digest import sha256_of_values

    if not isinstance(fields, dict):
        return json.dumps(fields).encode()
    content = {key: value for key, value in fields.items() if key != "sha256"}
    return json.dumps(content | {"sha256": sha256_of_values(content)}).encode()


def npy(array: Any) -> bytes:
    """Return the bytes of a ``.npy`` file."""
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def npz(**arrays: Any) -> bytes:
    """Return the bytes of a ``.npz`` file."""
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def members(data: bytes) -> dict[str, bytes]:
    """Return what the bytes of a ZIP file hold."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def scan(form: str) -> bytes:
    """Return the points of the shipped scan as ``ply``, ``ply-text``, ``pcd``, ``pcd-text``, ``xyz`` or ``npy``."""
    from tests.golden.make_sample_points import SAMPLE, ply

    data = SAMPLE.read_bytes()
    points = np.frombuffer(data, dtype="<f4", offset=data.index(b"end_header\n") + len("end_header\n")).reshape(-1, 3)
    text = "\n".join(" ".join(f"{v:g}" for v in row) for row in points).encode()
    pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    pcd += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA "
    match form:
        case "ply":
            return ply(points.astype(np.float32))
        case "ply-text":
            axes = "".join(f"property float {axis}\n" for axis in "xyz")
            return f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{axes}end_header\n".encode() + text
        case "pcd":
            return f"{pcd}binary\n".encode() + points.tobytes()
        case "pcd-text":
            return f"{pcd}ascii\n".encode() + text
    return text if form == "xyz" else npy(points)


def cloud() -> dict[str, Any]:
    """Return the arrays of a cloud's file."""
    from eitskin_proto.skin.cloud import flat_cloud
    from eitskin_proto.skin.cloud_file import MAGIC, VERSION
    from eitskin_proto.skin.skin import PAPER

    return {
        "magic": np.array(MAGIC), "version": np.array(VERSION), "grid_id": np.array(PAPER.grid_id),
        "cloud": flat_cloud(), "predicted": VOLTS, "predicted_flat": VOLTS,
    }  # fmt: skip


def measured() -> dict[str, Any]:
    """Return the arrays of a measured file; its numbers are made up, its shapes are not."""
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.cloud import flat_cloud
    from eitskin_proto.skin.skin import PAPER

    truth = np.zeros((3, 30, 45))
    truth[0, 10:15, 20:25] = 1.0
    return {
        "reference_V": VOLTS, "reference_cloud_mm": flat_cloud(),
        "voltages_V": np.stack([0.9 * VOLTS, VOLTS, 1.1 * VOLTS]),
        "cloud_mm": flat_cloud()[None], "cloud_index": np.array([0, -1, 0]), "truth": truth,
        "kind": np.array(["single", "untouched", "again"]), "touch_kind": np.array("raise"),
        "protocol_id": np.array(PROTOCOL_ID), "grid_id": np.array(PAPER.grid_id), "skin_digest": np.array(PAPER.digest),
    }  # fmt: skip
