"""Frames of a small sheet, and who judges sets on them."""

import numpy as np

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import rows_of as rows_of_electrodes
from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import Skin
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.model import ReducedModel, rows_of
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.prior import Prior
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.price import UnitPrice

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
"""Few, large units: 4 rows of 6."""


def judge_of(
    sheet: ExactSheet,
    model: ReducedModel,
    true: dict[int, float],
    missing: tuple[int, ...] = (),
    deadline: float = 1.0,
    heights: np.ndarray | None = None,
) -> Judge:
    """Return the judge of a frame of an exact sheet with some units touched, and noise of 50 dB; its clock shows 0."""
    flat = rows_of(exact_sheet(flat_metric_of(SMALL), SMALL).untouched)
    volts = rows_of(sheet.currents(np.array(list(true)), np.array(list(true.values())))[1])
    noisy = add_noise(volts, flat, "N2", 50.0, np.random.default_rng(3))
    frame = Frame(relative_change(noisy, flat), flat, Noise(), rows=~rows_of_electrodes(missing))
    price = UnitPrice(model.shape, Prior(places=SMALL.grid.n_units), 50.0)
    price.begin([], heights)
    return Judge(model, model.of_rank(8), model.of_rank(4), flat, frame, price, 50.0, deadline, lambda: 0.0)
