"""A data set's folder as what batches are made of."""

import numpy as np

from eitskin_proto.skin.cloud import network_input
from eitskin_sim.dataset.prediction_cache import predicted_log_of
from eitskin_sim.dataset.reader import load as load_set
from eitskin_training.samples.batches import TrainingData


def load(directory: str) -> TrainingData:
    """Return a data set that ``eitskin dataset`` wrote.

    Raises:
        MismatchError: It was made for another protocol or grid.
        OSError: There is none.
    """
    found = load_set(directory)
    labels = found.units.astype(np.uint8) if found.labels_kind == "units" else found.label_table_u8()
    held_out = {
        "A": found.rows(deformations="kept", touches="validation").astype(np.intp),
        "B": found.rows(deformations="other", touches="validation").astype(np.intp),
    }
    return TrainingData(
        voltages=found.voltages_V,
        deformation=found.deformation.astype(np.intp),
        touch_set=found.touch_set.astype(np.intp),
        reference=found.reference_V,
        untouched=found.untouched_V,
        clouds=np.stack([network_input(cloud, found.skin.grid) for cloud in found.clouds]),
        log_predicted=predicted_log_of(directory, found),
        labels_kind=found.labels_kind,
        labels=labels,
        train=found.rows(deformations="train", touches="train").astype(np.intp),
        validation=found.rows(deformations="train", touches="validation").astype(np.intp),
        held_out={family: rows for family, rows in held_out.items() if len(rows)},
        digest=found.digest,
        seed=found.seed,
        skin=found.skin,
        touch_kind=found.touch_kind,
        drift=found.drift,
        bends=found.bends,
    )
