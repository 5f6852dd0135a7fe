"""The outcome of an evaluation: errors per trial and per design, and its folder, numbers, tables and a picture."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from fabdesign.formats.csv_table import write_rows
from fabdesign.formats.json_file import plain, write_json
from fabdesign.formats.result_tables import Columns, Tabled, by_name
from fabdesign.formats.schema import MM, Key
from fabdesign.geometry.metrics import Closed, Errors, Statistics, beyond_in_words
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.output import new_folder
from fabdesign.units import in_mm
from studies.intervals.calibrate import IntervalScore
from studies.measured.used_frames import UsedFrames

_LEAST_BARS = 12  # trials, of which a histogram says less than their values
_UNORDERED = "no order, no surface"  # of a model's points
ERRORS = ("chamfer", "chamfer_floor", "surface_rms", "surface_floor")
_STATES = ("before", "after")
_INTERVALS = ("interval_inside", "interval_width", "interval_crps")
ERROR_NAMES = {"chamfer": "Chamfer distance", "surface_rms": "surface RMS"}  # for people


@dataclass(frozen=True)
class TrialResult:
    """Errors of one trial's used frames, m; NaN where the motion diverged, or no frame is used."""

    set_name: str
    trial: str
    design: str
    order: int
    role: str
    before: Errors
    after: Errors
    used: float = 1.0  # share of its frames
    intervals: IntervalScore | None = None  # of the model's 90 % intervals; None: it has none
    json_keys: ClassVar = "before", "after", "intervals"


@dataclass(frozen=True)
class DesignResult:
    """The trials of one design; the statistics leave out trials that diverged or have no frame that is used."""

    source: str  # name and description of the set
    noise: SensorNoise
    trials: tuple[TrialResult, ...]
    before: Mapping[str, Statistics]
    after: Mapping[str, Statistics]
    closed: Closed
    json_keys: ClassVar = (
        ("before", lambda of: _millimetres(of.before)), ("after", lambda of: _millimetres(of.after)), "closed",
        ("noise.sigma_mm", "noise.sigma"), ("noise.strays", "noise.strays"),
        ("histogram", lambda of: {error: histogram(of, error) for error in ERROR_NAMES}), "source", "intervals",
        ("trials", lambda of: {trial.trial: trial for trial in of.trials}),
        "diverged", ("without_judged_frame", "without_frames"),
    )  # fmt: skip

    @property
    def intervals(self) -> IntervalScore | None:
        """Return the score of all trials' frames and regions together."""
        return IntervalScore.pooled([t.intervals for t in self.trials if t.intervals is not None])

    @property
    def diverged(self) -> list[str]:
        lost = (t for t in self.trials if np.isnan(t.before.chamfer) or np.isnan(t.after.chamfer))
        return [t.trial for t in lost if t.used]

    @property
    def without_frames(self) -> list[str]:
        """Return trials of which no frame is used."""
        return [t.trial for t in self.trials if not t.used]


def _millimetres(table: Mapping[str, Statistics]) -> dict[str, Any]:
    return plain({name: table[name] for name in ERRORS}, MM) | {"surface_beyond": table["beyond"]}


@dataclass(frozen=True)
class SetEvaluation(Tabled):
    """designs: trials of role `test`; others: the rest, where they were asked for. skipped: bad trials left out, a line
    each."""

    designs: Mapping[str, DesignResult]
    used: Annotated[UsedFrames, Key(inside=True)]
    others: Annotated[Mapping[str, DesignResult], Key(brief=True)] = field(default_factory=dict)
    # parameters of the model whose intervals its fit calls not reliable
    unreliable: Annotated[tuple[str, ...], Key(brief=True)] = ()
    skipped: tuple[str, ...] = ()
    metric: str = "chamfer, surface_rms"
    unit: str = "mm"
    json_keys: ClassVar = "designs", "others", "unreliable", "used", "metric", "unit"

    @property
    def rows(self) -> list[tuple[str, TrialResult]]:
        """Return every trial, with the name of its table."""
        tables = (*self.designs.items(), *self.others.items())
        return [(name, trial) for name, table in tables for trial in table.trials]

    def columns(self) -> Columns:
        """Return a row a trial: design, set, trial, order, role, share of frames used, and errors before and after
        [mm]."""
        return by_name([_row(name, trial) for name, trial in self.rows])


