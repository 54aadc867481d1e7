"""Data sets of maps and touches, by LeRobot's own writer."""

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from lerobot.datasets.lerobot_dataset import LeRobotDataset

import eitskin
from lerobot_camera_eitskin.features import TOUCHES, image_of, touch_array, touch_features

IMAGE: Final = "observation.images.skin"
"""Key of the maps, kept as PNG: what is read is what was written."""

Episode = Iterable[tuple[npt.NDArray[np.float32], Iterable[eitskin.Touch]]]
"""Map (rows, columns) and touches of each frame."""


def write_dataset(folder: Path, episodes: Iterable[Episode], shape: tuple[int, int], rate_hz: int, task: str) -> None:
    """Write a data set, whole or not at all.

    Args:
        folder: It must not be there.
        episodes: Each with at least two frames.
        shape: (rows, columns) of the maps.
        rate_hz: Frames a second.
        task: What the robot does, in words.

    Raises:
        ValueError: A map has another shape, or an episode has too few frames.
        OSError: The folder is there, or cannot be written.
    """
    shown = {"dtype": "image", "shape": image_of(np.zeros(shape)).shape, "names": ["height", "width", "channels"]}
    features = {IMAGE: shown, **touch_features()}
    dataset = LeRobotDataset.create(folder.name, rate_hz, features, root=folder, use_videos=False)
    try:
        for episode in episodes:
            for values, touches in episode:
                dataset.add_frame({IMAGE: image_of(values), TOUCHES: touch_array(touches), "task": task})
            dataset.save_episode()
        dataset.finalize()
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
