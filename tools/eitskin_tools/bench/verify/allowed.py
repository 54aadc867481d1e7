"""What a frame allows anybody to know of touches anywhere: the bound of Cramer and Rao, with the verifier's own model.

Noise hides where a touch is and how large, and so does whatever may differ of the sheet. Both are in the covariance of
the true touches' parameters, (J^T C^-1 J + P)^-1 with J their derivatives, C the covariance of the frame and P what is
known of touches beforehand. No estimate without bias scatters by less; one that is held within what touches may be,
as those of gentle touches are, may. Twice: for the sheet as a scan shows it, and for one that is known exactly.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Rect
from eitskin_sim.scene.touch_table import ELLIPSE, RECTANGLE
from eitskin_sim.shapes.parameters import X, Y
from eitskin_sim.verification.fit import Frame
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet_model import SheetModel, model_of_cloud
from eitskin_sim.verification.touch_prior import TouchPrior
from eitskin_sim.verification.unseen import Spreads
from eitskin_tools.bench.verify.truth import SEED, Array

KNOWN: Final = Spreads(drift=0.0, tilt=0.0, gauge=0.0, material=0.0, scan_mm=0.0)
"""Of a sheet that is its model."""

DRAWS: Final = 200
"""Of the places of each touch set."""


class Allowed:
    """Adds up what frames of one row allow.

    Args:
        noise: Of the frames.
        prior: What is known of touches beforehand.
    """

    def __init__(self, noise: Noise, prior: TouchPrior) -> None:
        self._noise, self._prior = noise, prior
        self._models: dict[str, SheetModel] = {}
        self._sets = 0
        self._found: dict[str, list[Array]] = {"allowed": [], "known": []}

    def deform(self, cloud_mm: Array) -> None:
        """Take the scan of the touch sets that follow."""
        self._models = {"allowed": model_of_cloud(cloud_mm), "known": model_of_cloud(cloud_mm, spreads=KNOWN)}

    def add(self, scene: Scene) -> None:
        """Count one touch set; touches of several shapes have no such bound."""
        self._sets += 1
        if any(len(touch.shapes) > 1 for touch in scene.touches):
            return
        pieces = pieces_of_touches(scene.touches, scene.sheet.conductivity_S_per_m)
        for name, model in self._models.items():
            self._found[name].append(_scatter(model, self._noise, self._prior, pieces))

    def figures(self) -> dict[str, Any]:
        """Return the median and rms of how far centres are off; None if unknown."""
        found: dict[str, Any] = {}
        for name, own in self._found.items():
            off = np.concatenate([one.ravel() for one in own]) if own and len(own) == self._sets else None
            found |= {
                f"{name}_median_mm": None if off is None else float(np.median(off)),
                f"{name}_rms_mm": None if off is None else float(np.sqrt(np.mean(off**2))),
            }
        return found


def pieces_of_touches(touches: Sequence[Touch], sheet_S_per_m: float) -> Array:
    """Return touches as (n, 8) pieces; every shape of a touch is one.

    Args:
        touches: Of rectangles, discs and ellipses.
        sheet_S_per_m: Conductivity of the sheet.

    Raises:
        ValueError: A shape is none that is verified.
    """
    found = []
    for touch in touches:
        for shape in touch.shapes:
            contrast = touch.factor(sheet_S_per_m)
            if isinstance(shape, Ellipse):
                sides = shape.along_mm, shape.across_mm, shape.angle_deg
                found.append([ELLIPSE, shape.x_mm, shape.y_mm, *sides, contrast, touch.border_mm])
                continue
            if not isinstance(shape, Rect | Disc):
                raise ValueError(f"{type(shape).__name__}: expected rectangles, discs and ellipses")
            x0, y0, x1, y1 = shape.bounds_mm
            kind = RECTANGLE if isinstance(shape, Rect) else ELLIPSE
            middle = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            found.append([kind, *middle, x1 - x0, y1 - y0, 0.0, contrast, touch.border_mm])
    return np.array(found)


def _scatter(model: SheetModel, noise: Noise, prior: TouchPrior, pieces: Array) -> Array:
    """Return (draws, n) mm that centres are off."""
    change = model.solve(pieces)[1]
    white = model.whitener(change, model.flat_V, noise)
    fit = Frame(model, white, change, np.zeros(len(change)), prior).at(pieces, bool(pieces[:, 5].any()))
    _, by, own = fit.linear
    covariance = np.linalg.pinv(by.T @ by, hermitian=True)
    number = np.full(own.shape, -1)
    number[own] = np.arange(own.sum())
    variance = np.diag(covariance)[number[:, [X, Y]]]
    rng = np.random.default_rng([SEED, len(pieces)])
    return np.asarray(np.hypot(*np.moveaxis(np.sqrt(variance) * rng.standard_normal((DRAWS, *variance.shape)), -1, 0)))
