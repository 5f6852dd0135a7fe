"""What a trace found, as `trace.json` and as a model."""

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fabdesign import SIMULATOR, __version__
from fabdesign.effects import EFFECTS
from fabdesign.forward import PARAMETERS
from fabdesign.model import Covariance, EffectTerm, Model, Parameter, Provenance, Quantity
from fabdesign.trial import Trial
from studies.calibration.engine_difference import data_share, engine_difference
from studies.calibration.fitted_model import QUANTILE
from studies.calibration.parameters import PRIOR
from studies.judged import Stretch
from studies.tracing.errors import TrialError, mean_of, other_layouts
from studies.tracing.full_fit import Finalist
from studies.tracing.ranking import Grams, covariance
from studies.tracing.residual import Remains
from studies.tracing.search import Search, added_effects
from studies.tracing.together import gains
from studies.tracing.vector import FACTORS, Array
from studies.tracing.verdict import Evidence, Word, explains

FORMAT = "fabdesign.trace/1"


@dataclass(frozen=True, eq=False)
class Outcome:
    """Of a trace of a set. Distances in m."""

    name: str
    synthetic: bool
    verdict: Word
    evidence: Evidence
    tolerance: float
    search: Search
    errors: tuple[TrialError, ...]
    remains: Remains
    stretches: tuple[Stretch, ...]
    share_unjudged: float
    model: Model
    next_experiment: Mapping[str, Any] | None
    said: tuple[str, ...]  # lines for people

    @cached_property
    def effects(self) -> tuple[EffectTerm, ...]:
        """Those that the verdict stands by, in the order they were added; of those added together the largest first."""
        if self.verdict != "effect":
            return ()
        order = [name for done in self.search.rounds if done.chosen for name in self._parts(done.chosen)]
        found = {effect.name: effect for effect in self.model.effects}
        return tuple(found[name] for name in order)

    @property
    def grid_in_words(self) -> str:
        """Empty where no finer grid was compared with."""
        if self.search.grid.error is None:
            return ""
        return (
            f"grid: {self.model.points_per_side} points a side, whose error of {1e3 * self.search.grid.error:.2f} mm"
            " counts with the noise"
        )

    def as_json(self) -> dict[str, Any]:
        """`trace.json`; mm."""
        return {
            "format": FORMAT,
            "verdict": self.verdict,
            "effects": [self._effect(effect) for effect in self.effects],
            "indistinguishable": list(self.indistinguishable),
            "candidates": self._candidates(),
            "error": self._error(),
            "other_layouts": {
                name: {
                    "trials": len(own),
                    **{which: 1e3 * float(mean_of(own, "test", which) or 0.0) for which in ("before", "after")},
                }
                for name, own in other_layouts(self.errors).items()
            },
            "residual": {
                "where": list(self.remains.where),
                "when_s": self.remains.when,
                "follows": self.remains.follows,
            },
            "unjudged": [stretch.as_json() for stretch in self.stretches],
            "unjudged_share": self.share_unjudged,
            "discovered": None,
            "next_experiment": self.next_experiment,
            "excess": {
                "unit": "mm",
                "before": 1e3 * self.evidence.before,
                "after": 1e3 * self.evidence.after,
                "black_box": 1e3 * self.evidence.box_before,
                "chance": 1e3 * self.search.rounds[0].ranking.chance,
                "decoy": 1e3 * self.search.rounds[0].ranking.decoy,
                "fitted": None if self.evidence.fitted is None else 1e3 * self.evidence.fitted,
            },
            "grid": {
                "points_per_side": self.model.points_per_side,
                "error_mm": None if self.search.grid.error is None else 1e3 * self.search.grid.error,
            },
            "said": list(self.said),
        }

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """From the last effect chosen, or from one of several chosen together."""
        if self.verdict != "effect":
            return ()
        *_, last, final = self.search.rounds
        assert last.chosen is not None
        return final.stand_ins if last.chosen.together else last.indistinguishable

    def _effect(self, effect: EffectTerm) -> dict[str, Any]:
        declared = EFFECTS[effect.name]
        return {
            "name": effect.name,
            "site": declared.site,
            "scope": effect.scope or declared.scope,
            "parameters": {
                name: {"value": q.value, "unit": q.unit, "interval90": q.interval90 and list(q.interval90)}
                for name, q in effect.parameters.items()
            },
            "explains": self.explained.get(effect.name),
        }

    @cached_property  # of several effects found together it takes a cross-validation each
    def explained(self) -> dict[str, float | None]:
        """Share of the gap that each effect closes, in the order they were added."""
        if explains(self.evidence) is None:
            return {}
        shares: dict[str, float | None] = {}
        last = self.evidence.before
        for done in self.search.rounds:
            if done.chosen is not None:
                now = max(done.ranking.excess - done.chosen.gain, 0.0)
                share = (last - now) / self.evidence.before
                shares |= {name: share * part for name, part in self._parts(done.chosen).items()}
                last = now
        return shares

    def _parts(self, chosen: Finalist) -> dict[str, float]:
        """Of several effects found together, each one's part: by what its absence costs."""
        if len(chosen.effects) == 1:
            return {chosen.name: 1.0}
        found = gains(self.search.bench, chosen.state, self.search.folds, self.search.floor)
        costs = {name: max(found[name].gain, 0.0) for name in sorted(chosen.effects, key=lambda n: -found[n].gain)}
        return {name: cost / max(sum(costs.values()), 1e-12) for name, cost in costs.items()}

    @property
    def floor(self) -> float:
        """m, `surface_floor` of the set."""
        for role in ("test", "fit"):
            if (found := mean_of(self.errors, role, "after", "surface_floor")) is not None:
                return found
        return self.search.floor

    def candidates(self) -> list[dict[str, Any]]:
        """The first round's, best first, with `none`; m. Those fitted in full have that fit's figures; several that
        were fitted together have a row of their own."""
        first = self.search.rounds[0]
        full = {f.name: f for f in first.finalists}
        rows: list[dict[str, Any]] = [
            {"name": "none", "excess": first.ranking.excess, "gain": 0.0, "interval90": (0.0, 0.0), "full": True,
             "certain": False}
        ]  # fmt: skip
        for c in first.ranking.candidates:
            gain, interval = (
                (full[c.effect].gain, full[c.effect].interval90) if c.effect in full else (c.gain, c.interval90)
            )
            excess, certain = max(first.ranking.excess - gain, 0.0), first.ranking.certain(c)
            rows.append(
                {"name": c.effect, "excess": excess, "gain": gain, "interval90": interval, "full": c.effect in full,
                 "certain": certain}
            )  # fmt: skip
        for f in first.finalists:
            if len(f.effects) > 1:
                excess = max(first.ranking.excess - f.gain, 0.0)
                rows.append(
                    {"name": f.name, "excess": excess, "gain": f.gain, "interval90": f.interval90, "full": True,
                     "certain": f.interval90[0] > 0}
                )  # fmt: skip
        return sorted(rows, key=lambda row: float(row["excess"]))

    def _candidates(self) -> list[dict[str, Any]]:
        return [
            {
                "name": row["name"],
                "held_out": self._surface(row["excess"]),
                "gain": 1e3 * row["gain"],
                "interval90": [1e3 * row["interval90"][0], 1e3 * row["interval90"][1]],
                "adequate": bool(row["excess"] <= self.tolerance),
                "fitted": "in full" if row["full"] else "linear",
            }
            for row in self.candidates()
        ]

    def _surface(self, excess: float) -> float:
        """mm of surface RMS."""
        return 1e3 * float(np.hypot(excess, self.floor))

    def _error(self) -> dict[str, Any]:
        def pair(which: str, excess: float) -> dict[str, float | None]:
            fit, test = (mean_of(self.errors, role, which) for role in ("fit", "test"))
            return {
                "fit": None if fit is None else 1e3 * fit,
                "held_out": self._surface(excess) if test is None else 1e3 * test,
                "cross_validated": self._surface(excess),
            }

        return {
            "metric": "surface_rms",
            "unit": "mm",
            "noise_floor": 1e3 * self.floor,
            "tolerance": 1e3 * self.tolerance,
            "ceiling": self._surface(self.evidence.box_before),
            "before": pair("before", self.evidence.before),
            "after": pair("after", self.evidence.after if self.verdict == "effect" else self.evidence.before),
        }


