"""Ways to damage a file, drawn from a seed: its bytes, or its values."""

import copy
import io
import json
import random
import zipfile
from typing import Any, Final

import numpy as np

from . import samples

HOSTILE: Final[tuple[Any, ...]] = (
    None, True, False, 0, -1, 1, 2**31, -(2**63), 10**400, 1e308, -1e308, 1e-308, 5e-324, float("nan"), float("inf"),
    "", "abc", "\x1b[2J\x1b]0;x\x07", "\u202etxt", "a\nb", "\ud800", "x" * 5000, [], {}, [[]], [1, 2], {"a": 1},
    ["\x1b"], "eitskin", 0.5, 1e5, -0.0, "../../etc/passwd", "/dev/zero", [float("nan")] * 104, [1e300] * 104,
)  # fmt: skip
"""Values that nobody expects."""


def changed(value: Any, rng: random.Random) -> Any:
    """Return parsed JSON with one to three of its places changed."""
    found = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        found = _changed_once(found, rng)
    return found


def _changed_once(root: Any, rng: random.Random) -> Any:
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
        for key in list(keys)[:40]:
            places.append((value, key))
            walk(value[key])

    walk(root)
    if not places or rng.random() < 0.03:
        return copy.deepcopy(rng.choice(HOSTILE))
    holder, key = rng.choice(places)
    how = rng.randrange(10)
    if how == 0:
        del holder[key]
    elif how == 1:
        holder[key] = f"@nested{rng.choice((20, 200, 100_000))}@"
    elif how == 2 and isinstance(holder, dict):
        holder[rng.choice(("unknown", "\x1b[31m", "sha256", ""))] = copy.deepcopy(rng.choice(HOSTILE))
    elif how == 3 and isinstance(holder, list) and holder:
        holder.extend(holder * rng.choice((1, 3, 5000 // len(holder) + 1)))
    elif how == 4 and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
        holder[key] = holder[key] * rng.choice((-1, 0, 1e-9, 1e-3, 0.5, 2, 1e3, 1e9, 1e18))
    else:
        holder[key] = copy.deepcopy(rng.choice(HOSTILE))
    return root


def text_of(value: Any) -> str:
    """Return JSON, with what stands for deep nesting put in."""
    text = json.dumps(value)
    while (at := text.find('"@nested')) >= 0:
        end = text.index('@"', at + 2)
        depth = int(text[at + 8 : end])
        text = text[:at] + "[" * depth + "]" * depth + text[end + 2 :]
    return text


def bent(data: bytes, rng: random.Random) -> bytes:
    """Return bytes that were cut, flipped, filled, doubled or put in front."""
    at, found = rng.randrange(len(data) + 1), bytearray(data)
    match rng.randrange(9):
        case 0:
            return data[:at]
        case 1:
            for _ in range(rng.choice((1, 1, 4, 50)) if data else 0):
                found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
            return bytes(found)
        case 2:
            return data[:at] + rng.randbytes(rng.choice((1, 8, 500))) + data[at:]
        case 3:
            return data[:at] + bytes(min(200, len(data) - at)) + data[at + 200 :]
        case 4:
            return data + data
        case 5:
            return rng.choice((b"", bytes(1000), b"PK\3\4" + data, b"\x93NUMPY" + data, b"\n" * 99_999))
        case 6:
            return rng.randbytes(rng.choice((1, 100, 10_000)))
        case 7:  # in a header or a text: a number, and a much larger one
            sought, strange = b"0123456789", rng.choice((b"9" * 15, b"-1", b"1e300", b"nan", b"9" * 5000, b"((("))
        case _:
            sought, strange = b"[({,\"'", b""
    places = [at for at, byte in enumerate(data[:4000]) if byte in sought] or [0]
    at = rng.choice(places)
    return data[:at] + (strange or data[at : at + 1] * rng.choice((2, 60, 100_000))) + data[at + 1 :]


def array(rng: random.Random) -> bytes:
    """Return a .npy file that is not what anybody asked for."""
    shape = rng.choice(((), (0,), (104,), (104, 104), (1350, 104), (3, 30, 45), (7, 3), (5, 104), (2, 2, 2, 2), (1, 0)))
    kind = rng.choice(("f8", "f4", "f2", "i4", "u1", "?", "c16", "U3", "S4", "O", "M8[s]", "i8"))
    if kind == "O":
        return samples.npy(np.array([{"a": 1}, print], dtype=object))
    values = np.asfortranarray(np.zeros(shape, dtype=kind)) if rng.random() < 0.3 else np.ones(shape).astype(kind)
    if kind.startswith("f") and values.size and rng.random() < 0.5:
        values.flat[0] = rng.choice((np.nan, np.inf, 1e4, -1.0, 6e-8))
    data = samples.npy(values)
    if rng.random() < 0.5:
        return data
    header = rng.choice((
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000, 104), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (104,",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': [('a', '<f8'), ('b', 'O')], 'fortran_order': False, 'shape': (3,), }",
        "{'descr': '|V0', 'fortran_order': False, 'shape': (99999999999,), }",
        "{'descr': '<U999999', 'fortran_order': False, 'shape': (0,), }",
        "(" * 800, "{" * 100 + "}" * 100, "__import__('os').system('true')", "\x00" * 60,
    ))  # fmt: skip
    raw = header.encode("latin-1")
    return b"\x93NUMPY\x01\x00" + len(raw).to_bytes(2, "little") + raw + bytes(800)


def valued(array: Any, rng: random.Random) -> bytes:
    """Return a .npy file of an array's shape with numbers that nobody expects; a text becomes another one."""
    if array.dtype.kind == "U":
        return samples.npy(np.full(array.shape, rng.choice(("", "\x1b[2J", "x" * 5000, "a\nb", "\u202etxt", "nan"))))
    values = np.array(array, dtype=np.float64)
    hostile = rng.choice((np.nan, np.inf, -1.0, 0.0, 5e-324, 1e-300, 1e39, 1e300, -1e300, 0.5, 1e6))
    how = rng.randrange(4)
    if how == 0:
        values[...] = hostile
    elif how == 1:
        values *= hostile if np.isfinite(hostile) else -1.0
    else:
        for _ in range(rng.choice((1, 3, 100))):
            values.reshape(-1)[rng.randrange(values.size)] = hostile
    kinds = ("f8", "f8", "f4", array.dtype.str)
    with np.errstate(all="ignore"):
        return samples.npy(values.astype(rng.choice(kinds)))


def zipped(parts: dict[str, bytes]) -> bytes:
    """Return a ZIP file of these members."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for name, data in parts.items():
            packed.writestr(name, data)
    return out.getvalue()


def archive(parts: dict[str, bytes], rng: random.Random) -> bytes:
    """Return a ZIP file with members that are missing, strange, repeated, packed, or that explode."""
    how, out = rng.randrange(8), io.BytesIO()
    parts = dict(parts)
    if parts and how in (0, 1):
        name = rng.choice(list(parts))
        if how == 0:
            del parts[name]
        else:
            parts[name] = array(rng) if rng.random() < 0.5 else bent(parts[name], rng)
    method = zipfile.ZIP_DEFLATED if how in (2, 3) else zipfile.ZIP_STORED
    with zipfile.ZipFile(out, "w", method) as packed:
        for name, data in parts.items():
            packed.writestr(name, data)
        if how == 3:
            name = rng.choice(list(parts))
            bomb = bytes(64 << 20)
            packed.writestr(f"x{name}", bomb)
        elif how == 4:
            for number in range(3000):
                packed.writestr(f"\x1b[{number}.npy", b"")
        elif how == 5:
            packed.writestr("../up.npy", b"\x93NUMPY")
    data = out.getvalue()
    if how == 6:
        at = data.rfind(b"PK\5\6")
        return data[: at + 8] + b"\xff\xff\xff\xff" + data[at + 12 :]
    if how == 7:
        return bent(data, rng)
    return data
