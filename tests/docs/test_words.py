"""Documents, docstrings, comments and messages avoid phrases of a translated English, of which many were once here.

Each pattern has no good use in this project. Line lengths are tested in ``test_text``.
"""

import re
import subprocess

import pytest

from .markdown import ROOT

PHRASES = re.compile(
    r"""\b(
    whoever | so\ many\b(?!\ that) | stands?\ wherever | wherever\ a\ port | is\ told\ of\b | of\ one's\ own | of\ it\ all
    | is\ only\ told | nothing\ of\ it | decides\ over | networks?\ besides | what\ explains\ a\ frame
    | (?:was|is)\ (?:a\ \w+\ )?too\ (?:many|few),\ without\ which | would\ have\ been\ left | takes?\ for\ granted\ of
    | (?:who|what|whom)\ listens? | is\ none\ of\ it | are\ none\ of | no\ more\ than\ that\ | as\ it\ likes
    | are\ told\ apart\ by\ what | says\ so\ besides | besides\ it\b | and\ besides\b | besides:
    | is\ of\ all\ of\ it | of\ then\b | let\ alone\ besides | lies\ at\ hand | gone\ through\b | does\ without
    )""",
    re.IGNORECASE | re.VERBOSE,
)
