"""Moves of touches: sides of upright rectangles reach what they cross alone, and parameters are made of them."""

import numpy as np
import pytest

from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.shapes.elements import moves_of
from eitskin_sim.shapes.parameters import ANGLE, HALF_LENGTH, LOG_CONTRAST, X, Y, free, parameters_of

SQUARE = np.array([[0.0, 52.0, 44.0, 11.0, 9.0, 0.0, 50.0, 0.0]])


def test_moves_of_sides_add_up_to_each_parameter_of_an_upright_rectangle() -> None:
    own = free(SQUARE)
    own[:, ANGLE] = False
    moves = moves_of(SQUARE, own, shared_mesh(4.5).mesh)
    assert len(moves.touch) == 5, "four sides and the contrast"
    moved = (parameters_of(moves.moved) - parameters_of(SQUARE)) / moves.step[:, None]
    for column, parameter in enumerate(np.nonzero(own)[1]):
        found = moves.mix[:, column] @ moved
        assert found == pytest.approx(np.eye(7)[parameter], abs=1e-6)


def test_a_side_reaches_the_elements_that_it_crosses_alone() -> None:
    mesh = shared_mesh(4.5).mesh
    own = free(SQUARE)
    own[:, ANGLE] = False
    moves = moves_of(SQUARE, own, mesh)
    for number, side in enumerate((52.0 - 5.5, 52.0 + 5.5)):
        found = mesh.centres_mm[moves.reach[number], 0]
        assert np.abs(found - side).max() < 4.5 / 2 + 0.1
    whole = moves.reach[-1]
    assert moves.reach[:4].sum() < 2 * whole.sum()
    assert np.all(whole | ~moves.reach.any(axis=0))


def test_touches_that_turn_are_round_or_graded_move_by_their_parameters() -> None:
    turned, round_, graded = SQUARE.copy(), SQUARE.copy(), SQUARE.copy()
    turned[0, 5], round_[0, 0], graded[0, 7] = 20.0, 1.0, 3.0
    for one in (turned, round_, graded):
        own = free(one)
        own[:, LOG_CONTRAST] = False
        moves = moves_of(one, own, shared_mesh(4.5).mesh)
        assert np.array_equal(moves.mix, np.eye(int(own.sum())))
        assert set(np.nonzero(own)[1]) >= {X, Y, HALF_LENGTH}
    both = np.vstack([SQUARE, SQUARE + np.array([0, 12.0, 0, 0, 0, 0, 0, 0]), SQUARE + np.array([0, 60.0] + [0] * 6)])
    near = moves_of(both, free(both), shared_mesh(4.5).mesh).near
    assert near.tolist() == [[True, True, False], [True, True, False], [False, False, True]]
