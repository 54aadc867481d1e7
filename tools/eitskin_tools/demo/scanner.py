"""The scanner's process: sends the bent sheet's clouds to the runtime, as a robot's camera would.

Every period it takes the cloud of the script's moment, as a scanner gives it, and sends it over the control endpoint.
Where the bundle asks for it, the forward model's prediction of the untouched voltages goes with the cloud. The process
has a slightly raised nice value: it must not delay the stream, but must finish before the bend changes.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

import eitskin
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import load
from eitskin_tools.processes.signals import Stopped, raise_stopped_on_signals
from eitskin_tools.processes.skin_log import script_start

NICENESS: Final = 2
"""Of this process; see nice(2). With 10, on cores that other programs fill, a cloud came every four seconds."""


def send_clouds(control: str, log: Path, rate_hz: float, predict: bool, skin: Skin = PAPER) -> None:
    """Send clouds until the process is stopped.

    Args:
        control: Endpoint of the runtime.
        log: Of the virtual skin; says when the script began.
        rate_hz: Clouds a second.
        predict: Send the predicted voltages too.
        skin: What is scanned.

    Raises:
        SkinError: The runtime refuses a cloud.
    """
    from eitskin_tools.scripted_scene.script import demonstration

    script = demonstration(skin)
    rng = np.random.default_rng(0)
    if predict:
        _predicted(script.cloud_at(0.0), skin)  # the first one solves the flat sheet finely
    start_ns = script_start(log)["host_ns"]
    period_ns = round(1e9 / rate_hz)
    due_ns = time.perf_counter_ns()
    last: object = None
    while True:
        time_s = (time.perf_counter_ns() - start_ns) * 1e-9
        bend = script.scene_at(time_s).bend
        if bend != last:  # a sheet that does not move needs no new cloud
            last = bend
            cloud = script.cloud_at(time_s, rng)
            predicted, flat = _predicted(cloud, skin) if predict else (None, None)
            print(json.dumps({"time_s": time_s, "cloud": _send(control, cloud, predicted, flat, skin)}), flush=True)
        due_ns += period_ns
        behind_ns = time.perf_counter_ns() - due_ns
        if behind_ns > 0:
            due_ns += behind_ns // period_ns * period_ns
        else:
            time.sleep(-behind_ns * 1e-9)


def _predicted(cloud: np.ndarray, skin: Skin) -> tuple[np.ndarray, np.ndarray]:
    from eitskin_sim.surface.predict import flat_voltages, predict

    return predict(cloud, skin), flat_voltages(skin)


def _send(control: str, cloud: np.ndarray, predicted: np.ndarray | None, flat: np.ndarray | None, skin: Skin) -> int:
    return eitskin.send_cloud(control, cloud, predicted=predicted, predicted_flat=flat, skin=skin)


def main() -> int:
    """Run the scanner's process."""
    parser = argparse.ArgumentParser(description="Send clouds of the bending sheet.")
    parser.add_argument("control")
    parser.add_argument("log", type=Path)
    parser.add_argument("--rate", type=float, default=4.0)
    parser.add_argument("--skin", type=Path)
    parser.add_argument("--predict", action="store_true")
    arguments = parser.parse_args()
    raise_stopped_on_signals()
    os.nice(NICENESS)
    try:
        skin = PAPER if arguments.skin is None else load(arguments.skin)
        send_clouds(arguments.control, arguments.log, arguments.rate, arguments.predict, skin)
    except Stopped:
        pass
    except (eitskin.SkinError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
