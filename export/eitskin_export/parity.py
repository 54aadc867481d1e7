"""Compares the exported graphs with the trained network: the largest difference of each tensor.

The inputs are the same for every network: one to four touches on sheets bent by seeds that no data set uses, solved on
a coarse mesh, with N2 noise, and their clouds. (White noise in place of voltages and shapes drives logits past 130,
where float32 itself has an error of 1.8e-5, in torch as well, which says nothing about the graphs.) The network runs
whole and unfolded, so folding, splitting and exporting are tested at once, and in float64, so that float32's error
counts once and not twice.
"""

import copy
from dataclasses import replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import load_bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.session import onnxruntime, session_options
from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.normalise import log_prediction, relative_change
from eitskin_proto.skin.cloud import network_input
from eitskin_proto.skin.skin import Skin
from eitskin_sim.evaluation import trials
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Scene
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_training.network.model import VD2T

TOLERANCE: Final = 1e-5
"""Largest difference allowed in the map: float32 rounds a sum of 500 products to about 1e-6 of its size."""

SEED: Final = 7
"""Of the noise and the clouds."""

BENDS: Final = 8
"""Different deformations among the inputs."""

ELEMENT_MM: Final = 9.0
"""Of the mesh; what a network makes of voltages does not ask how exact they are."""

Array = npt.NDArray[np.float32]
Exact = npt.NDArray[np.float64]


