"""Makes a reference of frames: mean, spread, shared noise, and how far the sheet moved."""

import time
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference
from eitskin.reference.captured import SMALLEST_V, Reference
from eitskin.reference.front_end import repeated, stuck
from eitskin.reference.judged import ReferenceChecks, accept, judge
from eitskin.reference.movement import movement_of
from eitskin.reference.scanned import ReferenceScan
from eitskin.reference.steadiness import steady_frames
from eitskin_proto.sensor.noise_law import noise_of
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.volts import step_of, table_of_hello

MOST_FRAMES: Final = 10_000
"""Frames of a reference, 17 MB with 208 rows."""

MOST_UNFIT: Final = 200
"""Frames that are not fit, with few wanted: one second at 200 frames/s."""


class ReferenceBuilder:
    """Makes a reference from frame after frame.

    Args:
        frames: Number of frames, 2 to ``MOST_FRAMES``.
        skin: The skin of the reference.
        scan: Scan of the sheet in its present shape; None for a flat one.
        table: Rows of the frames.
    """

    __slots__ = ("_scan", "_skin", "_table", "_unfit", "_voltages", "frames", "taken")

    def __init__(
        self, frames: int, skin: Skin = PAPER, scan: ReferenceScan | None = None, table: RowTable = ADJACENT_104
    ) -> None:
        if not 2 <= frames <= MOST_FRAMES:
            raise ValueError(f"found a reference of {frames} frames, expected 2 to {MOST_FRAMES}")
        self.frames, self._skin, self._scan, self._table = frames, skin, scan, table
        self.taken = self._unfit = 0
        self._voltages = np.zeros((frames, table.rows))

    def add(self, voltages: npt.NDArray[np.float64]) -> bool:
        """Take one frame and return whether there are enough.

        Args:
            voltages: (rows,) V.
        """
        self._voltages[self.taken] = voltages
        self.taken += 1
        return self.taken >= self.frames

    def leave_out(self, why: str) -> None:
        """Count a frame that is not taken.

        Args:
            why: What is wrong with it.

        Raises:
            BadReference: These are as many as frames were wanted, and at least ``MOST_UNFIT``.
        """
        self._unfit += 1
        if self._unfit >= max(self.frames, MOST_UNFIT):
            raise BadReference(
                f"{self._unfit} frames could not be used for the reference, the last one because {why}: check the "
                "front end, its supply, wires, current and gain; behind a driver, state the converter's step"
            )

    def finish(self, hello: Hello, checks: ReferenceChecks | None = None, *, force: bool = False) -> Reference:
        """Return the reference of the frames.

        Args:
            hello: Of the device.
            checks: Checks of the reference (:func:`eitskin.reference.judged.reference_checks`); None for no checks.
            force: Accept it even if the sheet was bent, touched or moving, or all frames were the same.

        Raises:
            BadReference: All voltages are zero, or rows are alike as no sheet's are; or the sheet was bent, touched or
                moving, or the front end hung, with what was found.
        """
        voltages = self._voltages[: self.taken]
        mean_V = voltages.mean(axis=0)
        largest = float(np.abs(mean_V).max())
        if not largest >= SMALLEST_V:
            raise BadReference(
                f"the reference is at most {largest:.3g} V in every row, expected at least {SMALLEST_V:g} V in one: "
                "check that the electrodes are connected"
            )
        spread_V, shared_V = noise_of(voltages - voltages[0])  # exactly 0 if all frames are the same
        found = Reference(
            voltages_V=mean_V,
            spread_V=spread_V,
            frames=self.taken,
            serial_number=hello.serial_number,
            configuration_digest=hello.configuration_digest,
            configuration_name=hello.configuration_name,
            captured_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            grid_id=self._skin.grid_id,
            skin_digest=self._skin.digest,
            scan=self._scan,
            table=self._table,
            shared_V=shared_V if shared_V.size else None,
            steady_frames=steady_frames(voltages, spread_V),
        )
        against = checks or ReferenceChecks()
        step_V = step_of(hello)
        if wrong := stuck(found.voltages_V / step_V, own_rows=self._table.id == ADJACENT_104.id):
            raise BadReference(
                f"the reference does not come from a sheet: {wrong}; the front end's converter or multiplexer is "
                "stuck: power the device off and on, check its supply and its wires"
            )
        moved = movement_of(voltages, against.missing)
        judgement = judge(found, moved, against, repeated(voltages, step_V))
        accept(judgement, force=force)
        return replace(found, judgement=judgement)


def reference_of_scans(voltages: npt.NDArray[np.floating], hello: Hello, skin: Skin = PAPER) -> Reference:
    """Return the reference of scans that were made already, without a check.

    Args:
        voltages: (n, rows) V of the untouched sheet; complex ones as amounts.
        hello: Of the device.
        skin: The skin of the reference.

    Raises:
        BadReference: They are no reference.
        ValueError: They have another number of rows, or values that are not finite.
    """
    table = table_of_hello(hello)
    found = np.abs(voltages) if np.iscomplexobj(voltages) else np.asarray(voltages, dtype=np.float64)
    if found.ndim != 2 or not len(found) or found.shape[1] != table.rows or not np.isfinite(found).all():
        raise ValueError(f"reference has shape {found.shape}, expected (n, {table.rows}) finite volts")
    mean = found.mean(axis=0)
    if not float(np.abs(mean).max()) >= SMALLEST_V:
        raise BadReference(f"the reference is under {SMALLEST_V:g} V in every row: check that electrodes are connected")
    spread = found.std(axis=0, ddof=1) if len(found) > 1 else np.zeros(table.rows)
    return Reference(
        mean, spread, len(found), hello.serial_number, hello.configuration_digest, hello.configuration_name,
        time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), grid_id=skin.grid_id, skin_digest=skin.digest, table=table,
    )  # fmt: skip
