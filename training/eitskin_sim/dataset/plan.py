"""The content of a data set, determined from one seed before anything is computed.

A plan names every deformation, its split, and its touch sets. A shard is one deformation; it can be made from the plan
alone, anywhere and in any order, so the result does not depend on the worker.

Splits are by touch set and by deformation, never by sample: a set held out is held out at every deformation, and a bend
kept apart is never trained on. (A random split of samples leaks: a third of its test sets recur at another bend.) ::

                      touch sets   90 % train        10 % validation
    deformations
    train (paper, A)             learned from      chooses the best epoch
    kept  (A)                           -          tests
    other (B)                           -          tests
"""

from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, cast

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.digest import id_of_values
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import named
from eitskin_sim.devices.draws import check_outline
from eitskin_sim.freeform.draws import CLUSTERED_SHARE
from eitskin_sim.freeform.touches import TouchKind, ranges_of
from eitskin_sim.scene.family import draw, paper_bends
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.unit_grid.patterns import N_PAPER_SETS

SetName = Literal["paper", "units", "free"]
"""The paper's data; richer shapes on the unit grid; touches anywhere."""

DeviceKind = Literal["ideal", "random", "offset"]
"""The nominal device; one drawn for every few deformations; the same, read with a large offset."""

DEVICE_KINDS: Final[tuple[DeviceKind, ...]] = ("ideal", "random", "offset")

SET_NAMES: Final[tuple[SetName, ...]] = ("paper", "units", "free")

VALIDATION_SHARE: Final = 0.1
"""Share of touch sets that is held out (paper section V.A)."""

DEFAULTS: Final[dict[str, tuple[int, int, int]]] = {
    "paper": (10, N_PAPER_SETS, N_PAPER_SETS),
    "units": (140, 60_000, 3_000),
    "free": (140, 0, 5_000),
}
"""Deformations to train on, touch sets, and touch sets shown at each deformation; free sets are as many as samples."""

RECIPES: Final[dict[str, int]] = {"paper": 1, "units": 1, "free": 4}
"""Counts up when the same plan would give other numbers: a folder is never made half by one and half by another."""

HELD_OUT_DEFORMATIONS: Final = 20
"""Deformations of A, and as many of B, that are kept apart; a third of those trained on where these are few."""

DEFORMATIONS_PER_POOL: Final = 2
"""Deformations of the free set that take their touches from one pool, whose geometry is then made once for them."""

