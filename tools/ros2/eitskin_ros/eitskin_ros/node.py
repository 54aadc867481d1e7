"""A lifecycle node that publishes a skin.

/eitskin/touches   sensor_msgs/PointCloud2            with every frame; empty while nothing touches
/eitskin/map       sensor_msgs/Image, 32FC1           while a node subscribes
/eitskin/surface   sensor_msgs/PointCloud2            while a node subscribes
/diagnostics       diagnostic_msgs/DiagnosticArray    once a second

While the node is blind, because no frame comes or only old ones, it publishes no touches; /diagnostics says why.
A thread reads frames, so that requests to the runtime delay none.
"""

import threading
import time
from collections import deque
from contextlib import suppress
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from eitskin_ros import stream
from eitskin_ros.messages import map_message, surface_message, touches_message
from eitskin_ros.stream import Cloud, Frame, Stream, StreamError

PARAMETERS = {
    "autostart": True, "endpoint": "", "control": "", "server_key": "", "client_key": "", "frame_id": "skin",
    "reliability": "best_effort", "blind_s": 0.5, "map_rate_hz": 0.0,
}  # fmt: skip
RELIABILITIES = {"best_effort": (ReliabilityPolicy.BEST_EFFORT, 10), "reliable": (ReliabilityPolicy.RELIABLE, 1000)}

SKIN = ("drift", "drift_sd", "drift_uneven", "weak_rows", "touched", "touches_more", "cloud", "solver", "bundle",
        "configuration")  # fmt: skip
"""Fields of a frame that /diagnostics shows."""


