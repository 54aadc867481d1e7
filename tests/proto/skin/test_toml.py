"""A skin's file: what is written is read back, and what is wrong is named with what was meant."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import NAMED, load, named, parse, to_toml

HEAD = 'format = "eitskin-skin"\nversion = 1\n'


@pytest.mark.parametrize("name", NAMED)
def test_what_is_written_is_read_back(name, tmp_path):
    skin = named(name)
    assert parse(to_toml(skin)) == skin
    (tmp_path / "skin.toml").write_text(to_toml(skin))
    assert load(tmp_path / "skin.toml").digest == load(name).digest == skin.digest


def test_the_paper_s_file_states_what_is_meant_without_one():
    assert named("paper") == PAPER
    assert parse(HEAD).digest == PAPER.digest


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"format is None version None, expected 'eitskin-skin' version 1: is it a skin's description\?"),
        ('format = "eitskin-recipe"\nskin = "lab"\n', "format is 'eitskin-recipe' version None, expected"),
        ('format = "eitskin-skin"\nversion = 2\n', "version 2, expected 'eitskin-skin' version 1"),
        (HEAD + "[outlines]\n", r"unknown key 'outlines' in the file; did you mean 'outline'\?"),
        (HEAD + "[layer]\nthickness = 2.0\n", r"unknown key 'thickness' in \[layer\]; did you mean 'thickness_mm'\?"),
        (HEAD + "[layer]\nthickness_mm = 200.0\n", "thickness_mm is 200.0, expected a number from 0.05 to 20"),
        (HEAD + "[layer]\nthickness_mm = {value = 2.0}\n", "expected value and one of normal, uniform, log_normal"),
        (HEAD + "[electrodes]\nsize_mm = [4.0, 4.0]\n", "is a list of 2, expected one number, or 16, one an electrode"),
        (HEAD + "[front_end]\ngain = [1, 1, 1]\n", "gain is a list of 3, .* or 16, one a measured pair"),
        (HEAD + "[electrodes]\nsize_mm = 40.0\n", "overlap"),
        (HEAD + "[outline]\nsize_mm = [1000.0, 100.0]\n", r"size_mm\[0\] is 1000.0, expected a number from 50 to 400"),
        (HEAD + '[touches]\nkind = "lowering"\n', "kind is 'lowering', expected one of lower, raise, both"),
        (HEAD + "[touches]\nhigher = false\n", "neither lower nor higher"),
        (HEAD + "[touches]\nsize_mm = [20.0, 5.0]\n", "from 20 to 5, expected the smaller number first"),
        (HEAD + 'name = "a\\u001b[2J"\n', "expected a text of at most 60 printable characters"),
        ("format = ", "not a TOML file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(text, words):
    with pytest.raises(ValueError, match=words):
        parse(text)


@pytest.mark.parametrize(("lower", "higher", "kind"), [(0, 1, "raise"), (1, 0, "lower"), (1, 1, "both")])
def test_the_truth_values_of_earlier_releases_say_which_touches_there_are(lower, higher, kind):
    said = {0: "false", 1: "true"}
    found = parse(f"{HEAD}[touches]\nlower = {said[lower]}\nhigher = {said[higher]}\n")
    assert found == parse(f'{HEAD}[touches]\nkind = "{kind}"\n')
    assert found.digest == parse(to_toml(found)).digest


def test_a_skin_that_does_not_come_with_the_package_is_refused():
    with pytest.raises(ValueError, match="skin 'gel' does not come with the package; paper, hydrogel, lab do"):
        named("gel")


ARC = "arc_length_mm.value = [10, 40, 70, 100, 130, 160, 190, 220, 250, 280, 310, 340, 370, 400, 430, 460]\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "[layer]\nthickness_mm = {value = 2, uniform = 3}",
            r"thickness_mm is from -1 to 5, expected between 0\.01 and",
        ),
        (
            "[layer]\nthickness_mm = {value = 2, normal = 1}",
            "from -1 to 5 within 3 standard deviations, .*: make its normal",
        ),
        (
            "[layer]\nlength_scale = {value = 1, uniform = 3}",
            r"\[layer\] length_scale is from -2 to 4, expected between 0\.5",
        ),
        ("[front_end]\ngain = {value = 1, normal = 5}", r"\[front_end\] gain is from -14 to 16"),
        ("[front_end]\nminus_gain = {value = 1, normal = 1}", r"\[front_end\] minus_gain is from -2 to 4"),
        ("[front_end]\noffset_V = {value = 0, log_normal = 5}", "offset_V is log_normal about 0, which is 0 exactly"),
        ("[front_end]\nstray_pF = {value = 40, log_normal = 5}", "stray_pF log_normal is 5, expected at most 4"),
        ("[may_be_off]\ndrift = {value = 0, normal = 100}", r"\[may_be_off\] drift is from -300 to 300"),
        (
            "[electrodes]\narc_length_mm.uniform = 100000\n" + ARC,
            r"uniform is 100000, expected at most 26: there are 26 mm",
        ),
        (
            "[electrodes]\narc_length_mm.normal = 14\n" + ARC,
            "normal is 14, expected at most 13: .* 0 and 1, which would ov",
        ),
        ("[electrodes]\nsize_mm = {value = 4, normal = 5}", "size_mm normal is 5, expected at most 4"),
    ],
)
def test_what_cannot_be_off_so_far_is_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse(HEAD + text)


def test_what_can_be_is_read_and_what_calibration_found_is_as_uncertain_as_it_was_found() -> None:
    for text in (
        "[layer]\nthickness_mm = {value = 0.1, log_normal = 0.5}\ngauge_factor = {value = 0, uniform = 3}",
        "[electrodes]\nsize_mm = {value = 4, normal = 2}\narc_length_mm.normal = 5\n" + ARC,
        "[front_end]\noffset_V = {value = 0, uniform = 0.3}\nstray_pF = {value = 0, uniform = 50}",
    ):
        parse(HEAD + text)
    parse(HEAD + 'calibrated_from = "feed"\n[layer]\nthickness_mm = {value = 2, normal = 1}')


@pytest.mark.parametrize("size", ["[220.0, 90.0]", "[160.0, 110.0]", "[60.0, 50.0]"])
def test_electrodes_without_places_are_spread_evenly_along_another_border(size):
    skin = parse(HEAD + f"[electrodes]\nsize_mm = 2.0\n[outline]\nsize_mm = {size}\n")
    gaps = np.diff(skin.arc_length_mm, append=skin.arc_length_mm[0] + skin.outline.perimeter_mm)
    assert np.allclose(gaps, skin.outline.perimeter_mm / 16)


def test_electrodes_that_end_before_the_border_does_are_refused():
    arcs = [12.5 + 31.25 * k for k in range(16)]
    with pytest.raises(ValueError, match=r"leaves 151.2 of 620 mm free behind electrode 15.*all round"):
        parse(HEAD + f"[outline]\nsize_mm = [220.0, 90.0]\n[electrodes]\narc_length_mm = {arcs}\n")
