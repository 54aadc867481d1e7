"""The live page says in words whatever code SPEC.md lists."""

import re

import pytest

from .markdown import ROOT

SPEC = (ROOT / "firmware_proto/SPEC.md").read_text(encoding="utf-8")
VIEW = ROOT / "tools/eitskin_tools/view"
WORDS = (VIEW / "static/words.js").read_text(encoding="utf-8")


def table(head):
    """Return the rows of the table of SPEC.md that begins so, cell by cell."""
    (rows,) = re.findall(rf"^{re.escape(head)}.*\n\|[-|]+\n((?:\|.*\n)+)", SPEC, re.MULTILINE)
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows.splitlines()]


def codes(head):
    """Return what stands in the first column of a table."""
    return [code for first, *_ in table(head) for code in first.split(", ")]


def words(name):
    """Return {code: words} of a table of words.js."""
    (rows,) = re.findall(rf"^const {name} = \{{\n(.*?)\n\}};$", WORDS, re.MULTILINE | re.DOTALL)
    return dict(re.fullmatch(r'  "?([\w:]+)"?: "(.+)",', row).groups() for row in rows.splitlines())


def told_otherwise(file):
    """Return the codes that a file leaves out of what happened, because the page shows them in another place."""
    (found,) = re.findall(r"^(?:const )?TOLD_OTHERWISE.*? = .*?([(\[][^)\]]+[)\]])", file.read_text(), re.MULTILINE)
    return set(re.findall(r'"(\w+)"', found))


@pytest.mark.parametrize(
    ("head", "name"),
    [("| text | what was left out |", "SKIPPED"), ("| reason | the frame |", "WITHHELD"),
     ("| state | frames | means |", "VERIFIER")],
)  # fmt: skip
def test_each_code_has_words_and_no_words_are_of_another_code(head, name):
    assert set(words(name)) == set(codes(head))
    assert len(set(words(name).values())) == len(words(name)), "no two have the same words"


def test_each_event_has_words_or_is_told_in_another_place():
    listed, otherwise = codes("| text | what happened |"), told_otherwise(VIEW / "static/diary.js")
    assert {"lost", "device:NAME", "electrode:N:back", "withheld:REASON"} <= set(listed)
    kinds = set(re.findall(r'kind === "(\w+)"', WORDS))
    of_a_kind = {code for code in listed if re.search("[A-Z]", code)}
    assert {code.partition(":")[0] for code in of_a_kind} == kinds
    assert set(words("EVENTS")) | otherwise == set(listed) - of_a_kind
    assert not set(words("EVENTS")) & otherwise
    assert told_otherwise(VIEW / "film/overview.py") == otherwise


def test_what_a_value_means_is_true_of_each_solver_and_bundle():
    (relative, else_words), *more = re.findall(r'solver === "tikhonov" \? "(.+)" : "(.+)";', WORDS)
    assert more == []
    meanings = dict(table("| solver | a pixel's value |"))
    assert relative.split(":")[0] in meanings["tikhonov"]
    of_bundles = {name: meaning for name, meaning in meanings.items() if name.startswith("vd2t")}
    assert len(of_bundles) == 2
    for meaning in of_bundles.values():
        assert any(word in meaning and word in else_words for word in ("share", "probability")), meaning
    assert f">{else_words}<" in (VIEW / "static/index.html").read_text(encoding="utf-8"), "before the first frame"
