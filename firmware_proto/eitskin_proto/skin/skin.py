"""A skin: one frozen description that everything follows, and its digest.

Geometry, the map and the ids of everything made for a skin come from here. Functions take the skin itself, never
constants, because one process may use two skins.
"""

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.digest import id_of_values
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.parts import (
    Deformations,
    Doubts,
    Instrument,
    Layer,
    Map,
    Outline,
    Ring,
    Touches,
)
from eitskin_proto.skin.touch_kind import TouchKind


@dataclass(frozen=True)
class Skin:
    """A sheet with electrodes and its front end, their uncertainty, and their use.

    Args:
        name: For people; not part of the digest.
        outline: The border.
        layer: The conductive layer.
        electrodes: The ring of sixteen.
        front_end: The instrument.
        map: Where results are drawn.
        deformations: How it is bent.
        touches: Its touches.
        may_be_off: Other uncertainties.
        calibrated_from: Digest of the description that calibration started from, or "".
        stated_grid_id: ``grid_id`` of that description, which stays this one's though electrodes were found elsewhere.

    Raises:
        ValueError: Parts contradict each other; the text names them.
    """

    name: str = "paper"
    outline: Outline = field(default_factory=Outline)
    layer: Layer = field(default_factory=Layer)
    electrodes: Ring = field(default_factory=Ring)
    front_end: Instrument = field(default_factory=Instrument)
    map: Map = field(default_factory=Map)
    deformations: Deformations = field(default_factory=Deformations)
    touches: Touches = field(default_factory=Touches)
    may_be_off: Doubts = field(default_factory=Doubts)
    calibrated_from: str = ""
    stated_grid_id: str = ""

    def __post_init__(self) -> None:
        length, width = self.outline.size_mm
        if self.outline.kind == "disc" and length != width:
            raise ValueError(
                f"[outline] size_mm is {length:g} x {width:g}; expected twice the same number, the disc's diameter"
            )
        self._check_electrodes()

    def _check_electrodes(self) -> None:
        perimeter = self.outline.perimeter_mm
        arc, size = self.arc_length_mm, self.electrodes.size_mm.nominal(N_ELECTRODES)
        if arc.max() >= perimeter:
            k = int(arc.argmax())
            raise ValueError(
                f"[electrodes] arc_length_mm[{k}] is {arc[k]:g}, expected below {perimeter:g}, once round the border"
            )
        gaps = np.roll(arc, -1) - arc
        if np.count_nonzero(gaps <= 0.0) != 1:
            k = int(np.flatnonzero(gaps[:-1] <= 0.0)[0])
            raise ValueError(
                f"[electrodes] arc_length_mm[{k + 1}] is {arc[k + 1]:g} after {arc[k]:g}; electrodes go "
                "counter-clockwise, once round"
            )
        room = gaps % perimeter - (size + np.roll(size, -1)) / 2
        if room.min() < -1e-9:
            k = int(room.argmin())
            raise ValueError(
                f"[electrodes] {k} and {(k + 1) % N_ELECTRODES} overlap by {-room[k]:g} mm: they are "
                f"{gaps[k] % perimeter:g} mm apart and {size[k]:g} and {size[(k + 1) % N_ELECTRODES]:g} mm long"
            )

    @property
    def arc_length_mm(self) -> npt.NDArray[np.float64]:
        """(16,) stated centres of the electrodes."""
        return self.electrodes.arc_length_mm.nominal(N_ELECTRODES)

    @cached_property
    def grid(self) -> Grid:
        """The map and the units."""
        return Grid(self.outline.size_mm, self.map.shape, self.map.units)

    @cached_property
    def grid_id(self) -> str:
        """16 hex digits that stand for the map, the units and the electrodes on the flat sheet, as they were stated."""
        if self.stated_grid_id:
            return self.stated_grid_id
        content = {
            "sheet_mm": self.outline.size_mm,
            "shape": self.map.shape,
            "order": "row-major from (0, 0), x along columns",
            "units": self.map.units,
            "electrode_arc_mm": self.arc_length_mm.tolist(),
        }
        return id_of_values(content if self.outline.kind == "rectangle" else content | {"outline": self.outline.kind})

    @cached_property
    def digest(self) -> str:
        """16 hex digits that stand for the whole description, but not for its name."""
        content = asdict(self)
        del content["name"]
        del content["touches"]["kind"]  # digests stay what they were when two truth values said it
        content["touches"] |= {"lower": self.touches.lower, "higher": self.touches.higher}
        if not self.stated_grid_id:  # files from before it was written have the same digest
            del content["stated_grid_id"]
        return id_of_values(content)

    @property
    def touch_kind(self) -> TouchKind:
        """Which way touches change this skin's conductance."""
        return self.touches.kind

    def touched(self, kind: TouchKind) -> "Skin":
        """Return this skin, touched so that conductance changes one way, or both."""
        return replace(self, touches=replace(self.touches, kind=kind))

    def __hash__(self) -> int:
        return hash(self.digest)


PAPER = Skin()
"""The paper's sheet, the default skin."""
