"""Reads scenes and phantoms from JSON, strictly: unknown keys are errors, and a scene that comes back can be solved.

Touches lie on the sheet and are no smaller than an element, electrodes are apart, the bent sheet does not meet itself.
Where touches overlap, the later one in the list holds.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Literal, cast

from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import FileError, read_text
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene import limits
from eitskin_sim.scene.device.read import read_electrodes, read_sheet, sheet_json
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.folds import check_bend
from eitskin_sim.scene.parts import Bend, Electrodes, Phantom, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc, Polygon, Rect, Shape
from eitskin_sim.scene.soft_touch import check_touch, ellipse, shape_json, soft_fields, soft_json
from eitskin_sim.scene.strict_json import Fields, SceneError, loads, number, numbers, sequence

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

SHAPES: Final = ("rect_mm", "disc_mm", "ellipse_mm", "polygon_mm", "units")
"""Keys of a touch's shape, of which it has one."""


def load_scene(path: str | Path, skin: Skin = PAPER) -> Scene:
    """Return the scene that a JSON file holds.

    Args:
        path: The file.
        skin: Whose sheet, electrodes and units it means where it does not say.

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
    return loads(text, str(path))


def parse_phantoms(value: object, skin: Skin = PAPER) -> tuple[Phantom, ...]:
    """Return the phantoms of a parsed JSON list.

    Raises:
        SceneError: An entry is no phantom.
    """
    found = []
    for index, item in enumerate(sequence(value, "phantoms", limits.MOST_PHANTOMS)):
        fields = Fields(item, f"phantoms[{index}]")
        name, truth = fields.take("name", str(index + 1)), fields.take("truth", "area")
        scene = fields.take("scene", {})
        fields.close()
        if not isinstance(name, str) or not isinstance(truth, str) or truth not in ("units", "area"):
            raise SceneError(
                f"phantoms[{index}]: found name {quoted(name)}, truth {quoted(truth)}; expected a string, and "
                "'units' or 'area'"
            )
        try:
            parsed = parse_scene(scene, skin)
        except SceneError as error:
            raise SceneError(f"phantoms[{index}] {quoted(name)}: {str(error).removeprefix('scene.')}") from error
        found.append(Phantom(name, parsed, cast(Literal["units", "area"], truth)))
    return tuple(found)


def parse_scene(value: object, skin: Skin = PAPER) -> Scene:
    """Return the scene of a parsed JSON object, checked as a whole.

    Raises:
        SceneError: A key is unknown, or a value is outside its bounds; the message has both.
    """
    fields = Fields(value, "scene")
    sheet = read_sheet(fields.take("sheet", {}), skin)
    scene = Scene(
        sheet=sheet,
        electrodes=read_electrodes(fields.take("electrodes", {}), sheet, skin),
        bend=_bend(fields.take("bend", {}), sheet),
        touches=tuple(
            _touch(item, sheet, skin.grid.units, f"scene.touches[{i}]")
            for i, item in enumerate(sequence(fields.take("touches", []), "scene.touches", limits.MOST_SHAPES))
        ),
        current_A=fields.number("current_A", 1.0, above=0.0, low=1e-9, high=1e6),
        element_size_mm=fields.number("element_size_mm", 1.5, above=0.0),
    )
    fields.close()
    check_scene(scene)
    return scene


def check_scene(scene: Scene) -> None:
    """Raise SceneError if a scene cannot be solved: an overlap, a touch off the sheet or too small, a fold."""
    count = sum(len(touch.shapes) for touch in scene.touches)
    if count > limits.MOST_SHAPES:
        raise SceneError(
            f"scene.touches has {count} shapes, units counted singly; expected at most {limits.MOST_SHAPES}"
        )
    length, width = scene.sheet.size_mm
    number(scene.element_size_mm, "scene.element_size_mm", low=min(length, width) / 1000, high=min(length, width) / 8)
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


def _bend(value: object, sheet: Sheet) -> Bend:
    where = "scene.bend"
    fields = Fields(value, where)
    bumps = []
    for index, item in enumerate(sequence(fields.take("bumps_mm", []), f"{where}.bumps_mm", limits.MOST_BUMPS)):
        at = f"{where}.bumps_mm[{index}]"
        x, y, height, sigma = numbers(item, at, 4)
        number(sigma, f"{at}[3] (sigma)", above=0.0, low=min(sheet.size_mm) / 1000, high=limits.FARTHEST)
        for part, name in ((x, "x"), (y, "y"), (height, "height")):
            number(part, f"{at} ({name})", low=-limits.FARTHEST, high=limits.FARTHEST)
        bumps.append((x, y, height, sigma))
    bend = Bend(
        angle_deg=fields.number("angle_deg", 0.0, low=-limits.MOST_TURN_DEG, high=limits.MOST_TURN_DEG),
        axis_deg=fields.number("axis_deg", 0.0, low=-limits.MOST_TURN_DEG, high=limits.MOST_TURN_DEG),
        skew=fields.number("skew", 0.0, low=-1.0, high=1.0),
        twist_deg=fields.number("twist_deg", 0.0, low=-limits.MOST_TURN_DEG, high=limits.MOST_TURN_DEG),
        stretch_along=fields.number("stretch_along", 1.0, low=1.0 / limits.MOST_STRETCH, high=limits.MOST_STRETCH),
        stretch_across=fields.number("stretch_across", 1.0, low=1.0 / limits.MOST_STRETCH, high=limits.MOST_STRETCH),
        nonuniformity=fields.number("nonuniformity", 0.0, low=-limits.MOST_STRETCH, high=limits.MOST_STRETCH),
        bumps_mm=tuple(bumps),
    )
    fields.close()
    ratio = bend.stretch_along / bend.stretch_across
    if not 1.0 / limits.MOST_STRETCH <= ratio <= limits.MOST_STRETCH:
        raise SceneError(
            f"{where}.stretch_along is {bend.stretch_along:g} and stretch_across {bend.stretch_across:g}; their ratio "
            f"is {ratio:g}, it must be from {1.0 / limits.MOST_STRETCH:g} to {limits.MOST_STRETCH:g}"
        )
    return bend


def _touch(value: object, sheet: Sheet, units: tuple[int, int], where: str) -> Touch:
    fields = Fields(value, where)
    kinds = [kind for kind in SHAPES if kind in fields]
    if len(kinds) != 1:
        raise SceneError(f"{where}: found {kinds or 'no shape'}, expected one of {', '.join(SHAPES)}")
    soft = soft_fields(fields, 0 if kinds[0] == "units" else 1)
    conductivity = fields.number("conductivity_S_per_m", 50.0, above=0.0, low=1e-9, high=1e9)
    shape = fields.take(kinds[0], None)
    fields.close()
    readers = {"rect_mm": _rect, "disc_mm": _disc, "ellipse_mm": ellipse, "polygon_mm": _polygon}
    at = f"{where}.{kinds[0]}"
    if kinds[0] == "units":
        return Touch(_units(shape, sheet, units, at), conductivity, **soft)
    return Touch((readers[kinds[0]](shape, at),), conductivity, **soft)


def _rect(value: object, where: str) -> Shape:
    x0, y0, x1, y1 = numbers(value, where, 4)
    if x1 <= x0 or y1 <= y0:
        raise SceneError(f"{where} is [{x0:g}, {y0:g}, {x1:g}, {y1:g}]; x1 must be above x0, and y1 above y0")
    return Rect(x0, y0, x1, y1)


def _disc(value: object, where: str) -> Shape:
    x, y, radius = numbers(value, where, 3)
    return Disc(x, y, number(radius, f"{where}[2] (radius)", above=0.0))


def _polygon(value: object, where: str) -> Shape:
    listed = sequence(value, where, limits.MOST_CORNERS)
    corners = [numbers(item, f"{where}[{i}]", 2) for i, item in enumerate(listed)]
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    if len(corners) < 3:
        raise SceneError(f"{where} has {len(corners)} corners; it must have at least 3")
    if any(a == b for a, b in zip(corners, corners[1:] + corners[:1], strict=True)):
        raise SceneError(f"{where}: two neighbouring corners are the same point")
    polygon = Polygon(tuple((x, y) for x, y in corners))
    if not polygon.is_simple:
        raise SceneError(f"{where} crosses or touches itself; its sides must meet only at its corners")
    return polygon


def _units(value: object, sheet: Sheet, units: tuple[int, int], where: str) -> tuple[Shape, ...]:
    rows, columns = units
    dx, dy = sheet.size_mm[0] / columns, sheet.size_mm[1] / rows
    shapes: list[Shape] = []
    for index, item in enumerate(sequence(value, where, rows * columns)):
        column, row = numbers(item, f"{where}[{index}]", 2)
        if column != int(column) or row != int(row) or not (0 <= column < columns and 0 <= row < rows):
            raise SceneError(
                f"{where}[{index}] is [{column:g}, {row:g}]; column must be an integer from 0 to {columns - 1}, "
                f"row from 0 to {rows - 1}"
            )
        shapes.append(Rect(column * dx, row * dy, (column + 1) * dx, (row + 1) * dy))
    if not shapes:
        raise SceneError(f"{where} is empty; name at least one unit")
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
