"""Units put into a set and taken out of it, one or two at a time, until the frame is explained.

What the network shows says where it may be wrong: units that it is sure of are looked at last. The units in doubt are a
*pool* of some two dozen, on which one unit more or less is judged in microseconds (:mod:`eitskin_sim.reduced.flips`).
Steps of one unit end where two wrong ones hold each other: a unit stands between the two that are touched, or each of a
pair is one place off. So two are flipped at once, too: neighbours exchanged for each other, and of all other pairs the
best by ::

    |r - d_v - d_w|^2 = |r - d_v|^2 + |r - d_w|^2 - |r|^2 + 2 d_v d_w

with d_v what flipping unit v changes of the whitened voltages, and r what the set leaves. The cheapest set that is
known is always the next to go on from, and where nothing cheaper comes, the pool is filled with the units that would
explain most beside the best set, and with those around its own. All units have one contrast here, and the model may be
a coarse one (:meth:`eitskin_sim.reduced.model.ReducedModel.of_rank`): what is found is judged anew.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.flips import Flips
from eitskin_sim.reduced.state import state_of
from eitskin_sim.verification.sets.candidates import Bits, Candidates
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.known import Known
from eitskin_sim.verification.sets.neighbours import moves_of

DOUBT: Final = 9.2
"""Units that it costs less to differ in are in doubt at first: those of a height from 0.01 to 0.99."""

LEAST: Final = 18
"""A pool is filled up to so many with the units that would explain most beside the best set,"""

HELPS: Final = (1, 8)
"""by so many of them at least and at most."""

POOL: Final = 28
"""Units that are in doubt next."""

WIDER: Final = (40, 56)
"""As many later, one after the other."""

REACH: Final = 2
"""Units that are exchanged for each other lie at most so many, along and across, from each other."""

FAR: Final = 3
"""Two that are put in where others were taken out lie at most so many from one of these."""

FEWER: Final = 8
"""Pairs that are modelled where others were taken out."""

LAST: Final = 3
"""Stage of steps: one flipped, two flipped, moved to a place beside, others taken out before."""

GONE: Final = 10
"""Ways to take out one or two of a set that are looked at, of those after which it explains most."""

LATER: Final = (1.0, 1.0, 1.5)
"""A set waits for each further stage as if it cost so many times as much: the last takes long."""

TRIED: Final = 16
"""Other pairs that are modelled, of those that look best."""

INFLATION: Final = 2.0
"""Gains in chi-squared are divided by it: a model that is not quite the sheet's is not filled with touches."""

KEPT: Final = 8
"""Of each step's ways, so many of the best are kept to go on from."""

PATIENCE: Final = 14
"""Sets in a row that are gone on from without a cheaper one: then the pool is widened, or the search ends."""

ALMOST: Final = 3.0
"""A set with up to so many times the chi-squared of one that explains the frame may do so on the whole model."""