def model_of(
    search: Search,
    points_per_side: int,
    provenance: Provenance,
    *,
    with_effects: bool,
    known: tuple[EffectTerm, ...] = (),
) -> Model:
    """The last state as a model, or the first, without effects found; both with those known before."""
    plain = _parameters(search.before.x, _covariance(search.rounds[0].grams))
    if not with_effects or not search.after.vector.added:
        return Model(
            plain,
            known,
            points_per_side=points_per_side,
            provenance=provenance,
            covariance=_joint(search.rounds[0].grams, search.before.vector.names),
        )
    state, grams = search.after, search.rounds[-1].grams
    matrix = _covariance(grams)
    effects = []
    for added, part in added_effects(state):
        quantities = {}
        deviation = np.sqrt(np.diag(matrix)[part])
        low, high = (added.values(state.x[part] + side * QUANTILE * deviation) for side in (-1, 1))
        for name, value in added.values(state.x[part]).items():
            unit = EFFECTS[added.name].parameters[name].unit
            interval = (low[name], high[name]) if name in added.free else None
            quantities[name] = Quantity(value, unit, interval)
        effects.append(EffectTerm(added.name, quantities, added.scope))
    return Model(
        _parameters(state.x, matrix),
        (*known, *effects),
        points_per_side=points_per_side,
        provenance=provenance,
        without_effects=plain,
        covariance=_joint(grams, state.vector.names),
    )


