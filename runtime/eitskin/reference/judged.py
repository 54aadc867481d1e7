"""Judges whether the sheet was flat, untouched and still while its reference was captured.

Every dV divides by the reference, so a reference of a bent, touched or moving sheet makes all maps wrong until the
next. Four quantities are checked. Each has a bound beyond which the reference is refused (``force`` accepts it anyway),
and most have a lower one beyond which a remark is made::

    median spread of a frame      refused above 5 %, remarked above 2 %: noise, or a sheet that trembles
    movement                      refused above 0.5 %: how far the means of tenths of the capture wander beyond what
                                  noise does (:mod:`eitskin.reference.movement`)
    the model's flat sheet        refused above 20 %, remarked above 13 %: rms of log(V / V_model) over the rows, a
                                  common factor and the noise taken out; the model is the bundle's
    the reference before this     refused above 10 %, remarked above 3 %, the same way; or if the bundle's gate says
                                  that the sheet is touched

The bounds come from simulated sheets. An honest sheet whose electrodes are placed to 0.5 mm (1 mm) and sized to 0.5 mm
(1 mm), with contacts from a tenth to ten times the model's, is 2 to 7 % (4 to 12 %) off the model. Half of the bends of
family A, and two of three with a touch, are more than 20 % off; a touch alone on the flat sheet seldom is, so the first
reference of a sheet that is bent a little, or touched and held still, is not caught. Against an earlier reference of
the same device all of 320 touched captures were, and none of 1040 honest captures was refused, with noise of 50 dB of
all three kinds. A bend that stretches nothing changes no voltage: it is as good as a flat sheet.

Along a border the potential falls from where the current enters to where it leaves, whatever the sheet conducts. So all
104 rows have the same sign. A reference is refused in which a row above ``SIGN_SHARE`` of the largest has the other.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference, MismatchError
from eitskin.model.gate import Gate
from eitskin.reference.captured import Reference
from eitskin.reference.judgement import Judgement
from eitskin.reference.row_noise import lost_rows, relative_spread
from eitskin_proto.sensor.row_table import ADJACENT_104, ADJACENT_208
from eitskin_proto.sensor.wiring import read_wiring

if TYPE_CHECKING:
    from eitskin.model.bundle import Bundle

Array = npt.NDArray[np.float64]

LARGEST_SPREAD: Final = 0.05
"""The median row may vary by 5 % of its voltage: at 50 dB it varies by 0.3 %, under a moving touch by far more."""

LARGEST_MOVEMENT: Final = 0.005
"""Noise of 50 dB of all three kinds gives 0.0 %, a sheet that bends or a touch that comes several per cent."""

NOTED_SPREAD: Final = 0.02
"""Median row; 0.3 % at 50 dB where every row has its own noise, 1.5 % where all rows have the same."""

MODEL_DIFFERENCE: Final = (0.13, 0.20)
OLDER_DIFFERENCE: Final = (0.03, 0.10)
"""Remarked above the first, refused above the second."""

SIGN_SHARE: Final = 0.01
"""Share of the largest voltage below which an offset of the converter may turn a row's sign."""

NOTHING_ALIKE: Final = 10.0
"""Difference of sheets that have no two rows with a voltage in common."""

REMEDY: Final = (
    "leave the sheet flat, untouched and at rest, then capture again; if it is so, look at electrodes and wiring with "
    "'eitskin doctor', or accept it: 'eitskin reference --force', 'eitskin run --force-reference', force=True in Python"
)

OTHER_SHEET_HINT: Final = "a sheet that the bundle was not made for needs a bundle of its own: --bundle FILE"
"""Another possible cause of a large difference from the bundle's sheet."""


@dataclass(frozen=True, slots=True)
class ReferenceChecks:
    """What a captured reference is compared with; each part may be missing."""

    flat_V: Array | None = None
    """(104,) V of the model's flat sheet, of any current."""
    older: Reference | None = None
    """Of the same device in the same configuration."""
    gate: Gate | None = None
    missing: npt.NDArray[np.bool_] | None = None
    """(104,) rows that say nothing, such as those of electrodes left out."""


def reference_checks(
    bundle: "Bundle", older: Reference | None = None, missing: npt.NDArray[np.bool_] | None = None
) -> ReferenceChecks:
    """Return a bundle's checks for a reference, with those of an older one.

    Args:
        bundle: Its flat sheet and its gate are used, where it has them.
        older: An earlier reference.
        missing: (104,) rows that say nothing, such as those of electrodes left out.

    Raises:
        BundleError: The bundle is damaged.
    """
    consistency = bundle.consistency_arrays() or {}
    flat = np.asarray(consistency["reference"], dtype=np.float64) if "reference" in consistency else None
    arrays = None if older is None else bundle.gate_arrays()
    return ReferenceChecks(flat, older, None if arrays is None else Gate(arrays), missing)


