"""Every ``eitskin`` command in the documents is understood by the command line as it is."""

import contextlib
import io
import re
import shlex
from functools import cache
from itertools import pairwise

from eitskin_tools.bench.verify import chosen_rows
from eitskin_tools.cli import _parser

from .markdown import commands, pages

parser_of = cache(_parser)

PLACEHOLDERS = {"K": "2", "K-L": "2-4", "MM": "10", "N": "2", "S": "5", "X": "1", "Y": "2", "Z": "3"}
"""Numbers; every other word in capitals stands for a text."""


PROSE = "\n".join(path.read_text(encoding="utf-8") for path in pages()).replace("\n", " ")


def words_of(command):
    """Return what a shell would hand over: comments, redirections and a trailing ellipsis are none of it."""
    words = shlex.split(command, comments=True)
    return [PLACEHOLDERS.get(word, word) for word in words[1:] if word not in ("...", "&")]


def is_form(command):
    """Whether this names a command's form and is not meant to be typed: ``eitskin flash show | diff | write``."""
    return bool(re.search(r"\s\|\s|\w\|\w", command))


def understood(words):
    """Return whether the command line takes these words, and what it says if not."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            parser_of(words[0] if not words[0].startswith("-") else None).parse_args(words)
    except SystemExit as end:
        return end.code == 0, said.getvalue()
    return True, ""


def all_commands():
    # The changelog names what was before as well.
    today = [path for path in pages() if path.name != "CHANGELOG.md"]
    return sorted({command for path in today for command in commands(path) if not is_form(command)})


def named_alone(words):
    """Whether a text only names a subcommand, as in "see `eitskin train`"."""
    return all(re.fullmatch(r"[a-z][a-z-]*", word) for word in words) and len(words) <= 2


def refused(command):
    """Return what the command line says against a command in the documents; nothing if it is understood."""
    words = words_of(command)
    taken, said = understood(words)
    if not taken and named_alone(words) and "required" in said:
        taken, said = understood([*words, "--help"])
    if not taken and "required: " in said and f"`{command}`" in PROSE:
        return ""  # within a sentence an option stands without what else the command needs
    return "" if taken else said


def test_every_command_in_the_documents_is_understood():
    assert {command: said for command in all_commands() if (said := refused(command))} == {}


def test_every_row_of_bench_verify_in_the_documents_exists():
    found = [words_of(command) for command in all_commands() if "bench verify" in command]
    texts = [text for words in found for before, text in pairwise(words) if before == "--only"]
    assert texts
    chosen_rows(texts)
