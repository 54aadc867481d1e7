"""Makes the sample points: on the sample scene's surface, as a scanner of 0.1 mm sees them, in no order.

``python -m tests.golden.make_sample_points`` writes the file that is shipped.
"""

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.scene.bend import surface
from eitskin_sim.scene.scene import load_scene
from eitskin_sim.surface.measured_cloud import NOISE_MM
from eitskin_tools.command_line import files

SAMPLE: Final = Path(__file__).resolve().parents[2] / "tools" / "eitskin_tools" / "scenes" / "sample.ply"

SPACING_MM: Final = 1.5
"""Between points, give or take a third; the file has 82 kB."""

SEED: Final = 1


def points(name: str = "sample") -> npt.NDArray[np.float32]:
    """Return (6868, 3) mm of points of a shipped scene, in the frame of its surface.

    Args:
        name: Of the scene.
    """
    scene = load_scene(files.find(name, files.SCENE))
    rng = np.random.default_rng(SEED)
    size = np.array(scene.sheet.size_mm)
    jitter_mm = SPACING_MM / 3
    axes = [np.linspace(jitter_mm, extent - jitter_mm, round(extent / SPACING_MM) + 1) for extent in size]
    flat = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    flat = flat + rng.uniform(-jitter_mm, jitter_mm, flat.shape)
    rng.shuffle(flat)
    exact = surface(scene.bend, scene.sheet, flat)
    return np.asarray(exact + NOISE_MM * rng.standard_normal(exact.shape), dtype=np.float32)


def ply(points_mm: npt.NDArray[np.float32]) -> bytes:
    """Return the bytes of a binary .ply file of some points."""
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points_mm)}\n{axes}end_header\n"
    return head.encode("ascii") + points_mm.astype("<f4").tobytes()


if __name__ == "__main__":
    SAMPLE.write_bytes(ply(points()))
    print(SAMPLE)
