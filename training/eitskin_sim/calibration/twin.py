"""Writes the result of a calibration as a better description of the same skin."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from eitskin_proto.skin.quantity import Law, Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_sim.calibration.fit import Fit
from eitskin_sim.calibration.model import Model
from eitskin_sim.calibration.parameters import COMMON_OFFSET, LAYER_MODES
from eitskin_sim.calibration.session import Session
from eitskin_sim.calibration.stamp import BORDER, PRESS_CONTRAST_SD, PRESSES, STRENGTH
from eitskin_sim.calibration.unseen import UNSEEN

DIGITS: Final = 7
"""Of what is written: far below any standard error."""

MAX_LEARNED_SD_RATIO: Final = 0.8
"""Standard error over the prior's: above, nothing worth mentioning was learned."""


PRESS_CONTRAST_RANGE: Final = 2.0
"""Presses may have the estimated log contrast divided or multiplied by up to this factor, as a stamp is pressed lightly
or hard. Touches that raise conductance touch or do not: theirs reach as far as they are uncertain."""

TOUCH_RANGE_SD: Final = 2.0
"""Standard errors that what is uncertain of touches reaches."""


def calibrated_skin(skin: Skin, session: Session, found: Fit) -> Skin:
    """Return the same skin with what was found; each quantity's spread is the rms of its standard errors.

    What a file cannot say is left out: errors of single electrodes, what errors have in common, and the layer's own
    pattern, of which the rms alone is kept; everything static divides out by the reference.

    Args:
        skin: The skin from which calibration started.
        session: The recording.
        found: The most probable parameters.
    """
    model = session.flat
    parts: dict[str, Any] = {}
    for name, group in model.parameters.groups.items():
        z, sd = (one[model.parameters.slices[name]] for one in (found.z, found.sd))
        if name == LAYER_MODES:
            middle = xy_of(model)
            rms = float(np.sqrt(np.mean((model.layer.at(middle) @ z) ** 2)))
            parts.setdefault("may_be_off", {})["layer_rms"] = (_round(0.8 * rms), _round(1.2 * rms))
            continue
        if name in PRESSES or name in (UNSEEN, COMMON_OFFSET):
            continue
        stated = "conductivity_S_per_m" if name == "level" else name
        value = tuple(_round(one) for one in group.values(z))
        error = float(np.sqrt(np.mean(sd**2)) * group.spread)
        law: Law = "log_normal" if group.logarithmic else "normal"
        if name == "reference_stretch":  # of both axes; what is left of it is in the two lengths
            parts.setdefault("may_be_off", {})[name] = Quantity(_round(float(np.mean(value))), law, _round(error))
            continue
        quantity = Quantity(value[0] if len(value) == 1 else value, law, _round(error))
        part = next(
            one for one in ("layer", "electrodes", "front_end", "may_be_off") if hasattr(getattr(skin, one), stated)
        )
        parts.setdefault(part, {})[stated] = quantity
    if COMMON_OFFSET in model.parameters.groups:
        parts.setdefault("front_end", {})["offset_V"] = _offset(model, found)
    if model.recording.presses:
        parts["touches"] = _touches(session, found)
    changed = {part: replace(getattr(skin, part), **values) for part, values in parts.items()}
    name = f"{skin.name}, calibrated"
    return replace(skin, **changed, name=name, calibrated_from=skin.digest, stated_grid_id=skin.grid_id)


def _offset(model: Model, found: Fit) -> Quantity:
    """Return each pair's offset with the one that all rows have in common."""
    parameters, variance = model.parameters, 0.0
    for name in (COMMON_OFFSET, "offset_V"):
        if name in parameters.groups:
            own = parameters.slices[name]
            variance += float(np.mean(parameters.groups[name].errors(found.z[own], found.sd[own]) ** 2))
    values = parameters.values("offset_V", found.z) + parameters.one(COMMON_OFFSET, found.z)
    return Quantity(tuple(_round(one) for one in values), "normal", _round(float(np.sqrt(variance))))


def _touches(session: Session, found: Fit) -> dict[str, Any]:
    """Return which touches the skin meets: the stamp's, pressed more or less, within the file's bounds."""
    parameters = session.flat.parameters
    strength, border = parameters.one(STRENGTH, found.z), parameters.one(BORDER, found.z)

    def error(name: str) -> float:
        own = parameters.slices[name]
        return float(parameters.groups[name].errors(found.z[own], found.sd[own])[0])

    factor = (
        PRESS_CONTRAST_RANGE
        if session.way < 0
        else np.exp(TOUCH_RANGE_SD * np.hypot(error(STRENGTH) / strength, PRESS_CONTRAST_SD))
    )
    ends = sorted(float(np.exp(session.way * strength * one)) for one in (1.0 / factor, factor))
    name, low, high = ("lowering_contrast", 0.01, 0.99) if session.way < 0 else ("raising_contrast", 1.01, 1000.0)
    soft = TOUCH_RANGE_SD * error(BORDER)
    return {
        "kind": "lower" if session.way < 0 else "raise",
        name: tuple(_round(min(max(one, low), high)) for one in ends),
        "border_mm": tuple(_round(min(max(one, 0.0), 20.0)) for one in (border - soft, border + soft)),
    }


def xy_of(model: Model) -> Any:
    """Return (n, 2) mm, the sheet's pixels."""
    length, width = model.size_mm
    x, y = np.meshgrid((np.arange(30) + 0.5) * length / 30, (np.arange(20) + 0.5) * width / 20)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def _round(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
