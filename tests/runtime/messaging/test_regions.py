"""Regions: what is asked for, what is computed of it, and that the computed pixels are the whole network's."""

import queue
import threading
import time

import numpy as np
import pytest

import eitskin
from eitskin.errors import BundleError, UncutError
from eitskin.messaging.regions import Region, pixels, union, whole
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.onnx.crop import cut
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.region_worker import RegionWorker
from eitskin_proto.skin.skin import PAPER

SHAPE = PAPER.grid.shape
(EVERY,) = whole(SHAPE)


@pytest.fixture(scope="module", params=["area", "units"])
def shipped(request):
    if not default_path(request.param).exists():
        pytest.skip("the shipped bundles are not installed")
    return load_bundle(default_path(request.param))


def filled(bundle):
    buffers = Buffers(bundle)
    buffers.take(GeometryGraph(bundle).geometry(None, None, 0))
    buffers.change[:] = np.random.default_rng(2).normal(0, 0.1, (1, 104))
    return buffers


def test_millimetres_take_in_every_pixel_that_they_touch():
    assert Region.from_mm(0, 0, 150, 100) == EVERY
    assert Region.from_mm(0, 0, 10, 10) == Region(0, 3, 0, 3)  # a pixel is 10/3 mm: borders on pixels' edges
    assert Region.from_mm(9.9, 20.1, 10.1, 20.2) == Region(6, 7, 2, 4)


@pytest.mark.parametrize("bounds", [(-1, 0, 10, 10), (0, 0, 150.1, 10), (10, 0, 10, 10), (0, 50, 10, 40),
                                    (0, 0, float("nan"), 10), (0, 0, 10, float("inf"))])  # fmt: skip
def test_a_region_that_is_not_on_the_sheet_names_the_sheet(bounds):
    with pytest.raises(ValueError, match="not on the sheet: x is 0 to 150, y 0 to 100 mm"):
        Region.from_mm(*bounds)
    with pytest.raises(ValueError, match="not on the sheet"):
        eitskin.subscribe("ipc:///tmp/none", region_mm=bounds)


@pytest.mark.parametrize("topic", [b"", b"eitskin/region/0/31/0/45", b"eitskin/region/5/5/0/9", b"eitskin/region/1/2/3",
                                   b"eitskin/region/-1/2/0/3", b"eitskin/region/0/1/0/1x", b"\xff" * 40])  # fmt: skip
def test_a_topic_that_declares_no_region_on_the_sheet_is_none(topic):
    assert Region.from_topic(topic, SHAPE) is None


def test_a_region_comes_back_from_its_topic():
    for region in (EVERY, Region(3, 30, 0, 1), Region(29, 30, 44, 45)):
        assert Region.from_topic(region.topic, SHAPE) == region


def test_the_union_is_what_any_of_them_needs():
    one, other = Region(0, 2, 0, 3), Region(1, 3, 2, 4)
    assert union([other, one, one], SHAPE) == (one, other)
    assert pixels(union([one, other], SHAPE), SHAPE).tolist() == [0, 1, 2, 45, 46, 47, 48, 92, 93]
    assert union([one, EVERY], SHAPE) == union([], SHAPE) == (EVERY,)
    assert union([Region(row, row + 1, 0, 1) for row in range(17)], SHAPE) == (EVERY,)
    assert len(pixels((EVERY,), SHAPE)) == 1350


def test_the_cut_network_gives_the_pixels_of_the_whole_one(shipped):
    wanted = pixels((Region(0, 10, 5, 20), Region(20, 30, 40, 45)), SHAPE)
    whole, part = filled(shipped), filled(shipped)
    for one, other in zip(engines(shipped, whole), engines(shipped, part, wanted), strict=True):
        part.map[:] = 0.0
        one.infer()
        other.infer()
        assert one.name == other.name
        expected = whole.map[0, wanted]
        if one.name == "tikhonov":
            expected = expected / expected.max()  # the largest value of what was computed is 1
        assert np.ptp(expected) > 1e-3, "a constant would agree with anything"
        assert np.abs(part.map[0, wanted] - expected).max() < 1e-6  # the same products, summed in another order
        outside = np.setdiff1d(np.arange(1350), wanted)
        assert not part.map[0, outside].any()


def test_a_cut_network_is_smaller_by_the_rows_that_were_left_out(shipped):
    wanted = pixels((Region(0, 4, 3, 9),), SHAPE)
    width, architecture = shipped.bias_width, shipped.manifest["recipe"]["architecture"]
    outputs = 345 if architecture.get("symmetric") else 1350  # a quarter's pixels, or all
    for file, size in (("head.onnx", 4), ("head_int8.onnx", 1)):
        model = shipped.files[file]
        try:
            saved = len(model) - len(cut(model, wanted, SHAPE))
        except UncutError as reason:
            pytest.skip(f"a bundle from before sharpened heads could be cut: {reason}")
        computed = 9 * 4 * 5 if architecture.get("sharpening") else len(wanted)  # 2 x 2 cells, and two around
        expected = size * width * (outputs - computed) if shipped.labels == "area" else 8 * (1350 - len(wanted))
        assert expected <= saved < 1.1 * expected + 20_000  # biases, scales and notes on shapes go as well


