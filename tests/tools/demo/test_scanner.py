"""What the demonstration's scanner sends is what the runtime takes without a word."""

import numpy as np

from eitskin.reference.plausible import check_prediction
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_tools.scripted_scene.script import demonstration


def test_every_cloud_of_the_demonstration_and_its_prediction_pass():
    script, rng = demonstration(), np.random.default_rng(0)
    for number, time_s in enumerate(np.arange(0.0, script.period_s, 1.0)):
        cloud = script.cloud_at(float(time_s), rng)
        assert check_sheet(cloud)[1] == ()
        if number in (0, 9):
            check_prediction(cloud, predict(cloud), flat_voltages(), None)
