"""A true device: its layer, electrodes and electronics."""

from dataclasses import dataclass, field, replace
from typing import Final

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Electrodes, LaterChanges, Sheet


@dataclass(frozen=True, slots=True)
class Device:
    """A device: everything apart from bend and touches that affects voltages; the default is the paper's ideal one."""

    sheet: Sheet = field(default_factory=Sheet)
    electrodes: Electrodes = field(default_factory=Electrodes)
    front_end: FrontEnd = field(default_factory=FrontEnd)

    def since(self, late: LaterChanges | None) -> "Device":
        """Return the device with what came after its reference was taken; None is the device at that moment."""
        return replace(self, sheet=replace(self.sheet, late=late))


def ideal(skin: Skin) -> Device:
    """Return the device that a skin states, scaled to a layer of 1 S/m: what data sets know of it.

    A touch's conductivity is then its contrast. Contacts are scaled in proportion, so voltages are the skin's own times
    its conductivity, and what is divided by the reference does not change.
    """
    sheet, electrodes = nominal_sheet(skin), nominal_electrodes(skin)
    sigma = sheet.conductivity_S_per_m
    if sigma == 1.0:
        return Device(sheet, electrodes)
    scaled = tuple((sigma * electrodes.impedances_ohm_m2()).tolist())
    return Device(replace(sheet, conductivity_S_per_m=1.0), replace(electrodes, contact_impedance_ohm_m2=scaled))


IDEAL: Final = ideal(PAPER)
"""The paper's."""