def test_a_last_layer_that_cannot_be_cut_is_masked(tiny):
    wanted = pixels((Region(5, 9, 5, 9),), SHAPE)
    with pytest.raises(UncutError, match="Reshape"):
        cut(tiny.files["head.onnx"], wanted, SHAPE)
    whole, part = filled(tiny), filled(tiny)
    for one, other in zip(engines(tiny, whole), engines(tiny, part, wanted), strict=True):
        one.infer()
        other.infer()
        if one.name != "tikhonov":
            assert np.array_equal(part.map[0, wanted], whole.map[0, wanted])
            assert np.count_nonzero(part.map) <= len(wanted)


def test_bytes_that_are_no_network_are_refused():
    for data in (b"\x0b\x01", b"\x38\x05"):
        with pytest.raises(BundleError, match="no ONNX model"):
            cut(data, np.arange(3), SHAPE)


def test_a_solver_that_does_not_exist_is_named_with_those_that_do(tiny, hello):
    with pytest.raises(ValueError, match="solver 'magic' does not exist; this bundle has vd2t, vd2t-int8, tikhonov"):
        Pipeline(tiny, hello, solver="magic")
    chosen = Pipeline(tiny, hello, 10**9, solver="vd2t-int8")
    assert [engine.name for engine in chosen.engines] == ["vd2t-int8", "tikhonov"]
    assert [engine.name for engine in Pipeline(tiny, hello).engines] == ["vd2t"]  # without a budget nothing else runs


def test_the_newest_wish_wins_and_a_fickle_one_does_not_keep_a_core_busy(tiny, hello, monkeypatch):
    from eitskin.pipeline import region_worker

    monkeypatch.setattr(region_worker, "REST_S", 0.05)
    pipeline = Pipeline(tiny, hello)
    worker = RegionWorker(pipeline)
    for row in range(29):
        worker.want((Region(row, row + 1, 0, 45),))
    end = time.perf_counter() + 60
    while time.perf_counter() < end and (pipeline._next_engines is None or worker._thread is not None):
        time.sleep(0.01)
    assert pipeline._next_engines.regions == (Region(28, 29, 0, 45),)
    assert 1 <= worker.made < 10


def test_a_worker_hears_the_next_wish_whatever_became_of_the_last(tiny, hello, monkeypatch):
    from eitskin.pipeline import region_worker

    monkeypatch.setattr(region_worker, "REST_S", 0.05)
    pipeline, heard = Pipeline(tiny, hello), queue.SimpleQueue()

    def fails(regions):
        heard.put(regions)
        raise RuntimeError("no memory for a binding")

    monkeypatch.setattr(pipeline, "use_regions", fails)
    worker = RegionWorker(pipeline)
    for row in range(2):
        wanted = (Region(row, row + 1, 0, 45),)
        worker.want(wanted)
        assert heard.get(timeout=60) == wanted
        assert heard.get(timeout=60) == pipeline.whole
    worker.close()


def test_where_no_thread_is_left_everything_is_computed_and_the_next_wish_is_tried(tiny, hello, monkeypatch):
    def none_left(self):
        raise RuntimeError("can't start new thread")

    pipeline, heard = Pipeline(tiny, hello), queue.SimpleQueue()
    monkeypatch.setattr(pipeline, "use_regions", heard.put)
    worker, wanted = RegionWorker(pipeline), (Region(0, 1, 0, 45),)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", none_left)
        worker.want(wanted)
        assert heard.get(timeout=60) == pipeline.whole
    worker.want(wanted)
    assert heard.get(timeout=60) == wanted
    worker.close()


def test_a_worker_that_is_closed_makes_no_more_unions_and_leaves_no_thread(tiny, hello, monkeypatch):
    pipeline, making, go_on = Pipeline(tiny, hello), threading.Event(), threading.Event()
    worker = RegionWorker(pipeline)

    def slow(regions):
        making.set()
        assert go_on.wait(60)

    monkeypatch.setattr(pipeline, "use_regions", slow)
    worker.want((Region(0, 1, 0, 45),))
    assert making.wait(60)
    thread = worker._thread
    assert not thread.daemon  # the interpreter waits for it: C++ that is left behind aborts the process
    worker.want((Region(1, 2, 0, 45),))
    worker.close()  # waits a moment, and no longer
    assert thread.is_alive()
    go_on.set()
    thread.join(60)  # without the rest that it takes between two unions
    assert worker.made == 1
    worker.want((Region(2, 3, 0, 45),))
    worker.close()
    assert worker._thread is None


def test_only_the_union_is_computed_while_all_subscribers_agree(virtual_skin, running, tmp_path):
    one, other = (0.0, 0.0, 50.0, 30.0), (100.0, 60.0, 150.0, 100.0)
    with virtual_skin(touches=[[0.2, 60, 0.3]]) as port, running(port, tmp_path) as runtime:
        endpoint = runtime.publisher.endpoint
        with eitskin.subscribe(endpoint, mode="all", region_mm=one, timeout_s=60) as first:
            frame = next(frame for frame in first if frame.regions == (first.region,) and frame.solver != "none")
            outside = frame.map.copy()
            outside[first.region.slices] = 0.0
            assert frame.map[first.region.slices].any()
            assert not outside.any()
            assert "map:region" in frame.skipped
            with eitskin.subscribe(endpoint, region_mm=other, timeout_s=60) as second:
                both = union([first.region, second.region], SHAPE)
                assert next(frame for frame in second if frame.regions == both).map[second.region.slices].any()
            with eitskin.subscribe(endpoint, timeout_s=60) as plain:  # whoever says nothing gets everything
                assert next(frame for frame in plain if frame.regions == (EVERY,))
            assert next(frame for frame in first if frame.regions == (first.region,))
