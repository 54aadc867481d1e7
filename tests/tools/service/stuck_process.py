"""``eitskin run`` whose frame loop stands still in its hundredth frame; the arguments are those of ``eitskin``."""

import sys
import threading
from itertools import count

from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_tools import cli

compute, frames = Pipeline.compute, count(1)


def stuck(self, wanted):
    if next(frames) == 100:
        threading.Event().wait()
    return compute(self, wanted)


Pipeline.compute = stuck
sys.exit(cli.main(sys.argv[1:]))
