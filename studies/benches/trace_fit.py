"""The effects that the residuals of a bench need: columns that a record would show of each, beside the quasi-static
law; one joint fit of every effect, then those dropped again that they do not need, by the rules of sets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.forward import Term
from fabdesign.nouns.lag import first_order
from fabdesign.nouns.model import NORMAL90
from fabdesign.units import in_kpa
from optimize.fit.fitted import Fit, concluded
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.problem import BenchProblem
from optimize.fit.significance import NEEDED, conditioned, eliminated
from studies.benches.cylinder import friction_state
from studies.benches.law import ROUNDS, Law, rms
from studies.model_selection.judged import Judged
from studies.model_selection.outcome import Candidate
from studies.model_selection.rules import ON_BENCHES, Refits, Selection, follow
from studies.model_selection.verdict import STRUCTURE

# what a force goes back and forth over, and its sign
PATHS = {"displacement": 1.0, "contraction": -1.0, "stretch": 1.0}
PRESSURES = "pressure", "pressure_command", "pressure_amplitude"
FAST = 0.02, 0.05, 0.1, 0.2, 0.4  # s
SLOW = 0.7, 2.0, 6.0, 20.0  # s

Signals = Mapping[str, Array]  # (n,) of one record
Columns = Mapping[str, Array]  # (n,) by parameter, of a shape; each coefficient is that parameter's value


def signals_of(record: BenchRecord, law: Array, number: int) -> Signals:
    """Return law, what the quasi-static law says; number, the record's place among all; and as far as it has them path,
    which rises as the specimen lengthens, pressure [kPa] and time."""
    path = [sign * record.columns[name] for name, sign in PATHS.items() if name in record.columns]
    pressure, signals = record.first(PRESSURES), {"law": law, "number": np.array(number)}
    signals |= {"path": path[0]} if path else {}
    signals |= {} if pressure is None else {"pressure": in_kpa(pressure)}
    return signals | ({"time": record.columns["time"]} if "time" in record.columns else {})


@dataclass(frozen=True)
class ShapedEffect:
    """A candidate at one shape."""

    effect: str
    values: Mapping[str, float]  # of what shapes it
    units: Mapping[str, str]  # of all its parameters
    columns: Callable[[Signals], Columns]


def shapes_of(law: type[Law], signals: Sequence[Signals]) -> list[ShapedEffect]:
    """Return those that make sense on a specimen and that its records can show."""
    has = {name: all(name in s for s in signals) for name in ("path", "pressure", "time")}
    shapes: list[ShapedEffect] = []
    along, unit, timed = law.slides_over, law.unit, {"share": "1", "time": "s"}
    if along is not None and has["path"] and has["pressure"]:
        reach = float(np.median([np.ptp(s["path"]) for s in signals]))
        units = {"friction": f"{unit}/kPa", "friction_at_zero": unit, "slip": along}
        slips = [share * reach for share in (0.005, 0.02, 0.06)]
        shapes += [ShapedEffect("braid_hysteresis", {"slip": s}, units, partial(_friction, s)) for s in slips]
    if has["time"]:
        if law.damped and has["path"]:
            rate = {"contracting": f"{unit} s", "lengthening": f"{unit} s"}
            shapes.append(ShapedEffect("muscle_viscosity", {}, rate, _viscosity))
        if law.late:
            shapes += [ShapedEffect("filling_lag", {"time": t}, timed, partial(_slow, t, 1.0)) for t in FAST]
            shapes.append(ShapedEffect("dead_time", {}, {"delay": "s"}, lambda s: {"delay": _delay(s)}))
        else:
            shapes.append(ShapedEffect("time_offset", {}, {"offset": "s"}, lambda s: {"offset": _delay(s)}))
        slow, sign = law.slow
        shapes += [ShapedEffect(slow, {"time": t}, timed, partial(_slow, t, sign)) for t in SLOW]
    if len(signals) > 2:
        units = {"loss": "1", "trials": "1"}
        shapes += [ShapedEffect("stroke_softening", {"trials": n}, units, partial(_softening, n)) for n in (1.0, 3.0)]
    return shapes


def _friction(slip: float, s: Signals) -> Columns:
    state = friction_state(s["path"], slip)
    return {"friction": state * s["pressure"], "friction_at_zero": state}


def _viscosity(s: Signals) -> Columns:
    rate = np.gradient(s["path"], s["time"])
    return {"contracting": np.minimum(rate, 0.0), "lengthening": np.maximum(rate, 0.0)}


def _slow(time: float, sign: float, s: Signals) -> Columns:
    """Return what a share of the law lacks that comes with a time constant; less than nothing: has beyond it, and
    loses."""
    late = first_order(s["law"][1:], np.diff(s["time"]), time, start=s["law"][0])
    return {"share": sign * (late - s["law"])}


def _delay(s: Signals) -> Array:
    """Return what the law changes by in a second."""
    return np.asarray((np.interp(s["time"] - 0.05, s["time"], s["law"]) - s["law"]) / 0.05)


def _softening(trials: float, s: Signals) -> Columns:
    return {"loss": -s["law"] * (1 - np.exp(-s["number"] / trials))}


_WIDE = 3.0  # prior deviation of a strength, times the one that moves the records as much as all that the law leaves
_AT_LIMIT = 1e-6  # of the prior's deviation


@dataclass(frozen=True, eq=False)
class BenchTask(Refits):
    """residual (N,): law less measured, in the output's unit; record (N,): of which, whose rows share the error of the
    law. tables: of each shape {parameter: (N,)}, by which a unit of it changes the residual. either_sign: whether
    strengths have no bound. As rules ask it (`rules.Refits`): a fit with fewer effects is one with their shapes
    searched anew."""

    shapes: Sequence[ShapedEffect]
    tables: Sequence[Columns]
    residual: Array
    record: Indices
    floor: float
    tolerance: float
    either_sign: bool = False

    @property
    def effects(self) -> list[str]:
        return list(dict.fromkeys(shape.effect for shape in self.shapes))

    def judged(self, fit: Fit) -> Judged:
        """Return a fit with what records left out say of it. Unknowns at their limit take no part: what they would take
        has a sign that they cannot have."""
        low, high = fit.vector.limits
        held = np.flatnonzero(np.minimum(fit.x - low, high - fit.x) < _AT_LIMIT * fit.vector.prior)
        return Judged(fit, range(int(self.record.max()) + 1), self.floor, held)

    def without(self, known: Fit, labels: Sequence[str]) -> Fit:
        """Return the fit of the effects of another but `labels`."""
        return self.shaped([label for label in known.vector.labels if label not in labels]).fit

    def places(self, fit: Fit) -> list[int]:
        """Return which shapes the effects of a fit have."""
        keys = [(shape.effect, shape.values) for shape in self.shapes]
        return [keys.index((term.name, term.values)) for term in fit.vector.terms]

    def fit(self, places: Sequence[int] = (), rows: Indices | slice = slice(None)) -> Judged:
        """Return the effects at these shapes, together, from off. Residuals are linear in these, so the second step is
        the last. rows: that take part."""
        residual, record = self.residual[rows], self.record[rows]
        strengths = [(self.shapes[k], key, column[rows]) for k in places for key, column in self.tables[k].items()]
        columns = np.reshape([column for *_, column in strengths], (-1, len(record))).T
        before, parameters = rms(residual), []
        for shape, key, column in strengths:
            name = f"{shape.effect}.{key}"
            size = np.sqrt(np.mean(residual**2) / max(float(np.mean(column**2)), 1e-30))
            bounds = -np.inf if self.either_sign else lowest(name), np.inf
            parameters.append(FitParameter(name, _WIDE * float(size), 0.0, "linear", shape.units[key], bounds))
        terms = tuple(Term(self.shapes[k].effect, self.shapes[k].values) for k in places)
        vector = FitVector(tuple(parameters), (), terms)
        problem, x = BenchProblem(lambda x: residual + columns @ x, record, record, vector), vector.start
        for _ in range(2):
            state = problem.with_jacobian(problem.evaluate([x])[0], columns)
            fitted = concluded(problem, state, None, before, 1, "converged")
            x = fitted.minimum
        return self.judged(fitted)

    def deviation(self, joint: Fit) -> Array:
        """Return (p,) of the unknowns, by their covariance and by how far leaving out each record moves them
        (jackknife): its rows share the law's error."""
        records, places = np.unique(self.record), self.places(joint)
        others = [np.flatnonzero(self.record != k) for k in records]
        alone = np.array([self.fit(places, rows).fit.x for rows in others])
        return np.asarray(np.sqrt(np.diag(joint.covariance) + (len(records) - 1) * alone.var(axis=0)))

    def shaped(self, effects: Sequence[str], beside: Sequence[int] = ()) -> Judged:
        """Return each effect at the shape that leaves least of records left out, the others being at theirs; beside:
        shapes that stay."""
        places_of = {effect: [k for k, shape in enumerate(self.shapes) if shape.effect == effect] for effect in effects}
        chosen = {effect: places[0] for effect, places in places_of.items()}
        best = self.fit([*beside, *chosen.values()])
        for _ in range(ROUNDS):
            before = dict(chosen)
            for effect, places in places_of.items():
                for place in places if len(places) > 1 else ():
                    tried = self.fit([*beside, *(chosen | {effect: place}).values()])
                    if tried.scored.squares.sum() < best.scored.squares.sum():
                        best, chosen = tried, chosen | {effect: place}
            if chosen == before:
                break
        return best


