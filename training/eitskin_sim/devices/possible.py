"""Whether a sheet can be as a skin's description says: the electrodes have room, and it bends without folding.

The file's own reading (:mod:`eitskin_proto.skin.toml`) knows numbers and bounds; what follows from geometry is here.
"""

from typing import Final

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet

BENDS: Final = 3
"""Deformations that are drawn: none can be, or the first few can."""


def check_skin(skin: Skin) -> None:
    """Refuse a skin that cannot be solved or bent as it is stated.

    Raises:
        SceneError: The outline is no rectangle, an electrode reaches where its contact cannot, or hardly any
            deformation within the stated ranges leaves the sheet whole.
    """
    place(nominal_sheet(skin), nominal_electrodes(skin))
    draw("A", BENDS, 0, skin)
