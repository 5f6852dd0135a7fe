"""What a trained corrector is worth beside simple baselines, on trials that it has not seen, all on the same frames.

    python -m benchmarks.corrector SET --field M.toml [--paper P.toml] [--test DESIGN] --cache FOLDER -o TABLE.md

Rows: the data sheet, the model without its corrector, the correctors, and three baselines that need no network: the
mean residual field of the design's trials, that of the trial with the nearest pressures, and the trial's own residual
of the frame before, carried on (which needs its measurement). Residuals are heights over the simulated mid-surface,
node by node. Trials: those that the field model's file lists as held out, and those of role `test` of designs learned
from; `--test DESIGN` takes the trials of a design of role `test` alone, to be looked at once.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import commit
from corrector.examples import offsets
from corrector.load import load_corrector
from corrector.shape import FINE, LocalFrames, displaced, middle_of
from fabdesign.corrector import with_history
from fabdesign.forward import Case
from fabdesign.measurement_set import read_set
from fabdesign.metrics import Errors, closed, mean_errors, trial_errors
from fabdesign.model import Model
from fabdesign.model_file import read_model
from fabdesign.output import write_text
from fabdesign.predictor import Predictor
from fabdesign.trial import Trial
from studies.measured_data import noise_of
from studies.training.train import unordered_errors

FIRST, EVERY = 5, 3  # frames: the sixth, and every third from there on
HISTORY = tuple(k / 30 for k in range(1, 10))  # s, that both networks find theirs in
Motion = NDArray[np.float32]


class Simulated:
    """Motions of trials, kept in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def of(self, trials: Sequence[Trial], model: Model, name: str) -> dict[str, Motion]:
        """(U, 2 n, 3) m at `with_history(trial.times, HISTORY)`, by the trial's name."""
        missing = [t for t in trials if not self._file(name, t).is_file()]
        if missing:
            from sim import Simulator

            predictor = Predictor(Simulator(model.points_per_side), model, sensing=True)
            for k in range(0, len(missing), 32):
                part = missing[k : k + 32]
                cases = [Case(t.design, t.program, order=t.order) for t in part]
                wanted = [with_history(t.times, HISTORY)[0] for t in part]
                for trial, motion in zip(part, predictor.motions(cases, wanted), strict=True):
                    np.save(self._file(name, trial), motion)
        return {t.name: np.load(self._file(name, t)) for t in trials}

    def _file(self, name: str, trial: Trial) -> Path:
        return self.folder / f"{name}-{trial.name}.npy"


def frames_of(trial: Trial) -> NDArray[np.intp]:
    return np.arange(FIRST, len(trial.times), EVERY)


def residuals(trial: Trial, motion: Motion, frames: NDArray[np.intp]) -> NDArray[np.float32]:
    """(F, FINE, FINE) m over the simulated mid-surface."""
    middle = middle_of(_plain(trial, motion)[frames], 41)
    clouds, thickness = trial.load().frames, trial.design.fabric.thickness
    pairs = [offsets(m, clouds[k], thickness) for m, k in zip(middle, frames, strict=True)]
    return np.array([offset * (count > 0) for offset, count in pairs], dtype=np.float32)


def moved(trial: Trial, motion: Motion, heights: NDArray[np.float32]) -> Motion:
    """The simulated frames with their mid-surface moved by heights (F, FINE, FINE) m along its normal."""
    points, fabric = _plain(trial, motion)[frames_of(trial)], trial.design.fabric
    normal = LocalFrames.of(middle_of(points, 41), fabric.width, fabric.height, FINE).normal
    return displaced(points, heights[..., None] * normal, fabric.thickness)


def _plain(trial: Trial, motion: Motion) -> Motion:
    return motion[with_history(trial.times, HISTORY)[1][0]]


