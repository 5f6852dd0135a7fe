"""The demo's model on measured trials: calibrated, with effects, corrected; none of them has
seen these."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from fabdesign.effects.registry import acting_effects
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.formats.json_file import exact, of_exact
from fabdesign.geometry.metrics import Errors, closed, mean_errors
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.units import in_mm
from studies.layouts import ERRORS, error_cells
from studies.measured.fit_data import noise_of
from studies.measured.used_frames import GRID, find_used_frames
from studies.prediction.evaluate import errors_of
from studies.prediction.forward_model import sensed_model
from studies.prediction.stability import CURLS, TILTS, Branches, branches_of
from studies.report import page

DATA = Path(str(files("fabdesign") / "data"))
SET = "demo_set"
MODEL = "demo_model.toml"
MADE_BY = "python -m benchmarks.demo_model"  # the set and the model that are shipped
FAR_OFF = 2.0  # times the others' error
SHEET, CALIBRATED, EFFECTS, CORRECTED = "data sheet", "calibrated", "with effects", "and corrected"


@dataclass(frozen=True, eq=False)
class ShippedErrors:
    """The errors of each model on a measured set, means over the trials; `with effects` only where it has some."""

    measured: MeasurementSet
    shipped: Model
    errors: dict[str, Errors]  # m, by the model's name, in this order
    share_left_out: float  # of the frames
    by_trial: Mapping[str, Errors]  # m, of the whole model
    branches: Mapping[str, Branches]  # of the trials that are far off
    json_keys: ClassVar = (
        ("set", "measured.name"),
        ("trials", lambda of: len(of.measured.trials)),
        ("unjudged_share", "share_left_out"),
        ("effects", lambda of: acting_effects(of.shipped.terms)),
        ("by_trial", lambda of: {name: e.millimetres() for name, e in of.by_trial.items()}),
        ("another_branch", lambda of: {name: branch.is_nearer for name, branch in of.branches.items()}),
        ("models", lambda of: [{"name": name, **e.millimetres(), "closed": share} for name, e, share in of.rows()]),
    )

    @property
    def effects_in_words(self) -> str:
        """Return what the shipped model has besides its factors."""
        names = [name.replace("_", " ") for name in acting_effects(self.shipped.terms)]
        return f"Effects in the model: {', '.join(names)}." if names else "The model has no effects."

    @property
    def far_off(self) -> list[str]:
        """Return a sentence on each trial whose corrected motion is off by twice as much as the others': a mean hides
        it."""
        surface = {name: e.surface_rms for name, e in self.by_trial.items()}
        return [
            f"Trial {name} is off by {in_mm(surface[name]):.2f} mm, the others by {in_mm(others):.2f}. "
            + branch_in_words(self.branches[name])
            for name, others in far_off(surface).items()
        ]

    def kept(self) -> dict[str, Any]:
        """Return what `of_kept` takes: JSON, to the last bit."""
        branches = {name: {"own": one.unchanged, "others": one.others} for name, one in self.branches.items()}
        content = {"errors": self.errors, "by_trial": self.by_trial, "branches": branches}
        return {"share_left_out": self.share_left_out, **exact(content)}

    @staticmethod
    def of_kept(kept: Mapping[str, Any]) -> "ShippedErrors":
        """Return the errors of the set and the model that are shipped. Raises KeyError, TypeError or ValueError."""
        measured = read_set(DATA / SET)
        trials = {trial.name: trial for trial in measured.trials}
        return ShippedErrors(
            measured,
            read_model(DATA / MODEL),
            of_exact(dict[str, Errors], kept["errors"]),
            kept["share_left_out"],
            of_exact(dict[str, Errors], kept["by_trial"]),
            {
                name: Branches(trials[name], one["own"], of_exact(NDArray[np.float64], one["others"]))
                for name, one in kept["branches"].items()
            },
        )

    def rows(self) -> list[tuple[str, Errors, float | None]]:
        """Return each model's name, errors, and the share of the calibrated model's excess that it closes."""
        base = self.errors[CALIBRATED]
        later = (EFFECTS, CORRECTED)
        return [(name, e, closed(base, e).surface if name in later else None) for name, e in self.errors.items()]


def far_off(surface: Mapping[str, float]) -> dict[str, float]:
    """Return the trials that are off by twice as much as the others, and the others' mean. surface: m, by trial."""
    others = {name: [x for key, x in surface.items() if key != name] for name in surface}
    means = {name: float(np.mean(errors)) for name, errors in others.items() if errors}
    return {name: mean for name, mean in means.items() if surface[name] > FAR_OFF * mean}


