"""People read words, not codes: on a terminal and on the page of ``eitskin view``."""

import re
from pathlib import Path

from eitskin.messaging.streams.verified import STATES
from eitskin.pipeline.intake import REASONS
from eitskin_proto.wire.codes import EventCode
from eitskin_tools.console.words import EVENTS, SKIPPED, WITHHELD, electrode_words, event_words, skipped_words

SPEC = (Path(__file__).parents[3] / "firmware_proto" / "SPEC.md").read_text("utf-8")


def listed(title):
    """Return the codes of a table of SPEC.md that are written without a placeholder."""
    table = SPEC.split(f"\n### {title}\n")[1].split("\n#")[0].split("| reason |")[0]
    rows = re.findall(r"^\| ([a-z_:, ]+) \|", table, re.MULTILINE)
    return {code for row in rows for code in row.split(", ")} - {"text"}


def test_each_event_and_all_saved_computation_of_the_specification_have_words():
    events = listed("events")
    assert {"lost", "device_reset", "cloud", "drift:uneven"} <= events
    events |= {f"verifier:{state}" for state in STATES} | {f"device:{code.name.lower()}" for code in EventCode}
    assert set(EVENTS) == events
    assert set(SKIPPED) == listed("skipped")
    assert set(WITHHELD) == set(REASONS)


def test_codes_with_values_have_words_and_an_unknown_code_is_readable():
    assert event_words("withheld:stale") == "frame withheld: too late, a newer one came"
    assert event_words("rows:0-12, 40:frozen") == "rows 0-12, 40 frozen (estimated)"
    assert event_words("drift:+34%") == "drift of +34 %, or a long touch"
    assert event_words("electrode:7:swapped with 8:rearranged") == "electrode 7 swapped with 8 (rows reordered)"
    assert event_words("electrode:7:back") == "electrode 7 works again"
    assert electrode_words("3:not reciprocal:imputed") == "electrode 3 inconsistent (rows estimated)"
    assert (event_words("brand_new:of_it"), skipped_words("a_b")) == ("brand new: of it", "a b")
