"""Analysis of a residual: where on the cloth and when it is largest, and what it follows; and surface errors of used
frames, before and after: of the trials fitted, and once of those of role test."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.geometry.metrics import statistics
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.trial import Trial
from optimize.fit.clouds import evenly, places_on_cloth
from optimize.fit.fitted import Fit
from studies.measured.fit_data import MeasuredData
from studies.model_selection.black_box import (
    RIDGES,
    Frames,
    Residuals,
    frames_at,
    grid_of,
    lagged,
    set_points_of,
    standardised,
)
from studies.prediction.evaluate import errors_of
from studies.prediction.evaluation_report import TrialResult

CELLS = 10  # of the map of the cloth, a side
_FOLLOWED = 0.05  # share of its mean square that a feature must take of held-out trials to be named


@dataclass(frozen=True, eq=False)
class Remains:
    """The analysis of a residual. cells: (CELLS, CELLS) m RMS over the cloth, by rising v, then u; NaN where no point
    is. over_time: s and m RMS of frames, by trial. where: (u, v) m of the largest; when: s of the worst half second.
    follows: what it goes with, None where with nothing. drift: m RMS by which it changes from the first trial fitted to
    the last, as far as it goes with the place in the session and the use so far."""

    cells: Array
    over_time: dict[str, tuple[Array, Array]]
    where: tuple[float, float]
    when: float
    follows: str | None
    shares: dict[str, float]
    drift: float


def remains(state: Residuals, folds: Sequence[int]) -> Remains:
    """Return the analysis of the residual of a state."""
    u, v = ((1 + place) / 2 for place in places_on_cloth(state.misfit)[:2])
    kept, squared = state.kept, np.square(state.residual)
    cell = np.minimum((v * CELLS).astype(int), CELLS - 1) * CELLS + np.minimum((u * CELLS).astype(int), CELLS - 1)
    counts = np.bincount(cell[kept], minlength=CELLS**2)
    sums = np.bincount(cell[kept], squared[kept], minlength=CELLS**2)
    cells = np.sqrt(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)).reshape(CELLS, CELLS)
    worst = int(np.nanargmax(cells))
    fabric = state.samples[0].trial.design.fabric
    where = ((worst % CELLS + 0.5) / CELLS * fabric.width, (worst // CELLS + 0.5) / CELLS * fabric.height)
    over_time: dict[str, tuple[Array, Array]] = {}
    all_times, all_squares = [], []
    for s, sample in enumerate(state.samples):
        rows = kept & (state.misfit.sample == s)
        frame = state.misfit.frame[rows]
        count = np.maximum(np.bincount(frame, minlength=len(sample.times)), 1)
        squares = np.bincount(frame, squared[rows], minlength=len(sample.times)) / count
        over_time[sample.trial.name] = (sample.times, np.sqrt(squares))
        all_times.append(sample.times)
        all_squares.append(squares)
    times, squares = np.concatenate(all_times), np.concatenate(all_squares)
    blocks = (times / 0.5).astype(int)
    means = np.bincount(blocks, squares) / np.maximum(np.bincount(blocks), 1)
    shares, drift = _follows(state, folds)
    best = max(shares, key=lambda name: shares[name])
    follows = best if shares[best] > _FOLLOWED else None
    return Remains(cells, over_time, where, float(0.5 * means.argmax() + 0.25), follows, shares, drift)


def _follows(state: Residuals, folds: Sequence[int]) -> tuple[dict[str, float], float]:
    """Return the share of the residual's shapes, of trials left out, that each kind of feature predicts, linearly; and
    m RMS of what the session changes in them."""
    frames = frames_at(state)
    fold = np.asarray(folds)[frames.trial]
    kinds = _kinds(state, frames)
    total = float(np.square(frames.shapes).sum())
    place = _unexplained(np.zeros((len(fold), 0)), frames, fold)
    shares = {"place": 1 - place / total}
    for name, table in kinds.items():
        shares[name] = 1 - _unexplained(table, frames, fold) / total - max(shares["place"], 0.0)
    return shares, _drift(state.session[frames.trial, 0], kinds["pressure"].sum(axis=1), frames)


def _drift(place: Array, pressure: Array, frames: Frames) -> float:
    """Return m RMS that the place in the session (F,) makes of the shapes from the first trial to the last, alone and
    times the sum of the pressures (F,), by least squares with both."""
    extent = float(np.ptp(place))
    place = (place - place.mean()) / max(extent, 1e-9)
    moved = np.column_stack([np.ones(len(place)), pressure])
    table = np.concatenate([moved, moved * place[:, None]], axis=1)
    steps = np.linalg.lstsq(table, frames.shapes, rcond=1e-3)[0]
    changes = moved @ steps[moved.shape[1] :]
    return float(np.sqrt(np.square(changes).sum(axis=1).mean())) if extent else 0.0


def _kinds(state: Residuals, frames: Frames) -> dict[str, Array]:
    channels = max(s.trial.program.pressure.shape[1] for s in state.samples)
    parts: dict[str, list[Array]] = {name: [] for name in ("pressure", "rate", "history", "time", "pose")}
    for sample, sheet in zip(state.samples, state.sheets, strict=True):
        times, (grid, places) = sample.times, grid_of(sample)
        set_points, path = (set_points_of(sample, at, channels) for at in (times, grid))
        slow, fast = (lagged(path, tau)[places] for tau in (1.0, 0.15))
        middle = sheet.middle.reshape(len(times), -1, 3)[:, ::40]
        parts["pressure"].append(set_points)
        parts["rate"].append(fast - set_points)
        parts["history"].append(slow - set_points)
        parts["time"].append(np.stack([times, np.sqrt(times)], axis=1))
        parts["pose"].append(np.nan_to_num(np.asarray(middle, dtype=float).reshape(len(times), -1)))
    joined = {name: np.concatenate(rows) for name, rows in parts.items()}
    session = state.session[frames.trial]
    joined["order"] = np.concatenate([session, session[:, :1] * joined["pressure"]], axis=1)
    pose = joined["pose"] - joined["pose"].mean(axis=0)
    u, s, _ = np.linalg.svd(pose, full_matrices=False)
    joined["pose"] = (u * s)[:, :4]
    return joined


def _unexplained(table: Array, frames: Frames, fold: Indices) -> float:
    """Return the squares left of the shapes of held-out folds, m^2, by ridge regression with a constant, at best."""
    table = np.column_stack([np.ones(len(fold)), standardised(table)])
    best = np.inf
    for ridge in RIDGES:
        remaining = 0.0
        for out in np.unique(fold):
            a, b = table[fold != out], frames.shapes[fold != out]
            steps = np.linalg.solve(a.T @ a + len(a) * ridge * 0.1 * np.eye(a.shape[1]), a.T @ b)
            remaining += float(np.square(frames.shapes[fold == out] - table[fold == out] @ steps).sum())
        best = min(best, remaining)
    return best


FRAMES = 20  # of a trial


def errors_of_trials(
    data: MeasuredData, trials: Sequence[Trial], forward: ForwardModel, before: Fit, after: Fit
) -> list[TrialResult]:
    """Return the errors of every trial that has a used frame, in FRAMES of these."""
    measured, frames = data.sets[0], list[tuple[Trial, Indices]]()
    for trial in trials:
        if len(usable := np.flatnonzero(data.used.at(measured, trial))):
            frames.append((trial, usable[evenly(len(usable), FRAMES)]))
    fits = dict.fromkeys((before, after))  # one where nothing was added
    cases = [fit.vector.case(trial, fit.x) for fit in fits for trial, _ in frames]
    motions = forward.motions(cases, [trial.times[kept] for trial, kept in frames] * len(fits))
    results = []
    for k, (trial, kept) in enumerate(frames):
        clouds = trial.load().frames
        each = errors_of(trial, [clouds[f] for f in kept.tolist()], motions[k :: len(frames)], data.noise)
        about = measured.name, trial.name, trial.design.name, trial.order, trial.role
        results.append(TrialResult(*about, each[0], each[-1]))
    return results


def mean_of(errors: Sequence[TrialResult], role: str, which: str, error: str = "surface_rms") -> float | None:
    """Return the mean over trials of a role, m; None where there is none."""
    pairs = [getattr(e, which) for e in errors if e.role == role]
    finite = [e for e in pairs if np.isfinite(e.surface_rms)]
    return statistics(finite)[error].mean if finite else None


def other_layouts(errors: Sequence[TrialResult]) -> dict[str, list[TrialResult]]:
    """Return the errors by design, of the designs of which no trial was fitted."""
    fitted = {e.design for e in errors if e.role == "fit"}
    names = dict.fromkeys(e.design for e in errors if e.design not in fitted)
    return {name: [e for e in errors if e.design == name] for name in names}
