"""Touch sets as lists of parts, and the rule that parts which share an element of the mesh become one part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin_sim.arrays import Index
from eitskin_sim.freeform.mesh import SharedMesh
from eitskin_sim.freeform.parts import PartGeometry, reached
from eitskin_sim.scene.touch_table import TouchTable


@dataclass(frozen=True, slots=True)
class PartSets:
    """s sets as lists of parts.

    Args:
        member: (M,) numbers of parts, set after set.
        first: (s + 1,) where each set begins.
    """

    member: Index
    first: Index

    def __len__(self) -> int:
        """Return how many sets there are."""
        return len(self.first) - 1

    def of(self, number: int) -> Index:
        """Return the parts of one set."""
        return self.member[self.first[number] : self.first[number + 1]]


def chains(sets: PartSets) -> list[list[int]]:
    """Return the numbers of sets, in lists where each set has the parts of the one before, in their order, and more."""
    keys = [tuple(sets.of(number).tolist()) for number in range(len(sets))]
    found: list[list[int]] = []
    last: tuple[int, ...] = (-1,)
    for number in sorted(range(len(sets)), key=keys.__getitem__):
        if keys[number][: len(last)] == last:
            found[-1].append(number)
        else:
            found.append([number])
        last = keys[number]
    return found


def merged(
    parts: TouchTable, batches: Sequence[PartGeometry], sets: PartSets, grid: SharedMesh
) -> tuple[list[tuple[int, ...]], PartSets]:
    """Return parts to be added, each the numbers of several that share elements within a set, and sets of all parts.

    Args:
        parts: p parts; the first to be added is number p.
        batches: Their geometry.
        sets: Sets of them.
        grid: The mesh.
    """
    bits = reached(batches, grid.mesh.n_elements)
    pairs = _sharing(bits, sets)
    if not len(pairs):
        return [], sets
    new: dict[tuple[int, ...], int] = {}
    members = [sets.of(number) for number in range(len(sets))]
    order = np.argsort(pairs[:, 0], kind="stable")
    numbers, starts = np.unique(pairs[order, 0], return_index=True)
    for number, own in zip(numbers, np.split(pairs[order, 1:], starts[1:]), strict=True):
        groups = _joined(members[number].tolist(), own.tolist())
        members[number] = np.array(
            [group[0] if len(group) == 1 else new.setdefault(group, len(parts) + len(new)) for group in groups]
        )
    counts = np.cumsum([0, *(len(member) for member in members)])
    return list(new), PartSets(np.concatenate([*members, np.zeros(0, dtype=np.intp)]), counts)


def _sharing(bits: npt.NDArray[np.uint64], sets: PartSets) -> Index:
    """Return (n, 3) of set and two of its parts that share an element."""
    count = np.diff(sets.first)
    found = []
    for size in range(2, int(count.max(initial=0)) + 1):
        number = np.flatnonzero(count == size)
        own = sets.member[sets.first[number][:, None] + np.arange(size)]
        for i in range(size):
            for j in range(i):
                both = (bits[own[:, i]] & bits[own[:, j]]).any(axis=1)
                found.append(np.column_stack([number, own[:, j], own[:, i]])[both])
    return np.concatenate([*found, np.empty((0, 3), dtype=np.intp)])


def _joined(members: list[int], pairs: list[list[int]]) -> list[tuple[int, ...]]:
    """Return the groups that pairs join, each ascending, in the order of their last members: a chain stays one."""
    group = {member: {member} for member in members}
    for a, b in pairs:
        if group[a] is not group[b]:
            joined = group[a] | group[b]
            for member in joined:
                group[member] = joined
    place = {member: at for at, member in enumerate(members)}
    groups = {tuple(sorted(own)) for own in group.values()}
    return sorted(groups, key=lambda own: max(place[member] for member in own))
