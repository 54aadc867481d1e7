"""Whether a sheet can be as a skin's description says: the electrodes have room where they are.

The file's own reading (:mod:`eitskin_proto.skin.toml`) knows numbers and bounds; what follows from geometry is here.
"""

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet


def check_skin(skin: Skin) -> None:
    """Refuse a skin that cannot be solved as it is stated.

    Raises:
        SceneError: The outline is no rectangle, or an electrode reaches where its contact cannot.
    """
    place(nominal_sheet(skin), nominal_electrodes(skin))
