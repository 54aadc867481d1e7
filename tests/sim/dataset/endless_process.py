"""Makes a data set in two workers whose shards are never done; each says that it has begun."""

import os
import signal
from typing import Any

from eitskin_sim.dataset import generate


def never(_: dict[str, Any]) -> None:
    os.write(1, b"begun\n")
    while True:
        signal.pause()


if __name__ == "__main__":
    generate.make_shard = never
    list(generate._in_processes([{"deformations": number} for number in range(4)], 2))
