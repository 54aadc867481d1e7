"""Random requests with power cuts at every write: on the C core in memory, and on the emulated board."""

from tests.emulator.firmware import missing_tools
from tests.faults import powercut
from tests.faults.requests.search import Figures

from ..outcome import Effort, Outcome


def _outcome(name: str, found: Figures) -> Outcome:
    outcome = Outcome(name, tried=found.sequences)
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
    """Kill the firmware under QEMU at changes of storage, spread over a flash."""
    lacking = _lacking("firmware.board", "qemu")
    if lacking is not None:
        return lacking
    found = powercut.cut_board(effort.count(3, 60))
    outcome = Outcome("firmware.board", tried=found["cuts"], figures={"cut_points": found["cut_points"]})
    outcome.withstood, outcome.broken = outcome.tried - len(found["lost"]), found["lost"]
    return outcome


def _lacking(name: str, needs: str) -> Outcome | None:
    """Return what stands for an attack whose tools are not there; None if they are."""
    missing = missing_tools(needs)
    return Outcome(name, 1, 1, figures={"skipped": f"{', '.join(missing)} not found"}) if missing else None
