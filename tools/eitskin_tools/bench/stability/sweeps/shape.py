"""The sheet's form and where it is touched: bends to 350 degrees, stretch, touches over electrodes, the whole sheet.

A bend without stretch changes no voltage, so whatever it does to a map came in by the cloud. Touches that cover
electrodes are compared with the same touches inside the sheet, of the same size.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.family import bounds
from eitskin_sim.scene.parts import Bend, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.unit_grid.patterns import MOST_UNITS
from eitskin_tools.bench.stability.harness.limits import nuisance
from eitskin_tools.bench.stability.harness.samples import Sample, sheet_of, voltages_of
from eitskin_tools.bench.stability.harness.sweep import Stress

ANGLES: Final = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 310.0, 350.0)
LONGER: Final = (1.0, 1.05, 1.1, 1.15, 1.2, 1.25, 1.3, 1.4, 1.5)
SHORTER: Final = (1.0, 0.97, 0.94, 0.9, 0.85, 0.8)
COVERED: Final = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
UNITS: Final = (4.0, 9.0, 16.0, 25.0, 36.0, 81.0, 108.0, 117.0)

COLUMNS_AT: Final = (1, 4, 7, 10, 12)
"""The columns of units over the five electrodes of the sheet's first side."""


_stress = partial(Stress, solved=True)


def stresses() -> list[Stress]:
    """Return bends, stretches and touches of every size and place."""
    return [
        _stress("bend without stretch", "degrees", ANGLES, _bent, _explain_bend, origin=0.0),
        _stress("bend without stretch, cloud left flat", "degrees", ANGLES, _bent_unseen, _explain_bend, origin=0.0),
        _stress("stretch along x, longer", "times", LONGER, _stretched, _explain_stretch, origin=1.0),
        _stress("stretch along x, shorter", "times", SHORTER, _stretched, _explain_stretch, origin=1.0),
        _stress("bar over electrodes", "electrodes", COVERED, _on_the_border, _explain_cover, origin=0.0),
        _stress("the same bar in the middle", "electrodes", COVERED, _in_the_middle, _explain_cover, origin=0.0),
        _stress("touched area", "units of 126", UNITS, _grown, _explain_area, True, origin=4.0),
    ]


def _bent(sample: Sample, angle_deg: float, rng: np.random.Generator) -> Sample:
    return sample.solved(replace(sample.scene, bend=Bend(angle_deg=angle_deg)))


def _bent_unseen(sample: Sample, angle_deg: float, rng: np.random.Generator) -> Sample:
    bent = _bent(sample, angle_deg, rng)
    return replace(bent, sheet=sheet_of(replace(bent.scene, bend=Bend())))


def _explain_bend(samples: Sequence[Sample], angle_deg: float) -> str:
    apart = max(
        float(np.abs(voltages_of(replace(s.scene, bend=Bend(angle_deg=angle_deg)))
                     / voltages_of(replace(s.scene, bend=Bend())) - 1.0).max())
        for s in samples
    )  # fmt: skip
    largest = bounds()["angle_deg"][1]
    return (
        f"a bend to {angle_deg:.3g} degrees changes the voltages by {apart:.1g}, so what it does to a map comes in by "
        f"the cloud, and training ends at {largest:g} degrees"
    )


def _stretched(sample: Sample, stretch: float, rng: np.random.Generator) -> Sample:
    return sample.solved(replace(sample.scene, bend=Bend(stretch_along=stretch)))


def _explain_stretch(samples: Sequence[Sample], stretch: float) -> str:
    flat = [sample.solved(replace(sample.scene, bend=Bend())) for sample in samples]
    change, share = nuisance(flat, [_stretched(s.bare(), stretch, np.random.default_rng(0)) for s in samples])
    low, high = bounds()["stretch_along"]
    return (
        f"stretching by {stretch:.3g} changes dV by {change:.3g} rms, {share:.3g} times what the touches change; "
        f"training ends at {low:g} and {high:g}"
    )