def corrected(model: Model) -> Callable[[Trial, Motion], Motion]:
    found = load_corrector(model)

    def answer(trial: Trial, motion: Motion) -> Motion:
        times = trial.times[frames_of(trial)]
        have, _ = with_history(trial.times, HISTORY)
        wanted, _ = with_history(times, found.history())
        row = np.abs(wanted[:, None] - have).argmin(axis=1)
        if np.abs(wanted - have[row]).max() > 1e-4:
            raise ValueError("trials whose frames are not 1/30 s apart")
        case = Case(trial.design, trial.program, model.factors, model.terms, trial.order)
        return found.correct([case], [times], [motion[row]])[0]

    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--field", type=Path, required=True)
    parser.add_argument("--paper", type=Path)
    parser.add_argument("--test", help="A design whose trials of role test are looked at, alone.")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    measured, field = read_set(options.set), read_model(options.field)
    base = field.without(["corrector"])
    learned_names = {name.split("/")[1] for name in field.provenance.fitted}
    held_names = {name.split("/")[1] for name in field.provenance.held_out}
    fit = [t for t in measured.trials if t.role == "fit"]
    learned = [t for t in fit if t.name in learned_names and t.name not in held_names]
    designs = {t.design_name for t in learned}
    if options.test:
        asked = [t for t in measured.trials if t.role == "test" and t.design_name == options.test]
    else:
        asked = [t for t in fit if t.name in held_names and t.name not in learned_names]
        asked += [t for t in measured.trials if t.role == "test" and t.design_name in designs]
    cache = Simulated(options.cache)
    ways: dict[str, Callable[[Trial, Motion], Motion]] = {"field": corrected(field)}
    if options.paper:
        ways["paper"] = corrected(read_model(options.paper))
    sheet = cache.of(asked, Model(points_per_side=base.points_per_side), "sheet")
    based = cache.of([*asked, *learned], base, "base")
    rows = []
    for name in sorted({t.design_name for t in asked}):
        for role in ("fit", "test"):
            trials = [t for t in asked if t.design_name == name and t.role == role]
            if trials:
                rows.append((name, role, len(trials), _table(trials, sheet, based, ways, learned)))
    text = _markdown(rows)
    write_text(options.output, text)
    print(text)


def _table(trials, sheet, based, ways, learned) -> dict[str, Errors]:  # type: ignore[no-untyped-def]
    noise = noise_of(trials)
    same = [t for t in learned if t.design_name == trials[0].design_name]
    fields = {t.name: residuals(t, based[t.name], frames_of(t)) for t in same}
    found: dict[str, list[Errors]] = {}
    for trial in trials:
        clouds = [trial.load().frames[k] for k in frames_of(trial)]
        motion, frames = based[trial.name], frames_of(trial)
        answers = {
            "data sheet": _plain(trial, sheet[trial.name])[frames],
            "without corrector": _plain(trial, motion)[frames],
        }
        answers |= {name: way(trial, motion) for name, way in ways.items()}
        if same:
            nearest = min(same, key=lambda t: float(np.abs(t.program.pressure - trial.program.pressure).sum()))
            answers["mean residual field"] = moved(trial, motion, np.mean([*fields.values()], axis=0))
            answers["nearest trial's residual"] = moved(trial, motion, fields[nearest.name])
        answers["last frame's residual"] = moved(trial, motion, residuals(trial, motion, frames - 1))
        floor = None
        for name, answer in answers.items():
            if name == "paper":
                assert floor is not None
                errors = unordered_errors(clouds, answer, floor)
            else:
                errors = trial_errors(clouds, answer, noise, seed=trial.order)
                floor = errors.chamfer_floor
            found.setdefault(name, []).append(errors)
    return {name: mean_errors(each) for name, each in found.items()}


def _markdown(rows) -> str:  # type: ignore[no-untyped-def]
    lines = [f"`python -m benchmarks.corrector`, commit {commit()}; mm, frames 6 to the end, every third.", ""]
    for name, role, count, table in rows:
        lines += [
            f"*{name}*, {count} trials {'of role test' if role == 'test' else 'held out'}:",
            "",
            "| | surface RMS | floor | closed | Chamfer | floor |",
            "|---|---|---|---|---|---|",
        ]
        for way, e in table.items():
            share = closed(table["without corrector"], e).surface
            ordered = np.isfinite(e.surface_rms)
            surface = (f"{1e3 * e.surface_rms:.2f}", f"{1e3 * e.surface_floor:.2f}") if ordered else ("", "")
            told = f"{share:.0%}" if ordered and share is not None and way != "without corrector" else ""
            lines.append(
                f"| {way} | {surface[0]} | {surface[1]} | {told} | {1e3 * e.chamfer:.2f} "
                f"| {1e3 * e.chamfer_floor:.2f} |"
            )
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
