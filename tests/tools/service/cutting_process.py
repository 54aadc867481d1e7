"""``eitskin`` whose networks for regions are cut without end; the file in ``CUTS`` says that it has begun."""

import os
import sys
import threading
from pathlib import Path

from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_tools import cli

use_regions = Pipeline.use_regions


def endless(self, regions):
    if threading.current_thread().name != "eitskin-regions":
        return use_regions(self, regions)
    assert not threading.current_thread().daemon, "C++ code in a daemon aborts the process when the interpreter ends"
    Path(os.environ["CUTS"]).touch()
    threading.Event().wait()
    return None


Pipeline.use_regions = endless
sys.exit(cli.main(sys.argv[1:]))
