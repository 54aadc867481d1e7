"""``eitskin skin``, and ``--skin`` where commands take it: the skin that is named is used, or refused in one line."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import TABLES, named, parse, to_toml
from eitskin_tools import cli


@pytest.fixture
def second(tmp_path):
    path = tmp_path / "skin.toml"
    path.write_text(to_toml(SECOND))
    return str(path)


def one_line(capsys, words, status=1):
    assert cli.main(words) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return err


def test_what_is_shown_is_a_description_of_the_same_skin(capsys, second):
    for file, skin in ((second, SECOND), ("paper", PAPER), ("hydrogel", named("hydrogel"))):
        assert cli.main(["skin", "show", file]) == 0
        out = capsys.readouterr().out
        assert parse(out).digest == skin.digest
        assert skin.digest in out.splitlines()[0]
        assert skin.grid_id in out


def test_the_report_has_ids_mirrors_and_what_is_uncertain(capsys, second):
    assert cli.main(["skin", "show", second, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["digest"], found["grid_id"], found["touch_kind"]) == (SECOND.digest, SECOND.grid_id, "raise")
    assert [(one["x"], one["y"]) for one in found["mirror_images"]] == [(False, False), (True, True)]
    assert found["not_exact"] == []
    assert cli.main(["skin", "check", "hydrogel", "--json"]) == 0
    assert "layer.gauge_factor" in json.loads(capsys.readouterr().out)["not_exact"]


def test_check_prints_one_line(capsys, second):
    assert cli.main(["skin", "check", second]) == 0
    out = capsys.readouterr().out
    assert out == (f"{second}: second, rectangle of 220 x 90 mm, digest {SECOND.digest}, images 2 (itself, x and y)\n")


def test_electrodes_that_mostly_would_be_round_a_corner_are_refused(capsys, tmp_path):
    near = replace(PAPER, electrodes=near_a_corner(0.5))
    (tmp_path / "skin.toml").write_text(to_toml(near))
    said = one_line(capsys, ["skin", "check", str(tmp_path / "skin.toml")])
    assert " of 40 random devices of skin paper cannot be (electrode " in said
    (tmp_path / "skin.toml").write_text(to_toml(replace(near, electrodes=near_a_corner(0.01))))
    assert cli.main(["skin", "check", str(tmp_path / "skin.toml")]) == 0


def near_a_corner(sd_mm):
    """Return electrodes of which two keep a tenth of a millimetre from a corner."""
    arc = PAPER.arc_length_mm.copy()
    arc[[0, 8]] = 2.1, 252.1
    return replace(PAPER.electrodes, arc_length_mm=Quantity(tuple(arc.tolist()), "normal", sd_mm))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("size_mm = [220.0, 90.0]", "size_mm = [2200.0, 90.0]", "[outline] size_mm[0] is 2200"),
        ("[map]", "[mapp]", "did you mean 'map'"),
        ("10.0, 48.75", "1.0, 48.75", "electrode 0 is a patch round a corner"),
        ('kind = "rectangle"', 'kind = "disc"', "expected twice the same number, the disc's diameter"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(capsys, tmp_path, old, new, said):
    text = to_toml(SECOND)
    assert old in text
    (tmp_path / "skin.toml").write_text(text.replace(old, new))
    line = one_line(capsys, ["skin", "check", str(tmp_path / "skin.toml")])
    assert said in line
    assert "skin.toml" in line


def test_voltages_carry_the_skin_that_the_scene_was_read_with(tmp_path, capsys, second):
    (tmp_path / "scene.json").write_text(json.dumps({"touches": [{"units": [[14, 8]]}], "element_size_mm": 6.0}))
    words = ["simulate", str(tmp_path / "scene.json"), "--out", str(tmp_path / "v.npz")]
    assert cli.main([*words, "--skin", second]) == 0
    with np.load(tmp_path / "v.npz") as file:
        assert (str(file["grid_id"]), str(file["skin_digest"])) == (SECOND.grid_id, SECOND.digest)
        assert json.loads(str(file["scene"]))["sheet"]["size_mm"] == [220.0, 90.0]
    capsys.readouterr()
    assert "column must be an integer from 0 to 13" in one_line(capsys, words)


def test_a_bundle_of_another_skin_is_refused(capsys, second, pytestconfig):
    bundle = str(pytestconfig.rootpath / "tests" / "golden" / "tiny.eitskin")
    words = ["evaluate", "--single", "20", "--deformations", "1", "--each", "1", "--skin", second, "--bundle", bundle]
    line = one_line(capsys, words)
    assert f"expected {SECOND.grid_id}" in line
    assert "name a bundle of this skin with --bundle" in line


def test_the_documents_name_every_key(pytestconfig):
    text = (pytestconfig.rootpath / "docs" / "skin.md").read_text(encoding="utf-8")
    keys = [*TABLES, *(f"`{one.name}`" for part in TABLES.values() for one in fields(part))]
    assert [key for key in keys if key not in text] == []