def _units(sample: Sample, boxes: Sequence[tuple[int, int]]) -> Sample:
    touches = tuple(Touch((Rect(*PAPER.grid.unit_rect_mm(column, row)),)) for column, row in boxes)
    scene = replace(sample.scene, touches=touches)
    return replace(sample, scene=scene, voltages=voltages_of(scene))


def _bar(electrodes: float, row: int) -> list[tuple[int, int]]:
    first, last = COLUMNS_AT[0], COLUMNS_AT[max(int(electrodes), 1) - 1]
    return [(column, row) for column in range(first, last + 1)]


def _on_the_border(sample: Sample, electrodes: float, rng: np.random.Generator) -> Sample:
    if not sample.scene.touches:
        return sample
    return _units(sample, _bar(electrodes, 0 if electrodes else 1))


def _in_the_middle(sample: Sample, electrodes: float, rng: np.random.Generator) -> Sample:
    return _units(sample, _bar(electrodes, PAPER.grid.units[0] // 2)) if sample.scene.touches else sample


def _explain_cover(samples: Sequence[Sample], electrodes: float) -> str:
    rng = np.random.default_rng(0)
    inside, border = _in_the_middle(samples[0], electrodes, rng), _on_the_border(samples[0], electrodes, rng)
    kept = [float(np.median(np.abs(s.voltages / s.sheet.untouched))) for s in (inside, border)]
    rows = [int(np.count_nonzero(np.abs(s.voltages / s.sheet.untouched) < 0.1)) for s in (inside, border)]
    return (
        f"a bar over {max(int(electrodes), 1)} electrodes on the border takes {rows[1]} of 104 rows under a tenth of "
        f"V_post (in the middle: {rows[0]}); the median row keeps {kept[1]:.2g} (in the middle: {kept[0]:.2g})"
    )


def _grown(sample: Sample, units: float, rng: np.random.Generator) -> Sample:
    """Touch a block of units round the middle; above 81 whole columns are added, all but one of the sheet's."""
    return _units(sample, block(int(units))) if sample.scene.touches else sample


def block(units: int) -> list[tuple[int, int]]:
    """Return so many units (column, row) in a block round the sheet's middle.

    Raises:
        ValueError: The number is no square up to 81 and no multiple of 9 above.
    """
    rows, columns = PAPER.grid.units
    side = round(units**0.5)
    high, wide = (side, side) if side**2 == units and side <= rows else (rows, units // rows)
    if high * wide != units or not 1 <= units <= PAPER.grid.n_units:
        raise ValueError(
            f"{units} units make no block; expected a square up to 81, or a multiple of 9 up to {PAPER.grid.n_units}"
        )
    top, left = (rows - high) // 2, (columns - wide) // 2
    return [(column, row) for row in range(top, top + high) for column in range(left, left + wide)]


def whole(sample: Sample) -> Sample:
    """Return the sample touched everywhere."""
    return _units(sample, block(PAPER.grid.n_units))


def _explain_area(samples: Sequence[Sample], units: float) -> str:
    nearest = int(min(UNITS, key=lambda count: abs(count - units)))
    return (
        f"a touch shields what lies inside it: of {nearest} touched units, leaving out the middle one changes V by "
        f"{_hole(samples[0], nearest):.2g} of what it changes when it is touched alone; and {nearest} units are more "
        f"than the {MOST_UNITS} that training's touch sets have"
    )


def _hole(sample: Sample, units: int) -> float:
    """Return the change of V by a hole in the middle of a block, over the change by a touch there alone."""
    middle = (PAPER.grid.units[1] // 2, PAPER.grid.units[0] // 2)
    whole = block(units)
    assert middle in whole
    full, holed = _units(sample, whole), _units(sample, [unit for unit in whole if unit != middle])
    alone = _units(sample, [middle])
    change = np.linalg.norm((full.voltages - holed.voltages) / sample.sheet.untouched)
    return float(change / np.linalg.norm((alone.voltages - sample.sheet.untouched) / sample.sheet.untouched))
