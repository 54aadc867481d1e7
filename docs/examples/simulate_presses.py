"""Presses of a simulated sheet at known places: a file that ``eitskin teach`` reads.

    python docs/examples/simulate_presses.py SCENE.json presses.npz 60 [SEED]

The scene describes the sheet; its first touch is pressed at 60 random places, and the sheet is read untouched before
each. Readings have 0.3 % of noise, and drift by 0.1 % from press to press.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.scene import load_scene
from eitskin_sim.scene.shapes import Disc

NOISE, DRIFT = 0.003, 0.001

if len(sys.argv) not in (4, 5):
    sys.exit(__doc__)
scene = load_scene(Path(sys.argv[1]))
touch, size_mm = scene.touches[0], scene.sheet.size_mm
random = np.random.default_rng(int(sys.argv[4]) if len(sys.argv) == 5 else 0)
places_mm = random.uniform((12.0, 12.0), (size_mm[0] - 12.0, size_mm[1] - 12.0), (int(sys.argv[3]), 2))

untouched = solve_scene(replace(scene, touches=())).voltages
volts, xy_mm = [], []
for x, y in places_mm:
    pressed = replace(touch, shapes=(Disc(float(x), float(y), touch.shapes[0].radius_mm),))
    volts += [untouched, solve_scene(replace(scene, touches=(pressed,))).voltages]
    xy_mm += [(np.nan, np.nan), (x, y)]
n = len(volts)
drift = np.cumsum(DRIFT * random.standard_normal((n, 1)), axis=0)
np.savez(
    sys.argv[2],
    voltages_V=np.array(volts) * np.exp(drift + NOISE * random.standard_normal((n, 104))),
    xy_mm=np.array(xy_mm),
    size_mm=np.array(size_mm),
    outline=np.array("rectangle"),
)
print(f"wrote {sys.argv[2]}: {len(places_mm)} presses")
