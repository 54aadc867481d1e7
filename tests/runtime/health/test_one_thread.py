"""A program that hosts a skin leaves BLAS its threads: a frame must not wait for them, whatever fails."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from eitskin.model import small_products
from eitskin.model.bundle import default_path
from eitskin.model.small_products import product

PROGRAM = Path(__file__).with_name("one_thread_process.py")


@pytest.mark.process
def test_neither_health_nor_a_new_reference_nor_a_failing_electrode_wakes_a_thread_of_blas():
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    found = subprocess.run(
        [sys.executable, str(PROGRAM), str(default_path("units"))],
        env=clean, capture_output=True, text=True, timeout=120, check=True,
    ).stdout.splitlines()  # fmt: skip
    if int(found[0].split()[-1]) == 0:
        pytest.skip("this numpy computes with one thread in any case")
    if int(found[1].split()[-1]) > 0:
        pytest.skip("this numpy's OpenBLAS, older than 0.3.27, has its pool compute 104 rows times a vector")
    assert found[2] == "detached\t0\t5:detached:imputed"
    assert found[3] == "swapped\t0\t4:swapped with 5:rearranged\t5:swapped with 4:rearranged"


@pytest.mark.parametrize(("rows", "inner", "columns"), [(1350, 26, 104), (3, 400, 400), (1, 104, 104), (0, 5, 3)])
def test_a_product_in_pieces_is_the_product(rows, inner, columns, monkeypatch):
    rng = np.random.default_rng(0)
    left, right = rng.standard_normal((rows, inner)), rng.standard_normal((inner, columns))
    # sums of 400 terms of size 1, in another order: 400 * 2^-53 * 20 is under 1e-12
    np.testing.assert_allclose(product(left, right), left @ right, rtol=0, atol=1e-12)
    monkeypatch.setattr(small_products, "MAX_PRODUCTS", 1)
    np.testing.assert_allclose(product(left, right), left @ right, rtol=0, atol=1e-12)
