"""A bundle that was taught, from counts to a map and a list of touches."""

import hashlib
import io
import json
import zipfile

import numpy as np
import pytest

import eitskin
from eitskin.model.bundle import load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.model.taught import TaughtFinder
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin.touches.touch import LAYOUT, unpack_touches
from eitskin.touches.watch import TouchWatch
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.frames import Frame

Q = 24
RANDOM = np.random.default_rng(5)
SEEN_MM = RANDOM.uniform((0, 0), (150, 100), (Q, 2))
MIX = np.linalg.qr(RANDOM.normal(size=(N_ROWS, Q)))[0]


def response(places_mm):
    """Return (n, q) whitened responses, some 15 times as strong as noise."""
    distance = ((np.asarray(places_mm)[:, None] - SEEN_MM) ** 2).sum(axis=-1)
    return 15.0 * np.exp(-distance / (2.0 * 25.0**2))


def npz(arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def taught_bundle(folder, tiny_path):
    """Return a bundle that was taught on the sheet of another one."""
    tiny = load_bundle(tiny_path)
    field = response(tiny.skin.grid.pixel_centres_mm().reshape(-1, 2))
    ones = {"amplitude_sd": 0.3, "freedom": 20.0, "threshold": 6.0, "spread": 1.0, "logarithm": 1.0}
    arrays = {"project": 1e3 * MIX, "field": field, "variance": 0.01 * np.ones_like(field)}
    arrays |= {"inside": np.ones(len(field)), "untouched": np.eye(Q)} | {name: np.array(x) for name, x in ones.items()}
    data = npz(arrays)
    with zipfile.ZipFile(tiny_path) as archive:
        manifest = json.loads(archive.read("manifest.json"))
    del manifest["head"]
    manifest["files"] = {"taught.npz": {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}}
    with zipfile.ZipFile(folder / "taught.eitskin", "w") as archive:
        archive.writestr("manifest.json", json.dumps(manifest))
        archive.writestr("taught.npz", data)
    return load_bundle(folder / "taught.eitskin")


@pytest.fixture
def taught(tmp_path, tiny_path):
    return taught_bundle(tmp_path, tiny_path)


def test_a_touch_is_listed_with_its_errors_where_the_map_shows_it(taught, hello, counts):
    pipeline = Pipeline(taught, hello)
    pipeline.use_reference(Reference(counts * 1e-9, counts * 1e-12, 50, "TEST-1", 0xABCD, "paper", ""))
    pipeline.start_with(GeometryGraph(taught).geometry(None, None, 0))
    watch = TouchWatch(taught.skin.grid, TaughtFinder(pipeline.field, taught.skin.grid))

    def listed(sequence, change):
        z = change + RANDOM.normal(size=Q)
        sample = np.rint(counts * np.exp(1e-3 * MIX @ z)).astype(np.int32)
        frame = Frame(sequence, sequence * 5000, sample, generation=hello.generation, sample_bytes=hello.sample_bytes)
        assert pipeline.accept(frame.pack(), sequence)
        assert pipeline.compute(wanted=True)
        values = pipeline.buffers.map[0] if pipeline.record.touched else None
        packed = watch.update(values, pipeline.record.map_key, pipeline.buffers.surface, sequence * 5000)
        return unpack_touches(packed[0], LAYOUT.size, *packed[1:]).touches

    for sequence in range(20):
        assert listed(sequence, np.zeros(Q)) == ()
        assert pipeline.record.solver == "none"
    place = 61.0, 40.0
    (touch,) = listed(20, response([place])[0])
    assert pipeline.record.solver == "taught"
    assert np.hypot(touch.centre_mm[0] - place[0], touch.centre_mm[1] - place[1]) < 4.0 * max(touch.error_mm)
    assert 0.1 < min(touch.error_mm) < 3.0
    assert touch.amplitude == pytest.approx(1.0, abs=0.2)
    assert touch.log_likelihood_ratio > 6.0
    found = taught.skin.grid.pixel_centres_mm().reshape(-1, 2)[pipeline.buffers.map[0].argmax()]
    assert np.hypot(found[0] - touch.centre_mm[0], found[1] - touch.centre_mm[1]) < 4.0
    two = listed(21, response([(30.0, 50.0)])[0] + response([(120.0, 50.0)])[0])
    assert sorted(round(one.centre_mm[0], -1) for one in two) == [30.0, 120.0]


def test_frames_of_an_array_are_judged_each_by_itself(taught, counts):
    places = np.array([(30.0, 50.0), (120.0, 40.0), (75.0, 80.0), (60.0, 20.0)])
    volts = counts * 1e-9 * np.exp(1e-3 * response(places) @ MIX.T)
    found = eitskin.reconstruct(volts, counts * 1e-9, taught)
    peaks = taught.skin.grid.pixel_centres_mm().reshape(-1, 2)[found.map.reshape(len(places), -1).argmax(axis=1)]
    assert found.touched.all()
    assert np.hypot(*(peaks - places).T).max() < 4.0
