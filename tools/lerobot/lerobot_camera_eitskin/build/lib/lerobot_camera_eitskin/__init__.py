"""A soft electronic skin for LeRobot: maps as a camera's images, touches as an observation, data sets of recordings."""

from lerobot_camera_eitskin.camera import EitskinCamera, EitskinCameraConfig
from lerobot_camera_eitskin.features import TOUCHES, image_of, touch_array, touch_features

__all__ = ["TOUCHES", "EitskinCamera", "EitskinCameraConfig", "image_of", "touch_array", "touch_features"]