SETS_PER_HELD_OUT_DEFORMATION: Final = 500
"""Held-out touch sets shown at each deformation kept apart."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A data set before it is made.

    Args:
        set_name: Which recipe.
        seed: Where all draws come from.
        touch_sets: How many touch sets there are.
        per_deformation: How many of them are shown at each deformation to train on.
        bends: Every deformation.
        splits: "train", "kept" or "other" for each.
        near: Share of the free sets that are drawn with touches near to each other; others have none.
        touches: Which touches; a plan of hard ones says nothing of it, as before there were others.
        skin: The sheet, its map and what bends it, and the uncertainties that random devices are drawn from; a plan of
            the paper's ideal device says nothing of it.
        devices: Which devices.
    """

    set_name: SetName
    seed: int
    touch_sets: int
    per_deformation: int
    bends: tuple[Bend, ...]
    splits: tuple[str, ...]
    near: float | None = None
    touches: TouchKind = "hard"
    skin: Skin = PAPER
    devices: DeviceKind = "ideal"

    def to_json(self) -> dict[str, Any]:
        """Return the plan as JSON can hold it."""
        found = {**asdict(self), "recipe": RECIPES[self.set_name]}
        if self.touches == "hard":
            del found["touches"]
        if self.devices == "random" or self.skin.digest == PAPER.digest:
            del found["devices"]
        if self.devices == "ideal" and self.skin.digest == PAPER.digest:
            del found["skin"]
        return found

    @property
    def group(self) -> int:
        """How many deformations are made together."""
        return DEFORMATIONS_PER_POOL if self.set_name == "free" else 1

    def shards(self) -> list[list[int]]:
        """Return the deformations that are made together: of one group and one split."""
        found: dict[tuple[int, str], list[int]] = {}
        for number, split in enumerate(self.splits):
            found.setdefault((number // self.group, split), []).append(number)
        return list(found.values())

    @property
    def counts(self) -> tuple[int, ...]:
        """How many samples each deformation has."""
        if self.set_name == "free":
            apart = min(SETS_PER_HELD_OUT_DEFORMATION, self.per_deformation)
            return tuple(self.per_deformation if split == "train" else apart for split in self.splits)
        return tuple(len(self.shown(number)) for number in range(len(self.bends)))

    @property
    def digest(self) -> str:
        """Return 16 hex digits that stand for the plan."""
        return id_of_values(self.to_json())

    def held_out(self, deformation: int) -> int:
        """Return how many free touch sets of a deformation are held out: its last ones, or all."""
        count = self.counts[deformation]
        return round(VALIDATION_SHARE * count) if self.splits[deformation] == "train" else count

    def validation(self) -> npt.NDArray[np.bool_]:
        """Return (T,) which touch sets are held out."""
        held = np.zeros(self.touch_sets, dtype=np.bool_)
        if self.set_name == "free":
            last = np.cumsum(self.counts)
            for number, stop in enumerate(last):
                held[stop - self.held_out(number) : stop] = True
            return held
        generator = np.random.default_rng([self.seed, 1])
        held[generator.permutation(self.touch_sets)[: round(VALIDATION_SHARE * self.touch_sets)]] = True
        return held

    def shown(self, deformation: int) -> npt.NDArray[np.int32]:
        """Return which touch sets are shown at a deformation, ascending."""
        if self.set_name == "paper":
            return np.arange(self.touch_sets, dtype=np.int32)
        if self.set_name == "free":
            start = sum(self.counts[:deformation])
            return np.arange(start, start + self.counts[deformation], dtype=np.int32)
        generator = np.random.default_rng([self.seed, 2, deformation // self.group])
        if self.splits[deformation] == "train":
            chosen = generator.choice(self.touch_sets, self.per_deformation, replace=False)
        else:
            held = np.flatnonzero(self.validation())
            chosen = generator.choice(
                held, min(len(held), SETS_PER_HELD_OUT_DEFORMATION, self.per_deformation), replace=False
            )
        return np.sort(chosen).astype(np.int32)


def make_plan(
    set_name: str,
    seed: int = 0,
    *,
    deformations: int | None = None,
    touch_sets: int | None = None,
    per_deformation: int | None = None,
    kept: int | None = None,
    near: float | None = None,
    touches: str = "hard",
    devices: str = "ideal",
    skin: Skin | None = None,
) -> Plan:
    """Return a plan; what is left out takes the recipe's own size.

    Args:
        set_name: "paper", "units" or "free".
        seed: Where all draws come from.
        deformations: Deformations to train on.
        touch_sets: Touch sets in all; for "paper", the first of its 10,259.
        per_deformation: Touch sets shown at each deformation to train on; "paper" shows all.
        kept: Deformations of A kept apart, and as many of B; "paper" has none.
        near: Share of the sets drawn with touches near to each other; for "free" alone.
        touches: "hard", the paper's; "firm", of good conductors; "press", that lower conductance; "raise"; "both";
            "skin", as the skin's file says; "paper" has hard ones alone.
        devices: "ideal", or "random": a device for every few deformations; "offset": random ones whose readings have a
            large offset. "paper" has the ideal one alone.
        skin: What is bent and touched; None is the paper's, or for random devices the shipped skin "lab".

    Raises:
        ValueError: A number is outside its bounds.
    """
    _check_together(set_name, touch_sets, near, touches, devices)
    _check_paper(set_name, per_deformation, kept)
    if seed < 0:
        raise ValueError(f"seed is {seed}; it must be at least 0")
    ranges_of(touches, PAPER if skin is None else skin)
    if skin is None:
        skin = PAPER if devices == "ideal" else named("lab")
    if devices != "ideal":
        check_outline(skin)
    nominal_sheet(skin)
    kind = cast(TouchKind, touches)
    device_kind = cast(DeviceKind, devices)
    default = DEFAULTS[set_name]
    n_bends = default[0] if deformations is None else deformations
    n_sets = default[1] if touch_sets is None else touch_sets
    apart = min(HELD_OUT_DEFORMATIONS, -(-n_bends // 3)) if kept is None else kept
    if set_name == "free":
        n_shown = default[2] if per_deformation is None else per_deformation
        n_sets = n_bends * n_shown + 2 * apart * min(SETS_PER_HELD_OUT_DEFORMATION, n_shown)
        near = CLUSTERED_SHARE if near is None else near
        _check("share of near touches", near, 0.0, 1.0)
    else:
        n_shown = min(n_sets, default[2]) if per_deformation is None else per_deformation
    _check("deformations", n_bends, 1, 100_000)
    _check("touch sets", n_sets, 1 if set_name == "free" else 10, N_PAPER_SETS if set_name == "paper" else 10_000_000)
    _check("touch sets shown at a deformation", n_shown, 1, n_sets)
    _check("deformations kept apart", apart, 0, 10_000)
    if set_name == "paper":
        bends, splits = paper_bends(n_bends, skin), ("train",) * n_bends
        return Plan("paper", seed, n_sets, n_sets, bends, splits, skin=skin)
    bends = draw("A", n_bends + apart, seed, skin) + draw("B", apart, seed, skin)
    splits = ("train",) * n_bends + ("kept",) * apart + ("other",) * apart
    return Plan(cast(SetName, set_name), seed, n_sets, n_shown, bends, splits, near, kind, skin, device_kind)


def _check_together(set_name: str, touch_sets: int | None, near: float | None, touches: str, devices: str) -> None:
    """Refuse a set or devices that do not exist, and what does not go with the set."""
    if set_name not in DEFAULTS:
        raise ValueError(f"set {set_name!r} is unknown; expected one of {', '.join(SET_NAMES)}")
    if set_name == "free" and touch_sets is not None:
        raise ValueError(
            f"touch sets: found {touch_sets}, expected none for the free set: each sample has one of its own; "
            "give the number shown at a deformation"
        )
    if set_name != "free" and near is not None:
        raise ValueError(f"share of near touches: found {near:g}, expected none: only the free set supports it")
    if set_name == "paper" and touches != "hard":
        raise ValueError(f"touches: found {touches!r}, expected 'hard': the paper's set follows the paper")
    if devices not in DEVICE_KINDS:
        raise ValueError(f"devices {devices!r} are unknown; expected one of {', '.join(DEVICE_KINDS)}")
    if set_name == "paper" and devices != "ideal":
        raise ValueError(f"devices: found {devices!r}, expected 'ideal': the paper's set follows the paper")


def _check_paper(set_name: str, per_deformation: int | None, kept: int | None) -> None:
    """Refuse numbers that the paper's set has no choice of."""
    if set_name != "paper":
        return
    if per_deformation is not None:
        raise ValueError(
            f"touch sets shown at a deformation: found {per_deformation}, expected none for the paper's set: each "
            "shows all; give the touch sets in all"
        )
    if kept:
        raise ValueError(f"held-out deformations: found {kept}, expected none: the paper's set trains on all")


def _check(what: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{what}: found {value:.12g}, expected {low:.12g} to {high:.12g}")
