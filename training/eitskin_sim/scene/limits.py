"""The limits of a scene, which bound the time to read and solve it."""

from typing import Final

MAX_STRETCH: Final = 5.0
"""In either direction, and of one to the other: at 25 to 1 the weakest voltages are 1e-26 of the largest, and wrong."""

LARGEST_FILE: Final = 4 << 20
"""Bytes of a file of scenes."""

MAX_SHAPES: Final = 500
"""Rectangles, discs and polygons of a scene; the sheet has 126 units."""

MAX_CORNERS: Final = 200
"""Of a polygon; whether its sides cross is looked at for every two of them."""

MAX_BUMPS: Final = 100
MAX_PHANTOMS: Final = 1000
MAX_ASPECT: Final = 20.0
MAX_TURN_DEG: Final = 36_000.0
MIN_THICKNESS_MM: Final = 0.05
MAX_THICKNESS_MM: Final = 20.0
"""As in a skin's file. The modes of depth under the contacts end within 2.5 thicknesses, and their mesh goes with the
thickness: from here to there it is solved within a minute."""

MAX_COORDINATE_MM: Final = 1e5
"""mm; of what lies beside the sheet."""

ON_BORDER_MM: Final = 1e-6
"""How far a touch may reach over the sheet's border before it is refused: rounding, not geometry."""

MAX_GAUGE: Final = 5.0
"""Of either sign, as in a skin's file."""
MAX_DRIFT: Final = 100.0
"""Of the common factor that came since the reference, either way."""
MAX_UNEVEN: Final = 1.0
"""Rms of log conductivity."""
MIN_CORRELATION_MM: Final = 5.0
"""Two elements of the open sheet; what changes faster is no unevenness that a mesh of the default size represents."""
MAX_SEED: Final = 2**32 - 1
