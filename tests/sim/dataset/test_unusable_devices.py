"""A random device that cannot be used is blamed on what is off: the sheet, or its front end."""

from dataclasses import replace

import pytest

from eitskin_proto.skin.parts import Instrument, Layer
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import named
from eitskin_sim.dataset import device_files
from eitskin_sim.devices.device import IDEAL
from eitskin_sim.devices.readings import readings, sheet_differences
from eitskin_sim.scene.parts import Bend

LAB = named("lab")
CORNERS = Quantity((2.1, *PAPER.arc_length_mm[1:8].tolist(), 252.1, *PAPER.arc_length_mm[9:].tolist()), "normal", 2.0)
"""Places of which two are next to a corner, and as likely round it."""


@pytest.mark.parametrize(
    ("skin", "said"),
    [
        (
            replace(LAB, front_end=Instrument(gain=Quantity(5.0))),
            r"none read every .* uncertainties in \[front_end\] smaller",
        ),
        (
            replace(LAB, layer=Layer(thickness_mm=Quantity(20.0, "log_normal", 1.2), width_scale=Quantity(3.0))),
            r"a random sheet reads .* times the nominal .* uncertainties in \[layer\], \[electrodes\]",
        ),
        (
            replace(LAB, electrodes=replace(LAB.electrodes, arc_length_mm=CORNERS)),
            r"a random device of it is impossible \(.*\); make the uncertainties in \[layer\], \[electrodes\]",
        ),
    ],
)
def test_a_draw_that_is_not_usable_is_blamed_on_what_is_off(
    skin: Skin, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device_files, "job_skin", lambda _: skin)
    nominal = readings(IDEAL, sheet_differences(IDEAL, Bend()))
    with pytest.raises(ValueError, match=said):
        device_files.referenced_device({"seed": 0, "device": 0}, nominal)
