"""Text files of points (.xyz, .txt, .csv, .asc, .pts): a point a line, in columns.

A line of names says which columns are x, y and z; without one they are the first three behind a label, such as an
atom's. Numbers are parted by blanks, commas or semicolons, with a point or, where a comma does not part them, with a
comma for decimals. A whole number alone on a line is the count of the lines behind it, the first of which may be a
remark. A file that can be read in two ways is refused.
"""

import codecs
import re
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from eitskin_proto.files.plain import quoted
from eitskin_sim.arrays import Array
from eitskin_sim.surface.words import table

COMMENT: Final = re.compile(rb"[ \t]*(#|//|%|!|sep=|;(?![ \t]*[-+.,;\d]))[#/%! ]*")
"""How a line that holds no point begins; a semicolon before a number ends an empty column."""

REMARK: Final = re.compile(rb"(?<=\S)[ \t]+(#|//).*")
"""What follows a point on its line."""

LABEL: Final = re.compile(rb"(?!(nan|inf)\b)[A-Z]\S*", re.IGNORECASE)
"""A word that is no number, such as the name of an atom."""

NAME: Final = re.compile(rb"(?!(?:nan|inf)\b)([A-Z_]\w*?|)(?:[ _]?[\[(]?m?m[\])]?)?", re.IGNORECASE)
"""A column's name, which may be empty, with its unit if it has one."""

AXES: Final = {b"x", b"y", b"z"}

COLOURED: Final = 6
"""Columns of whole numbers that may be coordinates and colours, or three numbers with decimals behind commas."""


def read_text(data: bytes) -> Array:
    """Return the (n, 3) points of a file's bytes.

    Raises:
        ValueError: A line holds no point, or the file can be read in two ways.
    """
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if data.startswith(mark):
            data = data.decode(encoding).encode()
    if b"\0" in data:
        raise ValueError("it holds bytes of zero, which no text has: save it as text in UTF-8")
    lines = [
        (number, REMARK.sub(b"", line).replace(b'"', b""))
        for number, line in enumerate(data.removeprefix(codecs.BOM_UTF8).splitlines(), 1)
        if line and not line.isspace()
    ]
    names: list[bytes] = []
    remarked: list[bytes] = []
    while lines and (COMMENT.match(lines[0][1]) or _names(lines[0][1])):
        line = lines.pop(0)[1].lstrip()
        if remark := COMMENT.match(line):
            remarked = _names(line[remark.end() :]) or remarked
        else:
            names = _names(line)
            if not set(names) >= AXES:
                raise ValueError(
                    f"the columns are named {line.decode('latin-1')[:60]!r}, expected x, y and z among them"
                )
    lines = [(number, line) for number, line in lines if not COMMENT.match(line)]
    counts = [int(line) for _, line in lines if line.strip().isdigit()]
    lines = [(number, line) for number, line in lines if not line.strip().isdigit()]
    if counts and sum(counts) == len(lines) - 1 and sum(not LABEL.fullmatch(word) for word in lines[0][1].split()) < 3:
        lines.pop(0)  # a remark, as files of atoms have it
    if counts and sum(counts) != len(lines):
        raise ValueError(f"{sum(counts)} points are announced, found {len(lines)}")
    split = _splitter([line for _, line in lines], named=bool(names))
    width = len(split(lines[0][1])) if lines else 3
    if names and len(names) != width:
        raise ValueError(f"{width} numbers a line, expected {len(names)}, one for each named column")
    if not names and set(remarked) >= AXES and len(remarked) == width:
        names = remarked
    labelled = bool(not names and lines and LABEL.fullmatch(split(lines[0][1])[0]))
    columns = [names.index(axis) for axis in sorted(AXES)] if names else [labelled + axis for axis in range(3)]

    def rows() -> Iterator[list[bytes]]:
        for number, line in lines:
            words = split(line)
            if len(words) != width or width < 3 + labelled or (labelled and not LABEL.fullmatch(words[0])):
                found = quoted(line.decode("latin-1").strip())
                raise ValueError(f"line {number} is {found}, expected x y z, and as many columns on every line")
            yield [words[column] for column in columns]

    found = table(rows())
    if not names and len(found) > 2 and width > 3 and np.all(np.diff(found[:, 0]) == 1.0):
        raise ValueError("the first column counts the lines: name the columns on line 1, such as 'id x y z'")
    return found


def _names(line: bytes) -> list[bytes]:
    """The names of columns on a line, in small letters; none if it has a word that is no name."""
    words = re.split(rb" *[,;\t] *| +(?![\[(])", line.strip(b" \t").removesuffix(b";"))
    names = [match[1].lower() for match in map(NAME.fullmatch, words) if match]
    return names if len(names) == len(words) and sum(map(bool, names)) >= 2 else []


def _splitter(lines: list[bytes], *, named: bool) -> Callable[[bytes], list[bytes]]:
    """How all lines are cut into words that Python reads as numbers."""
    comma = next((line for line in lines if b"," in line), None)
    pointed = any(b"." in line for line in lines)
    parted = any(b";" in line for line in lines)
    if comma is None and not parted:
        return lambda line: line.split()
    words = (comma or b"").split()
    if parted or (len(words) >= 3 and all(re.fullmatch(rb"[^,]+(,[^,]+)?", word) for word in words)):
        if comma and pointed:
            raise ValueError("the numbers have both commas and points: write decimals in one way")
        return lambda line: [
            word.strip() for word in line.replace(b",", b".").strip().removesuffix(b";").split(b";" if parted else None)
        ]
    if comma and comma.count(b",") == COLOURED - 1 and not named and not pointed:
        raise ValueError(
            f"{quoted(comma.decode('latin-1').strip())} may be three numbers with decimals or six whole ones: write "
            "decimals with a point, or part numbers by semicolons"
        )
    return lambda line: [word.strip() for word in line.split(b",")]
