"""Touches, maps and surface of a soft electronic skin on standard ROS 2 messages."""
