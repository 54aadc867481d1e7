"""The sizes of a true device's deviations from the nominal one; read from JSON, or drawn.

A mismatch gives the sizes of deviations; their places and signs are drawn for every device
(:mod:`eitskin_sim.evaluation.device`). The lab mix represents a carefully built sheet.
"""

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.fields import Fields
from eitskin_proto.files.plain import plain
from eitskin_proto.files.reading import FileError, read_json
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.parts import SceneError, Sheet, Touch
from eitskin_sim.scene.scene import fields_of
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.scene.soft_touch import check_touch

LARGEST_FILE: Final = 1 << 20
MAX_ROWS: Final = 200


@dataclass(frozen=True, slots=True)
class Mismatch:
    """How far a device is from the nominal one; as it stands, not at all."""

    electrodes_mm: float = 0.0
    """Standard deviation of every electrode's place along the border."""
    electrode_size_mm: float | None = None
    """Of all; None leaves what is nominal, as with the lengths and the gauge factor below."""
    impedance_factor: float = 1.0
    """Contact impedance over the nominal one."""
    impedance_spread: float = 0.0
    """Standard deviation of its logarithm from contact to contact."""
    thickness_mm: float | None = None
    length_mm: float | None = None
    """Of the sheet, its electrodes and touches stretched along."""
    field_rms: float = 0.0
    """Unevenness of the layer's log conductivity, there when the reference was taken."""
    field_mm: float = 40.0
    """Its correlation length."""
    gauge_factor: float | None = None
    drift_percent: float = 0.0
    """Of the whole sheet's conductivity since the reference."""
    gradient_rms: float = 0.0
    """Of an uneven drift."""
    contrast: float | None = None
    """Of touches that raise conductance, in place of their own."""
    border_mm: float = 0.0
    """Of the same touches."""
    dent_mm: float = 0.0
    """Of the same touches."""
    unseen_stretch: float = 0.0
    """Unevenness of the stretch along the sheet that no scan shows."""
    scan_noise_mm: float = 0.1
    scan_stale_deg: float = 0.0
    """Lag of the scan behind the deformation, in degrees of 180."""
    scan_scale: float = 1.0
    scan: bool = True
    """False: no scan at all."""
    reference_stretch: float = 0.0
    """The sheet was stretched along by this part when the reference was taken."""
    reference_scan: bool = False
    """Whether it was scanned then, so that the reference counts as a flat one's."""
    reference_snr_db: float | None = None
    """The reference's own noise, N2; None for none."""
    gain_percent: float = 0.0
    """Standard deviation of each measured pair's gain."""
    offset_V: float = 0.0
    """Standard deviation of each measured pair's offset, under 1 A through a layer of 1 S/m."""
    stray_pF: float = 0.0
    """Capacitance of each terminal to ground."""
    stray_spread: float = 0.0
    """Standard deviation of its logarithm from terminal to terminal."""
    minus_percent: float = 0.0
    """How much less the amplifier's minus path passes than its plus path."""
    sink_percent: float = 0.0
    """How much less the sink takes than the source gives."""

    def require(self, skin: Skin) -> None:
        """Check that a device of a skin can be so far off.

        Raises:
            SceneError: Its length is another sheet's.
        """
        nominal = skin.outline.size_mm[0]
        if self.length_mm is not None and abs(self.length_mm / nominal - 1.0) > MAX_LENGTH_ERROR:
            low, high = (nominal * (1.0 + sign * MAX_LENGTH_ERROR) for sign in (-1.0, 1.0))
            raise SceneError(
                f"length_mm is {self.length_mm:g}, expected {low:.0f} to {high:.0f}: skin {skin.name!r} is "
                f"{nominal:g} mm long"
            )

    @property
    def alters_touches(self) -> bool:
        """Whether touches have another border or a dent, which those on the unit grid cannot have."""
        return bool(self.border_mm or self.dent_mm)


MAX_LENGTH_ERROR: Final = 1.0 / 15.0
"""A sheet is longer or shorter than the nominal one by at most this part of it."""

IDEAL: Final = Mismatch()

BOUNDS: Final[dict[str, tuple[float, float]]] = {
    "electrodes_mm": (0.0, 3.0), "electrode_size_mm": (1.0, 8.0), "impedance_factor": (1e-3, 1e4),
    "impedance_spread": (0.0, 2.0), "thickness_mm": (0.2, 20.0), "length_mm": (45.0, 430.0), "field_rms": (0.0, 0.5),
    "field_mm": (5.0, 500.0), "gauge_factor": (-3.0, 3.0), "drift_percent": (-60.0, 200.0), "gradient_rms": (0.0, 0.3),
    "contrast": (0.01, 1e4), "border_mm": (0.0, 8.0), "dent_mm": (0.0, 5.0), "unseen_stretch": (-0.3, 0.3),
    "scan_noise_mm": (0.0, 5.0), "scan_stale_deg": (0.0, 90.0), "scan_scale": (0.9, 1.1),
    "reference_stretch": (-0.1, 0.2), "reference_snr_db": (10.0, 120.0), "gain_percent": (0.0, 20.0),
    "offset_V": (0.0, 1.0), "stray_pF": (0.0, 10_000.0), "stray_spread": (0.0, 2.0), "minus_percent": (-20.0, 20.0),
    "sink_percent": (-20.0, 20.0),
}  # fmt: skip
"""Least and most of each number."""

