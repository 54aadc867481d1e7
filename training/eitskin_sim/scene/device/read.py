"""Reads a scene's ``sheet`` and ``electrodes`` from JSON, with what is not ideal about them, and writes them back.

Whatever has its default is left out where it is written, so an ideal sheet's JSON knows nothing of devices.
"""

from dataclasses import asdict
from typing import Any, Literal, cast

from eitskin_proto.files.plain import quoted
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene import limits
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Electrodes, Late, Sheet, SmoothField
from eitskin_sim.scene.strict_json import Fields, SceneError, number, numbers

IDEAL = ("gauge_factor", "field", "late")
"""Keys of a sheet that an ideal one lacks."""


def read_sheet(value: object, skin: Skin) -> Sheet:
    """Return the sheet of ``scene.sheet``; what it does not say is as the skin states it.

    Raises:
        SceneError: A key is unknown, or a value is outside its bounds.
    """
    where, stated = "scene.sheet", nominal_sheet(skin)
    fields = Fields(value, where)
    size = numbers(fields.take("size_mm", list(stated.size_mm)), f"{where}.size_mm", 2)
    for index, side in enumerate(size):
        number(side, f"{where}.size_mm[{index}]", above=0.0, low=1.0, high=10_000.0)
    if max(size) > limits.MOST_ASPECT * min(size):
        raise SceneError(
            f"{where}.size_mm is {size[0]:g} x {size[1]:g}; one side must be at most {limits.MOST_ASPECT:g} others"
        )
    sheet = Sheet(
        size_mm=(size[0], size[1]),
        thickness_mm=fields.number(
            "thickness_mm", stated.thickness_mm, low=limits.LEAST_THICKNESS_MM, high=limits.MOST_THICKNESS_MM
        ),
        conductivity_S_per_m=fields.number(
            "conductivity_S_per_m", stated.conductivity_S_per_m, above=0.0, low=1e-6, high=1e8
        ),
        gauge_factor=fields.number("gauge_factor", stated.gauge_factor, low=-limits.MOST_GAUGE, high=limits.MOST_GAUGE),
        field=_field(fields.take("field", None), f"{where}.field"),
        late=_late(fields.take("late", None), f"{where}.late"),
    )
    fields.close()
    return sheet


def _field(value: object, where: str) -> SmoothField | None:
    if value is None:
        return None
    fields = Fields(value, where)
    for key in ("rms", "correlation_mm"):
        if key not in fields:
            raise SceneError(f"{where} has no {key}; it must have rms and correlation_mm, and may have a seed")
    field = SmoothField(
        rms=fields.number("rms", 0.0, low=0.0, high=limits.MOST_UNEVEN),
        correlation_mm=fields.number("correlation_mm", 0.0, low=limits.LEAST_CORRELATION_MM, high=limits.FARTHEST),
        seed=_seed(fields),
    )
    fields.close()
    return field


def _late(value: object, where: str) -> Late | None:
    if value is None:
        return None
    fields = Fields(value, where)
    late = Late(
        factor=fields.number("factor", 1.0, above=0.0, low=1.0 / limits.MOST_DRIFT, high=limits.MOST_DRIFT),
        gradient_rms=fields.number("gradient_rms", 0.0, low=0.0, high=limits.MOST_UNEVEN),
        field=_field(fields.take("field", None), f"{where}.field"),
        seed=_seed(fields),
    )
    fields.close()
    return late


def _seed(fields: Fields) -> int:
    found = fields.number("seed", 0, low=0, high=limits.MOST_SEED)
    if found != int(found):
        raise SceneError(f"{fields.where}.seed is {found:g}; it must be an integer")
    return int(found)


def even_arc_length_mm(size_mm: tuple[float, float]) -> tuple[float, ...]:
    """Return sixteen even positions on the border of a sheet, as the paper's are on its own."""
    perimeter = 2.0 * (size_mm[0] + size_mm[1])
    return tuple(perimeter * (0.4 + k) / 16 for k in range(16))


def read_electrodes(value: object, sheet: Sheet, skin: Skin) -> Electrodes:
    """Return the electrodes of ``scene.electrodes``; what it does not say is as the skin states it.

    On a sheet of another size than the skin's they are even by default.

    Raises:
        SceneError: A key is unknown, or a value is outside its bounds.
    """
    where, stated = "scene.electrodes", nominal_electrodes(skin)
    fields = Fields(value, where)
    contact = fields.take("contact", stated.contact)
    if not isinstance(contact, str) or contact not in ("patch", "edge"):
        raise SceneError(f"{where}.contact is {quoted(contact)}; it must be 'patch' or 'edge'")
    own = sheet.size_mm == skin.outline.size_mm
    arc = stated.arc_length_mm if own else even_arc_length_mm(sheet.size_mm)
    electrodes = Electrodes(
        contact=cast(Literal["patch", "edge"], contact),
        size_mm=_each(fields, "size_mm", stated.size_mm, low=0.01),
        contact_impedance_ohm_m2=_each(
            fields, "contact_impedance_ohm_m2", stated.contact_impedance_ohm_m2, low=1e-9, high=1e6
        ),
        arc_length_mm=numbers(fields.take("arc_length_mm", arc), f"{where}.arc_length_mm", 16),
    )
    fields.close()
    return electrodes


def _each(
    fields: Fields, key: str, default: float | tuple[float, ...], *, low: float, high: float | None = None
) -> float | tuple[float, ...]:
    """Return a number of all electrodes, or one of each."""
    where, value = f"{fields.where}.{key}", fields.take(key, default)
    if not isinstance(value, list | tuple):
        return number(value, where, above=0.0, low=low, high=high)
    found = numbers(value, where, N_ELECTRODES)
    return tuple(number(one, f"{where}[{k}]", above=0.0, low=low, high=high) for k, one in enumerate(found))


def sheet_json(sheet: Sheet) -> dict[str, Any]:
    """Return the JSON of a sheet; what an ideal one lacks is there only where it is not ideal."""
    return {key: value for key, value in asdict(sheet).items() if key not in IDEAL or value}
