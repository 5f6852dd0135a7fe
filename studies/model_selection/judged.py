"""A fit and the errors of trials left out: each predicted from the others, with effects or without, to first order;
and names by chance: effects driven by another trial's pressures, which no data can need, judged as effects are.

What a fit leaves has structure, and with many effects to choose from one may take some of it by chance. A decoy is an
effect's columns with the trials exchanged: as large and as smooth as the effect's own, and wrong (target-decoy
competition, Elias and Gygi 2007, doi:10.1038/nmeth1019).
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import permutations
from math import factorial

import numpy as np
from scipy.spatial import cKDTree

from fabdesign.nouns.array import Array, Indices
from optimize.fit.clouds import Match, Sample, places_on_cloth
from optimize.fit.cross_validation import Gain, LeftOut, Scored
from optimize.fit.fitted import Fit
from optimize.fit.misfit import frames_of
from optimize.fit.problem import Linearisation
from optimize.fit.significance import NEEDED, cost

CAUSE = 0.3  # of its prior's deviation, at its strongest: an effect that is less is in any careful build
_NONE = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Judged:
    """A fit and its errors of trials left out. folds: of each trial; those with the same pressures share one. floor:
    noise, m. off: unknowns that take no part, such as those at a limit."""

    fit: Fit
    folds: Sequence[int]
    floor: float
    off: Indices = field(default_factory=lambda: _NONE)

    @cached_property
    def trials(self) -> LeftOut:
        """Return the linear model of the residuals that leaves trials out."""
        return LeftOut.of(self.fit, self.folds)

    @cached_property
    def scored(self) -> Scored:
        """Return what is left of trials left out."""
        return self.trials.scored(self.off)

    @property
    def excess(self) -> float:
        """Return the error of trials left out over the noise, m."""
        return self.scored.excess(self.floor)

    @property
    def typical(self) -> float:
        """Return the median over trials left out of the excess of each, m."""
        return self.scored.typical(self.floor)

    @cached_property
    def parts(self) -> dict[str, Indices]:
        """Return the unknowns of each effect that take part; without the effects that have none."""
        vector = self.fit.vector
        free = {label: np.setdiff1d(vector.part(label), self.off) for label in vector.labels}
        return {label: part for label, part in free.items() if len(part)}

    @cached_property
    def gains(self) -> dict[str, Gain]:
        """Return by each effect what trials left out gain by it."""
        return self.gains_without(())

    def gains_without(self, dropped: Iterable[str], asked: Collection[str] | None = None) -> dict[str, Gain]:
        """Return the gain [m of excess, in quadrature, and 90 %] of each effect that is `asked`, with those `dropped`
        off."""
        off = np.concatenate([self.off, self.fit.vector.parts(dropped)]).astype(np.intp)
        with_all, parts = self.trials.scored(off), self.parts
        return {
            label: self.trials.gain(self.trials.scored(np.concatenate([off, parts[label]])), with_all, self.floor)
            for label in (parts if asked is None else [label for label in parts if label in asked])
        }

    def predicts_better(self, other: "Judged", least: float) -> bool:
        """Return whether trials left out lose `least` [m] by another fit, and that for certain."""
        without, these = other.scored, self.scored
        alike = replace(these, squares=these.squares * without.weights / np.maximum(these.weights, 1e-12))
        return is_certain(self.trials.gain(without, alike, self.floor), least)


def is_certain(gain: Gain, least: float) -> bool:
    """Return whether a gain is `least` [m], and above nothing for certain."""
    return gain[0] >= least and gain[1][0] > 0


def strength(fit: Fit, label: str) -> float:
    """Return the strongest of the strengths of an effect of a fit, in deviations of their priors."""
    strengths = fit.vector.strengths(label)
    return float((np.abs(fit.x[strengths]) / fit.vector.prior[strengths]).max())


def is_cause(fit: Fit, label: str) -> bool:
    """Return whether an effect of a fit is more than what is in any careful build."""
    return strength(fit, label) >= CAUSE


_ORDERS = 199  # of the trials that are tried, drawn where there are more
TURNS = 2  # decoys of an effect: each trial has the columns of the next of its design, or of the one after that
CHANCE = 0.95  # quantile of the decoys' gains that an effect must gain more than


def certain_drift(judged: Judged, place: Array) -> float:
    """Return by how much factors that change evenly over the session move the cloth from its first trial to its last,
    m RMS to first order; 0 where that is not certain. place: (samples,) in the session.

    It is certain where the data need it (NEEDED), and where not one in twenty of the sessions with exchanged places
    needs it as much (permutation test)."""
    factors, count, extent = np.flatnonzero(judged.fit.vector.are_factors), len(place), float(np.ptp(place))
    if not extent:
        return 0.0
    even, rng = (place - place.mean()) / extent, np.random.default_rng(0)

    def change(order: Sequence[int] | Indices) -> tuple[Array, float]:
        x, covariance = judged.trials.changing(factors, even[np.asarray(order)])
        return x, cost(x, covariance, np.arange(len(x)))

    x, price = change(range(count))
    every = factorial(count) <= _ORDERS
    orders = [*permutations(range(count))] if every else [rng.permutation(count) for _ in range(_ORDERS)]
    if price < NEEDED or np.mean([change(order)[1] >= price * (1 - 1e-9) for order in orders]) > 1 - CHANCE:
        return 0.0
    moved = judged.fit.state.jacobian[judged.trials.kept][:, factors] @ x
    return float(np.sqrt(np.mean(np.square(moved))))


@dataclass(frozen=True)
class Decoys:
    """Effects by chance. gains: of trials left out by each, beside a fit; needed: whether data need it, by `NEEDED`."""

    gains: tuple[Gain, ...]
    needed: tuple[bool, ...]

    @property
    def chance(self) -> float:
        """Return the excess that one decoy in twenty gains, m; 0 without any."""
        return max(0.0, float(np.quantile([gain for gain, _ in self.gains], CHANCE))) if self.gains else 0.0

    def taken(self, least: float) -> int:
        """Return how many would be called missing, where an effect must gain `least` [m]."""
        return sum(
            needed and gain >= least and low > 0
            for needed, (gain, (low, _)) in zip(self.needed, self.gains, strict=True)
        )


def decoys_beside(known: Fit, joint: Fit, samples: Sequence[Sample], folds: Sequence[int], floor: float) -> Decoys:
    """Return decoys of each effect of a joint fit, judged beside another fit of the same points. floor: noise, m. None
    where a design has no two trials with different pressures."""
    trials, vector = LeftOut.of(known, folds), joint.vector
    without, gains, needed = trials.scored(), list[Gain](), list[bool]()
    for order in turned(samples, folds):
        table = exchanged(joint.state, samples, order)
        for label in vector.labels:
            part = vector.part(label)
            beside = trials.with_columns(table[:, part], vector.prior[part])
            gains.append(trials.gain(without, beside.scored(), floor))
            covariance = np.linalg.inv(beside.information)
            x = beside.x - covariance @ beside.gradient
            last = np.arange(len(x) - len(part), len(x))  # to switch them off costs so much, to first order
            needed.append(cost(x, np.asarray(covariance, dtype=np.float64), last) >= NEEDED)
    return Decoys(tuple(gains), tuple(needed))


def exchanged(state: Linearisation, samples: Sequence[Sample], order: Sequence[int]) -> Array:
    """Return (N, p) m: the Jacobian with rows of sample order[s] in place of those of sample s, at the frame nearest in
    time and of it the point nearest on the cloth; along the front's normal, and zero where it is not known."""
    match = state.misfit
    assert isinstance(match, Match)
    u, v, front = places_on_cloth(match)
    place, source = np.stack([u, v], axis=1), np.zeros(len(u), dtype=np.intp)
    points = {(int(match.sample[rows[0]]), int(match.frame[rows[0]])): rows for rows in frames_of(match)[1]}
    for (s, f), rows in points.items():
        other = order[s]
        there = points[other, int(np.abs(samples[other].times - samples[s].times[f]).argmin())]
        source[rows] = there[cKDTree(place[there]).query(place[rows])[1]]
    return np.nan_to_num(state.jacobian[source]) * (front * front[source])[:, None]


def turned(samples: Sequence[Sample], folds: Sequence[int]) -> list[list[int]]:
    """Return which sample's changes each sample takes: of its design and of other pressures, the next, and the one
    after. Empty where a design has no two."""
    orders = []
    for turn in range(1, TURNS + 1):
        order = []
        for s, sample in enumerate(samples):
            others = [
                t % len(samples)
                for t in range(s + 1, s + len(samples))
                if samples[t % len(samples)].trial.design_name == sample.trial.design_name
                and folds[t % len(samples)] != folds[s]
            ]
            if not others:
                return []
            order.append(others[(turn - 1) % len(others)])
        orders.append(order)
    return orders
