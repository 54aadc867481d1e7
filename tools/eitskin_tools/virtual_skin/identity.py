"""What a virtual skin is given: where its voltages come from, and what makes it different from others."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.ids import PROTOCOL_ID

Array = npt.NDArray[np.float64]


class Source(Protocol):
    """Where voltages come from."""

    def voltages(self, time_s: float) -> Array:
        """Return the V at a time since the first START, noise included.

        They are (104,); or (208,) of the full table, where a pair of pairs reads otherwise the other way round.
        """
        ...


@dataclass(frozen=True, slots=True)
class Identity:
    """What makes this skin different from others."""

    serial_number: str = "VIRTUAL-0001"
    protocol_id: str = PROTOCOL_ID
    """Another than this installation's plays a foreign device."""
    first_us: int = 0
    """What the device clock shows at boot; near 2^32 it wraps soon."""