def _row(name: str, trial: TrialResult) -> dict[str, Any]:
    row = {"design": name, "set": trial.set_name, "trial": trial.trial, "order": trial.order, "role": trial.role}
    row |= {"judged": trial.used} | {
        f"{error}_{when}": in_mm(getattr(getattr(trial, when), error)) for when in _STATES for error in ERRORS
    }
    return row | dict(zip(_INTERVALS, trial.intervals.shown if trial.intervals else (), strict=False))


def histogram(design: DesignResult, error: str) -> dict[str, list[float]]:
    """Return trials per bin of one error: `edges` in mm, counts `before` and `after`."""
    pairs = np.array([(getattr(r.before, error), getattr(r.after, error)) for r in design.trials])
    before, after = in_mm(pairs[np.isfinite(pairs).all(axis=1)]).T  # of those that did not diverge
    edges = np.histogram_bin_edges(np.concatenate([before, after]), bins=12)
    counts = {state: np.histogram(x, edges)[0].tolist() for state, x in (("before", before), ("after", after))}
    return {"edges": edges.tolist()} | counts


def write_evaluation(evaluation: SetEvaluation, out: Path) -> None:
    """Write `evaluation.json`, `trials.csv`, `evaluation.md` and `histogram.png` into the folder `out`, all or none."""
    with new_folder(out, made_by="evaluate") as unfinished:
        write_json(unfinished / "evaluation.json", evaluation)
        (unfinished / "evaluation.md").write_text(tables_markdown(evaluation), encoding="utf-8")
        _write_trials(evaluation, unfinished / "trials.csv")
        write_histogram(evaluation, unfinished / "histogram.png")


def tables_markdown(evaluation: SetEvaluation) -> str:
    """Return both tables for people: mm, mean (min to max, std) over trials."""
    used = evaluation.used.in_words
    parts = [
        "Errors in mm, mean over trials; of several trials with (min to max, standard deviation). Chamfer: unsquared, "
        "both directions summed. Surface RMS: measured points to the model's faces, capped at 10 mm. Floor: the "
        "smallest value that noise and sampling allow. Removed: share of the excess error over the floor that the "
        "model removes; models are compared by the value with * (surface RMS, in quadrature).\n",
        f"{used[0].upper()}{used[1:]}.\n",
    ]
    if evaluation.unreliable:
        names = ", ".join(evaluation.unreliable)
        parts.append(f"Warning: the model's intervals of {names} are not reliable, as its calibration said.\n")
    for heading, table in (("Trials of role test", evaluation.designs), ("Other trials", evaluation.others)):
        if table:
            parts.append(f"## {heading}\n\n| design | trials | error | floor | before | after | removed |")
            parts.append("|---|---|---|---|---|---|---|")
        for name, design in table.items():
            sound = len(design.trials) - len(design.diverged) - len(design.without_frames)
            of_chamfer = "chamfer", "chamfer_floor", design.closed.chamfer, ""
            for error, floor, share, mark in (
                of_chamfer,
                ("surface_rms", "surface_floor", design.closed.surface, " *"),
            ):
                parts.append(
                    f"| {name} | {len(design.trials)} | {error} | {_shown(design.after[floor], 1)} "
                    f"| {_shown(design.before[error], sound)} | {_shown(design.after[error], sound)} "
                    f"| {_closed(share) if np.isfinite(design.after[error].mean) else _UNORDERED}{mark} |"
                )
        parts.append("")
        parts += [
            f"{name}: {design.source}; noise {in_mm(design.noise.sigma):.2f} mm an axis, "
            + f"{design.noise.strays:.1%} strays"
            + (f"; diverged and left out: {', '.join(design.diverged)}" if design.diverged else "")
            + (f"; no frame used: {', '.join(design.without_frames)}" if design.without_frames else "")
            for name, design in table.items()
        ]
        for name, design in table.items():
            states = {"before": design.before["beyond"].mean, "after": design.after["beyond"].mean}
            beyond = [f"{when}, {beyond_in_words(share)}" for when, share in states.items() if np.isfinite(share)]
            parts.append(f"{name}: {'; '.join(beyond)}")
        parts += [_intervals(name, design.intervals) for name, design in table.items() if design.intervals]
        parts.append("")
    return "\n".join(parts).rstrip() + "\n"


