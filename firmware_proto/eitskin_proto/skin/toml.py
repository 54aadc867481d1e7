"""A skin's description as a TOML file: every key says its unit, and a key that is not known is an error.

::

    format = "eitskin-skin"
    version = 1
    name = "paper"
    [outline] [layer] [electrodes] [front_end] [map] [deformations] [touches] [may_be_off]

A table or key that is left out has the paper's value. Keys and bounds are those of :mod:`eitskin_proto.skin.parts`.
"""

import difflib
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

from eitskin_proto.files.plain import plain, quoted
from eitskin_proto.files.reading import parse_toml
from eitskin_proto.files.shipped import is_name, parse_file, text_named
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.parts import Deformations, Doubts, Instrument, Layer, Map, Outline, Ring, Touches
from eitskin_proto.skin.quantity import LAWS, Law, Quantity
from eitskin_proto.skin.reach import check_reach
from eitskin_proto.skin.skin import Skin

FORMAT: Final = "eitskin-skin"
VERSION: Final = 1

TABLES: Final[dict[str, type]] = {
    "outline": Outline, "layer": Layer, "electrodes": Ring, "front_end": Instrument, "map": Map,
    "deformations": Deformations, "touches": Touches, "may_be_off": Doubts,
}  # fmt: skip
"""Tables of the file, and the part of a skin that each is."""

TEXTS: Final = ("name", "calibrated_from", "stated_grid_id")
HEAD: Final = ("format", "version", *TEXTS)

NAMED: Final = ("paper", "hydrogel", "lab")
"""Descriptions that come with the package."""

LONGEST_NAME: Final = 60

A_LINE: Final = 8
"""Numbers of a list on one line."""


def load(path: str | Path) -> Skin:
    """Return the skin of a TOML file, or of one that comes with the package if only its name is given.

    Raises:
        ValueError: The file's content is wrong; the text names file and key.
        OSError: There is no such file.
    """
    if is_name(path, NAMED):
        return named(str(path))
    return parse_file(path, parse)


def named(name: str) -> Skin:
    """Return a skin that comes with the package: paper, hydrogel or lab.

    Raises:
        ValueError: There is none of this name.
    """
    return parse(text_named(name, NAMED, "skins", "skin"))


def parse(text: str) -> Skin:
    """Return the skin of a TOML text.

    Raises:
        ValueError: Not TOML, an unknown key, a wrong type, an impossible value or uncertainty, or parts that contradict
            each other.
    """
    content = parse_toml(text)
    if content.get("format") != FORMAT or content.get("version") != VERSION:
        found = f"{quoted(content.get('format'))} version {quoted(content.get('version'))}"
        raise ValueError(f"format is {found}, expected {FORMAT!r} version {VERSION}: is it a skin's description?")
    unknown(content, [*HEAD, *TABLES], "the head of the file")
    texts: dict[str, Any] = {name: _text(content.get(name, ""), name) for name in TEXTS}
    parts: dict[str, Any] = {name: _part(kind, content.get(name, {}), name) for name, kind in TABLES.items()}
    skin = Skin(**{**texts, "name": texts["name"] or "unnamed"}, **parts)
    if not skin.calibrated_from:  # what was found is as uncertain as it was found
        check_reach(skin)
    return skin


def unknown(content: dict[str, Any], known: list[str], where: str) -> None:
    """Raise ValueError if a key is not known, with the nearest one that is."""
    for key in content:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, 1, 0.5)
            meant = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
            raise ValueError(f"unknown key {quoted(key)} in {where}{meant}")


