"""Files of every kind that eitskin reads, as they should be, to be damaged; and what reads each."""

import io
import json
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

ROOT: Final = Path(__file__).parents[3]
TINY: Final = ROOT / "tests" / "golden" / "tiny.eitskin"

MOST_ELEMENTS: Final = 10_000
"""Of a mesh that is solved; the default scene has 8,500."""

Read = Callable[[Path], object]
"""Reads a sample as a command would, as far as what the file says has an effect."""


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

    volts = np.linspace(0.1, 1.0, 104)
    return {
        "format": FORMAT, "version": VERSION, "protocol_id": PROTOCOL_ID, "grid_id": PAPER.grid_id,
        "serial_number": "VIRTUAL-0001", "configuration_digest": "0011aaff", "configuration_name": "paper",
        "captured_utc": "2026-01-01T00:00:00Z", "frames": 100,
        "voltages_V": volts.tolist(), "spread_V": (1e-3 * volts).tolist(),
    }  # fmt: skip


def sealed(fields: Any) -> bytes:
    """Return a reference's file; one that was tampered with by somebody who can make checksums."""
    from eitskin_proto.files.digest import sha256_of_values

    content = dict(fields) if isinstance(fields, dict) else fields
    if isinstance(content, dict):
        content["sha256"] = sha256_of_values({k: v for k, v in content.items() if k != "sha256"})
    return json.dumps(content).encode()


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


@cache
def points() -> Any:
    """Return (6868, 3) mm of the shipped scan."""
    from eitskin_tools.scans import prepare

    data = prepare.SAMPLE.read_bytes()
    at = data.index(b"end_header\n") + len("end_header\n")
    return np.frombuffer(data, dtype="<f4", offset=at).reshape(-1, 3)


def recording() -> Any:
    """Return (500, 104) V of frames."""
    return np.tile(np.linspace(0.1, 1.0, 104), (500, 1))


def ply_text() -> bytes:
    """Return an ASCII .ply file."""
    rows = points()
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n" + "".join(f"property float {a}\n" for a in "xyz")
    return (head + "end_header\n" + "\n".join(" ".join(f"{v:g}" for v in row) for row in rows) + "\n").encode()


def ply_binary() -> bytes:
    """Return a binary .ply file."""
    from eitskin_tools.scans.prepare import ply

    return ply(points().astype(np.float32))


def cloud() -> dict[str, Any]:
    """Return the arrays of a cloud's file."""
    from eitskin_proto.skin.cloud import flat_cloud
    from eitskin_proto.skin.cloud_file import MAGIC, VERSION
    from eitskin_proto.skin.skin import PAPER

    rows = np.linspace(0.1, 1.0, 104)
    return {
        "magic": np.array(MAGIC), "version": np.array(VERSION), "grid_id": np.array(PAPER.grid_id),
        "cloud": flat_cloud(), "predicted": rows, "predicted_flat": rows,
    }  # fmt: skip


def members(path: Path) -> dict[str, bytes]:
    """Return what a ZIP file holds."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def members_of(data: bytes) -> dict[str, bytes]:
    """Return what the bytes of a ZIP file hold."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def bundle(parts: dict[str, bytes], manifest: Any) -> bytes:
    """Return a bundle's bytes, with the digests of its members."""
    from eitskin_proto.files.digest import sha256_of

    if isinstance(manifest, dict) and isinstance(manifest.get("files"), dict):
        for name, data in parts.items():
            if isinstance(manifest["files"].get(name), dict):
                manifest["files"][name]["sha256"] = sha256_of(data)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in {"manifest.json": json.dumps(manifest).encode(), **parts}.items():
            archive.writestr(name, data)
    return out.getvalue()


