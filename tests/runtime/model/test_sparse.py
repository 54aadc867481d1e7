import numpy as np
import pytest

from eitskin.errors import BundleError
from eitskin.model.sparse import SparseEngine

ROWS, PIXELS = 80, 1000


def arrays(sign=1.0, seed=0):
    """Return operators with rows that bends move along three directions, which whitening suppresses."""
    rng = np.random.default_rng(seed)
    bends = rng.normal(size=(ROWS, 3))
    whitening = np.linalg.inv(np.linalg.cholesky(1e4 * bends @ bends.T + np.eye(ROWS)))
    jacobian = rng.normal(size=(ROWS, PIXELS))
    operator = whitening @ jacobian
    size = np.linalg.norm(operator, axis=0)
    found = {"whitening": whitening, "operator": operator / size, "scale": 1 / size, "limit": 2 * size}
    return {**found, "sign": np.array(sign)}, jacobian, bends


def map_of(found, logs):
    change, out = np.expm1(logs).astype(np.float32), np.zeros(PIXELS, dtype=np.float32)
    SparseEngine(found, change, out).infer()
    return out


def test_the_touched_pixels_are_found_at_a_bend_that_changes_rows_more_than_they_do():
    found, jacobian, bends = arrays()
    truth = np.zeros(PIXELS)
    truth[[20, 150]] = 0.02, 0.014
    image = map_of(found, jacobian @ truth + 0.1 * bends[:, 1])
    assert set(np.argsort(image)[-2:]) == {20, 150}
    assert image[20] == 1.0
    assert np.count_nonzero(image > 0.3) == 2


@pytest.mark.parametrize(("sign", "seen"), [(1.0, [False, True]), (-1.0, [True, False]), (0.0, [True, True])])
def test_touches_show_which_change_conductance_as_the_skin_says(sign, seen):
    found, jacobian, _ = arrays(sign)
    for change, expected in zip((-0.02, 0.02), seen, strict=True):
        image = map_of(found, change * jacobian[:, 70])
        assert (int(image.argmax()) == 70 and image.max() == 1.0) == expected
        assert image.min() >= 0.0


@pytest.mark.parametrize(
    ("name", "value"),
    [("limit", np.zeros(3)), ("scale", np.full(PIXELS, np.nan)), ("sign", np.array(3.0)),
     ("operator", np.zeros((ROWS, PIXELS)))],
)  # fmt: skip
def test_operators_that_cannot_be_are_refused_by_name(name, value):
    with pytest.raises(BundleError, match=rf"l1\.npz: {name}.*eitskin build --physics"):
        SparseEngine({**arrays()[0], name: value}, np.zeros(ROWS, np.float32), np.zeros(PIXELS, np.float32))
