"""Learning from a turn's measurements: an effect traced, all parameters refitted with it, a network for what
remains."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean
from typing import NamedTuple

from fabdesign.errors import InputError
from fabdesign.files.model_file import read_model, write_model
from fabdesign.formats.json_file import plain
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import Accuracy, MeasurementSet
from fabdesign.output import WorkFolder
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.units import in_mm
from optimize.fit.free_parameters import fit_vector
from studies.calibration import Calibration, CalibrationOptions, calibrate_sets
from studies.loop.record import Learned, TracedEffects
from studies.measured.used_frames import GRID
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.forward_model import forward_model

MODEL = "model.toml"
TRACE = "trace"  # the folder of the trace

Simulators = Callable[[int], ForwardModel]  # by points a side
Say = Callable[[str], None]


def together(sets: Sequence[MeasurementSet]) -> MeasurementSet:
    """Return all turns' trials as one set, each turn's design by the turn's name."""
    if len(sets) == 1:
        return sets[0]
    return MeasurementSet(
        name=f"{sets[0].name} to {sets[-1].name}",
        designs={name: design for one in sets for name, design in one.designs.items()},
        trials=tuple(trial for one in sets for trial in one.trials),
        description=sets[0].description,
        frame_rate=sets[0].frame_rate,
        accuracy=Accuracy.worst([one.accuracy for one in sets]),
    )


class Traced(NamedTuple):
    """The verdict, the model with the effects that it has from now on, and lines for people; no model where there was
    too little to trace."""

    verdict: TracedEffects | None
    model: Model | None
    lines: list[str]


