"""No text of the project uses phrases of an English that reads as a riddle, of which many were once here.

The phrases have no good use. ``test_text`` tests the length of lines.
"""

import re
import subprocess

import pytest

from .markdown import ROOT, pages

ANYWHERE = (
    r"decides? over what|a touch too many|without which less|with networks besides|is of all of it|it is only told"
    r"|nothing of it is taken|whoever|stands? wherever|(?:is|are) told of|of one's own"
)
"""Not in documents, docstrings, comments or messages."""

IN_DOCUMENTS = (
    r"besides|so many|(?:is|are|was|were) told(?! apart)|those who|as it stands|in vain|gone through"
    r"|takes? it for|of then|of them all|(?:is|are) (?:not )?well|held against|beside other work|is met by"
)
"""Not in documents either."""

SUFFIXES = {
    ".md", ".ipynb", ".py", ".c", ".h", ".cpp", ".toml", ".html", ".js", ".css", ".sh", ".conf", ".service", ".rules",
}  # fmt: skip


def phrases(text, pattern):
    """Return the phrases of a text, across line breaks and the marks of comments."""
    flat = re.sub(r"\s*\n\s*(?:#|//|\*|\|)?\s*", " ", text)
    return re.findall(rf"\b(?:{pattern})\b", flat, re.IGNORECASE)


def test_documents_name_who_acts_and_what_is_done():
    found = {str(path.relative_to(ROOT)): phrases(path.read_text("utf-8"), IN_DOCUMENTS) for path in pages()}
    assert {name: said for name, said in found.items() if said} == {}


def test_no_text_has_the_phrases_of_a_translated_english():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip(f"the files of the project are not known: {listed.stderr.strip()}")
    paths = [path for name in listed.stdout.split("\0") if (path := ROOT / name).suffix in SUFFIXES and path.is_file()]
    found = {str(path.relative_to(ROOT)): phrases(path.read_text("utf-8"), ANYWHERE) for path in paths}
    found.pop("tests/docs/test_words.py", None)
    assert {name: said for name, said in found.items() if said} == {}
