"""The data and fits of a trace. Fits are kept in its folder, so that one that was killed goes on with the next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.geometry.shape import sheets_of
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import ForwardModel, Term
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.store import Arrays, Checkpoint
from fabdesign.units import in_mm
from optimize.fit.descent import FitStart, Progress, begun
from optimize.fit.fitted import Fit, concluded, kept
from optimize.fit.misfit import CLOUDS, capped
from optimize.fit.normal import loss
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.policy import DECLARED_ALONE, LITTLE, STEP, FitStage, Policy
from optimize.fit.problem import Evaluation, FitProblem, InputErrors
from optimize.fit.significance import NEEDED
from studies.fitting.fits import Fits
from studies.fitting.fitted_model import expected_rms
from studies.measured.fit_data import MeasuredData
from studies.model_selection.judged import Decoys, Judged, decoys_beside
from studies.model_selection.rules import Refits
from studies.model_selection.verdict import GROSS

# A step is the last that promises less, in log likelihood, than a quarter of what makes an effect needed.
_LAST = FitStage(slight=0.01, least=LITTLE, exact_end=False)
ASKED = Policy(_LAST)


Place = tuple[FitVector, Array]  # a vector, and where in it a model is


@dataclass(frozen=True, eq=False)
class Task(Refits):
    """The data and model of a trace, and its fits, also those that rules ask for (`rules.Refits`). slopes: a cheaper
    engine, for derivatives and frames in balance. factors: where they start. known: effects that the model has and
    keeps as they are. elsewhere: trials of layouts that none of the fitted has, for their designs and pressures, not
    their clouds."""

    data: MeasuredData
    forward: ForwardModel
    tolerance: float  # m of excess
    factors: dict[str, float]
    known: Sequence[str]
    checkpoint: Checkpoint
    say: Callable[[str], None]
    elsewhere: Sequence[Trial] = ()
    slopes: ForwardModel | None = None

    @property
    def floor(self) -> float:
        """Return the RMS of the noise in the residuals, m."""
        return self.data.noise.sigma

    @property
    def designs(self) -> list[Design]:
        """Return the designs of the trials fitted."""
        return [trial.design for trial in self.data.trials]

    def differs_elsewhere(self, one: Place, other: Place) -> float:
        """Return the RMS distance of two models' motions, m, on the layout of `elsewhere` where it is most, or 0."""
        times = [trial.times for trial in self.elsewhere]
        cases = [vector.case(trial, x) for vector, x in (one, other) for trial in self.elsewhere]
        sheets = sheets_of(self.forward)(cases, [*times, *times])
        squares: dict[str, list[float]] = {}
        for trial, a, b in zip(self.elsewhere, sheets, sheets[len(times) :], strict=False):
            apart = np.linalg.norm(a.middle - b.middle, axis=-1)
            squares.setdefault(trial.design_name, []).append(float(np.square(np.fmin(apart, CLOUDS.largest)).mean()))
        return max((float(np.sqrt(np.mean(means))) for means in squares.values()), default=0.0)

    @property
    def fits(self) -> Fits:
        """Return how its fits are made."""
        return Fits(self.forward, self.tolerance, self.slopes, self.checkpoint, self._progress_of)

    def refined(self, finer: ForwardModel, place: Place) -> "Task":
        """Return the task with motions of a finer engine, where those move what is left at a place by more than the
        tolerance; derivatives stay those of its own."""
        vector, x = place

        def there() -> Arrays:
            ends = [replace(self, forward=one).problem(vector).evaluate([x])[0] for one in (self.forward, finer)]
            apart = ends[1].misfit.residual - ends[0].misfit.residual
            return {"apart": np.array(capped(np.nan_to_num(apart, nan=CLOUDS.largest), CLOUDS.largest))}

        apart = float(self.checkpoint.arrays("grid", there)["apart"])
        if apart <= self.tolerance:
            return self
        self.say(f"the finer grid is taken: it moves what is left by {in_mm(apart):.2f} mm")
        return replace(self, forward=finer, slopes=self.forward)

    def _progress_of(self, named: str, vector: FitVector) -> Progress:
        begin = f"{named}, {len(vector.parameters)} unknowns: " if named else ""
        return lambda line, share: self.say(begin + line)

    def fit(self, named: str, vector: FitVector, start: FitStart, policy: Policy) -> Fit:
        """Fit as `optimize.fit.descent.fit` does. named: in the folder and in messages."""
        return self.fits.fit(self.problem(vector), start, policy, named)

    def linearised(self, named: str, vector: FitVector, start: FitStart) -> Fit:
        """Return a fit that ends where it begins, with missing columns of the Jacobian by differences."""
        x, problem = start.x, self.problem(vector)
        assert x is not None

        def there() -> Fit:
            self.say(f"{named}, {len(vector.parameters)} unknowns, to first order")
            state = begun(problem, problem.evaluate([x])[0], np.diag(STEP * vector.scale), start.jacobian)
            return concluded(problem, state, start.inputs, state.misfit.rms, 0, "converged")

        return kept(self.checkpoint, named, problem, start.inputs, there)

    def input_errors(self, vector: FitVector, x: Array) -> InputErrors | None:
        """Return what errors of the inputs do near x (p,), by which all fits are weighed; None for exact ones."""
        if self.data.weighed is None:
            return None

        def there() -> Arrays:
            problem = self.problem(vector)
            return vars(problem.input_errors(problem.evaluate([x])[0]))

        return InputErrors(**self.checkpoint.arrays("errors_of_inputs", there))

    def problem(self, vector: FitVector) -> FitProblem:
        """Return the motions of the trials fitted."""
        return self.fits.problem(self.data, vector)

    def judged(self, fit: Fit) -> Judged:
        """Return a fit with what trials left out say of it."""
        return Judged(fit, self.data.folds, self.floor)

    def with_effects(self, known: Fit, labels: Sequence[str]) -> Fit:
        """Return a fit of these effects alone with their shapes, from where one with more is."""
        vector, starts = with_shapes(known, labels)
        content = float(np.hypot(known.promised(to_first_order(known, labels)), 0.5 * self.tolerance))
        return self.fit(
            " ".join(vector.labels), vector, FitStart(starts, inputs=known.inputs), replace(ASKED, content=content)
        )

    def without(self, known: Fit, labels: Sequence[str]) -> Fit:
        """Return a fit of the effects of another but `labels`, as `with_effects` has it."""
        return self.with_effects(known, [other for other in known.vector.labels if other not in labels])

    def alone(self, known: Fit, plain: Fit) -> Fit:
        """Return the declared parameters' fit, from where they are by themselves or beside the effects of a fit,
        whichever is nearer: what one of their false minima leaves is nothing that an effect explains. Those that are
        nearest by themselves, and leave more than twice the tolerance, stay as they are."""
        vector, starts = with_shapes(known, [])
        by_themselves, *beside = self.problem(vector).evaluate([plain.minimum, *starts])
        nearest = min((by_themselves, *beside), key=lambda one: one.misfit.rms)
        if nearest is by_themselves and nearest.misfit.rms > expected_rms(self.data.noise, GROSS * self.tolerance):
            return plain
        return self.fit("plain to its end", vector, FitStart(nearest.x, inputs=known.inputs), DECLARED_ALONE)

    def decoys(self, known: Fit, everything: Fit) -> Decoys:
        """Return effects by chance beside a fit."""
        return decoys_beside(known, everything, self.data.samples, self.data.folds, self.floor)

    def matters_elsewhere(self, fit: Fit, label: str) -> bool:
        """Return whether a fit differs on other layouts where a term is off, to first order: by the tolerance, whatever
        is left of trials left out."""
        one, other = ((fit.vector, fit.without(labels)) for labels in ([], [label]))
        return self.differs_elsewhere(one, other) >= self.tolerance

    def needed_elsewhere(self, known: Fit, simpler: Fit) -> bool:
        """Return whether the data lose by a simpler fit, and other layouts move otherwise."""
        if _lost(known, simpler) < NEEDED:
            return False
        return self.differs_elsewhere((known.vector, known.x), (simpler.vector, simpler.x)) >= self.tolerance


