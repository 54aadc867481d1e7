"""Random requests with power cuts at every write: on the C core in memory, and on the emulated board."""

from tests.emulator.firmware import missing_tools
from tests.faults import powercut
from tests.faults.requests.search import Figures

from ..outcome import Effort, Outcome


def _outcome(name: str, found: Figures) -> Outcome:
    outcome = Outcome(name, tried=found.sequences - found.late)
    outcome.figures = {key: value for key, value in found.as_dict().items() if key not in ("lost", "sequences")}
    outcome.withstood = outcome.tried - max(found.breaches, found.differing)
    outcome.broken = found.lost
    return outcome


def requests(effort: Effort) -> Outcome:
    """Play sequences on the core, and boot what every change of storage would leave behind, torn and whole."""
    return _lacking("firmware.requests", "host") or _outcome(
        "firmware.requests", powercut.cut_sequences(effort.count(1000, 100_000), effort.seed)
    )


def board_requests(effort: Effort) -> Outcome:
    """Play some on the firmware under QEMU, and kill it at changes of storage."""
    return _lacking("firmware.board", "qemu") or _outcome(
        "firmware.board", powercut.cut_board_sequences(effort.count(3, 60), effort.seed)
    )


def _lacking(name: str, needs: str) -> Outcome | None:
    """Return what stands for an attack whose tools are not there; None if they are."""
    missing = missing_tools(needs)
    return Outcome(name, 1, 1, figures={"skipped": f"{', '.join(missing)} not found"}) if missing else None
