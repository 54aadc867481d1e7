"""A true device: the layer, the electrodes and the electronics that a reading comes from."""

from dataclasses import dataclass, field, replace
from typing import Final

from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.parts import Electrodes, Late, Sheet


@dataclass(frozen=True, slots=True)
class Device:
    """What voltages depend on beside the bend and the touches; the default is the paper's ideal device."""

    sheet: Sheet = field(default_factory=Sheet)
    electrodes: Electrodes = field(default_factory=Electrodes)
    front_end: FrontEnd = field(default_factory=FrontEnd)

    def since(self, late: Late | None) -> "Device":
        """Return the device with what came after its reference was taken; None is the device at that moment."""
        return replace(self, sheet=replace(self.sheet, late=late))


IDEAL: Final = Device()
"""What data sets, bundles and networks know."""
