"""A virtual sheet that is taught flat and bent: the untouched reading, or V_pred, says which shape it is in."""

import numpy as np
import pytest

from eitskin.model.bundle import load_bundle
from eitskin.model.taught import field_of
from eitskin_proto.errors import MismatchError
from eitskin_proto.sensor.row_table import ADJACENT_104
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Bend, Scene
from eitskin_tools.cli import main
from eitskin_tools.teach.physics import expected_changes

RANDOM = np.random.default_rng(1)
BENDS = {"flat": Bend(), "bent": Bend(60.0, stretch_along=1.02), "more": Bend(100.0, stretch_along=1.06)}
BENDS["between"] = Bend(40.0, stretch_along=1.009)
LEVELS = {name: factorise_scene(Scene(bend=bend, element_size_mm=4.0)).voltages() for name, bend in BENDS.items()}


def volts(name, places_mm=((np.nan, np.nan),)):
    """Return (n, 104) V of the sheet in a shape, pressed, or untouched where a place is NaN."""
    change = expected_changes(PAPER, np.nan_to_num(places_mm, nan=-100.0))
    return LEVELS[name] * np.exp(-0.6 * change)


@pytest.fixture(scope="module")
def sheet(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shapes")
    for name in ("flat", "bent"):
        xy = np.full((48, 2), np.nan)
        xy[1::2] = RANDOM.uniform((15, 15), (135, 85), (24, 2))
        readings = volts(name, xy) * np.exp(0.002 * RANDOM.normal(size=(48, 104)))
        np.savez(folder / f"{name}.npz", voltages_V=readings, xy_mm=xy, size_mm=(150.0, 100.0))
    return folder


def test_the_untouched_reading_chooses_the_shape(sheet, capsys):
    files = [str(sheet / f"{name}.npz") for name in ("flat", "bent")]
    assert main(["teach", *files, "--out", str(sheet / "both.eitskin")]) == 0
    said = capsys.readouterr().out
    assert said.index("In the shape flat") < said.index("In the shape bent")
    field, flat = field_of(load_bundle(sheet / "both.eitskin")), volts("flat")[0]
    field.use_reference(flat)
    places = RANDOM.uniform((30, 30), (120, 70), (4, 2))
    for name in ("flat", "bent"):
        for pressed in ((np.nan, np.nan), *places):
            field.change[:] = volts(name, [pressed])[0] / flat - 1.0
            assert (field.look() > field.threshold) == np.isfinite(pressed[0])
            assert field.shape == name
            touch = field.strongest()
            assert not np.hypot(touch.x_mm - pressed[0], touch.y_mm - pressed[1]) > 5.0
    for name in ("between", "more"):
        field.change[:] = volts(name)[0] / flat - 1.0
        field.look()
        assert field.shape == "unknown"


def test_a_prediction_takes_the_bend_out_of_a_field_that_was_taught_flat(sheet):
    assert main(["teach", str(sheet / "flat.npz"), "--out", str(sheet / "one.eitskin")]) == 0
    field, flat, more = field_of(load_bundle(sheet / "one.eitskin")), volts("flat")[0], volts("more")[0]
    field.use_reference(flat)
    field.use_prediction(np.log(more / flat).astype(np.float32))
    for bend, shape in (("more", "predicted"), ("flat", "flat")):
        for pressed in ((np.nan, np.nan), (75.0, 50.0)):
            field.change[:] = volts(bend, [pressed])[0] / flat - 1.0
            assert (field.look() > field.threshold) == np.isfinite(pressed[0])
            assert field.shape == shape
    assert np.hypot(field.strongest().x_mm - 75.0, field.strongest().y_mm - 50.0) < 5.0
    with pytest.raises(MismatchError, match="order of its rows: found a rank correlation of"):
        field.use_reference(np.roll(flat, 5))


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (lambda volts: volts, None),
        (lambda volts: np.roll(volts, 1, axis=1), "readings come 1 row late"),
        (lambda volts: np.roll(volts, -1, axis=0), "readings are shifted by one against xy_mm"),
    ],
)
def test_wrong_wiring_is_said_first_also_of_rows_in_an_order_of_their_own(sheet, capsys, spoilt, said):
    order = np.random.default_rng(2).permutation(104)
    with np.load(sheet / "flat.npz") as taught:
        arrays = {
            **taught,
            "voltages_V": spoilt(taught["voltages_V"])[:, order],
            "table": ADJACENT_104.electrodes[order],
        }
    np.savez(sheet / "w.npz", **arrays)
    main(["teach", str(sheet / "w.npz"), "--out", str(sheet / "w.eitskin")])
    warning = capsys.readouterr().err.splitlines()
    assert said is None or said in warning[0]
    assert said or not any("warning" in line for line in warning)


def test_files_of_different_sheets_are_refused(sheet, capsys):
    other = dict(np.load(sheet / "bent.npz"))
    np.savez(sheet / "wide.npz", **{**other, "size_mm": (150.0, 110.0)})
    files = [str(sheet / f"{name}.npz") for name in ("flat", "wide")]
    assert main(["teach", *files, "--out", str(sheet / "no.eitskin")]) == 1
    assert "150 x 110 mm, expected rows-104 on a rectangle of 150 x 100 mm" in capsys.readouterr().err