class SkinNode(LifecycleNode):
    """Publishes a runtime's frames while it is active."""

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("eitskin")
        for name, default in PARAMETERS.items():
            self.declare_parameter(name, default)
        self.declare_parameter("excluded", None, ParameterDescriptor(dynamic_typing=True))
        self.add_on_set_parameters_callback(self._on_parameters)
        self.create_service(Trigger, "/eitskin/capture_reference", self._on_capture)
        self.create_timer(1.0, self._on_timer)
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Check the parameters, connect, and make the topics."""
        given = self._given()
        self._frame_id, self._blind_s, reliability = given["frame_id"], given["blind_s"], given["reliability"]
        try:
            if not self._frame_id or self._frame_id.startswith("/"):
                raise StreamError(f"frame_id is {self._frame_id!r}, expected a name without a slash before it")
            if reliability not in RELIABILITIES:
                raise StreamError(f"reliability is {reliability!r}, expected {' or '.join(RELIABILITIES)}")
            if not self._blind_s > 0.0:
                raise StreamError(f"blind_s is {self._blind_s}, expected more than 0")
            keys = given["server_key"], given["client_key"]
            self._stream = Stream(given["endpoint"] or stream.default_endpoint("frames"), keys)
        except StreamError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        policy, depth = RELIABILITIES[reliability]
        quality = QoSProfile(depth=depth, reliability=policy)
        with_deadline = QoSProfile(depth=depth, reliability=policy, deadline=Duration(seconds=self._blind_s))
        self._touches = self.create_lifecycle_publisher(PointCloud2, "/eitskin/touches", with_deadline)
        self._maps = self.create_lifecycle_publisher(Image, "/eitskin/map", quality)
        self._surfaces = self.create_lifecycle_publisher(PointCloud2, "/eitskin/surface", quality)
        self._diagnostics = self.create_lifecycle_publisher(DiagnosticArray, "/diagnostics", 10)
        self._map_period_s, self._map_due_s = 1.0 / (given["map_rate_hz"] or 1e9), 0.0
        self._cloud: Cloud | None = None
        self._last: Frame | None = None
        self._blind, self._old, self._frames, self._listed_s = "no frame yet", 0, 0, time.monotonic()
        self._latencies_ms: deque[float] = deque(maxlen=1000)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Publish from now on."""
        done = super().on_activate(state)
        self._ending.clear()
        self._thread = threading.Thread(target=self._read_until_shutdown, name="frames", daemon=True)
        self._thread.start()
        return done

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Publish no more."""
        self.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        """Leave the runtime."""
        self._stream.close()
        for publisher in (self._touches, self._maps, self._surfaces, self._diagnostics):
            self.destroy_lifecycle_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def stop(self) -> None:
        """End the thread that reads frames."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _given(self) -> dict[str, Any]:
        return {name: self.get_parameter(name).value for name in PARAMETERS}

    def _read_until_shutdown(self) -> None:
        try:
            self._read()
        except Exception:
            if self.context.ok():
                raise  # otherwise Ctrl-C has shut ROS down amid a frame

    def _read(self) -> None:
        """Publish what comes, until the node is deactivated."""
        asked_s, came_s = 0.0, time.monotonic()
        while not self._ending.is_set():
            now_s = time.monotonic()
            if now_s > asked_s:
                asked_s = now_s + 0.1
                maps, surfaces = (one.get_subscription_count() > 0 for one in (self._maps, self._surfaces))
                wanted = {stream.TOUCHES: True, stream.MAPS: maps or surfaces, stream.CLOUDS: surfaces}
                self._stream.want({topic for topic, asked in wanted.items() if asked})
            found = self._stream.next(min(0.1, self._blind_s))
            if isinstance(found, Cloud):
                self._cloud = found
            elif found is not None and (age_s := found.age_s) > self._blind_s:
                self._old += 1
                self._be_blind(f"frames are {age_s:.2f} s old, more than {self._blind_s:g} s")
            elif found is not None:
                came_s = time.monotonic()
                self._publish(found, age_s)
            elif time.monotonic() - came_s > self._blind_s:
                endpoint, wrong = self._stream.endpoint, self._stream.wrong
                silence = f"no frame from {endpoint} within {self._blind_s:g} s: is `eitskin run` running there?"
                self._be_blind(f"{endpoint} sent {wrong}" if wrong else silence)

    def _publish(self, frame: Frame, age_s: float) -> None:
        """Publish a frame with the time at which its scan ended."""
        stamp = self.get_clock().now() - Duration(nanoseconds=round(1e9 * age_s))
        header = Header(stamp=stamp.to_msg(), frame_id=self._frame_id)
        now_s = time.monotonic()
        if not frame.map:
            self._touches.publish(touches_message(header, frame))
            if frame.same_host:
                self._latencies_ms.append(1e-6 * (time.monotonic_ns() - frame.fields["host_ns"]["read"]))
            if frame.touches or not frame.fields["touched"]:
                self._listed_s = now_s
            self._last, self._blind, self._frames = frame, "", self._frames + 1
        elif now_s >= self._map_due_s:
            self._map_due_s = max(self._map_due_s, now_s - self._map_period_s) + self._map_period_s
            self._maps.publish(map_message(header, frame))
            if self._cloud is not None and len(self._cloud.points) == 4 * len(frame.map):
                self._surfaces.publish(surface_message(header, frame, self._cloud))

    def _be_blind(self, why: str) -> None:
        self._blind = why
        self.get_logger().warning(f"blind: {why}", throttle_duration_sec=5.0)

    def _on_timer(self) -> None:
        """Publish how stream and skin are."""
        if self._thread is None:
            return
        frame, blind, late = self._last, self._blind, sorted(self._latencies_ms)
        fields = frame.fields if frame else {}
        values = {"frames_per_s": self._frames, "lost": self._stream.lost, "old": self._old}
        values |= {f"wire_{name}": count for name, count in fields.get("counts", {}).items()}
        values |= {f"latency_ms_p{at}": round(late[at * (len(late) - 1) // 100], 3) for at in (50, 99) if late}
        self._frames = 0
        level, how = (DiagnosticStatus.ERROR, f"blind: {blind}") if blind else (DiagnosticStatus.OK, "frames come")
        said = [self._status("stream", level, how, values)]
        if frame and not blind:
            faults = [f"electrode {entry}" for entry in fields.get("electrodes", ())]
            if time.monotonic() - self._listed_s > 3.0:
                faults.append("touched, but no touch is listed")
            skin = {name: fields[name] for name in SKIN if name in fields}
            level = DiagnosticStatus.WARN if faults else DiagnosticStatus.OK
            said.append(self._status("skin", level, "; ".join(faults) or "healthy", skin))
        self._diagnostics.publish(DiagnosticArray(header=Header(stamp=self.get_clock().now().to_msg()), status=said))

    def _status(self, name: str, level: bytes, message: str, values: dict[str, Any]) -> DiagnosticStatus:
        serial = self._last.fields["serial"] if self._last else ""
        told = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        return DiagnosticStatus(level=level, name=f"eitskin: {name}", message=message, hardware_id=serial, values=told)

    def _asked(self, timeout_s: float, command: str, **fields: Any) -> dict[str, Any]:
        given = self._given()
        endpoint, keys = (
            given["control"] or stream.default_endpoint("control"),
            (given["server_key"], given["client_key"]),
        )
        return stream.request(endpoint, keys, timeout_s, command, **fields)

    def _on_capture(self, asked: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        """Capture a reference of the flat, untouched sheet."""
        try:
            answer.success, answer.message = True, str(self._asked(60.0, "reference"))
        except StreamError as error:
            answer.success, answer.message = False, str(error)
        return answer

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Exclude electrodes at once; every other parameter takes effect with the next configuration."""
        for parameter in parameters:
            if parameter.name == "excluded":
                try:
                    self._asked(5.0, "exclude", electrodes=list(parameter.value or ()))
                except (StreamError, TypeError) as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def main() -> int:
    """Run the node until it is ended; return 1 if its parameters cannot be used."""
    rclpy.init()
    node = SkinNode()
    if node.get_parameter("autostart").value:
        for transition in (node.trigger_configure, node.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                return 1
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)
    node.stop()
    return 0
