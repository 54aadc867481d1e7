"""Reads scenes and phantoms from JSON, strictly: unknown keys are errors, and a scene that comes back can be solved.

Touches lie on the sheet and are no smaller than an element, electrodes are apart, the bent sheet does not meet itself.
Where touches overlap, the later one in the list holds.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Literal, cast

from eitskin_proto.fields import Fields
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import FileError, parse_json, read_text
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene import limits
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.folds import check_bend
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import (
    Bend,
    Electrodes,
    LaterChanges,
    Phantom,
    Scene,
    SceneError,
    Sheet,
    SmoothField,
    Touch,
)
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape
from eitskin_sim.scene.soft_touch import check_touch, shape_json, soft_fields, soft_json

__all__ = [
    "Bend",
    "Electrodes",
    "Phantom",
    "Scene",
    "SceneError",
    "Sheet",
    "Touch",
    "check_scene",
    "load_phantoms",
    "load_scene",
    "parse_phantoms",
    "parse_scene",
    "scene_json",
]

REAL_SHEET_KEYS: Final = ("gauge_factor", "field", "late")
"""Keys of a sheet that an ideal one lacks."""

SHAPES: Final = ("rect_mm", "disc_mm", "ellipse_mm", "polygon_mm", "units")
"""Keys of a touch's shape, of which it has one."""


def load_scene(path: str | Path, skin: Skin = PAPER) -> Scene:
    """Return the scene that a JSON file holds.

    Args:
        path: The file.
        skin: The skin whose sheet, electrodes and units are the defaults.

    Raises:
        SceneError: The file is no valid scene.
        OSError: The file cannot be read.
    """
    value = _read(path)
    if isinstance(value, list):
        raise SceneError(
            f"{path} is a list, expected one scene; a list of phantoms is for 'eitskin evaluate --phantoms', "
            "the 'scene' of one of them is for this"
        )
    try:
        return parse_scene(value, skin)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def load_phantoms(path: str | Path, skin: Skin = PAPER) -> tuple[Phantom, ...]:
    """Return the phantoms that a JSON file holds.

    Args:
        path: The file.
        skin: As for :func:`load_scene`.

    Raises:
        SceneError: The file is no list of phantoms.
        OSError: The file cannot be read.
    """
    value = _read(path)
    try:
        return parse_phantoms(value, skin)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def _read(path: str | Path) -> object:
    try:
        text = read_text(path, limits.LARGEST_FILE)
    except FileError as error:
        raise SceneError(str(error)) from error
    return parse_text(text, str(path))


def parse_text(text: str, where: str) -> object:
    """Return the content of a JSON text; a repeated key, NaN or Infinity is a SceneError."""
    try:
        return parse_json(text, strict=True)
    except FileError as error:
        raise SceneError(f"{where} {error}") from error


def parse_phantoms(value: object, skin: Skin = PAPER) -> tuple[Phantom, ...]:
    """Return the phantoms of a parsed JSON list.

    Raises:
        SceneError: An entry is no phantom.
    """
    listed = fields_of({"phantoms": value}).entries("phantoms", most=limits.MAX_PHANTOMS, of="phantoms")
    found = []
    for index in listed:
        fields = listed.table(index)
        name = fields.value("name", str(index + 1))
        if not isinstance(name, str):
            raise fields.wrong("name", "a text")
        truth = cast(Literal["units", "area"], fields.choice("truth", ("units", "area"), "area"))
        scene = fields.value("scene", {})
        fields.close()
        try:
            found.append(Phantom(name, parse_scene(scene, skin), truth))
        except SceneError as error:
            raise SceneError(f"{fields.where} {quoted(name)}: {str(error).removeprefix('scene.')}") from error
    return tuple(found)


def fields_of(content: object, where: str = "") -> Fields:
    """Return a reader of an object of a scene's JSON; its errors are SceneErrors and give paths with dots."""
    return Fields(content, where, error=SceneError, joint=".")


