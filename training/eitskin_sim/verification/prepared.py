"""Everything that verifying needs of one cloud, made once when it comes."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.reduced.model import ReducedModel, cloud_digest, rows_of
from eitskin_sim.reduced.quick import quick_model
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.verification.frame import Doubts
from eitskin_sim.verification.material import moved
from eitskin_sim.verification.model_error import scan_columns
from eitskin_sim.verification.nuisance import modes_of
from eitskin_sim.verification.residual import Array
from eitskin_sim.verification.scan_noise import scan_noise_mm
from eitskin_sim.verification.spreads import Spreads, usual
from eitskin_sim.verification.units import UnitVerifier


def prepared(
    cloud_mm: npt.ArrayLike,
    skin: Skin = PAPER,
    spreads: Spreads | None = None,
    model: ReducedModel | None = None,
    material: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> UnitVerifier:
    """Return the verifier of units on the sheet of a cloud.

    Args:
        cloud_mm: (3, rows, columns) mm.
        skin: Whose.
        spreads: How far sheet and scan may be off; None is what the skin says. A scan that shows more noise has more.
        model: The cloud's, where it is there already.
        material: Amplitudes by which frames of this shape have shown material to lie elsewhere; the model has them.

    Raises:
        ValueError: The cloud is malformed, or folds in its own plane.
    """
    spreads = spreads or usual(skin)
    surface = fit_cloud(cloud_mm, skin.grid)
    metric = moved(surface.metric, material, skin)
    made = model or quick_model(metric, skin, cloud_digest(np.asarray(cloud_mm)))
    modes = modes_of(metric, skin, spreads)
    worse = max(scan_noise_mm(cloud_mm, surface, skin.grid) / spreads.scan_mm, 1.0) if spreads.scan_mm else 1.0
    return UnitVerifier(made, flat_of(skin), Doubts(modes, worse * scan_columns(spreads.scan_mm, skin)))


@lru_cache(maxsize=4)
def flat_of(skin: Skin = PAPER) -> Array:
    """Return the (104,) V of the reduced models' flat, untouched sheet, under 1 A at 1 S/m."""
    return rows_of(exact_sheet(flat_metric_of(skin), skin).untouched)