class Exchange:
    """Exchanges on one frame, on a judge's coarse model.

    Args:
        judge: Of sets.
        explains: Says of units and their contrasts whether they explain the frame on the whole model.
        almost: A set with up to so many times the chi-squared of one that does is shown to it.
    """

    def __init__(self, judge: Judge, explains: Callable[[Index, Array], bool], almost: float = ALMOST) -> None:
        self._judge, self._explains, self._almost = judge, explains, almost
        self._model, self._frame, self._price = judge.coarse, judge.frame, judge.price
        self._of = Candidates(np.zeros(0, dtype=np.intp), np.zeros(0))
        self._pool: Index = self._of.units
        self._pooled: Bits = np.zeros(0, dtype=np.bool_)
        self._distance = judge.distance

    def improved(self, starts: Sequence[Bits], candidates: Candidates, most: int | None = None) -> Bits:
        """Return the first set found that explains the frame, or the cheapest until time is up.

        Asked again with the same candidates, the search goes on where it was.

        Args:
            starts: (m,) truth values each, where to begin; at least one.
            candidates: Units and their contrasts.
            most: Sets to go on from before it ends; None is until no pool is left.
        """
        if candidates is not self._of:
            self._begin(starts, candidates)
        known = self._known
        while self._sizes and not self._judge.late():
            if self._searched(most):
                break
            if most is not None and not self._wants_more:
                break
            self._sizes.pop(0)
            if self._sizes:
                known.begin_again()
                self._pool_of(self._sizes[0])
        return known.best

    def _begin(self, starts: Sequence[Bits], candidates: Candidates) -> None:
        self._of = candidates
        every = list({one.tobytes(): one for one in starts}.values())
        self._inside: Bits = np.any(every, axis=0)
        self._sizes, self._helps = [POOL, *WIDER], HELPS[1]
        if self._price.in_doubt:
            doubted = self._price.doubts[candidates.units] < DOUBT
            count = int(np.sum(doubted | self._inside))
            self._helps = int(np.clip(LEAST - count, *HELPS))
            self._sizes.insert(0, count + self._helps)
        self._flips = self._made(self._inside, every[0], self._sizes[0])
        self._idle, rows = 0, []
        for bits in every:
            price = self._price.of_bits(self._touched(bits))
            chi = self._judge.chi(self._judge.state(candidates.units[bits], candidates.contrasts[bits], coarse=True))
            rows.append((chi / INFLATION + price, 0, bits.tobytes(), price))
        self._known = Known(rows)

    def _pool_of(self, size: int) -> None:
        best = self._known.best
        self._flips = self._made(self._inside | best if size <= POOL else best, best, size)
        self._idle = 0

    def _searched(self, most: int | None) -> bool:
        """Go on from the cheapest set, again and again; return whether one explains the frame."""
        known, flips, limit = self._known, self._flips, self._almost * self._judge.content
        count = 0
        self._wants_more = True
        while known.open and self._idle < PATIENCE and not self._judge.late():
            if most is not None and count >= most:
                self._wants_more = False
                return False
            cost, stage, bits, price = known.cheapest()
            if (bits & ~self._pooled).any():
                flips = self._flips = self._with(bits)
            count += 1
            self._idle += 1
            if stage < LAST:
                known.later(cost * LATER[stage], stage + 1, bits, price)
            flips.to(bits[self._pool])
            for chi, own, flipped in self._children(flips, bits, stage):
                child = bits.copy()
                child[flipped] ^= True
                if not known.is_new(child):
                    continue
                more = price + own
                cheaper = chi / INFLATION + more < known.cost
                self._idle = 0 if cheaper else self._idle
                known.add(chi / INFLATION + more, child, more)
                if chi <= (limit if cheaper else ALMOST * self._judge.content) and self._explains(
                    self._of.units[child], self._of.contrasts[child]
                ):
                    known.best = child
                    return True
        return False

    def _touched(self, bits: Bits) -> Bits:
        """Return (units,) which units are in a set."""
        found = np.zeros(self._model.n_units, dtype=np.bool_)
        found[self._of.units[bits]] = True
        return found

    def _children(self, flips: Flips, bits: Bits, stage: int) -> Iterator[tuple[float, float, Index]]:
        """Yield chi-squared, the price beside the set's own, and the flipped candidates of the best steps.

        At stage 0 one is flipped, at stage 1 two, at stage 2 units are moved to a place beside, and at stage 3 one or
        two near each other are taken out first.
        """
        if stage == 0:
            yield from self._ones(flips, bits)
            return
        if stage == 1:
            yield from self._twos(flips, bits)
            return
        prices = self._price.flips(self._touched(bits))
        if stage == 2:
            yield from moves_of(self._judge, self._of, bits, prices, INFLATION, KEPT)
            return
        for numbers in self._gone(flips):
            if self._judge.late():
                return
            rest, out = bits.copy(), self._pool[numbers]
            rest[out], taken = False, set(out.tolist())
            less = float(prices[self._of.units[out]].sum())
            flips.to(rest[self._pool])
            steps = [*(self._ones(flips, rest) if len(out) == 2 else ()), *self._twos(flips, rest, out)]
            for chi, own, flipped in steps:
                if taken.isdisjoint(flipped.tolist()):
                    yield chi, less + own, np.append(out, flipped)

    def _gone(self, flips: Flips) -> list[Index]:
        """Return the numbers in the pool of one or two of a set to take out, those that it misses least first."""
        inside = np.flatnonzero(flips.inside)
        units = self._of.units[self._pool[inside]]
        first, second = np.nonzero(np.triu(self._distance[np.ix_(units, units)] <= REACH, 1))
        volts = np.concatenate([flips.each()[inside], flips.pairs(inside[first], inside[second])])
        gone = [*inside[:, None], *np.stack([inside[first], inside[second]], axis=1)]
        return [gone[at] for at in np.argsort(self._judge.chis(volts))[:GONE]]

    def _ones(self, flips: Flips, bits: Bits) -> Iterator[tuple[float, float, Index]]:
        own, twice, chi, _, _ = self._each(flips, bits)
        cost = chi / INFLATION + np.where(twice, np.inf, own)
        for at in np.argsort(cost)[:KEPT]:
            if np.isfinite(cost[at]):
                yield float(chi[at]), float(own[at]), self._pool[[at]]

    def _each(self, flips: Flips, bits: Bits) -> tuple[Array, Bits, Array, Array, Array]:
        """Return the price, whether it is in the set at another contrast, and chi-squared of each of the pool.

        And what each changes, and what the set leaves.
        """
        units, touched, flat = self._of.units[self._pool], self._touched(bits), self._judge.flat
        left = self._frame.whiten(self._frame.ratio - flips.volts / flat)
        changed = self._frame.whiten((flips.each() - flips.volts) / flat)
        self._judge.evaluations += len(units)
        chi = np.square(left - changed).sum(axis=1)
        return self._price.flips(touched)[units], touched[units] & ~flips.inside, chi, changed, left

    def _twos(self, flips: Flips, bits: Bits, around: Index | None = None) -> Iterator[tuple[float, float, Index]]:
        own, twice, chi, changed, left = self._each(flips, bits)
        units = self._of.units[self._pool]
        first, second = np.triu_indices(len(units), 1)
        if around is not None:  # what was taken out is put back elsewhere: near it
            close = (self._distance[units][:, self._of.units[around]] <= FAR).any(axis=1) & ~flips.inside
            kept = close[first] & close[second]
            first, second = first[kept], second[kept]
            if not len(first):
                return
        both, same = own[first] + own[second], units[first] == units[second]
        one_in = flips.inside[first] != flips.inside[second]
        both[same] = 0.0
        both[np.where(same, ~one_in, twice[first] | twice[second])] = np.inf
        rough = (chi[first] + chi[second] + 2.0 * (changed @ changed.T)[first, second] - left @ left) / INFLATION + both
        if around is None:
            rough[(self._distance[units[first], units[second]] <= REACH) & one_in & np.isfinite(both)] = -np.inf
        count = min(int(np.isneginf(rough).sum()) + (TRIED if around is None else FEWER), len(rough))
        order = np.argpartition(rough, count - 1)[:count]
        order = order[np.isfinite(both[order])]
        first, second, both = first[order], second[order], both[order]
        chi = self._judge.chis(flips.pairs(first, second))
        for at in np.argsort(chi / INFLATION + both)[:KEPT]:
            yield float(chi[at]), float(both[at]), self._pool[[first[at], second[at]]]

    def _with(self, bits: Bits) -> Flips:
        """Return the pool with some candidates more."""
        self._pooled = self._pooled | bits
        self._pool = np.flatnonzero(self._pooled)
        return Flips(self._model, self._of.units[self._pool], self._of.contrasts[self._pool])

    def _made(self, bits: Bits, beside: Bits, size: int) -> Flips:
        """Return a pool of some size with some candidates in it, those most in doubt, and those best beside a set."""
        of = self._of
        state = state_of(self._judge.rough, of.units[beside], of.contrasts[beside])
        free = np.flatnonzero(~self._touched(beside)[of.units])
        chi = np.empty(len(free))
        for contrast in np.unique(of.contrasts[free]):
            at = of.contrasts[free] == contrast
            chi[at] = self._judge.chis(state.with_each(of.units[free[at]], float(contrast)))
        rank = _ranks(self._price.doubts[of.units]) if self._price.in_doubt else np.full(len(of.units), len(of.units))
        helps = _ranks(chi)
        rank[free] = np.where(helps < self._helps, -1, rank[free] if self._price.in_doubt and size <= POOL else helps)
        rank[bits] = -1
        several = len(of.units) // self._model.n_units
        pool = np.sort(np.argsort(rank, kind="stable")[: max(size * min(several, 2), int(bits.sum()))])
        self._pooled = np.zeros(len(bits), dtype=np.bool_)
        self._pooled[pool], self._pool = True, pool
        return Flips(self._model, of.units[pool], of.contrasts[pool])


def _ranks(values: Array) -> Index:
    return np.asarray(np.argsort(np.argsort(values, kind="stable"), kind="stable"))
