"""The truth of a phantom: refused where it would be empty though something touches, and without its holes."""

from typing import Any

import pytest
from tests.second_skin import SECOND

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation.harness import Conditions, Run, evaluate_all
from eitskin_sim.evaluation.truth import check_truths
from eitskin_sim.scene.parts import Phantom, SceneError
from eitskin_sim.scene.scene import parse_phantoms


def phantoms(scene: dict[str, Any], truth: str = "area") -> tuple[Phantom, ...]:
    return parse_phantoms([{"name": "good", "scene": {}}, {"name": "a", "truth": truth, "scene": scene}])


LONG = {"sheet": {"size_mm": [160, 100]}, "touches": [{"disc_mm": [152, 45, 8], "contrast": 20}]}
COVERED = [{"disc_mm": [75, 50, 10], "contrast": 20}, {"rect_mm": [60, 30, 90, 70], "contrast": 1}]


@pytest.mark.parametrize(
    ("scene", "truth", "says"),
    [
        (
            LONG,
            "area",
            r"touches\[0\] is off the map: its middle is \(152, 45\) mm, on a sheet of 160 x 100 mm",
        ),
        (LONG, "units", r"expected 150 x 100 mm, that of skin 'paper': give the skin of this sheet with --skin FILE"),
        ({"sheet": {"size_mm": [75, 50]}}, "area", "sheet is 75 x 50 mm; expected 150 x 100 mm, each within a tenth"),
        ({"sheet": {"size_mm": [150, 90 - 1e-3]}}, "units", "give the skin of this sheet with --skin FILE"),
        ({"touches": [{"disc_mm": [75, 50, 3]}]}, "units", "no unit is touched: its touches cover none by half"),
        ({"touches": COVERED}, "area", "nothing is touched: holes remove its touches"),
    ],
)
def test_a_truth_that_would_be_empty_is_refused(scene: dict[str, Any], truth: str, says: str) -> None:
    for check in (check_truths, lambda of: evaluate_all(of, [Run(lambda case: case, "pre")], Conditions())):
        with pytest.raises(SceneError, match=rf"^phantoms\[1\] 'a': .*{says}") as raised:
            check(phantoms(scene, truth))
        assert "\n" not in str(raised.value)


def test_a_touch_is_on_the_map_of_its_own_skin() -> None:
    far = {"touches": [{"disc_mm": [180, 50, 8]}]}
    own = parse_phantoms([{"scene": far}], SECOND)
    check_truths(own, SECOND)
    with pytest.raises(SceneError, match="its sheet is 220 x 90 mm"):
        check_truths(own, PAPER)
