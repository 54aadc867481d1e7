"""Write surface.ply as a 3-D scanner would: noisy points of scene.json's bent sheet, in the scanner's frame.

Needs the extra ``sim``. Run this again after a change of scene.json.
"""

import math
from pathlib import Path

import numpy as np

from eitskin_sim.scene.bend import surface
from eitskin_sim.scene.scene import load_scene

HERE = Path(__file__).parent
POINTS = 6000
NOISE_MM = 0.1
TILT_RAD = math.radians(12.0)

scene = load_scene(HERE / "scene.json")
rng = np.random.default_rng(1)
places = rng.uniform((0.0, 0.0), scene.sheet.size_mm, (POINTS, 2))  # (n, 2) mm on the flat sheet
points = surface(scene.bend, scene.sheet, places)  # (n, 3) mm
points += NOISE_MM * rng.standard_normal(points.shape)
tilt = np.array([[1, 0, 0], [0, math.cos(TILT_RAD), -math.sin(TILT_RAD)], [0, math.sin(TILT_RAD), math.cos(TILT_RAD)]])
seen = points @ tilt.T + [40.0, -25.0, 310.0]
header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(seen)}\n"
header += "property float x\nproperty float y\nproperty float z\nend_header\n"
(HERE / "surface.ply").write_bytes(header.encode() + seen.astype("<f4").tobytes())