@lru_cache(maxsize=4)
def stored_inputs(skin: Skin, count: int = 16) -> tuple[Array, Array, Array]:
    """Return (n, 104) dv, (n, 3, rows, columns) clouds and (n, 104) log_predicted that never change."""
    rng = np.random.default_rng(SEED)
    bends = min(BENDS, count)
    phantoms = trials.random((1, 4), bends, -(-count // bends), "A", "area", skin)[:count]
    flat = _voltages(nominal_scene(skin))
    changes, clouds, predicted = [], [], []
    for bend, group in groupby(phantoms, key=lambda phantom: phantom.scene.bend):
        untouched = _voltages(nominal_scene(skin, bend))
        cloud = network_input(measured_cloud(bend, rng, skin=skin), skin.grid)
        for phantom in group:
            noisy = add_noise(_voltages(phantom.scene), flat, "N2", 50.0, rng)
            changes.append(relative_change(noisy, flat))
            clouds.append(cloud)
            predicted.append(log_prediction(untouched, flat))
    return tuple(np.asarray(values, dtype=np.float32) for values in (changes, clouds, predicted))  # type: ignore[return-value]


def _voltages(scene: Scene) -> Exact:
    """Return (104,) V on a coarse mesh."""
    return solve_scene(replace(scene, element_size_mm=ELEMENT_MM)).voltages


def session(graph: bytes) -> onnxruntime.InferenceSession:
    """Return a one-thread session of a graph, as the runtime makes it."""
    return onnxruntime.InferenceSession(graph, session_options(), providers=["CPUExecutionProvider"])


def run_graphs(geometry: bytes, head: bytes, dv: Array, clouds: Array, predicted: Array) -> dict[str, Array]:
    """Return {"bias": (n, H), "map": (n, n_pixels)} of the two graphs, one sample at a time as they stream."""
    geometry_session, head_session = session(geometry), session(head)
    wanted = {item.name for item in head_session.get_inputs()}
    biases, maps = [], []
    for index in range(len(dv)):
        one = slice(index, index + 1)
        (bias,) = geometry_session.run(["bias"], {"cloud": clouds[one]})
        feed = {"dv": dv[one], "bias": bias, "log_predicted": predicted[one]}
        (touched,) = head_session.run(["map"], {name: value for name, value in feed.items() if name in wanted})
        biases.append(bias[0])
        maps.append(touched[0])
    return {"bias": np.array(biases), "map": np.array(maps)}


def run_network(model: VD2T, dv: Array, clouds: Array, predicted: Array) -> dict[str, Exact]:
    """Return the same tensors from the whole network in torch, unfolded, as training evaluates it, in float64."""
    exact = copy.deepcopy(model).double().eval()
    change, points, log_predicted = (torch.from_numpy(array).double() for array in (dv, clouds, predicted))
    with torch.inference_mode():
        raw = exact.bias(points)
        maps = exact.maps(exact.logits(change, raw, log_predicted))
        images = raw.view(len(raw), -1, exact.architecture.hidden).transpose(0, 1)
        norm = exact.fusion[0]
        assert isinstance(norm, nn.BatchNorm1d)
        bias = torch.stack([nn.BatchNorm1d.forward(norm, image) for image in images], dim=1).flatten(1)
    return {"bias": bias.numpy(), "map": maps.numpy()}


def parity(model: VD2T, geometry: bytes, head: bytes) -> dict[str, float]:
    """Return the largest difference of each tensor between the network and its graphs on the stored inputs.

    Raises:
        SkinError: The map differs by more than ``TOLERANCE``.
    """
    inputs = stored_inputs(model.skin)
    expected, found = run_network(model, *inputs), run_graphs(geometry, head, *inputs)
    # The bias has no bound of its own size, so its difference is given relative to its largest value.
    size = max(1.0, float(np.abs(expected["bias"]).max()))
    differences = {
        "bias": float(np.abs(found["bias"] - expected["bias"]).max()) / size,
        "map": float(np.abs(found["map"] - expected["map"]).max()),
    }
    if not all(one < TOLERANCE for one in differences.values()):  # nor is one that is not a number
        raise SkinError(f"the exported graphs differ from the network: {differences}, expected under {TOLERANCE:g}")
    return differences


def through_runtime(model: VD2T, bundle: Path) -> float:
    """Return the largest difference between a written bundle's maps, run as the frame loop runs it, and the network's.

    The bundle is read and checked by the runtime's own reader, clouds are in mm and unaligned, and the head is bound to
    the runtime's fixed memory.

    Raises:
        SkinError: The map differs by more than ``TOLERANCE``, or the runtime refuses the bundle.
    """
    loaded = load_bundle(bundle)
    geometry_graph, buffers = GeometryGraph(loaded), Buffers(loaded)
    (head,) = (engine for engine in engines(loaded, buffers) if engine.name == "vd2t")
    dv, _, predicted = (values[::2] for values in stored_inputs(model.skin))  # one for each deformation
    rng = np.random.default_rng(9)
    grid = model.skin.grid
    flat = grid.flat_cloud_mm()
    clouds = [flat + 5.0 * rng.standard_normal((3, 1, 1)) * np.sin(flat[:1] / 40.0) for _ in dv]
    off = []
    for revision, cloud in enumerate(clouds):
        buffers.use_geometry(geometry_graph.geometry(cloud, predicted[revision], revision))
        buffers.change[0] = dv[revision]
        head.infer()
        one = slice(revision, revision + 1)
        expected = run_network(model, dv[one], network_input(cloud, grid)[np.newaxis], predicted[one])["map"]
        off.append(np.abs(buffers.map - expected).max())
    largest = float(np.max(off))
    if not largest < TOLERANCE:
        raise SkinError(
            f"{bundle}: the runtime's map differs from the network's by {largest:g}, expected {TOLERANCE:g}"
        )
    return largest


def int8_error(
    geometry: bytes, head: bytes, int8: bytes, dv: Array, clouds: Array, predicted: Array
) -> dict[str, float]:
    """Return how far int8 maps are from float32 ones: rms, largest, and the share of pixels that flip at 0.5."""
    exact = run_graphs(geometry, head, dv, clouds, predicted)["map"]
    rounded = run_graphs(geometry, int8, dv, clouds, predicted)["map"]
    return {
        "rms": float(np.sqrt(np.mean(np.square(rounded - exact)))),
        "max": float(np.abs(rounded - exact).max()),
        "flipped": float(np.mean((rounded > 0.5) != (exact > 0.5))),
    }
