"""How often a gate errs at deformations never used in fitting: flat, A and B, at rest and moving, by noise and size.

Beside each missed share stand two that a test would miss at the same false-alarm rate which knows the touch that it
looks for: "told" the true deformation, and "untold", for which deformations are Gaussian with their own covariance. For
a known signal s in Gaussian noise of covariance S the detectability is d = sqrt(s' S^-1 s), and the best test misses
Phi(z - d), with Phi(-z) the false-alarm rate. No gate can beat the first. What lies between the two is the price of not
knowing the deformation, and a gate also has to look for every touch at once. Both have all 104 rows, also beside a gate
that judges fewer.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER
from eitskin_tools.bench.skip.scenes import contrasts_of_growth, first_above, growing, moving, still

GROWTH_FRAMES: Final = (200, 2000)
"""Frames in which a touch grows: one second and ten at 200 frames/s."""

MOTION_FRAMES: Final = 200
"""Frames of a motion: flat to bent in a second."""

Array = npt.NDArray[np.float64]
Judge = Callable[[Array], Array]


def errors(judge: Judge, threshold: float, reference: Array, bends: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return what a gate does on fresh deformations.

    Args:
        judge: (n, 104) dV -> (n,) logits.
        threshold: Above which a frame counts as touched.
        reference: (104,) V0.
        bends: Of A and of B for false alarms; a tenth of it for motions and touches.
        rng: Source of the noise.
    """
    few = max(bends // 10, 2)
    return {
        "false_alarms": _false_alarms(judge, threshold, reference, bends, few, rng),
        "missed": _missed(judge, threshold, reference, few, rng),
        "growing_10mm": {name: _growing(judge, threshold, reference, name, few, rng) for name in ("flat", "A", "B")},
    }


def _false_alarms(
    judge: Judge, threshold: float, reference: Array, bends: int, few: int, rng: np.random.Generator
) -> dict[str, Any]:
    from eitskin_training.gate.material import NOISES, noisy_change
    from eitskin_training.gate.rates import rate_and_interval, untouched_logits

    found: dict[str, Any] = {}
    for family in ("flat", "A", "B"):
        logits = untouched_logits(judge, still(family, bends), reference, rng, PAPER)
        for noise, values in logits.items():
            rate, interval = rate_and_interval((values > threshold).mean(axis=1))
            found.setdefault(family, {})[noise] = {"rate": rate, "interval_95": interval, "bends": len(values)}
    for family in ("A", "B"):
        frames = [motion.frames(MOTION_FRAMES) for motion in moving(family, few)]
        for noise in NOISES:
            tripped = [float(np.mean(judge(noisy_change(logs, reference, rng, noise)) > threshold)) for logs in frames]
            rate, interval = rate_and_interval(np.array(tripped))
            entry = {"rate": rate, "interval_95": interval, "motions": len(frames), "frames": MOTION_FRAMES}
            found.setdefault(f"{family} moving", {})[noise] = entry
    return found


def _missed(judge: Judge, threshold: float, reference: Array, few: int, rng: np.random.Generator) -> dict[str, Any]:
    from eitskin_tools.bench.skip.scenes import SEED
    from eitskin_training.gate.rates import missed_probes
    from eitskin_training.gate.touches import probes
    from eitskin_training.gate.untouched import Bends

    solved = probes(few, SEED, PAPER)
    empty = np.empty((0, len(reference)))
    found: dict[str, Any] = missed_probes(judge, threshold, Bends(empty, empty, empty, probes=solved), reference, rng)
    spread = bend_covariance(few)
    told = {(probe.name, probe.family): bound(probe.logs, probe.before, reference) for probe in solved}
    untold = {(probe.name, probe.family): bound(probe.logs, probe.before, reference, spread) for probe in solved}
    return {
        name: {
            family: {
                noise: {"missed": share, "told": told[name, family][noise], "untold": untold[name, family][noise]}
                for noise, share in noises.items()
            }
            for family, noises in families.items()
        }
        for name, families in found.items()
    }


def bend_covariance(bends: int) -> Array:
    """Return the (104, 104) covariance of log(V / V0) over bends of A and B, in all their mirror images."""
    from eitskin_training.gate.material import images_of

    logs = np.concatenate([still(family, max(bends, 30)) for family in ("A", "B")])
    return np.asarray(np.cov(np.concatenate([logs[:, image] for image in images_of(PAPER)]).T))


def bound(touched: Array, untouched: Array, reference: Array, spread: Array | None = None) -> dict[str, float]:
    """Return by noise the share of touches that the best linear test misses, which knows the touch it looks for.

    Args:
        touched: (n, 104) log(V / V0).
        untouched: (n, 104) the same before the touch.
        reference: (104,) V0.
        spread: (104, 104) covariance of the bends' own log(V / V0), which the test is not told; None tells it the bend.
    """
    from scipy.stats import norm

    from eitskin_training.gate.fit import FALSE_ALARM_RATE
    from eitskin_training.gate.material import SNR_DB

    level = 10.0 ** (-SNR_DB / 20.0)
    after = np.exp(touched)
    size = np.abs(reference) * after
    sigma = {  # of log V
        "N1": np.sqrt(np.mean((after - 1.0) ** 2, axis=1, keepdims=True)) / after,
        "N2": np.ones_like(after),
        "N3": np.sqrt(np.mean(size**2, axis=1, keepdims=True)) / size,
    }
    found = {}
    for noise, relative in sigma.items():
        covariance = np.zeros((1, 1, 1)) if spread is None else spread[None]
        covariance = covariance + np.einsum("nr,rs->nrs", (level * relative) ** 2, np.eye(len(reference)))
        signal = (touched - untouched)[..., None]
        strength = np.sqrt(np.sum(signal * np.linalg.solve(covariance, signal), axis=(1, 2)))
        found[noise] = float(np.mean(norm.cdf(norm.isf(FALSE_ALARM_RATE) - strength)))
    return found


def _growing(
    judge: Judge, threshold: float, reference: Array, family: str, few: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Return when a touch that grows from nothing is first seen, in frames and in contrast, and how often never."""
    from eitskin_training.gate.material import NOISES, noisy_change

    motions = growing(family, few, 10.0)
    logs_of_contrast = np.log(contrasts_of_growth())
    found: dict[str, Any] = {}
    for frames in GROWTH_FRAMES:
        at = np.linspace(0.0, len(logs_of_contrast) - 1.0, frames)
        contrast = np.exp(np.interp(at, np.arange(len(logs_of_contrast)), logs_of_contrast))
        for noise in NOISES:
            first = [
                first_above(judge(noisy_change(motion.frames(frames), reference, rng, noise)) > threshold)
                for motion in motions
            ]
            seen = [at for at in first if at is not None]
            found.setdefault(f"{frames} frames", {})[noise] = {
                "never_seen": 1.0 - len(seen) / len(first),
                "frames_until_seen": {"p50": float(np.median(seen)), "max": max(seen)} if seen else None,
                "contrast_when_seen": {"p50": float(np.median(contrast[seen])), "max": float(contrast[max(seen)])}
                if seen
                else None,
                "touches": len(first),
            }
    return found