def to_toml(skin: Skin) -> str:
    """Return the TOML text of a skin; :func:`parse` gives the same skin back."""
    lines = [f'format = "{FORMAT}"', f"version = {VERSION}", f'name = "{_escaped(skin.name)}"']
    origin = {"calibrated_from": skin.calibrated_from, "stated_grid_id": skin.stated_grid_id}
    lines += [f'{name} = "{_escaped(text)}"' for name, text in origin.items() if text]
    for name in TABLES:
        part = getattr(skin, name)
        lines += ["", f"[{name}]", *(f"{one.name} = {_shown(getattr(part, one.name))}" for one in fields(part))]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _shown(value: Any) -> str:
    if isinstance(value, Quantity):
        stated = _shown(value.value)
        return stated if value.law == "exact" else f"{{value = {stated}, {value.law} = {value.spread!r}}}"
    if isinstance(value, tuple):
        shown = [_shown(one) for one in value]
        if len(shown) <= A_LINE:
            return f"[{', '.join(shown)}]"
        lines = (", ".join(shown[start : start + A_LINE]) for start in range(0, len(shown), A_LINE))
        return "[\n" + "".join(f"    {line},\n" for line in lines) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _text(value: object, name: str) -> str:
    if not isinstance(value, str) or len(value) > LONGEST_NAME or plain(value) != value:
        raise ValueError(f"{name} is {quoted(value)}, expected a text of at most {LONGEST_NAME} printable characters")
    return value


def _part(kind: type, content: object, table: str) -> Any:
    if not isinstance(content, dict):
        raise ValueError(f"{table} is {quoted(content)}, expected a table [{table}]")
    hints = get_type_hints(kind)
    own = {one.name: one for one in fields(kind)}
    unknown(content, list(own), f"[{table}]")
    return kind(**{key: _value(value, own[key], hints[key], f"[{table}] {key}") for key, value in content.items()})


def _value(value: object, own: Field[Any], hint: Any, where: str) -> Any:
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise ValueError(f"{where} is {quoted(value)}, expected one of {', '.join(get_args(hint))}")
        return value
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{where} is {quoted(value)}, expected true or false")
        return value
    if hint is Quantity:
        return _quantity(value, own, where)
    if hint is float:
        return _number(value, own, where)
    whole = get_args(hint)[0] is int  # a pair
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{where} is {quoted(value)}, expected two numbers [a, b]")
    pair = tuple(_number(one, own, where, whole=whole) for one in value)
    if not own.metadata["sizes"] and pair[0] > pair[1]:
        raise ValueError(f"{where} is from {pair[0]:g} to {pair[1]:g}; the first is the smaller one")
    return pair


def _number(value: object, own: Field[Any], where: str, *, whole: bool = False) -> float:
    low, high = own.metadata["low"], own.metadata["high"]
    fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if not fits or not low <= value <= high:
        kind = "a whole number" if whole else "a number"
        raise ValueError(f"{where} is {quoted(value)}, expected {kind} from {low:g} to {high:g}")
    return value if whole else float(value)  # type: ignore[return-value, arg-type]


def _quantity(value: object, own: Field[Any], where: str) -> Quantity:
    laws = [law for law in LAWS if law != "exact"]
    law: Law = "exact"
    spread: Any = 0.0
    if isinstance(value, dict):
        unknown(value, ["value", *laws], where)
        given = [one for one in laws if one in value]
        if "value" not in value or len(given) != 1:
            raise ValueError(f"{where} has {', '.join(value)}; expected value and one of {', '.join(laws)}")
        law, spread, value = given[0], value[given[0]], value["value"]
        if isinstance(spread, bool) or not isinstance(spread, int | float) or not 0.0 <= spread < 1e6:
            raise ValueError(f"{where} {law} is {quoted(spread)}, expected a number from 0 on")
    if isinstance(value, list) and own.metadata["each"]:
        if len(value) != N_ELECTRODES:
            of = own.metadata["each"]
            raise ValueError(f"{where} has {len(value)} numbers, expected one, or {N_ELECTRODES}, one {of}")
        return Quantity(tuple(_number(one, own, f"{where}[{k}]") for k, one in enumerate(value)), law, float(spread))
    return Quantity(_number(value, own, where), law, float(spread))
