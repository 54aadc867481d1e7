"""What the solvers are shown: cases with their truth, of phantoms on the ideal sheet or of trials on drawn devices.

Classical solvers are given V_pred as reference, which a robot can have.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.device import Device
from eitskin_sim.evaluation.device_runs import Plan, Trial, cases, devices
from eitskin_sim.evaluation.harness import Case, Conditions, Run, evaluate_all
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.measurement.noise import Kind
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.scene.scene import load_phantoms
from eitskin_tools.command_line import files
from eitskin_tools.evaluation.devices import rows_of, trials_of


@dataclass(frozen=True, slots=True)
class Panel:
    """Cases of one kind, which are averaged over.

    Args:
        name: What the table and the picture call it.
        labels: What the truth's pixels mean.
        touches: Which way they change conductance.
        cases: What may be seen, and the true map (rows, columns).
    """

    name: str
    labels: Literal["units", "area"]
    touches: TouchKind
    cases: list[tuple[Case, npt.NDArray[np.float64]]]


def of_phantoms(path: str, noise: Kind, seeds: int) -> Iterator[Panel]:
    """Yield a panel for each kind of labels and touches in a file of phantoms; those that nothing touches have no CC.

    Raises:
        ValueError: Nothing is touched in any of them.
    """
    phantoms = [one for one in load_phantoms(files.find(path, files.PHANTOMS)) if one.scene.touches]
    if not phantoms:
        raise ValueError(f"{path} holds no phantom that anything touches; expected at least one: the error is 1 - CC")
    kinds = dict.fromkeys((one.truth, one.scene.touch_kind) for one in phantoms)
    for labels, touches in kinds:
        group = [one for one in phantoms if (one.truth, one.scene.touch_kind) == (labels, touches)]
        lower = ", touches lower" if touches == "lower" else ""
        yield Panel(f"{Path(path).stem}, {labels} labels{lower}", labels, touches, _ideal(group, noise, seeds))


def _ideal(phantoms: Sequence[Phantom], noise: Kind, seeds: int) -> list[tuple[Case, npt.NDArray[np.float64]]]:
    seen: list[Case] = []

    def keep(case: Case) -> npt.NDArray[np.float64]:
        seen.append(case)
        return np.zeros_like(truth_map(phantoms[0]))

    evaluate_all(phantoms, [Run(keep, "predicted")], Conditions(noise=noise, seeds=seeds))
    truths = [truth_map(phantom) for phantom in phantoms for _ in range(seeds)]
    return list(zip(seen, truths, strict=True))


def of_devices(name: str, kinds: Sequence[str], deformations: int, each: int, plan: Plan) -> Iterator[Panel]:
    """Yield a panel for each mismatch and trial that go together.

    Args:
        name: As ``--devices`` takes it.
        kinds: Trials by name.
        deformations: Of drawn trials.
        each: Touches at each of them.
        plan: Devices a mismatch, seed, noise.

    Raises:
        ValueError, OSError: There is no such list or trial.
    """
    for row, mismatch in rows_of(name):
        drawn = list(devices(mismatch, plan))
        for kind in trials_of(kinds, deformations, each):
            if kind.labels == "units" and any(device.mismatch.alters_touches for _, device in drawn):
                continue  # the grid's truth has neither soft borders nor other contrasts
            touches: TouchKind = "lower" if kind.lowering else "raise"
            found = [pair for number, device in drawn for pair in _of_device(number, device, kind, plan)]
            yield Panel(f"{row}, {kind.name}", kind.labels, touches, found)


def _of_device(number: int, device: Device, kind: Trial, plan: Plan) -> list[tuple[Case, npt.NDArray[np.float64]]]:
    return [(case, truth_map(phantom)) for case, phantom in cases(device, kind, "predicted", plan, number)]
