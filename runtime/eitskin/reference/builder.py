"""Averages frames into a reference: mean, spread, and how far the sheet moved, without keeping the frames."""

import time
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference
from eitskin.reference.captured import SMALLEST_V, Reference
from eitskin.reference.front_end import Sameness, stuck
from eitskin.reference.judged import ReferenceChecks, accept, judge
from eitskin.reference.movement import Movement
from eitskin.reference.scanned import ReferenceScan
from eitskin.reference.steadiness import Steadiness
from eitskin_proto.sensor.noise_law import shared_noise
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.volts import step_of, table_of_hello

MOST_UNFIT: Final = 200
"""Frames that are not fit, with few wanted: one second at 200 frames/s."""


class ReferenceBuilder:
    """Makes a reference from frame after frame, by Welford's running mean and covariance.

    Args:
        frames: Number of frames, at least 2.
        skin: The skin of the reference.
        scan: Scan of the sheet in its present shape; None for a flat one.
        table: Rows of the frames.
    """

    __slots__ = (
        "_delta", "_mean", "_movement", "_outer", "_product", "_products", "_sameness", "_scan", "_skin", "_squares",
        "_steadiness", "_table", "_unfit", "frames", "taken",
    )  # fmt: skip

    def __init__(
        self, frames: int, skin: Skin = PAPER, scan: ReferenceScan | None = None, table: RowTable = ADJACENT_104
    ) -> None:
        if frames < 2:
            raise ValueError(f"a reference of {frames} frames has no spread; expected at least 2 frames")
        self.frames, self._skin, self._scan, self._table = frames, skin, scan, table
        self.taken = 0
        self._mean = np.zeros(table.rows)
        self._squares = np.zeros(table.rows)
        self._delta = np.zeros(table.rows)
        self._product = np.zeros(table.rows)
        self._outer, self._products = np.zeros((2, table.rows, table.rows))
        self._unfit = 0
        self._movement = Movement(frames, table.rows)
        self._sameness = Sameness(table.rows)
        self._steadiness = Steadiness(table.rows)

    def add(self, voltages: npt.NDArray[np.float64]) -> bool:
        """Take one frame and return whether there are enough.

        Args:
            voltages: (rows,) V.
        """
        self.taken += 1
        self._movement.add(voltages)
        self._sameness.add(voltages)
        self._steadiness.add(voltages)
        np.subtract(voltages, self._mean, out=self._delta)
        np.divide(self._delta, self.taken, out=self._product)
        np.add(self._mean, self._product, out=self._mean)
        np.subtract(voltages, self._mean, out=self._product)
        np.multiply.outer(self._product, self._delta, out=self._outer)
        np.add(self._products, self._outer, out=self._products)
        np.multiply(self._product, self._delta, out=self._product)
        np.add(self._squares, self._product, out=self._squares)
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
        largest = float(np.abs(self._mean).max())
        if not largest >= SMALLEST_V:
            raise BadReference(
                f"the reference is at most {largest:.3g} V in every row, expected at least {SMALLEST_V:g} V in one: "
                "check that the electrodes are connected"
            )
        shared_V = shared_noise(self._products / (self.taken - 1), self.taken)
        spread_V = np.sqrt(self._squares / (self.taken - 1))
        found = Reference(
            voltages_V=self._mean.copy(),
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
            steady_frames=self._steadiness.frames(spread_V),
        )
        against = checks or ReferenceChecks()
        looked_at = found.voltages_V if against.missing is None else np.where(against.missing, 0.0, found.voltages_V)
        step_V = step_of(hello)
        if wrong := stuck(found.voltages_V / step_V, own_rows=self._table.id == ADJACENT_104.id):
            raise BadReference(
                f"the reference does not come from a sheet: {wrong}; the front end's converter or multiplexer is "
                "stuck: power the device off and on, check its supply and its wires"
            )
        faults = self._sameness.faults(found.voltages_V, step_V)
        judgement = judge(found, self._movement.relative(looked_at), against, faults)
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
