"""Whether a sheet can be as a skin's description says: the electrodes have room where they are.

The file's own reading (:mod:`eitskin_proto.skin.toml`) knows numbers and bounds; what follows from geometry is here.
"""

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet


def check_skin(skin: Skin) -> None:
    """Refuse a skin that cannot be as it is stated.

    A disc has no corners: that its electrodes have room along the border is all there is, and its reading knows that.

    Raises:
        SceneError: An electrode reaches where its contact cannot.
    """
    if skin.outline.kind == "disc":
        return
    place(nominal_sheet(skin), nominal_electrodes(skin))
