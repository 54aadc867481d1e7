"""Checks that a skin's description is geometrically possible: the electrodes have room at their places.

The reader of the file (:mod:`eitskin_proto.skin.toml`) checks numbers and bounds; this module checks geometry.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.skin import Skin
from eitskin_sim.devices.draws import draw_device
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import SceneError

TRIED_DEVICES: Final = 40
"""Random devices whose electrodes are placed."""


def check_skin(skin: Skin) -> None:
    """Refuse a skin that cannot be as it is stated, or mostly not as far off as it says.

    A disc has no corners: that its electrodes have room along the border is all there is, and its reading knows that.

    Raises:
        SceneError: An electrode reaches where its contact cannot; so it does in most of ``TRIED_DEVICES``.
    """
    if skin.outline.kind == "disc":
        return
    sheet = nominal_sheet(skin)
    place(sheet, nominal_electrodes(skin))
    failed: list[SceneError] = []
    for seed in range(TRIED_DEVICES):
        try:
            place(sheet, draw_device(skin, np.random.default_rng(seed)).device.electrodes)
        except SceneError as error:
            failed.append(error)
    if 2 * len(failed) > TRIED_DEVICES:
        raise SceneError(
            f"{len(failed)} of {TRIED_DEVICES} random devices of skin {skin.name} cannot be ({failed[0]}), expected "
            "few: state places or sizes in [electrodes] less uncertain, or farther from what they meet"
        )
