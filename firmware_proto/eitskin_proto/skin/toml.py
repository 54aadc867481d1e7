"""A skin's description as a TOML file: every key says its unit, and a key that is not known is an error.

::

    format = "eitskin-skin"
    version = 1
    name = "paper"
    [outline] [layer] [electrodes] [front_end] [map] [deformations] [touches] [may_be_off]

A table or key that is left out has the paper's value; electrodes without places are spread evenly along the border of
another outline. Keys and bounds are those of :mod:`eitskin_proto.skin.parts`.
"""

from dataclasses import Field, fields, replace
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

import numpy as np

from eitskin_proto.fields import Fields
from eitskin_proto.files.reading import ShippedFiles, parse_toml
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.parts import Deformations, Doubts, Instrument, Layer, Map, Outline, Ring, Touches
from eitskin_proto.skin.quantity import LAWS, Law, Quantity
from eitskin_proto.skin.skin import Skin

FORMAT: Final = "eitskin-skin"
VERSION: Final = 1

TABLES: Final[dict[str, type]] = {
    "outline": Outline, "layer": Layer, "electrodes": Ring, "front_end": Instrument, "map": Map,
    "deformations": Deformations, "touches": Touches, "may_be_off": Doubts,
}  # fmt: skip
"""Tables of the file, and the part of a skin that each is."""

TEXTS: Final = ("name", "calibrated_from", "stated_grid_id")

NAMED: Final = ("paper", "hydrogel", "lab")
"""Descriptions that come with the package."""

LONGEST_NAME: Final = 60

SPREADS: Final[tuple[Law, ...]] = tuple(law for law in LAWS if law != "exact")
"""Keys of a quantity that is not known exactly."""

MOST_SPREAD: Final = 1e6

SDS: Final = 3.0
"""Standard deviations that must be possible."""

MOST_GAP: Final = 2.5
"""A gap between electrodes of more than this many times the second largest is where they do not go round."""

A_LINE: Final = 8
"""Numbers of a list on one line."""


def parse(text: str) -> Skin:
    """Return the skin of a TOML text.

    Raises:
        ValueError: Not TOML, an unknown key, a wrong type, an impossible value or uncertainty, or parts that contradict
            each other.
    """
    content = Fields(parse_toml(text), "")
    content.check_format(FORMAT, VERSION, "a skin's description")
    texts: dict[str, Any] = {name: content.text(name, "", least=0, longest=LONGEST_NAME) for name in TEXTS}
    tables = {name: content.table(name, f"[{name}]") for name in TABLES}
    content.close()
    tables["touches"] = _with_kind(tables["touches"])
    placed = "arc_length_mm" in tables["electrodes"]
    parts: dict[str, Any] = {name: _part(kind, tables[name]) for name, kind in TABLES.items()}
    if not placed and parts["outline"] != Outline():
        parts["electrodes"] = _spread(parts["electrodes"], parts["outline"].perimeter_mm)
    skin = Skin(**{**texts, "name": texts["name"] or "unnamed"}, **parts)
    _check_round(skin)
    if not skin.calibrated_from:  # a calibrated value has the uncertainty of its calibration
        _check_signs(skin)
    return skin


def _spread(ring: Ring, perimeter_mm: float) -> Ring:
    """Return the paper's electrodes, moved evenly along another border."""
    own = ring.arc_length_mm.nominal(N_ELECTRODES) * (perimeter_mm / Outline().perimeter_mm)
    return replace(ring, arc_length_mm=replace(ring.arc_length_mm, value=tuple(own.tolist())))


def _check_round(skin: Skin) -> None:
    """Refuse electrodes that end before the border does, as those of a smaller sheet would."""
    gaps = (np.roll(skin.arc_length_mm, -1) - skin.arc_length_mm) % skin.outline.perimeter_mm
    second, largest = np.sort(gaps)[-2:]
    if largest > MOST_GAP * second:
        k = int(gaps.argmax())
        raise ValueError(
            f"[electrodes] arc_length_mm leaves {largest:.4g} of {skin.outline.perimeter_mm:.4g} mm free behind "
            f"electrode {k}, expected electrodes all round: leave arc_length_mm out to spread them evenly"
        )


def _check_signs(skin: Skin) -> None:
    """Refuse what is positive and could be negative, as far off as the file says: a layer of -1 mm."""
    for table, kind in TABLES.items():
        for one in fields(kind):
            found = getattr(getattr(skin, table), one.name)
            if isinstance(found, Quantity) and found.law in ("normal", "uniform") and one.metadata["low"] > 0.0:
                sds = SDS if found.law == "normal" else 1.0
                if (least := float(np.min(found.value)) - sds * found.spread) <= 0.0:
                    raise ValueError(
                        f"[{table}] {one.name} is down to {least:.4g}, expected above 0: make its {found.law} = "
                        f"{found.spread:g} smaller"
                    )


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


def _with_kind(touches: Fields) -> Fields:
    """Return [touches] with ``kind``; files of earlier releases have the truth values ``lower`` and ``higher``."""
    if not ("lower" in touches or "higher" in touches):
        return touches
    lower, higher = touches.truth("lower", False), touches.truth("higher", True)
    if not (lower or higher):
        raise ValueError("[touches] has neither lower nor higher, expected one of them: the skin would detect nothing")
    rest = {key: touches.value(key) for key in touches if key not in ("lower", "higher")}
    kind = "both" if lower and higher else "lower" if lower else "raise"
    return Fields({"kind": kind} | rest, touches.where)


def _part(kind: type, content: Fields) -> Any:
    hints = get_type_hints(kind)
    content.only(hints)
    return kind(**{one.name: _value(content, one, hints[one.name]) for one in fields(kind) if one.name in content})


def _value(content: Fields, own: Field[Any], hint: Any) -> Any:
    """Return the value of one field of a part, of the kind that the part declares."""
    key = own.name
    if get_origin(hint) is Literal:
        return content.choice(key, get_args(hint))
    if hint is bool:
        return content.truth(key)
    bounds = {name: own.metadata[name] for name in ("low", "high")}
    if hint is float:
        return content.number(key, **bounds)
    if hint is Quantity:
        return _quantity(content, own, bounds)
    if get_args(hint)[0] is int:
        return content.wholes(key, least=2, most=2, **bounds)
    pair = content.numbers(key, 2, **bounds)
    if not own.metadata["sizes"] and pair[0] > pair[1]:
        raise ValueError(f"{content.path(key)} is from {pair[0]:g} to {pair[1]:g}, expected the smaller number first")
    return pair


def _quantity(content: Fields, own: Field[Any], bounds: dict[str, float]) -> Quantity:
    law: Law = "exact"
    key, spread = own.name, 0.0
    if isinstance(content.value(key), dict):
        stated = content.table(key)
        stated.only(["value", *SPREADS])
        laws = [law for law in SPREADS if law in stated]
        if "value" not in stated or len(laws) != 1:
            raise ValueError(f"{stated.where} has {', '.join(stated)}; expected value and one of {', '.join(SPREADS)}")
        law, spread = laws[0], stated.number(laws[0], low=0.0, high=MOST_SPREAD)
        content, key = stated, "value"
    if own.metadata["each"] and isinstance(value := content.value(key), list):
        if len(value) != N_ELECTRODES:
            of = own.metadata["each"]
            raise content.wrong(key, f"one number, or {N_ELECTRODES}, one {of}")
        return Quantity(content.numbers(key, N_ELECTRODES, **bounds), law, spread)
    return Quantity(content.number(key, **bounds), law, spread)


FILES: Final = ShippedFiles(NAMED, "skins", "skin", parse)
load, named = FILES.load, FILES.named
