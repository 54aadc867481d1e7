"""A small network that corrects the Gaussian's estimate of a missing electrode's rows, because touches act nonlinearly.

The conditional mean of :mod:`eitskin_proto.sensor.row_gaussian` is taken first; the network sees all 104 rows as they
then are, which electrodes are gone, and V_pred, and corrects the missing rows alone ::

    [ (l - mean) / spread | gone | log(V_pred / V0) / 0.3 ]   (224,)
         -> linear, SiLU -> linear, SiLU -> linear   (104,)  times spread, added to l in the missing rows

It starts as the conditional mean itself. :mod:`eitskin_training.adapt` teaches it; ``arrays`` is what a bundle stores
and :mod:`eitskin.health.correction` computes, every scale folded into the matrices.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from eitskin_proto.sensor.row_gaussian import RATIO_RANGE, RowGaussian, missing_spread, missing_weights, rows_of
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS

WIDTH: Final = 320
"""Of both hidden layers: 208,000 weights, a fifth of what a frame of a shipped network reads."""

PREDICTED_SPREAD: Final = 0.3
"""About what log(V_pred / V0) spreads over deformations."""

Missing = tuple[int, ...]

LOW, HIGH = float(np.log(RATIO_RANGE[0])), float(np.log(RATIO_RANGE[1]))


class Gaussian:
    """The conditional mean in torch, for batches in which groups of samples lose the same electrodes.

    Args:
        gaussian: How rows go together.
    """

    def __init__(self, gaussian: RowGaussian) -> None:
        self.mean = torch.tensor(gaussian.mean, dtype=torch.float32)
        self.spread = torch.tensor(np.sqrt(np.diag(gaussian.covariance)), dtype=torch.float32)
        self._precision = gaussian.precision()
        self._known: dict[Missing, tuple[Tensor, Tensor, Tensor, Tensor]] = {}

    def missing(self, electrodes: Missing) -> Tensor:
        """Return (104,) which rows are gone."""
        return torch.from_numpy(rows_of(electrodes))

    def fill(self, logs: Tensor, electrodes: Missing) -> Tensor:
        """Return (n, 104) l with the rows of these electrodes as the others say."""
        gone, left, weights, _ = self._of(electrodes)
        filled = logs.clone()
        filled[:, gone] = self.mean[gone] - (logs[:, left] - self.mean[left]) @ weights.T
        return filled

    def uncertainty(self, electrodes: Missing) -> Tensor:
        """Return (104,) the standard deviation that the Gaussian leaves to missing rows; 1 elsewhere."""
        return self._of(electrodes)[3]

    def _of(self, electrodes: Missing) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        if electrodes not in self._known:
            rows = rows_of(electrodes)
            left_over = np.ones(N_ROWS)
            left_over[rows] = missing_spread(self._precision, rows)
            self._known[electrodes] = (
                torch.from_numpy(np.flatnonzero(rows)),
                torch.from_numpy(np.flatnonzero(~rows)),
                torch.tensor(missing_weights(self._precision, rows), dtype=torch.float32),
                torch.tensor(left_over, dtype=torch.float32),
            )
        return self._known[electrodes]


class Filling(nn.Module):
    """Fills in missing rows: the Gaussian, then the network's correction.

    Args:
        gaussian: How rows go together.
        width: Of both hidden layers.
    """

    def __init__(self, gaussian: RowGaussian, width: int = WIDTH) -> None:
        super().__init__()
        self.gaussian = Gaussian(gaussian)
        self.layers = nn.Sequential(
            nn.Linear(2 * N_ROWS + N_ELECTRODES, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU()
        )
        self.out = nn.Linear(width, N_ROWS)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(
        self, logs: Tensor, groups: Sequence[tuple[slice, Missing]], predicted: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return (n, 104) l with every group's missing rows filled in, and (n, 104) which rows these are.

        Args:
            logs: (n, 104) l = log(V / V0), anything in the missing rows.
            groups: Which samples lose which electrodes; samples of no group stay as they are.
            predicted: (n, 104) log(V_pred / V0), zeros where there is none.
        """
        filled = logs.clone()
        gone = logs.new_zeros((len(logs), N_ELECTRODES))
        missing = torch.zeros(logs.shape, dtype=torch.bool)
        for samples, electrodes in groups:
            filled[samples] = self.gaussian.fill(logs[samples], electrodes)
            gone[samples, list(electrodes)] = 1.0
            missing[samples] = self.gaussian.missing(electrodes)
        apart = (filled - self.gaussian.mean) / self.gaussian.spread
        inputs = torch.cat([apart, gone, predicted / PREDICTED_SPREAD], dim=1)
        corrected = filled + self.out(self.layers(inputs)) * self.gaussian.spread
        return torch.where(missing, corrected.clamp(LOW, HIGH), logs), missing

    def arrays(self) -> dict[str, npt.NDArray[np.float32]]:
        """Return the layers as the runtime multiplies them: (224, w), (w, w), (w, 104) and their biases."""
        first, second = (layer for layer in self.layers if isinstance(layer, nn.Linear))
        scale = torch.cat(
            [1.0 / self.gaussian.spread, torch.ones(N_ELECTRODES), torch.full((N_ROWS,), 1.0 / PREDICTED_SPREAD)]
        )
        found = {
            "filling_first": first.weight.T * scale[:, None],
            "filling_first_bias": first.bias,
            "filling_second": second.weight.T,
            "filling_second_bias": second.bias,
            "filling_third": self.out.weight.T * self.gaussian.spread,
            "filling_third_bias": self.out.bias * self.gaussian.spread,
        }
        return {name: value.detach().numpy().astype(np.float32) for name, value in found.items()}
