"""The real verifier's process around a checker without physics, told by files of the folder in VERIFIER_SCRIPT.

``die``: it ends at once. ``bad_model``: no model can be made. ``hold``: it waits in a frame until that file is gone.
``hang``: it never comes back from a frame. ``cannot``: nothing can be said of frames. ``slipped``: untouched, the sheet
is not that of its scan. ``shape.npy``: frames show this cloud, told once. Each frame that is taken is written down in
``taken``, what the untouched sheet reads in ``rested``, and each surface's number in ``setups``.
"""

import os
import sys
import time
import types
from pathlib import Path

import numpy as np

FOLDER = Path(os.environ["VERIFIER_SCRIPT"])


class Checker:
    why = ""

    def __init__(self, setup):
        if (FOLDER / "bad_model").exists():
            raise ValueError("the cloud folds in its own plane")
        self._flat_V = setup.reference_V
        ratio = setup.spread_V / np.abs(setup.reference_V)
        with (FOLDER / "setups").open("a") as file:
            print(setup.number, file=file)
        (FOLDER / "spread").write_text(str(np.median(ratio)))

    def learn_baseline(self, letter):
        with (FOLDER / "rested").open("a") as file:
            print(letter.frames, float(abs(letter.change).max()), file=file)
        return "it has slipped" if (FOLDER / "slipped").exists() else ""

    def another_shape(self):
        if not (FOLDER / "shape.npy").exists():
            return None
        cloud_mm = np.load(FOLDER / "shape.npy")
        (FOLDER / "shape.npy").unlink()
        return cloud_mm, self._flat_V, self._flat_V

    def check(self, frame):
        with (FOLDER / "taken").open("a") as file:
            print(frame.seq, frame.cloud, int(frame.missing.sum()), file=file)
        if (FOLDER / "hang").exists():
            while True:
                pass
        while (FOLDER / "hold").exists():
            time.sleep(0.01)
        if (FOLDER / "cannot").exists():
            raise ValueError("nothing can be said of it")
        return (float(abs(frame.change).max()), 104, 0.25, False), (), ""


if (FOLDER / "die").exists():
    sys.exit("died as it was told")
checkers = types.ModuleType("eitskin_tools.verifier.checkers")
checkers.Checker = Checker
sys.modules[checkers.__name__] = checkers

from eitskin_tools.verifier import process  # noqa: E402 -- behind the stand-in

process.HANGS_S = 2.0
sys.exit(process.main())