def with_shapes(joint: Fit, labels: Sequence[str]) -> tuple[FitVector, Array]:
    """Return the factors and these terms with all of their parameters that are no choice of a whole number, and (2, p)
    where a joint fit says they are with the others off: to first order, and as they are with the others there, which
    is nearer where these are far from small."""
    places = [to_first_order(joint, labels), joint.minimum]
    vector, index = joint.vector.only(labels)
    known = [dict(zip(vector.names, vector.inside(x[index]), strict=True)) for x in places]
    parameters = [p for p in vector.parameters if p.is_factor]
    for label, term in zip(vector.labels, vector.terms, strict=True):
        effect = EFFECTS[term.name]
        for key, p in effect.parameters.items():
            if not p.integer:
                name = f"{label}.{key}"
                unknown = FitParameter(name, p.deviation, p.centre, p.transform, p.unit, p.bounds)
                begin = known[0].get(name, unknown.unknown(term.values.get(key, p.typical)))
                parameters.append(replace(unknown, start=begin))
    terms = tuple(_chosen_only(term) for term in vector.terms)
    full = FitVector(tuple(parameters), vector.factors, terms)
    return full, np.array([[of.get(p.name, p.start) for p in parameters] for of in known])


def to_first_order(joint: Fit, labels: Sequence[str]) -> Array:
    """Return (p,) where a joint fit has its unknowns, to first order, with all terms but `labels` off."""
    return joint.without(label for label in joint.vector.labels if label not in labels)


def _chosen_only(term: Term) -> Term:
    """Return a term with the values alone that a fit of all parameters does not move."""
    return replace(term, values={k: v for k, v in term.values.items() if EFFECTS[term.name].parameters[k].integer})


def _lost(known: Fit, other: Fit) -> float:
    """Return what a fit with fewer effects loses, of log likelihood and prior. Shapes not in `known` cost nothing."""
    x = np.zeros(len(known.x))
    places = {name: k for k, name in enumerate(known.vector.names)}
    labels = {
        label: label_in(known.vector, t) for label, t in zip(other.vector.labels, other.vector.terms, strict=True)
    }
    for name, value in zip(other.vector.names, other.x, strict=True):
        label, dot, key = name.rpartition(".")
        if (place := places.get(f"{labels.get(label, label)}{dot}{key}")) is not None:
            x[place] = value
    there = Evaluation(x, other.state.misfit, other.state.sheets)
    return loss(known.state, there, known.normal, known.vector, known.inputs)


def label_in(vector: FitVector, term: Term) -> str:
    """Return the label of a term in a vector: that of the same effect, of several in the same channel."""
    same = [(label, other) for label, other in zip(vector.labels, vector.terms, strict=True) if other.name == term.name]
    chosen = _chosen_only(term).values
    return same[0][0] if len(same) == 1 else next(label for label, t in same if _chosen_only(t).values == chosen)
