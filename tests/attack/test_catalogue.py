"""Every attack can be loaded, and the page about attacks names each."""

import re
from pathlib import Path

from .catalogue import ATTACKS, load

PAGE = Path(__file__).parents[2] / "docs" / "attacks.md"


def test_every_attack_is_a_function() -> None:
    assert all(callable(load(name)) for name in ATTACKS)


def test_the_page_names_each_attack_and_no_other() -> None:
    first_table, _ = PAGE.read_text(encoding="utf-8").split("## What must hold")
    assert re.findall(r"^\| ([a-z_-]+\.[a-z_-]+) \|", first_table, re.MULTILINE) == list(ATTACKS)