def data_set(folder: Path) -> None:
    """Write a data set of two bends on the unit grid and nothing computed: its numbers are made up."""
    from eitskin_proto.files.digest import sha256_of
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.cloud import flat_cloud
    from eitskin_proto.skin.skin import PAPER
    from eitskin_sim.dataset.index import FORMAT, VERSION

    folder.mkdir(exist_ok=True)
    rows = np.linspace(0.1, 1.0, 104)
    units = np.zeros((6, 126), dtype=np.bool_)
    units[np.arange(6), np.arange(6)] = True
    files = {
        "touches.npz": npz(
            units=np.packbits(units, axis=1, bitorder="little"), validation=np.arange(6) > 4, reference=rows
        )
    }
    for number in range(2):
        files[f"deformation-{number:04d}.npz"] = npz(
            touch_set=np.arange(6, dtype=np.int32), voltages=np.tile(rows, (6, 1)).astype(np.float32), untouched=rows,
            cloud=flat_cloud().astype(np.float32),
        )  # fmt: skip
    for name, data in files.items():
        (folder / name).write_bytes(data)
    bend = {
        "angle_deg": 0.0, "axis_deg": 0.0, "skew": 0.0, "twist_deg": 0.0, "stretch_along": 1.0, "stretch_across": 1.0,
        "nonuniformity": 0.0, "bumps_mm": [],
    }  # fmt: skip
    listed = [{"file": name, "sha256": sha256_of(data)} for name, data in files.items()]
    index = {
        "format": FORMAT, "version": VERSION, "protocol_id": PROTOCOL_ID, "grid_id": PAPER.grid_id,
        "set": "paper", "seed": 0,
        "digest": "0" * 16, "touches": listed[0],
        "deformations": [{**entry, "samples": 6, "split": "train", "bend": bend} for entry in listed[1:]],
    }  # fmt: skip
    (folder / "index.json").write_text(json.dumps(index))


def read_bundle(path: Path) -> None:
    """Load a bundle, warm its engines up, and compute a map."""
    from eitskin.health.imputation import Consistency
    from eitskin.messaging.frame_record import FrameRecord
    from eitskin.model.buffers import Buffers
    from eitskin.model.bundle import load_bundle
    from eitskin.model.gate import Gate
    from eitskin.model.geometry import GeometryGraph
    from eitskin.pipeline.map_source import MapSource

    found = load_bundle(path)
    repr(found)
    buffers = Buffers(found)
    geometry = GeometryGraph(found).geometry(None, None, 0)
    buffers.take(geometry)
    buffers.change[:] = 0.01
    record = FrameRecord(memoryview(buffers.map[0]).cast("B"))
    maps = MapSource(found, buffers, record, None, solver=None, skip_unchanged=False)
    if maps.infer() and not np.isfinite(maps.map).all():
        raise AssertionError("a map that is not finite would be published")
    arrays = found.gate_arrays()
    if arrays is not None:
        Gate(arrays).touched()
    arrays = found.consistency_arrays()
    if arrays is not None:
        Consistency.of(arrays)


def read_reference(path: Path) -> None:
    """Load a reference and report it."""
    from eitskin.reference import captured

    found = captured.load(path)
    for line in found.report():
        if not line.isprintable():
            raise AssertionError(f"a line that a terminal could obey: {line!r}")
    found.answer()


def read_configuration(path: Path) -> None:
    """Load a configuration and check it."""
    from eitskin_proto.wire import config_toml

    found = config_toml.load(path)
    found.to_blob()
    found.check()


def read_scene(path: Path) -> None:
    """Load a scene and solve it, where that takes seconds and not the minute that a fine mesh may take."""
    from eitskin_sim.fem.meshing import scene_mesh
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.scene import load_scene

    scene = load_scene(path)
    if scene_mesh(scene).n_elements > MOST_ELEMENTS:
        return
    found = solve_scene(scene).voltages  # the contact law of data sets: seconds faster than that of the command
    if not np.isfinite(found).all():
        raise AssertionError("voltages that are not finite would be written")


def read_phantoms(path: Path) -> None:
    """Load phantoms."""
    from eitskin_sim.scene.scene import load_phantoms

    load_phantoms(path)


def read_scan(path: Path) -> None:
    """Read points and order them."""
    from eitskin_sim.surface.ordered_cloud import organise
    from eitskin_sim.surface.point_files import read_points

    organise(read_points(path))


def read_cloud(path: Path) -> None:
    """Load a cloud's file as the control client does."""
    from eitskin_proto.skin.cloud import align_cloud
    from eitskin_proto.skin.cloud_file import load_surface

    align_cloud(load_surface(path).cloud_mm)


def read_recording(path: Path) -> None:
    """Load recorded frames."""
    from eitskin.diagnostics.electrode_checkup import load_recording

    load_recording(path)


def read_data_set(path: Path) -> None:
    """Load a data set and make its labels."""
    from eitskin_sim.dataset.reader import load

    found = load(path)
    found.label_table_u8()
    found.rows()


def read_run(path: Path) -> None:
    """Load a run's best epoch and its history."""
    from eitskin_training.curves import history_of
    from eitskin_training.run_files import trained

    trained(path)
    history_of(path)
