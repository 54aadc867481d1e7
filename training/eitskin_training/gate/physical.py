"""A gate from the forward model alone: matched filters for first-order touches, whitened by untouched sheets and noise.

It needs no data set and no training. Untouched sheets for learning, for the threshold and for measuring are at
different bends.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.measurement.noise import add_noise
from eitskin_training.gate import filters
from eitskin_training.network.mirror import mirrors

FALSE_ALARM_RATE: Final = 0.01
"""Of single untouched frames."""

FELT_SHARE: Final = 0.9
"""Share of touches of a size that are found if the sheet feels that size."""

SIZE_GROUPS: Final = 20
"""Into which touches are divided by their size."""

FRAMES: Final = 8192
"""Of untouched sheets, to learn from, to choose the threshold, and to measure it."""

TOUCHES: Final = 2000
"""First-order touches that filters are made of, and as many frames that measure what is found."""

SOLVED_SHARE: Final = 0.5
"""Share of frames at a solved bend; others are between one and the flat sheet."""


@dataclass(frozen=True, slots=True)
class Untouched:
    """log(V / V0) of untouched sheets, free of noise, at bends of three kinds that have none in common.

    Args:
        learn: (n, 104)
        choose: (c, 104)
        measure: (m, 104)
    """

    learn: Array
    choose: Array
    measure: Array


def touch_logs(
    jacobian: Array, skin: Skin, inside: npt.NDArray[np.bool_], rng: np.random.Generator, count: int = TOUCHES
) -> tuple[Array, Array]:
    """Return (count, 104) first-order log(V touched / V untouched) of discs on the sheet, and their (count,) mm.

    Args:
        jacobian: (104, pixels) relative change of each row with that of each pixel's conductivity.
        skin: Sizes and contrasts of its touches.
        inside: (pixels,) which are on the sheet.
        rng: Draws them.
        count: How many.
    """
    grid, touches = skin.grid, skin.touches
    places = grid.pixel_centres_mm().reshape(-1, 2)
    chosen = rng.choice(len(places), size=count, p=inside / inside.sum())
    centres = places[chosen] + rng.uniform(-0.5, 0.5, (count, 2)) * grid.pixel_mm
    radii = _log_uniform(touches.size_mm, count, rng) / 2
    apart = np.linalg.norm(places - centres[:, None], axis=2)
    shares = np.clip((radii[:, None] - apart) / grid.pitch_mm + 0.5, 0.0, 1.0)
    raising = np.full(count, touches.higher) if touches.higher != touches.lower else rng.random(count) < 0.5
    rises, falls = (_log_uniform(one, count, rng) for one in (touches.raising_contrast, touches.lowering_contrast))
    contrast = np.where(raising, rises, falls)
    effective = 2.0 * (contrast - 1.0) / (contrast + 1.0)
    return effective[:, None] * (shares @ jacobian.T), 2.0 * radii


def _log_uniform(bounds: tuple[float, float], count: int, rng: np.random.Generator) -> Array:
    low, high = np.log(bounds).tolist()
    return np.exp(rng.uniform(low, high, count))


def physical_gate(
    untouched: Untouched, touches: Array, sizes_mm: Array, reference: Array, skin: Skin, rng: np.random.Generator
) -> tuple[filters.Arrays, dict[str, Any]]:
    """Return the arrays of a bundle's gate.npz, and what a manifest states of it.

    Args:
        untouched: Sheets.
        touches: (t, 104) log(V touched / V untouched).
        sizes_mm: (t,) diameters of the touches.
        reference: (104,) V of the flat sheet.
        skin: Whose noise and mirror images.
        rng: Draws frames.

    Raises:
        ValueError: No touch has a pattern to speak of.
    """
    seen = filters.seen(touches)
    if not len(seen):
        raise ValueError(
            f"no touch changes rows by {filters.MIN_TOUCH_MEAN_LOG:.1%} or more, so there is nothing to find; give the "
            "skin larger touches, or contrasts further from 1"
        )
    mean, whitening = filters.whitening_of(_frames(untouched.learn, reference, skin, rng))
    mean[:] = 0.0  # the flat sheet is the usual one
    bank = filters.bank(seen @ whitening, rng)
    choose, measure = (
        filters.ratios(_frames(logs, reference, skin, rng) @ whitening, bank)
        for logs in (untouched.choose, untouched.measure)
    )
    limit = float(np.quantile(choose, 1.0 - FALSE_ALARM_RATE))
    bent = _bends(untouched.measure, len(touches), skin, rng) + touches
    found = filters.ratios(_noisy(bent, reference, skin, rng) @ whitening, bank) > limit
    first, second, bias = filters.layers(whitening, bank, limit)
    arrays = filters.in_form(mean, first, np.zeros(first.shape[1]), second, bias, np.ones(len(bank)), 0.0)
    arrays["threshold"] = np.asarray(0.0, dtype=np.float32)
    return arrays, {
        "target_false_alarm_rate": FALSE_ALARM_RATE,
        "false_alarm_rate": float((measure > limit).mean()),
        "held_out_sheets": len(untouched.measure),
        "missed_rate": float(1.0 - found.mean()),
        "felt_mm": _felt_mm(sizes_mm, found),
    }


def _felt_mm(sizes_mm: Array, found: npt.NDArray[np.bool_]) -> float | None:
    """Return from which size on ``FELT_SHARE`` of touches are found; None if that is so of no size."""
    groups = np.array_split(np.argsort(sizes_mm), SIZE_GROUPS)
    faint = [number for number, group in enumerate(groups) if found[group].mean() < FELT_SHARE]
    felt = groups[faint[-1] + 1 if faint else 0 :]
    return float(sizes_mm[felt[0]].min()) if felt else None


def _frames(logs: Array, reference: Array, skin: Skin, rng: np.random.Generator) -> Array:
    """Return (``FRAMES``, 104) noisy logarithms of untouched sheets."""
    return _noisy(_bends(logs, FRAMES, skin, rng), reference, skin, rng)


def _bends(logs: Array, count: int, skin: Skin, rng: np.random.Generator) -> Array:
    """Return (count, 104) of untouched sheets: of solved ones and of partial bends, in any of their mirror images."""
    shares = np.where(rng.random(count) < SOLVED_SHARE, 1.0, rng.random(count))
    images = np.array([mirror.rows for mirror in mirrors(skin)])
    rows = images[rng.integers(len(images), size=count)]
    return np.take_along_axis(shares[:, None] * logs[rng.integers(len(logs), size=count)], rows, axis=1)


def _noisy(logs: Array, reference: Array, skin: Skin, rng: np.random.Generator) -> Array:
    """Return (n, 104) logarithms with the skin's noise, cut off as in the gate."""
    snr_db = rng.uniform(*skin.front_end.snr_db, (len(logs), 1))
    noisy = add_noise(reference * np.exp(logs), reference, skin.front_end.noise, snr_db, rng)
    return np.asarray(np.log(np.maximum(1.0 + relative_change(noisy, reference), filters.MIN_RATIO)))
