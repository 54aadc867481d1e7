"""Products in pieces small enough for one thread of BLAS."""

import numpy as np
import pytest

from eitskin.model import small_products
from eitskin.model.small_products import product


@pytest.mark.parametrize(("rows", "inner", "columns"), [(1350, 26, 104), (3, 400, 400), (1, 104, 104), (0, 5, 3)])
def test_a_product_in_pieces_is_the_product(rows, inner, columns, monkeypatch):
    rng = np.random.default_rng(0)
    left, right = rng.standard_normal((rows, inner)), rng.standard_normal((inner, columns))
    # sums of 400 terms of size 1, in another order: 400 * 2^-53 * 20 is under 1e-12
    np.testing.assert_allclose(product(left, right), left @ right, rtol=0, atol=1e-12)
    monkeypatch.setattr(small_products, "MAX_PRODUCTS", 1)
    np.testing.assert_allclose(product(left, right), left @ right, rtol=0, atol=1e-12)
