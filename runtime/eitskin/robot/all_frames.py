"""``for one in eitskin.subscribe_all(): one.skin, one.frame, one.touches``: the frames of all skins of a robot.

Each skin is a subscription of its own; one poll waits for all of them. A skin with frames waiting gets its turn in
order, so a fast skin starves no slow one. In mode ``latest`` each turn takes the newest frame of its skin.

An error names a skin that falls silent; the next call of the iterator continues with the others.
"""

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import zmq

from eitskin.errors import RobotError, SilentSkin, StaleFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.frame import Frame
from eitskin.messaging.reader import LONGEST_WAIT_MS, Reader
from eitskin.messaging.subscriber import FIRST_S
from eitskin.messaging.subscription import Subscription
from eitskin.robot.config import RobotSkin
from eitskin.robot.described import Source, robot_skins
from eitskin.robot.pose import Pose
from eitskin.touches.touch import Touch


@dataclass(frozen=True, slots=True)
class SkinFrame:
    """A frame of one of several skins.

    Attributes:
        skin: Name of the skin.
        frame: As :func:`eitskin.subscribe` returns it.
        pose: Where the skin sits on the robot.
    """

    skin: str
    frame: Frame
    pose: Pose

    @property
    def touches(self) -> tuple[Touch, ...]:
        """The touches, with places and normals in the robot's frame, if the subscription requested touches."""
        return tuple(self.pose.touch(touch) for touch in self.frame.touches)


class RobotSubscription(Reader[SkinFrame]):
    """Open subscriptions to all skins of a robot: iterate it, and close it with ``close`` or as a context manager.

    Args:
        source: Path of the robot.toml, or of the folder in which ``eitskin run --config`` runs; None takes that
            command's default folder.
        mode: ``latest`` returns the newest frame, for a control loop; ``all`` returns every frame, for a recorder.
        timeout_s: How long a skin may send nothing before :class:`eitskin.SilentSkin`, which names it. None allows 5 s
            for the first frame of each and no limit after it; ``math.inf`` waits without limit from the start.
        max_age_s: The oldest acceptable frame; an older one raises :class:`eitskin.StaleFrame`.
        touches: Request the list of touches in each frame; ``SkinFrame.touches`` has them in the robot's frame.
        maps: False requests touches without maps, a sixth of the bytes; ``frame.map`` then has shape (0, 0).
        keys: CURVE keys, required for TCP: one for all skins, or a mapping by name.

    Raises:
        RobotError: There are no skins, or the file is wrong.
        OSError: There is no such file.
        ValueError: A bound is not positive, or the mode does not exist.
        EndpointError: ZeroMQ cannot make sense of an endpoint.
    """

    def __init__(
        self,
        source: Source = None,
        mode: str = "latest",
        *,
        timeout_s: float | None = None,
        max_age_s: float | None = None,
        touches: bool = False,
        maps: bool = True,
        keys: ClientKeys | Mapping[str, ClientKeys] | None = None,
    ) -> None:
        super().__init__()
        self.skins: dict[str, RobotSkin] = {one.name: one for one in robot_skins(source)}
        """By name, in the robot's order."""
        for name, value in (("timeout_s", timeout_s), ("max_age_s", max_age_s)):
            if value is not None and not value > 0:
                raise ValueError(f"{name} is {value}, expected more than 0")
        if isinstance(keys, Mapping) and (strange := sorted(set(keys) - set(self.skins))):
            raise RobotError(f"found keys for {', '.join(strange)}, expected only for {', '.join(self.skins)}")
        self._first_s = FIRST_S if timeout_s is None else timeout_s
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        self._max_age_s = max_age_s
        self._subscriptions: dict[str, Subscription] = {}
        self._poller = zmq.Poller()
        self._turns: deque[str] = deque()
        self._by_socket: dict[Any, str] = {}
        try:
            for name, one in self.skins.items():
                own = keys.get(name) if isinstance(keys, Mapping) else keys
                found = Subscription(one.publish, mode=mode, touches=touches, maps=maps, keys=own)
                self._subscriptions[name] = found
                self._by_socket[found.socket] = name
                self._poller.register(found.socket, zmq.POLLIN)
        except BaseException:
            self.close()
            raise
        now_s = time.monotonic()
        self._heard_s = dict.fromkeys(self.skins, now_s)
        self._due_s = dict.fromkeys(self.skins, now_s + self._first_s)

    @property
    def received(self) -> dict[str, int]:
        """Number of received frames, by skin."""
        return {name: one.received for name, one in self._subscriptions.items()}

    @property
    def lost(self) -> dict[str, int]:
        """Published frames that this side did not take in time, by skin; in mode ``latest`` this is intended."""
        return {name: one.lost for name, one in self._subscriptions.items()}

    def silent_s(self) -> dict[str, float]:
        """Return the seconds since the last frame, by skin; since the start if none has come."""
        now_s = time.monotonic()
        return {name: now_s - heard_s for name, heard_s in self._heard_s.items()}

    def next_frame(self) -> SkinFrame:
        """Wait for the next frame of any skin and return it.

        Raises:
            SilentSkin: A skin has sent nothing for too long; its ``skin`` is the name. The next call continues with
                the other skins, and raises again after the same time.
            StaleFrame: The frame is older than ``max_age_s``.
            Closed: The subscription was stopped or closed.
        """
        return self._next()

    def _wait(self, timeout_s: float | None) -> SkinFrame:
        while True:
            self._check_stopped()
            self._raise_if_silent()
            if not self._turns:
                self._poll()
                continue
            name = self._turns.popleft()
            if (frame := self._subscriptions[name].waiting()) is None:
                continue
            self._heard_s[name] = now_s = time.monotonic()
            self._due_s[name] = now_s + self._timeout_s
            if self._max_age_s is not None and (age_s := frame.age_s) > self._max_age_s:
                raise StaleFrame(
                    f"the newest frame of skin {name} is {age_s:.3f} s old, expected at most {self._max_age_s:g} s"
                )
            return SkinFrame(name, frame, self.skins[name].pose)

    def _poll(self) -> None:
        left_ms = (min(self._due_s.values()) - time.monotonic()) * 1000
        ready = self._poller.poll(int(max(0, min(left_ms + 1, LONGEST_WAIT_MS))))
        self._turns.extend(self._by_socket[socket] for socket, _ in ready)
        for name in self._subscriptions.keys() - self._turns:
            self._subscriptions[name].connect_if_silent()

    def _raise_if_silent(self) -> None:
        now_s = time.monotonic()
        late = min(self._due_s, key=self._due_s.__getitem__)
        if now_s < self._due_s[late] or late in self._turns:
            return
        for name in (name for name in self.skins if name not in self._turns and now_s >= self._due_s[name]):
            if self._subscriptions[name].waits:
                self._turns.append(name)  # the program itself did not ask
                continue
            allowed_s = self._timeout_s if self._subscriptions[name].received else self._first_s
            self._due_s[name] = now_s + allowed_s
            endpoint, why = self.skins[name].publish, self._subscriptions[name].silence(allowed_s)
            raise SilentSkin(name, f"no frame of skin {name} from {endpoint} within {allowed_s:g} s: {why}")

    def _release(self) -> None:
        for one in self._subscriptions.values():
            one.close()


subscribe_all = RobotSubscription
"""Opens subscriptions to the frames of all skins of a robot, to be iterated."""
