"""``eitskin`` whose C code keeps the interpreter for ever from its hundredth frame on, as a solver's library might.

The arguments are those of ``eitskin``. ``HANGS_ONCE`` names a file that is written before; where it is, nothing hangs.
"""

import ctypes
import os
import sys
from itertools import count
from pathlib import Path

from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_tools import cli

compute, frames, mark = Pipeline.compute, count(1), Path(os.environ["HANGS_ONCE"])


def hang(self, wanted):
    if next(frames) == 100 and not mark.exists():
        mark.touch()
        mutex = ctypes.create_string_buffer(64)
        lock = ctypes.PyDLL(None).pthread_mutex_lock  # unlike CDLL, PyDLL keeps the interpreter's lock
        while lock(mutex) == 0:  # twice by the same thread: it waits for itself
            pass
    return compute(self, wanted)


Pipeline.compute = hang
sys.exit(cli.main(sys.argv[1:]))
