"""Print the touches of all skins of a robot, in the robot's frame; name a skin that falls silent.

python docs/examples/all_skins.py [ROBOT.toml, or the folder of 'eitskin run --config']
"""

import sys
from contextlib import suppress

import eitskin

with suppress(KeyboardInterrupt), eitskin.subscribe_all(*sys.argv[1:2], timeout_s=5.0, touches=True) as frames:
    for name, skin in frames.skins.items():
        print(f"{name} sits {skin.pose}")
    while True:
        try:
            one = next(frames)
        except eitskin.SilentSkin as silence:
            print(f"stop: {silence}")  # the robot is blind there
            continue
        for touch in one.touches:
            x, y, z = touch.place_mm
            facing = " ".join(f"{part:.2f}" for part in touch.normal)
            print(f"{one.skin}: touch {touch.id} at {x:.0f} {y:.0f} {z:.0f} mm of the robot, facing {facing}")
