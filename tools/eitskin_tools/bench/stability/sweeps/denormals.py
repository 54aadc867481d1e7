"""What numbers that a processor computes slowly would cost, and what the smallest that the runtime hands over cost.

Ratios of CPU time in one run, each input in turn with a usual one. ``unguarded`` writes denormals into the solvers'
memory by hand, where nothing of the runtime can put them. ``worst`` is the dearest of what it can: dV of 2**-53, the
smallest that counts and a reference can make, in every row and between usual rows, and for the geometry graph a cloud
that is bent by less than any number of normal size. See :mod:`eitskin.model.denormals`.
"""

import time
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle
from eitskin.model.denormals import flushed
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.session import checked_graph, open_session
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import network_input
from eitskin_tools.bench.stability.harness.rows import Row, rounded

Single = npt.NDArray[np.float32]

TIMES: Final = 60
"""Runs of each input."""

SMALL: Final = (1e-36, 1e-38, 1e-40)
"""Sizes around the smallest float32 of normal size, 1.2e-38: also products with it are slow."""

LEAST: Final = 2.0**-53
"""The smallest dV but 0."""


def denormal_rows(bundle: Bundle) -> list[Row]:
    """Return a row for each solver of a bundle, and for its geometry graph."""
    rng = np.random.default_rng(0)
    buffers = Buffers(bundle)
    buffers.take(GeometryGraph(bundle).geometry(None, None, 0))
    usual = rng.normal(0.0, 0.05, N_ROWS).astype(np.float32)
    signs = np.sign(usual)
    half = np.arange(N_ROWS) % 2 == 0
    admitted = [LEAST * signs, np.where(half, usual, LEAST * signs), np.where(half, usual, 0.0), 0.0 * usual]
    small = [size * usual / np.float32(0.05) for size in SMALL]
    rows = []
    for engine in engines(bundle, buffers):

        def infer(change: Single, engine: Engine = engine) -> None:
            buffers.change[0] = change
            engine.infer()

        rows.append(_row(engine.name, infer, usual, admitted, small))
    session = open_session(bundle, "geometry.onnx", checked_graph(bundle, "geometry.onnx"))

    def bend(points: Single) -> None:
        session.run(["bias"], {"cloud": points[None]})

    clouds = [_bent(bundle, size, rng) for size in SMALL]
    rows.append(_row("geometry", bend, _bent(bundle, 1.0, rng), [flushed(cloud) for cloud in clouds], clouds))
    return rows


def _bent(bundle: Bundle, size_mm: float, rng: np.random.Generator) -> Single:
    grid = bundle.skin.grid
    cloud = grid.flat_cloud_mm()
    cloud[2] = 50.0 * size_mm * rng.standard_normal(cloud[2].shape)
    return network_input(cloud, grid)


def _row(name: str, work: Callable[[Single], None], usual: Single, admitted: list[Single], small: list[Single]) -> Row:
    worst = max(_ratio(work, value.astype(np.float32), usual) for value in admitted)
    unguarded = max(_ratio(work, value.astype(np.float32), usual) for value in small)
    return {
        "sweep": "denormals",
        "solver": name,
        "unit": "times the CPU time of a usual input",
        "from": min(SMALL),
        "to": max(SMALL),
        "worst": rounded(worst),
        "unguarded": rounded(unguarded),
        "frames": 0,
        "degrades_10pct_at": None,
        "breaks_at": None,
        "why": f"the smallest numbers that reach it cost {worst:.2f} times a usual input, denormals {unguarded:.1f}",
    }


def _ratio(work: Callable[[Single], None], hostile: Single, usual: Single) -> float:
    """Return how many times the CPU time of a usual input another one takes, by medians of runs in turn."""
    spans: list[list[int]] = [[], []]
    for _ in range(TIMES):
        for taken, value in zip(spans, (usual, hostile), strict=True):
            start = time.thread_time_ns()
            work(value)
            taken.append(time.thread_time_ns() - start)
    return float(np.median(spans[1]) / np.median(spans[0]))