def parse_scene(value: object, skin: Skin = PAPER) -> Scene:
    """Return the scene of a parsed JSON object, checked as a whole.

    Raises:
        SceneError: A key is unknown, or a value is outside its bounds; the message has both.
    """
    fields = fields_of(value, "scene")
    sheet = _sheet(fields.table("sheet"), skin)
    touches = fields.entries("touches", most=limits.MAX_SHAPES, of="touches")
    scene = Scene(
        sheet=sheet,
        electrodes=_electrodes(fields.table("electrodes"), sheet, skin),
        bend=_bend(fields.table("bend"), sheet),
        touches=tuple(_touch(touches.table(index), sheet, skin.grid.units) for index in touches),
        current_A=fields.number("current_A", 1.0, low=1e-9, high=1e6),
        element_size_mm=fields.number("element_size_mm", 1.5, above=0.0),
    )
    fields.close()
    check_scene(scene)
    return scene


def check_scene(scene: Scene) -> None:
    """Raise SceneError if a scene cannot be solved: an overlap, a touch off the sheet or too small, a fold."""
    count = sum(len(touch.shapes) for touch in scene.touches)
    if count > limits.MAX_SHAPES:
        raise SceneError(
            f"scene.touches has {count} shapes, units counted singly; expected at most {limits.MAX_SHAPES}"
        )
    length, width = scene.sheet.size_mm
    low, high = min(length, width) / 1000, min(length, width) / 8
    if not low <= scene.element_size_mm <= high:
        raise SceneError(
            f"scene.element_size_mm is {scene.element_size_mm:g}, expected a number from {low:g} to {high:g}"
        )
    place(scene.sheet, scene.electrodes)
    for index, touch in enumerate(scene.touches):
        check_touch(touch, scene.sheet, f"scene.touches[{index}]", scene.touches[:index])
        for shape in touch.shapes:
            _check_shape(shape, scene, f"scene.touches[{index}]")
    check_bend(scene.bend, scene.sheet, scene.touches)


def _check_shape(shape: Shape, scene: Scene, where: str) -> None:
    length, width = scene.sheet.size_mm
    x0, y0, x1, y1 = shape.bounds_mm
    for name, found, high in (("x", x0, length), ("y", y0, width), ("x", x1, length), ("y", y1, width)):
        if not -limits.ON_BORDER_MM <= found <= high + limits.ON_BORDER_MM:
            raise SceneError(f"{where} reaches outside the sheet: {name} = {found:g} mm; it must be from 0 to {high:g}")
    if shape.width_mm < scene.element_size_mm:
        raise SceneError(
            f"{where} is smaller than an element: it is {shape.width_mm:.4g} mm wide; element_size_mm is "
            f"{scene.element_size_mm:g}: lower it to {shape.width_mm:.4g} or less"
        )


def _sheet(fields: Fields, skin: Skin) -> Sheet:
    """Return the sheet of ``scene.sheet``; what it does not say is as the skin states it."""
    stated = nominal_sheet(skin)
    length, width = fields.numbers("size_mm", 2, stated.size_mm, low=1.0, high=10_000.0)
    if max(length, width) > limits.MAX_ASPECT * min(length, width):
        raise SceneError(
            f"{fields.where}.size_mm is {length:g} x {width:g}; one side must be at most {limits.MAX_ASPECT:g} others"
        )
    sheet = Sheet(
        size_mm=(length, width),
        thickness_mm=fields.number(
            "thickness_mm", stated.thickness_mm, low=limits.MIN_THICKNESS_MM, high=limits.MAX_THICKNESS_MM
        ),
        conductivity_S_per_m=fields.number("conductivity_S_per_m", stated.conductivity_S_per_m, low=1e-6, high=1e8),
        gauge_factor=fields.number("gauge_factor", stated.gauge_factor, low=-limits.MAX_GAUGE, high=limits.MAX_GAUGE),
        field=_field(fields),
        late=_late(fields),
    )
    fields.close()
    return sheet


def _field(sheet: Fields) -> SmoothField | None:
    if sheet.value("field", None) is None:
        return None
    fields = sheet.table("field")
    field = SmoothField(
        rms=fields.number("rms", low=0.0, high=limits.MAX_UNEVEN),
        correlation_mm=fields.number("correlation_mm", low=limits.MIN_CORRELATION_MM, high=limits.MAX_COORDINATE_MM),
        seed=_seed(fields),
    )
    fields.close()
    return field


