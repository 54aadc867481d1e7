"""What a stream's gate says of frames that come one after the other: its state goes on from frame to frame."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.model.gate import Gate
from eitskin_proto.sensor.normalise import relative_change

Array = npt.NDArray[np.float64]


def judge_of(bundle: Bundle | None) -> Callable[[Array, Array], bool]:
    """Return what judges (104,) V against a reference (104,) V; without a gate every frame is taken for touched."""
    arrays = None if bundle is None else bundle.gate_arrays()
    if arrays is None:
        return lambda volts, reference: True
    gate = Gate(arrays)

    def touched(volts: Array, reference: Array) -> bool:
        gate.change[:] = relative_change(volts, reference)
        return gate.touched()

    return touched
