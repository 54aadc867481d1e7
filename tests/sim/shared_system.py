"""The system of a device at one bend, on the mesh that touches anywhere are solved on."""

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.fem.forward import System
from eitskin_sim.freeform.mesh import ELEMENT_MM
from eitskin_sim.freeform.sheet import assembled_metric
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.parts import Bend


def shared_system(bend: Bend, size_mm: float = ELEMENT_MM, device: Device | None = None, skin: Skin = PAPER) -> System:
    true = device or ideal(skin)
    return assembled_metric(lambda xy: metric(bend, true.sheet, xy), size_mm, true, skin).system