@dataclass(frozen=True)
class Lesson:
    """The lesson of a turn: the sets of all turns so far. name: of the turn, whose folder in `work` gets what is
    learned; say: hears how far it is."""

    study: LoopStudy
    sets: Sequence[MeasurementSet]
    work: WorkFolder
    name: str
    simulators: Simulators
    say: Say

    @property
    def _quick(self) -> ForwardModel:
        """Return the simulator of the study's grid, or of a coarser one that serves for slopes."""
        return self.simulators(min(self.study.points_per_side, GRID))

    def learn(self, known: Model) -> Learned:
        """Learn, and write `model.toml` in the folder of the turn. known: the model that the turn's design was chosen
        with. A trace refits the declared parameters along; on another grid than the study's, or without one, they and
        the effects are fitted by `calibrate`. What cannot be is said, and left out."""
        study, measured, known, notes = self.study, together(self.sets), known.without(["corrector"]), []
        traced, model, started = None, None, known
        if study.learning.trace:
            traced, learned, lines = self.traced(measured, known)
            notes += lines
            if learned is not None:
                started = replace(known, effects=learned.effects)
                model = learned if study.learning.trace_grid == study.points_per_side else None
        if model is None:
            calibration = self._calibrated(started)
            model, remaining = calibration.model, in_mm(calibration.excess)
            fitted = len(model.provenance.fitted)
            notes.append(f"calibrated on {fitted} trials: {remaining:.2f} mm over the noise remain")
            notes += [f"warning: the intervals are not reliable: {why}" for why in calibration.warnings]
        trained = False
        with self.work.adding() as files:
            (files / self.name).mkdir()
            write_model(model, files / self.name / MODEL)
        fit = sum(trial.role == "fit" for trial in measured.trials)
        if study.learning.train is not None:
            if fit < study.learning.train_trials:
                notes.append(f"no network: {fit} trials to learn from; expected {study.learning.train_trials}")
            else:
                line, trained = self._trained(measured, model)
                notes.append(line)
        self.say("evaluating the model on the held-out trials")
        return Learned(
            said=notes,
            trace=traced,
            factors=model.factors,
            effects=[effect.name for effect in model.effects],
            corrector=trained,
            held_out=self._held_out(read_model(self.work.folder / self.name / MODEL)),
        )

    def traced(self, measured: MeasurementSet, known: Model) -> Traced:
        """Trace in the folder `trace` of the turn. measured: all sets as one."""
        from fabdesign.runtime.fingerprint import OtherContent
        from studies.measured.fit_data import TooLittle
        from studies.tracing import Options, trace_set, verdict_in_words

        learning = self.study.learning
        trace = partial(
            trace_set,
            measured,
            self.work.folder / self.name / TRACE,
            inputs=[],
            options=Options(learning.tolerance, learning.trace_grid, self.study.search.seed, known),
            forward=self.simulators(learning.trace_grid),
            say=lambda line: self.say(f"trace: {line}"),
        )
        try:
            try:
                outcome = trace()
            except OtherContent:  # begun with other code: a loop goes on for weeks
                outcome = trace(force=True)
        except TooLittle as error:
            return Traced(None, None, [f"not traced: {error}"])
        traced = TracedEffects(
            verdict=outcome.verdict,
            effects=[effect.name for effect in outcome.effects],
            indistinguishable=[*outcome.indistinguishable],
            excess=plain(outcome.excess_mm),
        )
        return Traced(traced, outcome.model, [f"trace: {verdict_in_words(outcome)}"])

    def _calibrated(self, start: Model) -> Calibration:
        grid, quick = self.study.points_per_side, self._quick
        vector = fit_vector(
            [effect.name for effect in start.effects],
            terms=start.terms,
            designs=[design for measured in self.sets for design in measured.designs.values()],
        )
        return calibrate_sets(
            self.sets,
            self.simulators(grid),
            vector=vector,
            progress=lambda line, share: self.say(f"calibrating: {line}"),
            options=CalibrationOptions(slopes=quick, coarse=quick, points_per_side=grid, seed=self.study.search.seed),
        )

    def _trained(self, measured: MeasurementSet, base: Model) -> tuple[str, bool]:
        """Return what a network is worth, in a line, and whether it is used: the model with it takes the place of the
        one without where it brings the trials kept back nearer, of every design."""
        from studies.training import TrainingOptions, train_on

        network, seed = self.study.learning.train, self.study.search.seed
        assert network is not None
        if network == "paper":
            import corrector.paper_training  # noqa: F401 loads PyTorch
        with self.work.adding() as files:
            folder = files / self.name
            folder.mkdir()
            try:
                result = train_on(
                    [measured],
                    self.simulators(self.study.points_per_side),
                    folder / MODEL,
                    TrainingOptions(base, network=network, seed=seed, coarse=self._quick),
                    goes_to=self.work.folder / self.name / MODEL,
                    force=True,
                    progress=lambda what, done, total: self.say(f"training: {what} {done} of {total}"),
                )
            except InputError as error:  # trials that nothing can be learned from
                shutil.rmtree(folder)
                return f"no network: {error}", False
            shares = [of.closed.surface for of in result.held_out.values() if of.closed.surface is not None]
            used = bool(shares) and min(shares) > 0
            if not used:
                shutil.rmtree(folder)
        worth = f"removes {min(shares):.0%} of the excess" if shares else "there was no excess left"
        learned = f"network {network} learned from {result.learned_from} trials, {worth} on held-out trials"
        return f"{learned}{'' if used else '; it is not used'}", used

    def _held_out(self, model: Model) -> dict[str, float] | None:
        """Return the surface excess [mm] on the trials of role test of all sets, before and after as `evaluate` has
        them; None where no frame of such trials is used."""
        try:
            predictor = forward_model(self.simulators(self.study.points_per_side), model)
            seed = self.study.search.seed
            errors = evaluate_sets(predictor, self.sets, coarse=self._quick, seed=seed).designs
        except InputError:
            return None
        means = {
            state: [Errors(**{name: over.mean for name, over in getattr(of, state).items()}) for of in errors.values()]
            for state in ("before", "after")
        }
        return {state: in_mm(fmean(one.excess for one in each)) for state, each in means.items()}
