"""Limits the threads of a command's arithmetic."""

import os
import sys


def one_blas_thread() -> None:
    """Let numpy's products run on one thread, as figures of CPU time mean it; small ones only wait for a second.

    BLAS reads this when numpy is first imported, so nothing is changed where that has happened.
    """
    if "numpy" not in sys.modules:
        os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
