"""A new cloud takes effect: the geometry graph runs in the thread that brought the cloud, frames do not wait."""

import threading
import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eitskin.model.geometry import GeometryGraph, Given
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.held_prediction import prediction_against
from eitskin.reference.captured import Reference
from eitskin.reference.plausible import check_prediction
from eitskin_proto.skin.sheet_cloud import check_sheet


class CloudChange:
    """Gives a pipeline the flat sheet first, and then every cloud that comes.

    Args:
        pipeline: It has not seen a frame yet.

    Raises:
        BundleError: The geometry graph cannot be loaded or has another signature.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._graph = GeometryGraph(pipeline.bundle)
        self._lock = threading.Lock()
        self._revision = 0
        pipeline.start_with(self._graph.geometry(None, None, 0))
        self._graph.rest()

    def use(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None,
        predicted_flat: npt.ArrayLike | None,
        reference: Reference | None,
    ) -> tuple[int, tuple[str, ...]]:
        """Use a surface from the next frame on, and return its revision and what is doubtful; from any thread.

        Args:
            cloud: (3, rows, columns) mm in any pose; None for the flat sheet.
            predicted: (104,) V of this surface untouched; None for no prediction.
            predicted_flat: (104,) V of the flat sheet by the same model; None takes the reference.
            reference: What frames are held against.

        Raises:
            ValueError: The cloud or the voltages are malformed, or cannot be of this sheet; with value and bound.
            BadReference: There is a prediction, but nothing to hold it against.
        """
        skin, doubts = self._pipeline.skin, tuple[str, ...]()
        if cloud is not None:
            cloud, doubts = check_sheet(cloud, skin)
            cloud = cloud.astype(np.float32).astype(np.float64)  # as control requests and streams carry it
        ratio: npt.NDArray[np.float32] | None = None
        if predicted is not None:
            surface = skin.grid.flat_cloud_mm() if cloud is None else cloud
            check_prediction(surface, predicted, predicted_flat, reference, skin)
            fills = self._pipeline.health is not None
            ratio = prediction_against(predicted, predicted_flat, reference, fills=fills)
        with self._lock:
            geometry = self._graph.geometry(cloud, ratio, self._revision + 1)
            self._revision += 1
            self._pipeline.use_geometry(replace(geometry, given=_given(cloud, predicted, predicted_flat)))
            return geometry.revision, doubts


def _given(cloud: npt.ArrayLike | None, predicted: npt.ArrayLike | None, predicted_flat: npt.ArrayLike | None) -> Given:
    """Return copies of what was given, for whoever wants to compute it once more."""
    points = None if cloud is None else np.array(cloud, dtype=np.float32)
    volts = [None if one is None else np.array(one, dtype=np.float64) for one in (predicted, predicted_flat)]
    return Given(points, volts[0], volts[1], time.perf_counter_ns(), time.time_ns())
