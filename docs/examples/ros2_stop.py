"""A robot that moves until something touches the skin or it is blind, and moves on after that.

    python docs/examples/ros2_stop.py

Call your own robot in ``drive``.
"""

import time
from contextlib import suppress

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

OLDEST_S = 0.2


class Robot(Node):
    """Stops when it is touched or blind."""

    def __init__(self) -> None:
        """Subscribe."""
        super().__init__("robot")
        self.calm_frames = int(self.declare_parameter("calm_frames", 20).value)  # 0.1 s at 200 frames/s
        quality = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(PointCloud2, "/eitskin/touches", self.on_touches, quality)
        self.create_timer(OLDEST_S / 4, self.on_timer)
        self.moving, self.calm, self.came_s = False, 0, 0.0

    def drive(self, go: bool, why: str) -> None:
        """Stand in for a robot's drive; print when it was called, in ns of the machine's monotonic clock."""
        self.moving, self.calm = go, 0
        print("go" if go else "stop", time.monotonic_ns(), why, flush=True)

    def on_touches(self, message: PointCloud2) -> None:
        """Stop at a touch; move on after enough frames without one."""
        age = self.get_clock().now() - Time.from_msg(message.header.stamp)
        if age.nanoseconds > 1e9 * OLDEST_S:
            return  # old messages show nothing: the timer stops the robot
        self.came_s = time.monotonic()
        self.calm = 0 if message.width else self.calm + 1
        if self.moving and message.width:
            self.drive(False, f"touched {1e-6 * age.nanoseconds:.2f} ms ago")
        elif not self.moving and self.calm >= self.calm_frames:
            self.drive(True, "untouched")

    def on_timer(self) -> None:
        """Stop if no message came in time."""
        if self.moving and time.monotonic() - self.came_s > OLDEST_S:
            self.drive(False, "blind")


def main() -> None:
    """Run until Ctrl-C."""
    rclpy.init()
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(Robot())


if __name__ == "__main__":
    main()
