"""A finger in MuJoCo presses a bent sheet, and the runtime feels it.

    python docs/examples/mujoco_finger.py [PRESSES] [PICTURE.png]

The sheet covers a cylinder. Every contact is a press, the sheet's model gives its voltages, and the same runtime as on
a robot turns them into touches. The picture shows them beside the truth. Needs the extra ``simulators``.
"""

import sys

import mujoco
import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

import eitskin
from eitskin_proto.skin.toml import named
from eitskin_sim.press import Press, Sheet

WORLD = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <geom name="sheet" type="cylinder" size=".1 .05" euler="90 0 0" solref="-60 -16" solimp=".9 .9 .001"/>
    <body name="finger" pos="0 0 .13">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="tip" type="sphere" size=".01" mass=".1" friction="0 0 0"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="400" kv="12"/>
    <position joint="y" kp="400" kv="12"/>
    <position joint="z" kp="400" kv="12"/>
  </actuator>
</mujoco>
"""
RADIUS_MM, TIP_MM = 100.0, 10.0
DEPTH_MM = 10.0
STEPS = 10  # of the simulation a frame: 50 frames a second
NOISE = 0.003  # of each voltage


def on_cylinder(xy_mm: np.ndarray, above_mm: float = 0.0) -> np.ndarray:
    """Return the (n, 3) mm of (n, 2) places on the flat sheet, or above them along the normal."""
    turn = (xy_mm[:, 0] - 75.0) / RADIUS_MM
    out = RADIUS_MM + above_mm
    return np.stack([out * np.sin(turn), xy_mm[:, 1] - 50.0, out * np.cos(turn)], axis=1)


def presses_of(data: mujoco.MjData, sheet: Sheet) -> list[Press]:
    """Return the contacts as presses: a ball's is as wide as its cut at the surface, and no deeper than the table."""
    found = []
    for contact in data.contact:
        depth = float(np.clip(-1e3 * contact.dist, 0.0, sheet.law.depths_mm[1]))
        (place,) = sheet.places_mm(1e3 * contact.pos)
        radius = np.sqrt(depth * (2.0 * TIP_MM - min(depth, TIP_MM)))
        found.append(Press(*place.tolist(), max(float(radius), 2.0), depth))
    return found


def draw(path: str, sheet: Sheet, frame: eitskin.Frame, pairs: np.ndarray) -> None:
    """Draw the last press on the bent sheet, and all presses and touches on the flat one."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    bent = figure.add_subplot(1, 2, 1, projection="3d")
    bent.plot_surface(
        *sheet.cloud_mm, facecolors=colormaps["viridis"](frame.map.clip(0.0, 1.0)), shade=False, rstride=1, cstride=1
    )
    bent.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", zticks=(80, 100))
    bent.set_title("the last map that was touched")
    flat = figure.add_subplot(1, 2, 2)
    flat.scatter(*pairs[:, :2].T, s=120, facecolors="none", edgecolors="tab:blue", label="contact")
    flat.scatter(*pairs[:, 2:].T, s=30, marker="x", color="tab:red", label="touch")
    flat.set(xlabel="x, mm", ylabel="y, mm", xlim=(0, 150), ylim=(0, 100), aspect="equal", title="all presses")
    flat.legend()
    figure.savefig(path, dpi=100)


def main(count: int, picture: str | None) -> None:
    """Press the sheet again and again."""
    model = mujoco.MjModel.from_xml_string(WORLD)
    data, random, description = mujoco.MjData(model), np.random.default_rng(0), named("hydrogel")
    grid = description.grid
    cloud = on_cylinder(grid.pixel_centres_mm().reshape(-1, 2)).T.reshape(grid.cloud_shape)
    sheet = Sheet(description, cloud)
    noise = 1.0 + NOISE * random.standard_normal((50, 104))
    pairs, last = [], None
    with eitskin.Skin(source=eitskin.Feed(), bundle="press", reference=sheet.flat_V * noise) as skin:
        skin.set_cloud(sheet.cloud_mm, sheet.untouched_V, sheet.flat_V)
        for place in random.uniform((15.0, 15.0), (135.0, 85.0), (count, 2)):
            deepest, felt = None, None
            for above_mm in [20.0] * 20 + [-DEPTH_MM] * 25 + [20.0] * 5:
                (target,) = on_cylinder(place[None], TIP_MM + above_mm)
                data.ctrl[:] = 1e-3 * target - (0.0, 0.0, 0.13)
                mujoco.mj_step(model, data, STEPS)
                presses = presses_of(data, sheet)
                volts = sheet.voltages(presses) * (1.0 + NOISE * random.standard_normal(104))
                frame = skin.feed(volts, int(1e6 * data.time))
                if presses and (deepest is None or presses[0].depth_mm > deepest.depth_mm):
                    deepest, felt = presses[0], frame
            touch = max(felt.touches, key=lambda one: one.area_mm2) if felt and felt.touches else None
            if deepest is None or touch is None:
                print("not felt", "" if deepest is None else f"at {deepest.x_mm:.1f}, {deepest.y_mm:.1f} mm")
                continue
            pairs.append((deepest.x_mm, deepest.y_mm, *touch.centre_mm))
            last = felt
            print(
                f"contact at {deepest.x_mm:.1f}, {deepest.y_mm:.1f} mm, {deepest.depth_mm:.1f} mm deep; touch at "
                f"{touch.centre_mm[0]:.1f}, {touch.centre_mm[1]:.1f} mm"
            )
    off = np.array(pairs).reshape(-1, 4)
    median_mm = np.median(np.hypot(*(off[:, 2:] - off[:, :2]).T)) if pairs else np.nan
    print(f"felt {len(pairs)} of {count} presses, {median_mm:.2f} mm off in the median")
    if picture and last is not None:
        draw(picture, sheet, last, off)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, sys.argv[2] if len(sys.argv) > 2 else None)
