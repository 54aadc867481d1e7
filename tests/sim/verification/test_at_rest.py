"""What a sheet reads at rest: closed forms, and what is left of what was not known."""

import numpy as np
import pytest

from eitskin_sim.verification import constants
from eitskin_sim.verification.at_rest import at_rest

ROWS = 40
NONE = np.zeros(ROWS)


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """A touch changes nothing of what is off."""
    monkeypatch.setattr(constants, "MODEL_ERROR_SHARE_OF_TOUCH", 0.0)
    monkeypatch.setattr(constants, "ROW_ERROR_BY_TOUCH", 0.0)


@pytest.mark.usefixtures("exact")
def test_one_way_in_which_a_sheet_differs_is_weighed_against_noise() -> None:
    """The scalar rule: with S = m'm / n^2, a share S / (1 + S) is believed and 1 / (1 + S) of its variance is left."""
    way = np.random.default_rng(1).standard_normal((ROWS, 1))
    noise = 0.25 * np.eye(ROWS)
    found = at_rest(NONE, 0.8 * way[:, 0], NONE, way, NONE, noise)
    share = float((way**2).sum()) / 0.25
    assert found.beside == pytest.approx(0.8 * share / (1.0 + share) * way[:, 0])
    assert found.columns @ found.columns.T == pytest.approx(way @ way.T / (1.0 + share), abs=1e-9)
    assert found.scale == 1.0


@pytest.mark.usefixtures("exact")
def test_what_is_left_is_how_far_what_is_found_is_from_the_truth() -> None:
    rng = np.random.default_rng(2)
    ways, noise, floor = rng.standard_normal((ROWS, 6)), 0.3, np.full(ROWS, 0.1)
    off = []
    for _ in range(400):
        truth = ways @ rng.standard_normal(6) + floor * rng.standard_normal(ROWS)
        read = truth + noise * rng.standard_normal(ROWS)
        found = at_rest(NONE, read, NONE, ways, floor, noise**2 * np.eye(ROWS))
        if found.scale == 1.0:
            left = found.columns @ found.columns.T + 1e-12 * np.eye(ROWS)
            rest = truth - found.beside
            off.append(rest @ np.linalg.solve(left, rest) / ROWS)
    assert np.mean(off) == pytest.approx(1.0, abs=0.1)


def test_more_than_was_thought_widens_what_is_left_and_a_touch_leaves_some_unknown() -> None:
    rng = np.random.default_rng(3)
    ways, noise = rng.standard_normal((ROWS, 4)), 1e-4 * np.eye(ROWS)
    usual = at_rest(NONE, ways @ np.ones(4), NONE, ways, np.full(ROWS, 0.05), noise)
    odd = at_rest(NONE, ways @ np.ones(4) + rng.standard_normal(ROWS), NONE, ways, np.full(ROWS, 0.05), noise)
    assert usual.scale == 1.0
    assert odd.scale > 10.0
    size = [float(np.square(one.columns).sum()) for one in (usual, odd)]
    assert size[1] > 100.0 * size[0]
    least = constants.MODEL_ERROR_SHARE_OF_TOUCH**2 * ways @ ways.T + np.diag(
        (constants.ROW_ERROR_BY_TOUCH * usual.beside) ** 2
    )
    left = usual.columns @ usual.columns.T
    assert np.linalg.eigvalsh(left - least).min() > -1e-9
