"""What a prediction is held against: the model's own flat sheet where that came along, else the reference in use.

A new reference is another V0, so what a prediction says of it is told anew.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference
from eitskin.model.buffers import Buffers
from eitskin.model.denormals import flushed
from eitskin.model.geometry import Geometry
from eitskin.reference.captured import Reference
from eitskin.reference.predicted import log_ratio


def prediction_against(
    predicted: npt.ArrayLike, predicted_flat: npt.ArrayLike | None, reference: Reference | None, *, fills: bool
) -> npt.NDArray[np.float32]:
    """Return the (104,) log(V_pred / V0) of a prediction.

    Args:
        predicted: (104,) V of a surface untouched.
        predicted_flat: (104,) V of the flat sheet by the same model; None takes the reference.
        reference: What frames are held against; None while there is none.
        fills: Whether weak rows are filled in, and so can be held against a whole prediction; else they say nothing.

    Raises:
        BadReference: There is nothing to hold it against.
        ValueError: The voltages are malformed, or cannot be of one sheet.
    """
    against = predicted_flat
    if against is None:
        if reference is None:
            raise BadReference("a prediction needs predicted_flat, or a captured reference to hold it against")
        against = reference.flat().voltages_V
    ratio = log_ratio(predicted, against)
    if reference is not None and (predicted_flat is None or not fills):
        ratio[reference.weak] = 0.0
    return ratio


class HeldPrediction:
    """Gives a pipeline's buffers geometries whose predictions are held against the reference in use.

    Args:
        buffers: Of the pipeline.
        fills: As in :func:`prediction_against`.
    """

    def __init__(self, buffers: Buffers, *, fills: bool) -> None:
        self._buffers, self._fills = buffers, fills
        self._reference: Reference | None = None

    def use(self, reference: Reference) -> None:
        """Hold what is in use against another reference, and all that comes."""
        self._reference = reference
        if self._buffers.geometry is not None:
            self.take(self._buffers.geometry)

    def take(self, geometry: Geometry) -> None:
        """Use another geometry."""
        self._buffers.take(self._held(geometry))

    def _held(self, geometry: Geometry) -> Geometry:
        """Return the same object where that changes nothing, or where no sheet is like that: then it stays as it is."""
        given, reference = geometry.given, self._reference
        if reference is None or given is None or given.predicted is None:
            return geometry
        try:
            found = prediction_against(given.predicted, given.predicted_flat, reference, fills=self._fills)
        except ValueError:
            return geometry
        ratio = flushed(found[None])
        return geometry if np.array_equal(ratio, geometry.log_predicted) else replace(geometry, log_predicted=ratio)
