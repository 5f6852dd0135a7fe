"""What the demo's measured set says about its model: calibrated, traced, corrected, on trials that took no part."""

from collections.abc import Callable
from dataclasses import astuple, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.forward import ForwardModel
from fabdesign.measurement_set import read_set
from fabdesign.metrics import Errors, closed
from fabdesign.model_file import read_model
from fabdesign.trial import MeasurementSet
from studies.evaluate import Evaluation, evaluate_sets
from studies.tracing.outcome import Outcome
from studies.tracing.run import trace_set
from studies.tracing.words import verdict_in_words

SET = "demo_set"
MODEL = "demo_model.toml"
MADE_BY = "python -m benchmarks.demo_model"  # the set and the model that are shipped
SHEET, CALIBRATED, TRACED, CORRECTED = "data sheet", "calibrated", "with what a trace adds", "with a trained corrector"


@dataclass(frozen=True, eq=False)
class Judged:
    """Of a measured set: the trace, and each model's errors, means over the trials held out."""

    measured: MeasurementSet
    outcome: Outcome
    errors: dict[str, Errors]  # m, by the model's name, in this order

    @property
    def said(self) -> str:
        return verdict_in_words(self.outcome)

    @property
    def trials(self) -> int:
        """Held out."""
        return sum(trial.role == "test" for trial in self.measured.trials)

    def rows(self) -> list[tuple[str, Errors, float | None]]:
        """Each model's name, errors, and the share of the calibrated model's excess that it closes."""
        base = self.errors[CALIBRATED]
        later = (TRACED, CORRECTED)
        return [(name, e, closed(base, e).surface if name in later else None) for name, e in self.errors.items()]

    def as_json(self) -> dict[str, Any]:
        """mm."""
        names = ("chamfer", "chamfer_floor", "surface_rms", "surface_floor")
        return {
            "set": self.measured.name,
            "held_out_trials": self.trials,
            "verdict": self.outcome.verdict,
            "effects": [effect.name for effect in self.outcome.effects],
            "said": self.said,
            "models": [
                {"name": name, **{key: 1e3 * getattr(errors, key) for key in names}, "closed": share}
                for name, errors, share in self.rows()
            ],
        }


def judge_model(
    out: Path,
    *,
    forward: ForwardModel | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Judged:
    """Trace the embedded set into `out` (`trace.json`, `model.toml`, `report.html`), and say how far the data sheet,
    the calibrated, the traced and the shipped corrected model are from the trials of role `test`.

    forward: the bare simulator of the trace, by default with 21 points a side; the errors are taken with the shipped
    model's grid, or with `forward`. The same call goes on after a kill.
    """
    data = Path(str(files("fabdesign") / "data"))
    measured, shipped = read_set(data / SET), read_model(data / MODEL)
    outcome = trace_set(measured, out, inputs=[data / SET], forward=forward, say=say)
    if forward is None:
        from sim import Simulator

        forward = Simulator(shipped.points_per_side)
    say("how far each model is from the trials held out")
    calibrated = outcome.model.before if outcome.model.effects else outcome.model
    plain, traced, corrected = (evaluate_sets(m, [measured], forward) for m in (calibrated, outcome.model, shipped))
    errors = {
        SHEET: _mean(plain, after=False),
        CALIBRATED: _mean(plain, after=True),
        TRACED: _mean(traced, after=True),
        CORRECTED: _mean(corrected, after=True),
    }
    return Judged(measured, outcome, errors)


def _mean(evaluation: Evaluation, *, after: bool) -> Errors:
    trials = [t.after if after else t.before for design in evaluation.designs.values() for t in design.trials]
    return Errors(*np.mean([astuple(errors) for errors in trials], axis=0).tolist())


def as_text(judged: Judged) -> str:
    """A table for people; mm."""
    lines = [
        f"measured set: {judged.measured.description}; {judged.trials} trials held out",
        f"{'mm':26}{'Chamfer':>9}{'floor':>8}{'surface RMS':>13}{'floor':>8}{'closed':>9}",
    ]
    for name, e, share in judged.rows():
        told = "" if share is None else f"{share:.0%}"
        values = (e.chamfer, e.chamfer_floor)
        lines.append(
            f"{name:26}{1e3 * values[0]:9.2f}{1e3 * values[1]:8.2f}{1e3 * e.surface_rms:13.2f}"
            f"{1e3 * e.surface_floor:8.2f}{told:>9}"
        )
    return "\n".join([*lines, judged.said])
