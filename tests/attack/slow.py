"""``eitskin`` with a flaw: its runtime takes some time more for every frame.

    python -m tests.attack.slow WHERE SECONDS run ...

WHERE is ``within`` a frame, before it is published, or ``between`` two of them.
"""

import sys
import time
from typing import Any

from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.stats import Statistics
from eitskin_tools.cli import main

PLACES = {"within": (Pipeline, "compute"), "between": (Statistics, "ready")}


def slow_down(where: str, seconds: float) -> None:
    """Let every frame take so much longer there."""
    kind, name = PLACES[where]
    original = getattr(kind, name)

    def slowed(*arguments: Any) -> Any:
        time.sleep(seconds)
        return original(*arguments)

    setattr(kind, name, slowed)


if __name__ == "__main__":
    slow_down(sys.argv[1], float(sys.argv[2]))
    sys.exit(main(sys.argv[3:]))