SHAPES: Final = {"field_mm": "field_rms", "stray_spread": "stray_pF"}
"""Fields that only state the distribution of another number."""

LAB: Final = Mismatch(
    electrodes_mm=0.5, impedance_factor=10.0, impedance_spread=0.5, field_rms=0.05, gauge_factor=1.0, contrast=10.0,
    border_mm=2.0, scan_noise_mm=0.3,
)  # fmt: skip
"""The lab mix: a sheet that was built with care, and a finger's border."""

Row = tuple[str, Mismatch | None]
"""A name, and a mismatch; None is drawn anew for every device."""


def lab_rows() -> list[Row]:
    """Return the lab mix, and what is left of it without its touches and without its gauge factor."""
    hard = replace(LAB, contrast=None, border_mm=0.0)
    return [
        ("none", IDEAL),
        ("lab mix", LAB),
        ("lab mix, hard touches", hard),
        ("lab mix, hard touches, gauge 0", replace(hard, gauge_factor=0.0)),
        ("lab mix, hard touches, drift 1 %", replace(hard, drift_percent=1.0)),
    ]


def random_rows() -> list[Row]:
    """Return the ideal device, and devices drawn from everything at once."""
    return [("none", IDEAL), ("random", None)]


def random_mismatch(rng: np.random.Generator, skin: Skin = PAPER) -> Mismatch:
    """Return a mismatch of everything about the device and the scan at once; touches stay as they are.

    Args:
        rng: Source of the draws.
        skin: The nominal skin of the device.
    """
    electrode_mm = float(np.mean(skin.electrodes.size_mm.nominal(N_ELECTRODES)))
    thickness_mm, gauge = (float(one.nominal(1)[0]) for one in (skin.layer.thickness_mm, skin.layer.gauge_factor))
    return Mismatch(
        electrodes_mm=float(rng.uniform(0.0, 1.0)),
        electrode_size_mm=electrode_mm * float(rng.uniform(0.75, 1.25)),
        impedance_factor=float(10 ** rng.uniform(-1.0, 2.0)),
        impedance_spread=float(rng.uniform(0.0, 0.5)),
        thickness_mm=thickness_mm * float(rng.uniform(0.75, 1.25)),
        length_mm=skin.outline.size_mm[0] * float(rng.uniform(149.0, 151.5)) / 150.0,
        field_rms=float(rng.uniform(0.0, 0.1)),
        field_mm=float(rng.uniform(20.0, 60.0)),
        gauge_factor=gauge + float(rng.uniform(-1.0, 1.5)),
        drift_percent=float(rng.normal(0.0, 3.0)),
        gradient_rms=float(rng.uniform(0.0, 0.02)),
        unseen_stretch=float(rng.uniform(-0.1, 0.1)),
        scan_noise_mm=float(rng.uniform(0.1, 0.5)),
        scan_stale_deg=float(rng.uniform(0.0, 5.0)),
        scan_scale=float(rng.uniform(0.995, 1.005)),
        reference_stretch=float(rng.uniform(0.0, 0.01)),
        reference_snr_db=float(rng.uniform(55.0, 70.0)),
        gain_percent=float(rng.uniform(0.0, 2.0)),
        offset_V=float(rng.uniform(0.0, 0.01)),
        stray_pF=float(10 ** rng.uniform(1.0, 2.0)),
        stray_spread=float(rng.uniform(0.0, 0.7)),
        minus_percent=float(rng.normal(0.0, 0.3)),
        sink_percent=float(rng.normal(0.0, 0.4)),
    )


def load_rows(path: str | Path) -> list[Row]:
    """Return the rows of a JSON list: objects with a ``name`` and any of a mismatch's fields.

    Raises:
        SceneError: It is none, a key is unknown, a number outside its bounds, or touches as it has them change nothing.
        OSError: It cannot be read.
    """
    try:
        value = read_json(path, LARGEST_FILE)
    except FileError as error:
        raise SceneError(str(error)) from error
    try:
        listed = fields_of({"devices": value}).entries("devices", least=1, most=MAX_ROWS, of="mismatches")
        return [_row(listed.table(place)) for place in listed]
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def _row(given: Fields) -> Row:
    where = given.where
    name = given.value("name", where)
    if not isinstance(name, str) or not name:
        raise given.wrong("name", "a text")
    values: dict[str, Any] = {}
    for one in fields(Mismatch):
        if given.value(one.name, None) is None:
            continue
        if one.name in ("scan", "reference_scan"):
            values[one.name] = given.truth(one.name)
        else:
            low, high = BOUNDS[one.name]
            values[one.name] = given.number(one.name, low=low, high=high)
    given.close()
    for name_of_shape, size in SHAPES.items():
        if name_of_shape in values and size not in values:
            raise SceneError(f"{where}.{name_of_shape} does nothing without {size}: give that too, or leave it out")
    found = Mismatch(**values)
    touch = Touch((Disc(20.0, 20.0, 20.0),), 50.0, found.contrast, found.border_mm, found.dent_mm)
    check_touch(touch, Sheet(), where)
    return plain(name), found


def deviations(mismatch: Mismatch) -> dict[str, Any]:
    """Return the deviations of a mismatch from the ideal, as a row of JSON."""
    ideal = asdict(IDEAL)
    return {name: value for name, value in asdict(mismatch).items() if value != ideal[name]}