def _intervals(name: str, score: IntervalScore) -> str:
    return (
        f"{name}: 90 % intervals hold {score.inside:.0%} of the regions' heights at every sixth frame; mean width "
        f"{in_mm(score.width):.2f} mm, CRPS {in_mm(score.crps):.3f} mm"
    )


def _closed(share: float | None) -> str:
    if share is None:
        return "no excess"
    return f"{share:.0%}" if share > -0.005 else f"the excess grew by {-share:.0%}"


def _shown(values: Statistics, trials: int) -> str:
    if not np.isfinite(values.mean):
        return _UNORDERED
    mean, most, least, std = (in_mm(x) for x in (values.mean, values.max, values.min, values.std))
    if trials == 1:
        return f"{mean:.2f}"
    return f"{mean:.2f} ({least:.2f} to {most:.2f}, {std:.2f})"


def _write_trials(evaluation: SetEvaluation, path: Path) -> None:
    errors = [f"{name}_{state}" for state in _STATES for name in ERRORS]
    header = ["set", "design", "trial", "order", "role", *(f"{name}_mm" for name in errors)]
    header += ["surface_beyond_before", "surface_beyond_after", "judged"]
    header += ["interval_inside", "interval_width_mm", "interval_crps_mm"]
    rows = []
    for name, r in evaluation.rows:
        row = _row(name, r) | {"before": r.before.beyond, "after": r.after.beyond}
        numbers = [row.get(key) for key in (*errors, "before", "after", "judged", *_INTERVALS)]
        shown = ["" if x is None else f"{x:.6g}" for x in numbers]
        rows.append([r.set_name, name, r.trial, r.order, r.role, *shown])
    write_rows(path, header, rows)


def write_histogram(evaluation: SetEvaluation, path: Path) -> None:
    from matplotlib.figure import Figure

    panels = [("test", *item) for item in evaluation.designs.items()]
    panels += [("other", *item) for item in evaluation.others.items()]
    figure = Figure(figsize=(9, 2.6 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 2, squeeze=False)
    for row, (kind, name, design) in zip(axes, panels, strict=True):
        for axis, error, floor in zip(row, ("chamfer", "surface_rms"), ("chamfer_floor", "surface_floor"), strict=True):
            draw_distribution(axis, design, error)
            axis.axvline(in_mm(design.after[floor].mean), color="black", linestyle="--", label="noise floor")
            axis.set(xlabel=f"{ERROR_NAMES[error]}, mm", title=f"{name}, {kind} trials")
            axis.legend(fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
    figure.suptitle("; ".join(sorted({design.source for *_, design in panels})), fontsize="small")
    figure.savefig(path, dpi=120)


def draw_distribution(axis: Any, design: DesignResult, error: str) -> None:
    """Draw the errors before and after: a mark a trial of a few, else how many trials have which error."""
    states = {"before": "tab:gray", "after": "tab:blue"}
    if len(design.trials) < _LEAST_BARS:
        for row, (state, colour) in enumerate(states.items()):
            values = [in_mm(getattr(getattr(trial, state), error)) for trial in design.trials]
            axis.plot(values, np.full(len(values), row), "o", color=colour, alpha=0.7, label=state)
        axis.set(yticks=[0, 1], yticklabels=[*states], ylim=(1.6, -0.6))
        return
    draw_bars(axis, histogram(design, error), states)


def draw_bars(axis: Any, shown: Mapping[str, Any], colours: Mapping[str, str]) -> None:
    """Draw a `histogram`, each state in its colour."""
    for state, colour in colours.items():
        axis.stairs(shown[state], shown["edges"], fill=True, alpha=0.6, color=colour, label=state)
    axis.set_ylabel("trials")
    axis.yaxis.get_major_locator().set_params(integer=True)
