"""A ROS 2 node: touches as points with normals, and maps, on standard messages, in metres.

    python docs/examples/ros2_node.py
    python docs/examples/ros2_node.py --ros-args -p endpoint:=ipc:///run/user/1000/eitskin/frames -p frame_id:=forearm

/eitskin/touches   sensor_msgs/PointCloud2   one point per touch: x y z nx ny nz area peak error_x error_y amplitude
                                             log_likelihood_ratio id; empty without touches
/eitskin/map       sensor_msgs/Image         32FC1, if the topic has a subscriber; row 0 is y = 0

frame_id names the frame in which clouds are sent; without clouds, the flat sheet's, with its corner at the origin. The
skin measures no force, so there is no wrench. The node publishes nothing while no frames come: set a deadline.
"""

from array import array
from contextlib import suppress

import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

import eitskin

NUMBERS = ("x", "y", "z", "nx", "ny", "nz", "area", "peak", "error_x", "error_y", "amplitude", "log_likelihood_ratio")
POINT = np.dtype([(name, "<f4") for name in NUMBERS] + [("id", "<u4")])


class Skin(Node):
    """Publishes a runtime's frames."""

    def __init__(self) -> None:
        """Declare the parameters and the topics."""
        super().__init__("eitskin")
        self.endpoint = str(self.declare_parameter("endpoint", "").value) or None
        self.frame_id = str(self.declare_parameter("frame_id", "skin").value)
        self.touches = self.create_publisher(PointCloud2, "/eitskin/touches", qos_profile_sensor_data)
        self.maps = self.create_publisher(Image, "/eitskin/map", qos_profile_sensor_data)
        fields = [PointField(name=name, offset=POINT.fields[name][1], datatype=7, count=1) for name in NUMBERS]
        self.fields = [*fields, PointField(name="id", offset=POINT.fields["id"][1], datatype=6, count=1)]

    def publish(self, frame: eitskin.Frame) -> None:
        """Publish a frame with the time at which its scan ended."""
        stamp = (self.get_clock().now() - Duration(nanoseconds=round(1e9 * frame.age_s))).to_msg()
        header = Header(stamp=stamp, frame_id=self.frame_id)
        points = np.zeros(len(frame.touches), dtype=POINT)
        for point, touch in zip(points, frame.touches, strict=True):
            point["x"], point["y"], point["z"] = np.divide(touch.place_mm, 1e3)
            point["nx"], point["ny"], point["nz"] = touch.normal
            point["area"], point["peak"], point["id"] = 1e-6 * touch.area_mm2, touch.peak, touch.id
            doubts = (*(touch.error_mm or (None, None)), touch.amplitude, touch.log_likelihood_ratio)  # if taught
            for name, value in zip(NUMBERS[-4:], doubts, strict=True):
                point[name] = np.nan if value is None else value
            point["error_x"], point["error_y"] = 1e-3 * point["error_x"], 1e-3 * point["error_y"]
        cloud = PointCloud2(header=header, height=1, width=len(points), fields=self.fields, is_dense=True)
        cloud.point_step, cloud.row_step = POINT.itemsize, points.nbytes
        cloud.data = array("B", points.tobytes())
        self.touches.publish(cloud)
        if self.maps.get_subscription_count():
            rows, columns = frame.map.shape
            image = Image(header=header, height=rows, width=columns, encoding="32FC1", step=4 * columns)
            image.data = array("B", frame.map.tobytes())
            self.maps.publish(image)


def main() -> None:
    """Publish frames until Ctrl-C."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C ends the wait for a frame, too
    node = Skin()
    with suppress(KeyboardInterrupt), eitskin.subscribe(node.endpoint, touches=True, timeout_s=0.5) as frames:
        while rclpy.ok():
            try:
                node.publish(frames.next_frame())
            except eitskin.NoFrame as error:
                node.get_logger().warning(f"blind: {error}", throttle_duration_sec=5.0)
            rclpy.spin_once(node, timeout_sec=0.0)


if __name__ == "__main__":
    main()