def _late(sheet: Fields) -> LaterChanges | None:
    if sheet.value("late", None) is None:
        return None
    fields = sheet.table("late")
    late = LaterChanges(
        factor=fields.number("factor", 1.0, low=1.0 / limits.MAX_DRIFT, high=limits.MAX_DRIFT),
        gradient_rms=fields.number("gradient_rms", 0.0, low=0.0, high=limits.MAX_UNEVEN),
        field=_field(fields),
        seed=_seed(fields),
    )
    fields.close()
    return late


def _seed(fields: Fields) -> int:
    found = fields.number("seed", 0, low=0, high=limits.MAX_SEED)
    if found != int(found):
        raise fields.wrong("seed", "a whole number")
    return int(found)


def even_arc_length_mm(size_mm: tuple[float, float]) -> tuple[float, ...]:
    """Return sixteen even positions on the border of a sheet, as the paper's are on its own."""
    perimeter = 2.0 * (size_mm[0] + size_mm[1])
    return tuple(perimeter * (0.4 + k) / 16 for k in range(16))


def _electrodes(fields: Fields, sheet: Sheet, skin: Skin) -> Electrodes:
    """Return the electrodes of ``scene.electrodes``; what it does not say is as the skin states it.

    On a sheet of another size than the skin's they are even by default.
    """
    stated = nominal_electrodes(skin)
    own = sheet.size_mm == skin.outline.size_mm
    arc = stated.arc_length_mm if own else even_arc_length_mm(sheet.size_mm)
    electrodes = Electrodes(
        contact=cast(Literal["patch", "edge"], fields.choice("contact", ("patch", "edge"), stated.contact)),
        size_mm=_each(fields, "size_mm", stated.size_mm, low=0.01, high=limits.MAX_COORDINATE_MM),
        contact_impedance_ohm_m2=_each(
            fields, "contact_impedance_ohm_m2", stated.contact_impedance_ohm_m2, low=1e-9, high=1e6
        ),
        arc_length_mm=fields.numbers("arc_length_mm", N_ELECTRODES, arc),
    )
    fields.close()
    return electrodes


def _each(
    fields: Fields, key: str, default: float | tuple[float, ...], *, low: float, high: float
) -> float | tuple[float, ...]:
    """Return a number of all electrodes, or one of each."""
    if isinstance(fields.value(key, default), list | tuple):
        return fields.numbers(key, N_ELECTRODES, default, low=low, high=high)
    return fields.number(key, default, low=low, high=high)


def sheet_json(sheet: Sheet) -> dict[str, Any]:
    """Return the JSON of a sheet; what an ideal one lacks is there only where it is not ideal."""
    return {key: value for key, value in asdict(sheet).items() if key not in REAL_SHEET_KEYS or value}


def _bend(fields: Fields, sheet: Sheet) -> Bend:
    bumps = []
    listed = fields.entries("bumps_mm", most=limits.MAX_BUMPS, of="bumps")
    for index in listed:
        bump = listed.entries(index, least=4, most=4, of="numbers")
        x, y, height = (bump.number(k, low=-limits.MAX_COORDINATE_MM, high=limits.MAX_COORDINATE_MM) for k in range(3))
        bumps.append((x, y, height, bump.number(3, low=min(sheet.size_mm) / 1000, high=limits.MAX_COORDINATE_MM)))
    turn = {"low": -limits.MAX_TURN_DEG, "high": limits.MAX_TURN_DEG}
    stretch = {"low": 1.0 / limits.MAX_STRETCH, "high": limits.MAX_STRETCH}
    bend = Bend(
        angle_deg=fields.number("angle_deg", 0.0, **turn),
        axis_deg=fields.number("axis_deg", 0.0, **turn),
        skew=fields.number("skew", 0.0, low=-1.0, high=1.0),
        twist_deg=fields.number("twist_deg", 0.0, **turn),
        stretch_along=fields.number("stretch_along", 1.0, **stretch),
        stretch_across=fields.number("stretch_across", 1.0, **stretch),
        nonuniformity=fields.number("nonuniformity", 0.0, low=-limits.MAX_STRETCH, high=limits.MAX_STRETCH),
        bumps_mm=tuple(bumps),
    )
    fields.close()
    ratio = bend.stretch_along / bend.stretch_across
    if not 1.0 / limits.MAX_STRETCH <= ratio <= limits.MAX_STRETCH:
        raise SceneError(
            f"{fields.where}.stretch_along is {bend.stretch_along:g} and stretch_across {bend.stretch_across:g}; their "
            f"ratio is {ratio:g}, it must be from {1.0 / limits.MAX_STRETCH:g} to {limits.MAX_STRETCH:g}"
        )
    return bend


