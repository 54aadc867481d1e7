"""A reference with a scan counts as that of the flat sheet, wherever frames are held against it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eitskin.errors import BadReference, MismatchError
from eitskin.reference import captured as references
from eitskin.reference.judged import ReferenceChecks
from eitskin.reference.plausible import scan_of
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.cloud_file import Surface
from eitskin_proto.skin.skin import PAPER

from .capturing import capture

STRETCH = 1.03


@pytest.fixture
def flat_V(counts):
    return np.abs(counts) * 1e-9 + 1e-6


@pytest.fixture
def bent(flat_V):
    """What a stretched sheet reads over a flat one, as the model says."""
    return 1.0 + 0.05 * np.sin(np.arange(104.0))


@pytest.fixture
def scan(bent):
    cloud = flat_cloud() * np.array([STRETCH, 1.0, 1.0])[:, None, None]
    return scan_of(Surface(cloud, 3.0 * bent, np.full(104, 3.0)), PAPER)


def taken(voltages, hello, scan=None, checks=None):
    noise = 1e-3 * np.random.default_rng(2).standard_normal((20, 104))
    return capture(voltages * (1.0 + noise), hello, checks, scan=scan)


def test_the_model_s_ratio_makes_a_flat_reference(flat_V, bent, scan, hello):
    found = taken(flat_V * bent, hello, scan)
    assert np.allclose(found.flat().voltages_V, flat_V, rtol=2e-3)  # noise of 20 frames
    assert np.allclose(found.flat().spread_V / found.flat().voltages_V, found.spread_V / found.voltages_V, rtol=1e-12)
    assert found.flat().weak.tolist() == found.weak.tolist()
    assert any("scanned when it was captured" in line for line in found.report())


def test_a_bent_sheet_is_refused_but_not_where_it_was_scanned(flat_V, hello):
    bent = np.exp(0.3 * np.sin(np.arange(104.0)))
    scan = scan_of(Surface(flat_cloud(), bent, np.ones(104)), PAPER)
    checks = ReferenceChecks(flat_V=flat_V)
    with pytest.raises(BadReference, match="differs from the bundle's flat"):
        taken(flat_V * bent, hello, None, checks)
    assert taken(flat_V * bent, hello, scan, checks).judgement.refusals == ()


def test_a_stored_scan_comes_back(flat_V, scan, hello, tmp_path):
    path = tmp_path / "flat.json"
    found = taken(flat_V, hello, scan)
    references.save(found, path)
    again = references.load(path, PAPER)
    assert np.array_equal(again.flat().voltages_V, found.flat().voltages_V)
    assert np.array_equal(again.scan.cloud_mm, scan.cloud_mm)
    assert json.loads(path.read_text())["version"] == 2
    references.save(replace(found, scan=None), path)
    assert json.loads(path.read_text())["version"] == 1


def test_what_would_ignore_the_scan_must_refuse_the_file(flat_V, scan, hello, tmp_path):
    path = tmp_path / "flat.json"
    references.save(taken(flat_V, hello, scan), path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"version": 1}))
    with pytest.raises(MismatchError, match="version: found 1, expected 2"):
        references.load(path)
    del content["scan"]
    path.write_text(json.dumps(content))
    with pytest.raises(MismatchError, match="version: found 2, expected 1"):
        references.load(path)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"predicted_V": [1.0] * 103}, r"predicted_V has shape \(103,\)"),
        ({"predicted_V": [1e9] * 104}, "expected 0.08 to 6 times"),
        ({"predicted_V": [-1.0] * 104}, "expected 0.08 to 6 times"),
        ({"cloud_mm": [[0.0]]}, r"expected \(3, rows, columns\)"),
        ({"cloud_mm": "none"}, "malformed"),
    ],
)
def test_a_scan_that_cannot_be_is_refused(scan, flat_V, hello, tmp_path, change, text):
    from eitskin_proto.files.digest import sha256_of_values

    path = tmp_path / "flat.json"
    references.save(taken(flat_V, hello, scan), path)
    content = json.loads(path.read_text())
    content["scan"] |= change
    del content["sha256"]
    content["sha256"] = sha256_of_values(content)
    path.write_text(json.dumps(content))
    with pytest.raises(BadReference, match=text):
        references.load(path)


def test_frames_are_held_against_the_flat_one(flat_V, bent, scan, hello, tiny):
    from eitskin.pipeline.frame_pipeline import Pipeline
    from eitskin.reference.normaliser import Normaliser

    found = taken(flat_V * bent, hello, scan)
    pipeline = Pipeline(tiny, hello, None, solver="tikhonov")
    pipeline.use_reference(found)
    alone = Normaliser(hello.volts_per_count)
    alone.use_reference(found.flat().voltages_V)
    counts = np.round(flat_V / hello.volts_per_count).astype(np.int32)
    change = np.zeros((2, 104), dtype=np.float32)
    for one, out in ((pipeline.normaliser, change[0]), (alone, change[1])):
        one.load(counts)
        assert one.change_into(out)
    assert np.array_equal(change[0], change[1])
    assert np.abs(change[0]).max() < 5e-3
