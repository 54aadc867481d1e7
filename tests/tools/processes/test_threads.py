"""One BLAS thread, asked for before numpy is there."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

COUNT = """
import os
from eitskin_tools.processes.threads import one_blas_thread
{before}
one_blas_thread()
import numpy as np
a = np.ones((600, 600))
a @ a
print(len(os.listdir("/proc/self/task")), os.environ.get("OPENBLAS_NUM_THREADS"))
"""


@pytest.mark.parametrize(("before", "threads"), [("", "1"), ("import numpy", "3")])
def test_products_run_on_one_thread_unless_numpy_is_there_already(before, threads):
    done = subprocess.run(
        [sys.executable, "-c", COUNT.format(before=before)],
        capture_output=True, text=True, check=True, env={"OPENBLAS_NUM_THREADS": "3", "PATH": ""},
    )  # fmt: skip
    running, asked = done.stdout.split()
    assert asked == threads
    if threads == "1":
        assert running == "1"
