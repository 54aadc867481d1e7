"""Files of somebody's own sheet, as they should be, to be damaged: what ``eitskin evaluate`` reads, and a skin."""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from . import samples

SKIN: Final = (samples.ROOT / "firmware_proto" / "eitskin_proto" / "skins" / "hydrogel.toml").read_bytes()


def measured() -> dict[str, Any]:
    """Return the arrays of a measured file; its numbers are made up, its shapes are not."""
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.cloud import flat_cloud
    from eitskin_proto.skin.skin import PAPER

    rows = np.linspace(0.1, 1.0, 104)
    truth = np.zeros((3, 30, 45))
    truth[0, 10:15, 20:25] = 1.0
    return {
        "reference_V": rows, "reference_cloud_mm": flat_cloud(), "voltages_V": np.stack([0.9 * rows, rows, 1.1 * rows]),
        "cloud_mm": flat_cloud()[None], "cloud_index": np.array([0, -1, 0]), "truth": truth,
        "kind": np.array(["single", "untouched", "again"]), "touch_kind": np.array("raising"),
        "protocol_id": np.array(PROTOCOL_ID), "grid_id": np.array(PAPER.grid_id), "skin_digest": np.array(PAPER.digest),
    }  # fmt: skip


def mismatches() -> list[dict[str, Any]]:
    """Return a list of mismatches with every key."""
    from eitskin_sim.evaluation.devices.mismatch import BOUNDS

    every: dict[str, Any] = {name: 0.7 * low + 0.3 * high for name, (low, high) in BOUNDS.items()}
    every |= {"scan": True, "length_mm": 148.0}  # of the paper's sheet
    return [{"name": "every key", **every}, {"name": "none"}, {"name": "no scan", "scan": False}]


def tank() -> dict[str, Any]:
    """Return two frames of a tank, with and without an object in their names."""
    rng = np.random.default_rng(0)
    water = 1e-3 * (1.0 + 0.1 * rng.standard_normal((208, 2)))
    return {
        "electrode01_metal_electrode05_plastic_100ua": np.hstack([water, 1.01 * water]),
        "nothing": np.hstack([water, water]),
    }


def read_measured(path: Path) -> None:
    """Judge a measured file's samples and print what was found."""
    from eitskin_tools.evaluation.measured import evaluate_measured, table
    from eitskin_tools.evaluation.measured_file import load_measured
    from eitskin_tools.evaluation.solvers import Request

    found = evaluate_measured(load_measured(path), Request("vd2t"))
    _printed(found, table(found))


def read_mismatches(path: Path) -> None:
    """Load mismatches, and draw a device of each and what a robot scans of it; solved they are by other kinds."""
    from eitskin_sim.evaluation.devices.device import draw_device
    from eitskin_sim.evaluation.devices.mismatch import deviations, load_rows
    from eitskin_sim.scene.electrodes import place
    from eitskin_sim.scene.parts import Bend

    for name, mismatch in load_rows(path):
        if mismatch is None:
            raise AssertionError("a file cannot ask for drawn mismatches")
        device = draw_device(mismatch, 0, 0)
        place(device.sheet, device.electrodes)
        cloud = device.cloud(Bend(angle_deg=60.0), np.random.default_rng(0))
        if cloud is not None and not np.isfinite(cloud).all():
            raise AssertionError("a scan that is not finite would be handed on")
        _printed(deviations(mismatch), name)


def read_tank(path: Path) -> None:
    """Find the objects in a tank's frames and print what was found."""
    from eitskin_tools.evaluation.tank import evaluate_tank, table

    found = evaluate_tank(path)
    _printed(found, table(found))


def read_skin(path: Path) -> None:
    """Load a skin, look whether it can be, and write it again."""
    from eitskin_proto.skin.toml import load, parse, to_toml
    from eitskin_sim.devices.possible import check_skin

    skin = load(path)
    text = to_toml(skin)
    _printed({"digest": skin.digest}, text)
    if parse(text) != skin:
        raise AssertionError("a skin that is written is not the one that was read")
    check_skin(skin)


def _printed(found: Any, text: str) -> None:
    """Look at what a command would print: JSON without what JSON does not know, and lines no terminal obeys."""
    json.dumps(found, allow_nan=False)
    for line in text.splitlines():
        if not line.isprintable():
            raise AssertionError(f"a line that a terminal could obey: {line!r}")
