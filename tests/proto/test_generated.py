import runpy
from pathlib import Path

FIRMWARE = Path(__file__).parents[2] / "firmware_proto"
GENERATE = runpy.run_path(str(FIRMWARE / "generate.py"))


def test_the_c_header_is_what_the_generator_writes():
    assert GENERATE["header"]() == (FIRMWARE / "core" / "eit_wire.h").read_text()


def test_the_tables_of_the_specification_are_what_the_generator_writes():
    text = (FIRMWARE / "SPEC.md").read_text()
    assert GENERATE["spec"](text) == text
    damaged = text.replace("configuration_digest", "configuration_digit")
    assert GENERATE["spec"](damaged) != damaged
