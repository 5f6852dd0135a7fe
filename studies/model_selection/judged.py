"""A fit and the errors of trials left out: each predicted from the others, with effects or without, to first order."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.nouns.array import Indices
from optimize.fit.cross_validation import Gain, LeftOut, Scored
from optimize.fit.fitted import Fit

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
    keys, vector = EFFECTS[label_effect(label)].strengths, fit.vector
    strengths = [k for k in vector.part(label) if vector.parameters[k].name.rpartition(".")[2] in keys]
    return float((np.abs(fit.x[strengths]) / vector.prior[strengths]).max())


def is_cause(fit: Fit, label: str) -> bool:
    """Return whether an effect of a fit is more than what is in any careful build."""
    return strength(fit, label) >= CAUSE
