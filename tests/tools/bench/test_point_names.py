import itertools
from typing import Any

import pytest

from eitskin_tools.bench.tradeoff.point_names import PLACES, beside

pyplot = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture
def axes() -> Any:
    pyplot.switch_backend("Agg")
    figure, found = pyplot.subplots(figsize=(7.0, 5.0))
    found.set(xlim=(0.0, 100.0), ylim=(0.0, 100.0))
    yield found
    pyplot.close(figure)


def test_names_of_points_side_by_side_lie_over_no_name_and_no_point(axes: Any) -> None:
    points = [(50.0, 50.0), (52.0, 50.0), (54.0, 51.0), (10.0, 90.0), (14.0, 90.0)]
    texts = beside(axes, points, ["a name of some length"] * len(points))
    boxes = [text.get_window_extent() for text in texts]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
    for x, y in axes.transData.transform(points):
        assert not any(box.contains(x, y) for box in boxes)


@pytest.mark.parametrize("point", [(99.0, 50.0), (1.0, 50.0), (50.0, 99.0), (50.0, 1.0), (99.0, 99.0), (1.0, 1.0)])
def test_a_name_stays_inside_the_axes(axes: Any, point: tuple[float, float]) -> None:
    (text,) = beside(axes, [point], ["a name of some length"])
    box, inside = text.get_window_extent(), axes.get_window_extent()
    assert inside.contains(box.x0, box.y0)
    assert inside.contains(box.x1, box.y1)


def test_more_names_at_one_point_than_places_stand_right_and_above(axes: Any) -> None:
    count = len(PLACES) + 1
    texts = beside(axes, [(50.0, 50.0)] * count, ["name"] * count)
    held = [(text.get_horizontalalignment(), text.get_verticalalignment()) for text in texts]
    assert held[0] == held[-1] == PLACES[0]
