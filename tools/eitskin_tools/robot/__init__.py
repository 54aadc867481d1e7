"""``eitskin run --config``: a process for each skin of a robot, and their supervisor."""
