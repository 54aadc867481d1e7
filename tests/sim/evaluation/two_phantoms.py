"""Two phantoms of a bent sheet, one with each kind of truth: what tests of the harness and of its command evaluate."""

BENT = {"angle_deg": 90, "stretch_along": 1.06, "stretch_across": 0.985}
FILE = [
    {"name": "two", "truth": "units", "scene": {"bend": BENT, "touches": [{"units": [[3, 2], [10, 6]]}]}},
    {"name": "disc", "truth": "area", "scene": {"bend": BENT, "touches": [{"disc_mm": [70, 45, 6]}]}},
]
