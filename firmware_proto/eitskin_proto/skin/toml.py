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
        check_reach(skin)
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


SDS: Final = 3.0
"""Standard deviations that must be possible."""

MOST_LOG: Final = 4.0
"""Standard deviation of a logarithm: three of them are more than five decades."""

POSSIBLE: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "layer": {
        "thickness_mm": (0.01, 100.0),
        "conductivity_S_per_m": (1e-9, 1e9),
        "gauge_factor": (-20.0, 20.0),
        "length_scale": (0.5, 2.0),
        "width_scale": (0.5, 2.0),
    },
    "front_end": {
        "gain": (0.01, 100.0),
        "offset_V": (-200.0, 200.0),
        "minus_gain": (0.1, 10.0),
        "sink_share": (0.1, 10.0),
    },
    "may_be_off": {
        "drift": (-1.5, 1.5),
        "reference_stretch": (-0.3, 0.3),
        "scan_scale": (0.5, 2.0),
    },
}
"""From, to: true values that can be. What is not here is kept within bounds where it is drawn."""


def check_reach(skin: Skin) -> None:
    """Refuse a skin whose true values, as far off as its file says, could not be.

    Raises:
        ValueError: With the key, what was found and what was expected.
    """
    for table in ("layer", "electrodes", "front_end", "may_be_off"):
        part = getattr(skin, table)
        for name in part.__dataclass_fields__:
            quantity = getattr(part, name)
            if isinstance(quantity, Quantity) and quantity.spread:
                where = f"[{table}] {name}"
                _check_logarithm(quantity, where)
                if bounds := POSSIBLE.get(table, {}).get(name):
                    _check_bounds(quantity, where, bounds)
    _check_electrodes(skin)


def _check_logarithm(quantity: Quantity, where: str) -> None:
    if quantity.law != "log_normal":
        return
    if not np.all(quantity.value):
        raise ValueError(f"{where} is log_normal about 0, which is 0 exactly; expected another value, or normal")
    if quantity.spread > MOST_LOG:
        raise ValueError(
            f"{where} log_normal is {quantity.spread:g}, expected at most {MOST_LOG:g}: of the natural logarithm"
        )


def _check_bounds(quantity: Quantity, where: str, bounds: tuple[float, float]) -> None:
    value = np.atleast_1d(np.array(quantity.value, dtype=np.float64))
    if quantity.law == "log_normal":
        ends = np.outer(np.exp([-SDS * quantity.spread, SDS * quantity.spread]), value)
    else:
        off = quantity.spread * (1.0 if quantity.law == "uniform" else SDS)
        ends = np.array([value - off, value + off])
    low, high = float(ends.min()), float(ends.max())
    if not bounds[0] <= low <= high <= bounds[1]:
        how = "" if quantity.law == "uniform" else f" within {SDS:g} standard deviations"
        raise ValueError(
            f"{where} is from {low:.4g} to {high:.4g}{how}, expected between {bounds[0]:g} and {bounds[1]:g}: make its "
            f"{quantity.law} = {quantity.spread:g} smaller"
        )


def _check_electrodes(skin: Skin) -> None:
    """Refuse places that are off by more than half of the room to the next electrode, and sizes by more than a size."""
    ring = skin.electrodes
    arc, size = skin.arc_length_mm, ring.size_mm.nominal(N_ELECTRODES)
    room = (np.roll(arc, -1) - arc) % skin.outline.perimeter_mm - (size + np.roll(size, -1)) / 2.0
    k = int(room.argmin())
    most = float(room[k]) * (1.0 if ring.arc_length_mm.law == "uniform" else 0.5)
    if ring.arc_length_mm.law in ("normal", "uniform") and ring.arc_length_mm.spread > most:
        raise ValueError(
            f"[electrodes] arc_length_mm {ring.arc_length_mm.law} is {ring.arc_length_mm.spread:g}, expected at most "
            f"{most:.4g}: there are {room[k]:.4g} mm between electrodes {k} and {(k + 1) % N_ELECTRODES}, which would "
            "overlap"
        )
    if ring.size_mm.law in ("normal", "uniform") and ring.size_mm.spread > size.min():
        raise ValueError(
            f"[electrodes] size_mm {ring.size_mm.law} is {ring.size_mm.spread:g}, expected at most {size.min():g}, the "
            "size of the smallest"
        )


FILES: Final = ShippedFiles(NAMED, "skins", "skin", parse)
load, named = FILES.load, FILES.named
