"""The network's map checked by physics where touches lie anywhere: ``eitskin evaluate --solver verified``.

Touches of the network's map, as the stream finds them, are where the search starts
(:mod:`eitskin_sim.verification.free`). The map is drawn from the shapes that were found, with a share of the network's
own (:mod:`eitskin_tools.evaluation.verified.share`): the two err in part independently, so both together are nearer to
the truth than either. Where physics cannot explain the frame by its shapes, the
network's own map stays, and the frame is flagged. Making the model of a shape,
once or twice more where the frame shows that the sheet is stretched otherwise than its scan, counts as set-up: it
serves all frames of the shape. So does seeing it untouched first, where that is asked for.
"""

import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eitskin.touches.moments import Finder
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.harness import Case, Run
from eitskin_sim.evaluation.metrics import TOUCHED
from eitskin_sim.verification.free.found import FreeVerdict
from eitskin_sim.verification.free.search import BUDGET_S, FreeVerifier
from eitskin_sim.verification.free.starts import shares_of
from eitskin_sim.verification.residual import Noise
from eitskin_tools.evaluation.verified.share import network_share
from eitskin_tools.evaluation.verified.units import Checked, shape_of, untouched_mean


class VerifiedFree:
    """A network and the verifier of touches anywhere behind it.

    Args:
        network: The network's run.
        noise: What the instrument's noise is.
        touches: Which way touches change conductance.
        skin: Whose models.
        budget_s: What a frame may take.
        follow: Whether the touches of the last frame of a shape are the first start of the next.
        at_rest: Untouched frames of a shape that physics sees before its first touch.
    """

    def __init__(
        self,
        network: Run,
        noise: Noise,
        touches: TouchKind,
        skin: Skin,
        budget_s: float = BUDGET_S,
        follow: bool = False,
        at_rest: int = 0,
    ) -> None:
        self._network, self._noise, self._touches, self._skin = network, noise, touches, skin
        self._budget_s, self._follow, self._at_rest = budget_s, follow, at_rest
        self._last: npt.NDArray[np.float64] | None = None
        self._finder = Finder(skin.grid)
        self.checked: list[Checked[FreeVerdict]] = []
        """Verdicts in the order of the cases."""
        self._shape: tuple[bytes, FreeVerifier] | None = None
        self._seen_at_rest: tuple[npt.NDArray[np.float64], int] | None = None

    @property
    def run(self) -> Run:
        """Return the run that the harness takes."""
        return replace(self._network, solver=self.solve)

    def rest(self, voltages_V: npt.NDArray[np.float64], frames: int) -> None:
        """Take what the shape in use reads while nothing touches it, for its next frame and those after.

        Args:
            voltages_V: (104,) the mean of some frames.
            frames: How many.
        """
        self._seen_at_rest = voltages_V, frames

    def solve(self, case: Case) -> npt.NDArray[np.float64]:
        """Return the map of the shapes found and a share of the network's, or that alone where they explain nothing."""
        image = self._network.solver(case)
        grid = self._skin.grid
        found = self._finder.find(image)
        shares = shares_of(found.pixels, found.touch, found.weights, found.count, grid)
        key = shape_of(case) + case.flat_reference.tobytes()
        if self._shape is None or self._shape[0] != key:
            verifier = FreeVerifier(
                case.flat_reference, self._noise, self._touches, self._skin, clock=time.process_time
            )
            before = 0.0
            verifier.deform(case.sheet.cloud_mm)
            if self._at_rest:
                self.rest(untouched_mean(case, self._noise, self._at_rest), self._at_rest)
            self._shape, self._last = (key, verifier), None
        else:
            verifier = self._shape[1]
            before = verifier.deformation.spent_cpu_s
        if self._seen_at_rest is not None:
            verifier.rest(*self._seen_at_rest)
            self._seen_at_rest = None
        made, start = verifier.deformation.spent_cpu_s, time.process_time()
        verdict = verifier.verify(case.voltages, shares, self._last, self._budget_s)
        self._last = verdict.pieces if self._follow and len(verdict.pieces) else None
        cpu_s = time.process_time() - start - (verifier.deformation.spent_cpu_s - made)
        setup_ms = 1e3 * (verifier.deformation.spent_cpu_s - before)
        touched = (image >= TOUCHED).ravel()
        self.checked.append(Checked(verdict, 1e3 * verdict.seconds, 1e3 * cpu_s, setup_ms, touched))
        share = network_share(verdict, image, found.count, grid)
        return image if verdict.flagged else (1.0 - share) * verdict.map(grid) + share * np.clip(image, 0.0, 1.0)
