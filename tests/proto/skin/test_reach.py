"""How far a skin's file may say that things are off: what cannot be is refused by its key."""

import pytest

from eitskin_proto.skin.toml import parse

HEAD = 'format = "eitskin-skin"\nversion = 1\n'
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