def branch_in_words(branch: Branches) -> str:
    """Return whether a trial that is far off lies on another branch, as simulated from starts that differ a little."""
    changed = f"the frame tilted by up to {max(TILTS):g} degrees or the cloth curved by up to {max(CURLS):g} 1/m more"
    nearest = f"{in_mm(branch.nearest):.2f} mm, without the change {in_mm(branch.unchanged):.2f} mm"
    which = "It is not another stable shape (branch), as far as small changes of the start show."
    if branch.is_nearer:
        which = "It took another stable shape (branch): a small change of the start leads there."
    return f"{which} With {changed}, the model without its corrector comes to {nearest}."


def evaluate_shipped(*, forward: ForwardModel | None = None) -> ShippedErrors:
    """Return how far the data sheet and the shipped model, calibrated, with its effects, and with its corrector, are
    from the embedded trials. forward: the bare simulator, by default with the shipped model's grid."""
    measured, shipped = read_set(DATA / SET), read_model(DATA / MODEL)
    fine = coarse = forward
    if fine is None or coarse is None:
        from sim import Simulator

        fine, coarse = Simulator(shipped.points_per_side), Simulator(GRID)
    uncorrected = shipped.without(["corrector"])
    models = {SHEET: Model(points_per_side=shipped.points_per_side)}
    models |= (
        {CALIBRATED: uncorrected.before, EFFECTS: uncorrected} if uncorrected.effects else {CALIBRATED: uncorrected}
    )
    models[CORRECTED] = shipped
    used = find_used_frames([(measured, measured.trials)], coarse)
    frames = {trial.name: np.flatnonzero(used.at(measured, trial)) for trial in measured.trials}
    trials = [trial for trial in measured.trials if len(frames[trial.name])]
    noise = noise_of(measured.trials)
    each = {name: _each(trials, frames, noise, sensed_model(fine, model)) for name, model in models.items()}
    by_trial = {trial.name: errors for trial, errors in zip(trials, each[CORRECTED], strict=True)}
    means = {name: mean_errors(errors) for name, errors in each.items()}
    far = far_off({name: e.surface_rms for name, e in by_trial.items()})
    other = branches_of([t for t in trials if t.name in far], sensed_model(fine, uncorrected))
    return ShippedErrors(
        measured, shipped, means, used.share_left_out, by_trial, {branch.trial.name: branch for branch in other}
    )


def _each(
    trials: Sequence[Trial], frames: Mapping[str, NDArray[np.intp]], noise: SensorNoise, model: Predictor
) -> list[Errors]:
    """Return the mean errors over the used `frames` of each trial; each is simulated once, and its errors are those of
    `evaluate`."""
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    motions = model.motions(cases, [trial.times for trial in trials])
    each = []
    for trial, motion in zip(trials, motions, strict=True):
        clouds, kept = trial.load().frames, frames[trial.name]
        each += errors_of(trial, [clouds[k] for k in kept], [motion[kept]], noise)
    return each


def as_text(shipped: ShippedErrors) -> str:
    """Return a table for people; mm."""
    lines = [
        f"measured: {shipped.measured.description}",
        f"{'mm':16}{'Chamfer':>9}{'floor':>8}{'surface RMS':>13}{'floor':>8}{'removed*':>10}",
    ]
    for name, e, share in shipped.rows():
        shown = "" if share is None else f"{share:.0%}"
        lines.append(
            f"{name:16}{in_mm(e.chamfer):9.2f}{in_mm(e.chamfer_floor):8.2f}{in_mm(e.surface_rms):13.2f}"
            f"{in_mm(e.surface_floor):8.2f}{shown:>10}"
        )
    lines.append(f"* share of the excess error (surface RMS over its floor) of {CALIBRATED} that is removed")
    return "\n".join([*lines, *shipped.far_off, shipped.effects_in_words])


def as_blocks(shipped: ShippedErrors) -> list[page.Block]:
    """Return what comes below the searches on the demo's page."""
    rows = [
        (name, *error_cells(e, wished=False), "" if share is None else f"{share:.0%}")
        for name, e, share in shipped.rows()
    ]
    made = (
        f"The model is shipped as <code>fabdesign/data/{MODEL}</code>. It was made by <code>{MADE_BY}</code> from other"
    )
    return [
        page.Title("What measured trials say about the model"),
        page.Text(f"{shipped.measured.description}. Nothing was fitted to them or learned from them."),
        page.TableBlock(("model", *ERRORS, "removed of the\ncalibrated model's excess"), rows),
        *(page.Text(line) for line in (*shipped.far_off, shipped.effects_in_words)),
        page.Text(Markup(f"{made} trials of the same synthetic rig."), "quiet"),
    ]
