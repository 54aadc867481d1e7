"""A program that hosts a skin leaves BLAS its threads: a frame must not wait for them, whatever fails."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eitskin.model.bundle import default_path

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
