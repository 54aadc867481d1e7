"""The nominal skin of a description, for which models, operators and predictions are made.

The true sheet and electrodes differ from these in an unknown way, within the description's uncertainties. The flat
sheet has the stated size on the map; where its true lengths are known to be others, its flat metric says so.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, SceneError, Sheet, Touch


def nominal_sheet(skin: Skin) -> Sheet:
    """Return the sheet that a skin states: even, and without drift.

    Raises:
        SceneError: The skin's outline is no rectangle.
    """
    if skin.outline.kind != "rectangle":
        raise SceneError(
            f"skin {skin.name!r}: [outline] kind is {skin.outline.kind!r}, expected 'rectangle': the forward model "
            "solves no other here; a disc can be used with 'eitskin build --physics', 'eitskin teach' and "
            "'eitskin evaluate --tank' or '--measured --reference pre'"
        )
    layer = skin.layer
    return Sheet(
        size_mm=skin.outline.size_mm,
        thickness_mm=_one(layer.thickness_mm),
        conductivity_S_per_m=_one(layer.conductivity_S_per_m),
        gauge_factor=_one(layer.gauge_factor),
    )


def nominal_electrodes(skin: Skin) -> Electrodes:
    """Return the electrodes that a skin states."""
    ring = skin.electrodes
    return Electrodes(
        contact=ring.contact,
        size_mm=ring.size_mm.value,
        contact_impedance_ohm_m2=ring.contact_impedance_ohm_m2.value,
        arc_length_mm=tuple(skin.arc_length_mm.tolist()),
    )


def nominal_scene(
    skin: Skin, bend: Bend | None = None, touches: tuple[Touch, ...] = (), element_size_mm: float | None = None
) -> Scene:
    """Return a scene of a skin as it is stated; flat, untouched and of the usual elements where nothing is said."""
    scene = Scene(nominal_sheet(skin), nominal_electrodes(skin), bend or Bend(), touches)
    return scene if element_size_mm is None else replace(scene, element_size_mm=element_size_mm)


def flat_metric_of(skin: Skin) -> Callable[[Array], Array]:
    """Return the metric of the flat sheet, (n, 2) places in mm -> (n, 3) E, F, G.

    It is 1, 0, 1 but where the sheet's true lengths are known to be others than those of the map.
    """
    along, across = _one(skin.layer.length_scale), _one(skin.layer.width_scale)

    def metric(xy_mm: Array) -> Array:
        return np.tile([along**2, 0.0, across**2], (len(xy_mm), 1))

    return metric


def _one(quantity: Quantity) -> float:
    return float(quantity.nominal(1)[0])
