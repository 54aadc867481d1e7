"""Recordings as files that other programs read: NPZ, Parquet, rosbag2."""
