"""Idle acquisition: which drives and why, how much faster a scan is, how soon a touch is met, how many are missed.

The choice is made again here, on bends and touches of its own, by the argument of :mod:`eitskin_training.gate.idle`:
the best subset of one drive, of two, and so on, with its share of what all rows tell about a small touch. The
configuration says how much faster an idle scan is, and how soon a whole frame may come at best; how soon it does come
is measured by :mod:`eitskin_tools.bench.skip.waking`.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.model.gate import EXTRAS, FIELDS, Gate
from eitskin.pipeline.idle import PREFIX
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire import config_toml
from eitskin_proto.wire.scan_rows import drive_count, drives_to_list, table_rows
from eitskin_tools.bench.skip.frames import Material, noisy
from eitskin_tools.bench.skip.gate_error import errors
from eitskin_tools.bench.skip.gate_row import logits_of
from eitskin_tools.bench.skip.waking import measure
from eitskin_tools.scripted_scene.script import CURRENT_A

BENDS: Final = 60
"""Of A and of B for the covariance, each in four mirror images and with three noises."""

RESTING_FRAMES: Final = 400
"""Noisy untouched frames that the virtual skin sends over and over."""

Array = npt.NDArray[np.float64]


def idle(bundle: Bundle, shown: Material, bends: int, touches: int, rng: np.random.Generator) -> dict[str, Any] | None:
    """Return the row of idle acquisition, or None for a bundle without an idle gate.

    Args:
        bundle: What is deployed.
        shown: Its touches wake the skin.
        bends: Fresh bends of A and of B for the gate's errors.
        touches: Of each kind, to measure how soon they are met.
        rng: Source of noise.
    """
    arrays = bundle.gate_arrays()
    if arrays is None or f"{PREFIX}drives" not in arrays:
        return None
    drives = int(np.asarray(arrays[f"{PREFIX}drives"]).reshape(-1)[0])
    rows = table_rows(False, drives)
    gate = Gate({name: arrays[PREFIX + name] for name in (*FIELDS, *EXTRAS) if PREFIX + name in arrays}, len(rows))
    reference = shown.reference_V
    return {
        "drives": drives_to_list(drives),
        "rows": len(rows),
        "chosen_by": _table(reference, rng),
        "configuration": _times("paper", drives),
        "touch_to_first_full_frame": _waking(bundle, shown, touches, rng),
        "error": errors(logits_of(gate, rows), gate.threshold, reference, bends, rng),
    }


def _waking(bundle: Bundle, shown: Material, touches: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return what was measured of a strong touch and of the weakest, on the flat sheet."""
    untouched_V = CURRENT_A * noisy(shown.reference_V, RESTING_FRAMES, shown.reference_V, rng)
    kinds = {"15 mm, contrast 50": shown.one_V, "10 mm, contrast 20": shown.weak_V}
    return {name: measure(bundle, untouched_V, CURRENT_A * rows, touches) for name, rows in kinds.items()}


def _table(reference: Array, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return the best subsets with their share of the information, on bends and touches that nothing was fitted on."""
    from eitskin_tools.bench.skip.scenes import SEED, still
    from eitskin_training.gate.idle import covariance_of, idle_table
    from eitskin_training.gate.material import images_of, noisy_change
    from eitskin_training.gate.touches import probes

    logs = np.concatenate([still(family, BENDS) for family in ("A", "B")])
    logs = np.repeat(np.concatenate([logs[:, image] for image in images_of(PAPER)]), 6, axis=0)
    touches = np.concatenate(
        [probe.logs - probe.before for probe in probes(2, SEED, PAPER) if "anywhere" in probe.name]
    )
    found = idle_table(covariance_of(noisy_change(logs, reference, rng)), touches)
    return [{"drives": drives_to_list(mask), "share_of_information": round(share, 4)} for mask, share in found]


def _times(name: str, drives: int) -> dict[str, Any]:
    """Return what a configuration makes of these drives: times of a scan, the rate's gain, and the soonest map."""
    configuration = config_toml.load(name)
    whole_us, idle_us = configuration.scan_us(), configuration.scan_us(drives)
    full_ms, idle_ms = (1e6 / rate for rate in (configuration.rate_mHz, configuration.idle_rate_mHz))
    return {
        "name": name,
        "drives_of_a_whole_scan": drive_count(False, configuration.drives),
        "scan_us": {"whole": whole_us, "idle": idle_us},
        "largest_rate_gain": round(whole_us / idle_us, 2),
        "rate_Hz": {"whole": 1000 / full_ms, "idle": 1000 / idle_ms},
        "soonest_full_frame_ms": {
            "mean": round(idle_ms / 2 + (idle_us + whole_us) / 1000, 2),
            "largest": round(idle_ms + (idle_us + whole_us) / 1000, 2),
            "largest_at_fastest_idle_rate": round((2 * idle_us + whole_us) / 1000, 2),
        },
    }
