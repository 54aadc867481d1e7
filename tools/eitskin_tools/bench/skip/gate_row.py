"""The runtime's own gate as a function of many frames, and its errors."""

from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.model.gate import Gate
from eitskin_tools.bench.skip.gate_error import Array, Judge, errors


def logits_of(gate: Gate, rows: npt.NDArray[np.intp] | slice = slice(None)) -> Judge:
    """Return a function from (n, 104) dV to (n,) logits of a gate that judges some of the rows."""

    def judge(dv: Array) -> Array:
        found = np.empty(len(dv))
        for index, row in enumerate(dv[:, rows]):
            gate.change[:] = row
            gate.touched()
            found[index] = gate.logit
        return found

    return judge


def errors_of(bundle: Bundle, reference: Array, bends: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return the errors of a bundle's gate; it has one."""
    arrays = bundle.gate_arrays()
    assert arrays is not None
    gate = Gate(arrays)
    return errors(logits_of(gate), gate.threshold, reference, bends, rng)