def _touch(fields: Fields, sheet: Sheet, units: tuple[int, int]) -> Touch:
    kinds = [kind for kind in SHAPES if kind in fields]
    if len(kinds) != 1:
        raise SceneError(f"{fields.where}: found {kinds or 'no shape'}, expected one of {', '.join(SHAPES)}")
    soft = soft_fields(fields, 0 if kinds[0] == "units" else 1)
    conductivity = fields.number("conductivity_S_per_m", 50.0, low=1e-9, high=1e9)
    shapes = _units(fields, sheet, units) if kinds[0] == "units" else (_shape(fields, kinds[0]),)
    fields.close()
    return Touch(shapes, conductivity, **soft)


def _shape(fields: Fields, key: str) -> Shape:
    """Return the rectangle, disc, ellipse or polygon of a touch."""
    where = fields.path(key)
    if key == "polygon_mm":
        return _polygon(fields.entries(key, least=3, most=limits.MAX_CORNERS, of="corners"), where)
    if key == "rect_mm":
        x0, y0, x1, y1 = fields.numbers(key, 4)
        if x1 <= x0 or y1 <= y0:
            raise SceneError(f"{where} is [{x0:g}, {y0:g}, {x1:g}, {y1:g}]; x1 must be above x0, and y1 above y0")
        return Rect(x0, y0, x1, y1)
    count = 3 if key == "disc_mm" else 5
    found = fields.entries(key, least=count, most=count, of="numbers")
    x, y = found.number(0), found.number(1)
    if key == "disc_mm":
        return Disc(x, y, found.number(2, above=0.0))
    return Ellipse(x, y, found.number(2, above=0.0), found.number(3, above=0.0), found.number(4))


def _polygon(listed: Fields, where: str) -> Shape:
    corners = [listed.numbers(index, 2) for index in listed]
    if corners[0] == corners[-1]:
        corners.pop()
    if len(corners) < 3:
        raise SceneError(f"{where} has {len(corners)} corners; it must have at least 3")
    if any(a == b for a, b in zip(corners, corners[1:] + corners[:1], strict=True)):
        raise SceneError(f"{where}: two neighbouring corners are the same point")
    polygon = Polygon(tuple((x, y) for x, y in corners))
    if not polygon.is_simple:
        raise SceneError(f"{where} crosses or touches itself; its sides must meet only at its corners")
    return polygon


def _units(fields: Fields, sheet: Sheet, units: tuple[int, int]) -> tuple[Shape, ...]:
    rows, columns = units
    dx, dy = sheet.size_mm[0] / columns, sheet.size_mm[1] / rows
    shapes: list[Shape] = []
    listed = fields.entries("units", least=1, most=rows * columns, of="units [column, row]")
    for index in listed:
        column, row = listed.numbers(index, 2)
        if column != int(column) or row != int(row) or not (0 <= column < columns and 0 <= row < rows):
            raise SceneError(
                f"{listed.path(index)} is [{column:g}, {row:g}]; column must be an integer from 0 to {columns - 1}, "
                f"row from 0 to {rows - 1}"
            )
        shapes.append(Rect(column * dx, row * dy, (column + 1) * dx, (row + 1) * dy))
    return tuple(shapes)


def scene_json(scene: Scene) -> str:
    """Return a scene as JSON that :func:`load_scene` reads back to the same scene; units come back as rectangles."""
    touches: list[dict[str, Any]] = []
    for touch in scene.touches:
        for shape in touch.shapes:
            key, value = shape_json(shape)
            touches.append({key: value, **soft_json(touch)})
    return json.dumps(
        {
            "sheet": sheet_json(scene.sheet),
            "electrodes": asdict(scene.electrodes),
            "bend": asdict(scene.bend),
            "touches": touches,
            "current_A": scene.current_A,
            "element_size_mm": scene.element_size_mm,
        }
    )
