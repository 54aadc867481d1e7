"""A camera of LeRobot whose images are the maps of a running skin.

Its type is ``eitskin``. A read takes the newest frame and never an old one: ``eitskin.NoFrame`` and
``eitskin.StaleFrame``, both ``TimeoutError``, say why there is none.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import eitskin
from lerobot_camera_eitskin.features import image_of, touch_array


@CameraConfig.register_subclass("eitskin")
@dataclass(kw_only=True)
class EitskinCameraConfig(CameraConfig):
    """Which skin, and the size of its images."""

    width: int | None = 360
    height: int | None = 240
    """Eight times the map's columns and rows; these are the paper's."""
    endpoint: str | None = None
    """Where the runtime publishes; None for the default of ``eitskin run``."""
    server_key: str | None = None
    client_key: str | None = None
    """Files of CURVE keys, which TCP needs."""
    max_age_s: float = 0.5
    """Age of the oldest frame that a read accepts."""


class EitskinCamera(Camera):
    """Maps of a running skin as images; ``touches`` are those of the last image."""

    def __init__(self, config: EitskinCameraConfig) -> None:
        """Keep the configuration; nothing is opened."""
        super().__init__(config)
        self.config = config
        self.frame: Any = None
        """The :class:`eitskin.Frame` of the last image."""
        self._frames: Any = None

    @property
    def is_connected(self) -> bool:
        """Whether it is subscribed to a runtime."""
        return self._frames is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return what a runtime at the default endpoint is configured by; it need not run."""
        return [{"type": "eitskin", "name": "the skin of 'eitskin run'", "id": "eitskin"}]

    def connect(self, warmup: bool = True) -> None:
        """Subscribe, and wait for the first frame.

        Raises:
            DeviceAlreadyConnectedError: It is subscribed.
            eitskin.NoFrame: No frame came within 5 s.
            eitskin.EndpointError: The endpoint or the keys cannot be used.
            ValueError: One key is missing, or the maps have another size.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError("the skin is already connected: disconnect it first")
        names = [name for name in (self.config.server_key, self.config.client_key) if name]
        if len(names) == 1:
            raise ValueError("server_key and client_key need each other: give both")
        keys = eitskin.load_client_keys(*map(Path, names)) if names else None
        self._frames = eitskin.subscribe(self.config.endpoint, touches=True, keys=keys)
        try:
            height, width, _ = image_of(self._newest(5.0).map).shape
            if (height, width) != (self.height, self.width):
                raise ValueError(
                    f"the skin's images have height {height} and width {width}, expected {self.height} and "
                    f"{self.width}: set both in the configuration"
                )
        except BaseException:
            self.disconnect()
            raise

    def read(self) -> npt.NDArray[np.uint8]:
        """Return the newest image (height, width, 3), waiting a second for one; errors as of :meth:`async_read`."""
        return image_of(self._newest(1.0).map)

    def async_read(self, timeout_ms: float = 200) -> npt.NDArray[np.uint8]:
        """Return the newest image (height, width, 3) that was not yet read.

        Raises:
            DeviceNotConnectedError: It is not connected.
            eitskin.NoFrame: None came in time; the text says why.
            eitskin.StaleFrame: Only older ones than ``max_age_s`` came in time.
        """
        return image_of(self._newest(1e-3 * timeout_ms).map)

    def read_latest(self, max_age_ms: int = 500) -> npt.NDArray[np.uint8]:
        """Return the newest image without waiting, also one that was read before.

        Raises:
            DeviceNotConnectedError: It is not connected.
            eitskin.StaleFrame: It is older than ``max_age_ms``.
        """
        return image_of(self._fresh(self._connected().waiting() or self.frame, 1e-3 * max_age_ms).map)

    @property
    def touches(self) -> npt.NDArray[np.float32]:
        """The touches of the last image, (4, 9), see :func:`touch_array`; ``eitskin.StaleFrame`` if that is too old."""
        self._connected()
        return touch_array(self._fresh(self.frame, self.config.max_age_s).touches)

    def disconnect(self) -> None:
        """End the subscription."""
        if self._frames is not None:
            self._frames.close()
        self._frames = self.frame = None

    def _connected(self) -> Any:
        if self._frames is None:
            raise DeviceNotConnectedError("the skin is not connected: call connect() first")
        return self._frames

    def _newest(self, timeout_s: float) -> eitskin.Frame:
        """Return the newest frame; frames that waited through a pause are too old and passed over."""
        frames = self._connected()
        end_s, stale = time.monotonic() + timeout_s, None
        while True:
            if (frame := frames.waiting()) is not None:
                try:
                    return self._fresh(frame, self.config.max_age_s)
                except eitskin.StaleFrame as error:
                    stale = error
            if (left_s := end_s - time.monotonic()) <= 0.0:
                raise stale or eitskin.NoFrame(
                    f"no frame from {frames.endpoint} within {timeout_s:g} s: {frames.silence(timeout_s)}"
                )
            frames.socket.poll(1000.0 * left_s)

    def _fresh(self, frame: eitskin.Frame, max_age_s: float) -> eitskin.Frame:
        """Return a frame, which is kept, or refuse an old one."""
        if (age_s := frame.age_s) > max_age_s:
            raise eitskin.StaleFrame(f"the newest frame is {age_s:.3f} s old, expected at most {max_age_s:g} s")
        self.frame = frame
        return frame
