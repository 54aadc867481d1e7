"""Pools of touches and the sets drawn from them: on the sheet, apart, varied, never a phantom, split by touch."""

import numpy as np
import pytest

from eitskin_sim.freeform import draws
from eitskin_sim.freeform.draws import (
    CLUSTERED_SHARE,
    Bar,
    SetDrawer,
    SetPool,
    middles_mm,
    near_table,
    set_pool,
)
from eitskin_sim.freeform.sets import chains
from eitskin_sim.freeform.touches import CLASSES, CONTRAST, LONGEST_MM, touch_pool
from eitskin_sim.scene.gap import gap_mm, half_extents_mm
from eitskin_sim.scene.touch_table import TouchTable, bounds, shape_of


@pytest.fixture(scope="module")
def pool() -> SetPool:
    return set_pool({4: (900, 90), 5: (900, 90)}, 1)


def rectangle(x: float, y: float, length: float, width: float, angle: float = 0.0) -> list[float]:
    return [0.0, x, y, length, width, angle, 50.0]


def disc(x: float, y: float, diameter: float) -> list[float]:
    return [1.0, x, y, diameter, diameter, 0.0, 50.0]


@pytest.mark.parametrize(
    ("one", "other", "gap"),
    [
        (disc(0, 0, 10), disc(13, 0, 4), 6.0),
        (disc(0, 0, 10), rectangle(12, 0, 8, 30), 3.0),
        (rectangle(12, 9, 8, 8), disc(5, 2, 4), np.hypot(3, 3) - 2),
        (rectangle(0, 0, 10, 4), rectangle(9, 0, 6, 20), 1.0),
        (rectangle(0, 0, 10, 10, 45.0), rectangle(15, 0, 10, 10), 10 - np.sqrt(50)),
        (rectangle(0, 0, 30, 2), rectangle(0, 0, 2, 30), -16.0),
    ],
)
def test_the_gap_between_two_pieces(one: list[float], other: list[float], gap: float) -> None:
    for a, b in ((one, other), (other, one)):
        assert gap_mm(np.array([a]), np.array([b]))[0] == pytest.approx(gap)


# Corner faces corner: shadows say less than the distance, never more.
def test_a_gap_is_never_overrated() -> None:
    touches = touch_pool(300, np.random.default_rng(0)).pieces
    one, other = touches[:40], touches[150:190]
    found = gap_mm(one, other)
    rim = np.linspace(0.0, 1.0, 30)
    for a, b, gap in zip(one, other, found, strict=True):
        points = [
            np.concatenate(
                [rim[:, None] * p + (1 - rim[:, None]) * q for p, q in zip(c, np.roll(c, 1, 0), strict=True)]
            )
            for c in (_outline(a), _outline(b))
        ]
        nearest = np.sqrt(((points[0][:, None] - points[1]) ** 2).sum(axis=-1)).min()
        assert gap <= nearest + 0.05  # chords of discs
        assert gap > 0.0 or nearest < 60.0


def _outline(piece: np.ndarray) -> np.ndarray:
    shape = shape_of(piece)
    if piece[0] == 1.0:
        angle = np.linspace(0.0, 2 * np.pi, 60)
        return piece[1:3] + piece[3] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    x0, y0, x1, y1 = bounds(piece)
    return np.asarray(getattr(shape, "corners_mm", [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))


def test_touches_of_a_pool_are_on_the_sheet_and_varied(pool: SetPool) -> None:
    pieces = pool.parts.pieces
    assert 0.15 < pieces[:, 0].mean() < 0.4
    assert np.all((pieces[:, 6] >= CONTRAST[0]) & (pieces[:, 6] <= CONTRAST[1]))
    assert len(np.unique(pieces[:, 6])) == 2 * CLASSES
    assert 60.0 < pieces[:, 3:5].max() <= LONGEST_MM
    assert pieces[:, 3:5].min() > 2.0
    half = half_extents_mm(pieces)
    assert np.all(pieces[:, 1:3] >= half - 1e-9)
    assert np.all(pieces[:, 1:3] <= np.array([150.0, 100.0]) - half + 1e-9)
    boxes = np.array([bounds(piece) for piece in pieces])
    assert boxes[:, 2:] - boxes[:, :2] == pytest.approx(2 * half)


# Each set of a chain is the one before and a touch more: what makes a factor serve several sets.
def test_sets_come_in_families_that_begin_with_touches_in_turn(pool: SetPool) -> None:
    sets = pool.sets[4]
    own = [sets.of(number).tolist() for number in range(900)]
    lengths = [[len(own[number]) for number in chain] for chain in chains(sets)]
    assert sum(len(chain) for chain in lengths) == 900
    assert all(row == sorted(row) for row in lengths)
    assert 900 / len(lengths) > 2.0
    singles = [touches[0] for touches in own[:810] if len(touches) == 1]
    assert max(np.bincount(singles)) <= 4  # 235 chains begin with 162 touches in turn, a few are drawn again


@pytest.mark.parametrize("near", [0.0, CLUSTERED_SHARE, 0.8])
def test_as_many_pairs_as_asked_for_lie_near_to_each_other(near: float) -> None:
    """Near: nearer than all but a fifth of the pairs of touches that may stand together at all."""
    pool = set_pool({4: (900, 90), 5: (900, 90)}, 1, near)
    middle = middles_mm(pool.parts)
    barred = near_table(pool.parts)[:-1, :-1]
    one, other = np.triu_indices(len(middle), 1)
    may = ~barred[one, other]
    bound_mm = np.quantile(np.hypot(*(middle[one] - middle[other]).T)[may], 0.2)
    first, second = (
        np.concatenate([sets.member[sets.first[:-1][np.diff(sets.first) > 1] + place] for sets in pool.sets.values()])
        for place in (0, 1)
    )
    free = first % CLASSES != second % CLASSES  # of one conductivity there are too few for one of 8 to be near
    first, second = first[free], second[free]
    share = float((np.hypot(*(middle[first] - middle[second]).T) < bound_mm).mean())
    # Of 8 the nearest is among the nearest fifth with a chance of 1 - 0.8^8 = 0.83; bounds leave four deviations
    expected = near * 0.83 + (1 - near) * 0.2
    assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / len(first)) + 0.06


def test_no_touch_of_a_set_held_out_is_ever_learned_from(pool: SetPool) -> None:
    learned = {int(part) for sets in pool.sets.values() for n in range(810) for part in sets.of(n)}
    held = {int(part) for sets in pool.sets.values() for n in range(810, 900) for part in sets.of(n)}
    assert learned
    assert held
    assert not learned & held


# The bound is on correlation, so it may bar more than it must, and never less.
def test_no_phantom_passes_not_even_slightly_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = touch_pool(64, np.random.default_rng(5))
    pieces = np.concatenate([np.array([rectangle(75.2, 50.1, 60.0, 10.0)]), moved.pieces])
    with_phantom = TouchTable(pieces, np.concatenate([[0], moved.first + 1]))
    bar = Bar(with_phantom)
    alone = np.full((len(with_phantom), 8), -1)
    alone[:, 0] = np.arange(len(with_phantom))
    assert bar.may_resemble(alone)[0]
    assert bar.may_resemble(alone).mean() < 0.05
    monkeypatch.setattr(draws, "COUNT_CHANCES", (0.0, 1.0))
    sets = SetDrawer(with_phantom).draw(2_000, np.random.default_rng(6))
    assert len(sets) == 2_000
    assert 0 not in sets.member