def _covariance(grams: Grams) -> Array:
    """In prior standard deviations, with the engines' difference in the declared parameters."""
    matrix = covariance(grams)
    prior = np.array([PRIOR[name] for name in PARAMETERS])
    own = np.sqrt(np.diag(matrix))[:FACTORS] * prior
    extra = data_share(own) * engine_difference() / prior
    return matrix + np.diag(np.concatenate([np.square(extra), np.zeros(len(matrix) - FACTORS)]))


def _parameters(x: Array, matrix: Array) -> dict[str, Parameter]:
    found = {}
    for k, name in enumerate(PARAMETERS):
        centre, half = PRIOR[name] * x[k], QUANTILE * PRIOR[name] * float(np.sqrt(matrix[k, k]))
        found[name] = Parameter(float(np.exp(centre)), (float(np.exp(centre - half)), float(np.exp(centre + half))))
    return found


def _joint(grams: Grams, names: Sequence[str]) -> Covariance:
    """Of the factors' logarithms and the effects' parameters, in their transforms."""
    scale = [PRIOR[n] if n in PRIOR else EFFECTS[n.split(".")[0]].parameters[n.split(".")[1]].deviation for n in names]
    return Covariance(tuple(names), _covariance(grams) * np.outer(scale, scale))


def provenance_of(
    set_name: str, fitted: Sequence[Trial], held_out: Sequence[Trial], hashes: Mapping[str, str], seed: int
) -> Provenance:
    """Where the model comes from."""
    return Provenance(
        sets=(set_name,),
        fitted=tuple(f"{set_name}/{t.name}" for t in fitted),
        held_out=tuple(f"{set_name}/{t.name}" for t in held_out),
        versions={"python": platform.python_version(), "fabdesign": __version__, "simulator": str(SIMULATOR)}
        | {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "taichi")},
        hashes=hashes,
        seed=seed,
    )
