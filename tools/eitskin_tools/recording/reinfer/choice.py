"""What a recording is compared with: another bundle, another solver of one, or a solver of the simulation."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from eitskin.model.bundle import Bundle
from eitskin.model.engine import HEADS
from eitskin.reference.normaliser import Normaliser
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_tools.command_line import needs
from eitskin_tools.recording.bundles import bundle_of, reference_of
from eitskin_tools.recording.reinfer.rerun import Computed, Rerun
from eitskin_tools.recording.script import Script, Step

if TYPE_CHECKING:
    from eitskin_tools.recording.reinfer.session import Solving

OWN = (*HEADS, "tikhonov")
"""Solvers that a bundle has."""


Makers = Mapping[str, Callable[[Script, Bundle], "Solving"]]
"""What makes solvers that neither a bundle nor the simulation has, by their names."""


def others(
    script: Script, recorded: Bundle, named: Path | None, solver: str | None, makers: Makers = MappingProxyType({})
) -> "Solving | None":
    """Return what to compare with what was running; None where that itself is asked for.

    Args:
        script: The recording.
        recorded: The bundle that was running.
        named: Another bundle's file; None for the same.
        solver: Its name; None for the bundle's own choice.
        makers: Of further solvers, which need the simulation.

    Raises:
        SkinError: The bundle is of another skin, or cannot be used.
        ValueError: There is no such solver.
        MissingExtraError: The solver needs packages that are not there.
    """
    bundle = recorded if named is None else bundle_of(script, named)
    if solver is None:
        return None if bundle.id == recorded.id else Rerun(script, bundle)
    if solver in OWN:
        return Rerun(script, bundle, solver)
    needs.require(f"--solver {solver}", ("scipy",))
    return makers[solver](script, bundle) if solver in makers else OfSimulation(script, bundle, solver, tuple(makers))


class OfSimulation:
    """A solver of the simulation on recorded frames: what was touched is as the gate said then.

    It takes the untouched voltages as the forward model predicts them of the cloud in use.

    Args:
        script: The recording.
        bundle: Says what labels its maps have.
        name: As ``eitskin evaluate --solver`` takes it.
        besides: Further names that there are.

    Raises:
        ValueError: There is none of this name.
    """

    def __init__(self, script: Script, bundle: Bundle, name: str, besides: tuple[str, ...] = ()) -> None:
        from eitskin_sim.evaluation.harness import SOLVERS

        if name not in SOLVERS:
            every = dict.fromkeys((*OWN, *SOLVERS, *besides))
            raise ValueError(f"solver {name!r} does not exist; expected one of {', '.join(every)}")
        self._script, self._bundle, self._name, self._solve = script, bundle, name, SOLVERS[name]
        self.bundle_id = bundle.id
        self._normaliser = Normaliser(script.hello.volts_per_count)
        self._view = FrameView()
        self._nothing = np.zeros(bundle.skin.grid.shape, dtype=np.float32)
        self._sheet: Any = None
        self._flat_V: Any = None

    def compute(self, step: Step) -> Computed | None:
        """Compute a frame; None where the recording does not say what it is held against, or it was withheld."""
        from eitskin_sim.evaluation.harness import Case, Sheet
        from eitskin_sim.surface.predict import flat_voltages

        skin = self._bundle.skin
        if step.reference is not None:
            self._flat_V = reference_of(self._script, step.reference, skin).flat().voltages_V
        if step.cloud is not None:
            self._sheet = Sheet(step.cloud.cloud.astype(np.float64), np.full(N_ROWS, np.nan), skin)
        if self._flat_V is None or self._sheet is None or not step.known or step.frame.withheld:
            return None
        self._view.load(step.frame.payload)
        if not step.frame.touched or self._view.drives != ALL_DRIVES:
            return Computed(self._nothing, step.frame.touched, "none")
        self._normaliser.load(self._view.counts)
        held = self._sheet.predicted() * self._flat_V / flat_voltages(skin)
        labels: Any = "units" if self._bundle.labels == "units" else "area"
        lowering = self._bundle.touch_kind == "lower"
        case = Case(self._normaliser.voltages(), held, self._flat_V, self._sheet, labels, lowering=lowering)
        return Computed(np.asarray(self._solve(case), dtype=np.float32), True, self._name)
