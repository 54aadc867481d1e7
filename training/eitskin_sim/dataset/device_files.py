"""The content of a deformation's file with a random device: readings relative to the nominal reference.

Training divides every voltage by one reference, the nominal sheet's. A random device has a reference of its own, so
what it reads is stored as ::

    voltages = reading * (nominal reference / the device's reference)

whose relative change is that of the device's own reading against its own reference. The device's ``reference`` and
``drift``, by which each sample's resistances had changed since then, are stored beside it. The rest is what a robot
would have: a scan that is noisy, wrong in scale and early or late, and no data about the device.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, TABLE
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import parse
from eitskin_sim.arrays import Array
from eitskin_sim.dataset.plan import Plan
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.draws import DrawnDevice, Moment, draw_device, draw_drift, draw_front_end, draw_moment
from eitskin_sim.devices.readings import corrected, drive_differences, readings, sheet_differences
from eitskin_sim.scene.family import scaled
from eitskin_sim.scene.folds import check_bend
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend, SceneError
from eitskin_sim.surface.measured_cloud import measured_cloud

DEVICE, MOMENT, DRIFT, SCAN = 7, 8, 9, 10
"""Seeds of a plan's draws, beside those of :mod:`eitskin_sim.dataset.plan` and others."""

REFERENCE_RATIO_RANGE: Final = (0.4, 2.5)
"""Bounds of a reference over the nominal one, in every row, stated offsets taken away; a lab would find the fault
behind any other before taking data."""

ATTEMPTS: Final = 100
"""Draws of a front end."""

SHEET: Final = "[layer], [electrodes] and [may_be_off]"
"""Tables that say how a sheet is off."""


def job_skin(job: dict[str, Any]) -> Skin:
    """Return the skin of a job, which has its TOML."""
    return _parsed(job["skin"])


@lru_cache(maxsize=4)
def _parsed(text: str) -> Skin:
    return parse(text)


def device_job(plan: Plan, first: int) -> dict[str, Any]:
    """Return the data from which a worker draws the device of a shard's deformations; empty for ideal devices."""
    if plan.devices == "ideal":
        return {}
    return {"device": first, "offset": True} if plan.devices == "offset" else {"device": first}


@dataclass(frozen=True, slots=True)
class ReferencedDevice:
    """A device and what it read when its reference was taken."""

    drawn: DrawnDevice
    reference_V: Array
    """(104,)"""


def referenced_device(job: dict[str, Any], nominal: Array) -> ReferencedDevice:
    """Return the device of a job, with electronics that read every row of its reference by the sign that it has.

    Args:
        job: See :func:`device_job`.
        nominal: (104,) V of the nominal sheet, flat and untouched.

    Raises:
        ValueError: The drawn sheet cannot be, or reads unlike the nominal one under any electronics; or the skin's
            electronics are hardly ever so.
    """
    skin = job_skin(job)
    rng = np.random.default_rng([job["seed"], DEVICE, job["device"]])
    offset = bool(job.get("offset", False))
    drawn = draw_device(skin, rng, offset=offset)
    try:
        before = sheet_differences(drawn.device, drawn.reference_bend)
    except ValueError as error:
        raise ValueError(
            f"skin {skin.name}: a random device of it is impossible ({error}); make the uncertainties in {SHEET} "
            "smaller"
        ) from error
    for _ in range(ATTEMPTS):
        found = readings(drawn.device, before)
        if usable_reference(skin, found, nominal, offset=offset):
            return ReferencedDevice(drawn, found)
        drawn = replace(drawn, device=replace(drawn.device, front_end=draw_front_end(skin, rng, offset=offset)))
    least, most = REFERENCE_RATIO_RANGE
    perfect = readings(Device(drawn.device.sheet, drawn.device.electrodes), before)
    ratio = perfect / nominal
    if not usable_reference(skin, perfect + stated_offset_V(skin), nominal):
        raise ValueError(
            f"skin {skin.name}: a random sheet reads {ratio.min():.3g} to {ratio.max():.3g} times the nominal "
            f"reference, expected every row within {least:g} and {most:g}; make the uncertainties in {SHEET} smaller"
        )
    raise ValueError(
        f"skin {skin.name}: in {ATTEMPTS} draws of its front end none read every row within {least:g} and "
        f"{most:g} times the nominal reference; make the uncertainties in [front_end] smaller"
    )


def usable_reference(skin: Skin, found: Array, nominal: Array, *, offset: bool = False) -> bool:
    """Return whether the readings of a reference (104,) are near the nominal ones (104,), both in V.

    The skin's stated offset is taken away first. With an offset that nobody states, readings may be of any size.
    """
    ratio = (found - stated_offset_V(skin)) / nominal
    least, most = REFERENCE_RATIO_RANGE
    return bool(least < ratio.min() and (offset or ratio.max() < most))


def stated_offset_V(skin: Skin) -> Array:
    """Return (104,) V, the offset that a skin's file states of each row's pair, for a layer of 1 S/m."""
    sigma = float(skin.layer.conductivity_S_per_m.nominal(1)[0])
    return np.asarray(sigma * skin.front_end.offset_V.nominal(N_ELECTRODES)[TABLE[:, 1]])


def true_bend(drawn: DrawnDevice, bend: Bend) -> Bend:
    """Return the bend of a device of its true size, or of the stated one where that would fold."""
    found = drawn.bent(bend)
    try:
        check_bend(found, drawn.device.sheet)
    except SceneError:
        return bend
    return found


def moment_of(job: dict[str, Any], number: int) -> Moment:
    """Return the state of a job's device at a deformation."""
    return draw_moment(job_skin(job), np.random.default_rng([job["seed"], MOMENT, number]))


def device_file(
    job: dict[str, Any],
    number: int,
    bend: Bend,
    device: Device,
    made: tuple[Array, Array],
    references: tuple[Array, Array],
) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a deformation's file apart from the numbers of its touch sets.

    Args:
        job: See :func:`device_job`.
        number: Of the deformation.
        bend: The true one.
        device: The true one at that moment.
        made: (n, 16, 16) and (16, 16) potentials of its electrodes, touched and not.
        references: (104,) V, the device's own and the nominal one.
    """
    moment = moment_of(job, number)
    own, nominal = references
    scale = nominal / own
    fine, coarse = sheet_differences(device, bend), drive_differences(made[1])
    ratio = np.divide(fine, coarse, out=np.ones_like(fine), where=~np.eye(len(fine), dtype=np.bool_))
    drift = draw_drift(job_skin(job), len(made[0]), np.random.default_rng([job["seed"], DRIFT, number]))
    touched = drift[:, None, None] * corrected(drive_differences(made[0]), ratio)
    return {
        "voltages": (readings(device, touched) * scale).astype(np.float32),
        "untouched": readings(device, fine) * scale,
        "cloud": scan(job_skin(job), bend, moment, np.random.default_rng([job["seed"], SCAN, number])),
        "reference": own,
        "drift": drift.astype(np.float32),
    }


def scan(skin: Skin, bend: Bend, moment: Moment, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Return the (3, rows, columns) mm cloud that a scanner gives of a bend at a moment."""
    shown = scaled(bend, moment.scan_amplitude)
    try:
        check_bend(shown, nominal_sheet(skin))
    except SceneError:  # ahead of a sheet that all but folds
        shown = scaled(bend, min(moment.scan_amplitude, 1.0))
    return measured_cloud(shown, rng, moment.scan_noise_mm, skin) * np.float32(moment.scan_factor)