def judge(found: Reference, movement: float, checks: ReferenceChecks, refused: tuple[str, ...] = ()) -> Judgement:
    """Return the findings about a captured reference.

    Args:
        found: The reference; one with a scan is judged as the flat one computed from it.
        movement: Of its capture, relative.
        checks: What it is compared with.
        refused: Reasons for refusal found already.
    """
    as_read, found, refusals, remarks = found, _comparable(found, checks).flat(), list(refused), []
    usable = ~lost_rows(found.voltages_V, found.spread_V)
    if checks.missing is not None:
        usable &= ~checks.missing
    sigma = relative_spread(found.voltages_V, found.spread_V)
    spread = float(np.median(sigma[usable])) if usable.any() else 1.0
    if spread > LARGEST_SPREAD:
        refusals.append(
            f"the frames of the reference vary by {spread:.1%} (median row), expected at most {LARGEST_SPREAD:.0%}"
        )
    elif spread > NOTED_SPREAD:
        remarks.append(f"frames vary by {spread:.1%} (median row), 0.3% is usual at 50 dB: does the sheet tremble?")
    if movement > LARGEST_MOVEMENT:
        refusals.append(
            f"the voltages moved by {movement:.1%} while the reference was captured, expected at most "
            f"{LARGEST_MOVEMENT:.1%}"
        )
    large = usable & (np.abs(found.voltages_V) > SIGN_SHARE * np.abs(found.voltages_V).max())
    below = int(np.count_nonzero(found.voltages_V[large] < 0.0))
    turned = min(below, int(np.count_nonzero(large)) - below)
    if turned and found.table.id == ADJACENT_104.id:
        refusals.append(
            f"{turned} rows of the reference have the other sign than the rest, expected one sign in all: wires are "
            "exchanged, or the front end turns some measurements"
        )
    noise = sigma**2 / found.frames
    model, older = None, None
    if checks.flat_V is not None and len(checks.flat_V) == found.table.rows:
        model = _difference(found.voltages_V, checks.flat_V, usable, noise)
        flat = "the bundle's flat, untouched sheet"
        _compare(model, MODEL_DIFFERENCE, flat, refusals, remarks, f" ({OTHER_SHEET_HINT})")
        if model > MODEL_DIFFERENCE[1] and found.table.id == ADJACENT_104.id:
            rows = as_read if as_read.table.id == ADJACENT_208.id else found
            wiring = read_wiring(rows.voltages_V, checks.flat_V)
            refusals += [] if wiring.right else [wiring.text]
    touched = None
    if (before := _same_device(found, checks.older)) is not None:
        both = usable & ~lost_rows(before.voltages_V, before.spread_V)
        past = relative_spread(before.voltages_V, before.spread_V) ** 2 / before.frames
        older = _difference(found.voltages_V, before.voltages_V, both, noise + past)
        _compare(older, OLDER_DIFFERENCE, f"the reference of {before.captured_utc}", refusals, remarks)
        touched = _touched(checks.gate, found.voltages_V, before.voltages_V, both)
        if touched:
            refusals.append(
                f"the sheet is touched, by the bundle's gate against the reference of {before.captured_utc}"
            )
    return Judgement(spread, movement, model, older, touched, tuple(refusals), tuple(remarks))


def accept(judgement: Judgement, *, force: bool = False) -> None:
    """Refuse a reference that was judged to be of a bent, touched or moving sheet.

    Raises:
        BadReference: With every reason, unless ``force``.
    """
    if judgement.refusals and not force:
        raise BadReference(f"{', and '.join(judgement.refusals)}: {REMEDY}")


def _comparable(found: Reference, checks: ReferenceChecks) -> Reference:
    """Return a reference in the rows of the bundle's flat sheet, if it has them."""
    if checks.flat_V is None:
        return found
    try:
        return found.in_table(ADJACENT_104)
    except MismatchError:
        return found


def _same_device(found: Reference, older: Reference | None) -> Reference | None:
    if older is None or older.serial_number != found.serial_number:
        return None
    if older.configuration_digest != found.configuration_digest:
        return None
    try:
        return older.in_table(found.table).flat()
    except MismatchError:
        return None


def _difference(voltages: Array, against: Array, usable: npt.NDArray[np.bool_], noise: Array) -> float:
    """Rms over rows of log|V / V_against|, without a common factor and without what noise adds to it."""
    rows = usable & (against != 0.0)
    if rows.sum() < 2:
        return NOTHING_ALIKE
    logs = np.log(np.abs(voltages[rows] / against[rows]))
    apart = logs - np.median(logs)
    return float(np.sqrt(max(float(np.mean(apart**2 - noise[rows])), 0.0)))


def _compare(
    difference: float, bounds: tuple[float, float], what: str, refusals: list[str], remarks: list[str], hint: str = ""
) -> None:
    noted, largest = bounds
    text = f"the sheet differs from {what} by {difference:.0%} (rms over rows, beyond a common factor)"
    if difference > largest:
        refusals.append(f"{text}, expected at most {largest:.0%}{hint}")
    elif difference > noted:
        remarks.append(f"{text}, usual is {noted:.0%}: is it flat and untouched, are electrodes in their places?")


def _touched(gate: Gate | None, voltages: Array, against: Array, usable: npt.NDArray[np.bool_]) -> bool | None:
    if gate is None or len(gate.change) != len(voltages):
        return None
    gate.change[:] = np.where(usable, voltages / np.where(usable, against, 1.0) - 1.0, 0.0)
    return gate.touched()