def lowest(name: str) -> float:
    """Return the least of a strength, EFFECT.PARAMETER: nothing, unless it may have either sign."""
    effect, _, key = name.partition(".")
    declared = EFFECTS[effect].parameters.get(key)
    return -np.inf if declared is not None and declared.bounds[0] < 0 else 0.0


def select(task: BenchTask) -> Selection:
    """Return a selection of every effect at once, then by the rules: to first order what the data do not need, then
    what records left out gain too little by, with shapes and strengths fitted anew."""
    none = task.fit()
    if none.excess <= task.tolerance:
        return Selection(none.fit, none, none)
    everything = task.shaped(task.effects)
    known = conditioned(everything.fit.x.copy(), everything.fit.covariance, everything.off)
    labels = [*eliminated(*known, everything.parts, NEEDED)[0]]
    if not labels:
        return Selection(everything.fit, none, none)
    judged = task.shaped(labels)
    return follow(ON_BENCHES, task, Selection(everything.fit, none, judged, everything.excess))


def candidates_of(task: BenchTask, selection: Selection) -> tuple[Candidate, ...]:
    """Return every effect by itself, at its best shape and with any sign, the one that leaves least first."""
    rows, before, task = [], selection.before.excess, replace(task, either_sign=True)
    for effect in task.effects:
        alone = task.shaped([effect])
        gain, interval = alone.gains_without(())[effect]
        takes = interval[0] > 0 and alone.excess <= (1 - STRUCTURE) * before
        remaining, chosen = (alone.excess, alone.typical), effect in selection.chosen.vector.labels
        refused = takes and _wrong_sign(task, alone)
        rows.append((alone.scored.rms(), Candidate(effect, gain, interval, *remaining, chosen, refused=refused)))
    return tuple(candidate for _, candidate in sorted(rows, key=lambda row: row[0]))


def _wrong_sign(task: BenchTask, alone: Judged) -> bool:
    """Return whether a strength is less than it can be for certain."""
    most = alone.fit.x + NORMAL90 * task.deviation(alone.fit)
    return any(m < lowest(name) for m, name in zip(most.tolist(), alone.fit.vector.names, strict=True))


def alike(task: BenchTask, chosen: Judged) -> tuple[str, ...]:
    """Return effects that in the place of one of those chosen do as well, as far as records left out can say."""
    names, places = [], task.places(chosen.fit)
    for place in places:
        others = [k for k in places if k != place]
        for effect in task.effects:
            if effect not in chosen.fit.vector.labels:
                swapped = task.shaped([effect], others)
                gain = chosen.trials.gain(swapped.scored, chosen.scored, task.floor)
                if effect in swapped.parts and gain[1][0] <= 0:
                    names.append(effect)
    return tuple(dict.fromkeys(names))
