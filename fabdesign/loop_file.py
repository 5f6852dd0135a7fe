"""Study files of kind "loop": a target, a start design, and where measurements come from."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fabdesign.effort import COARSEST, FINEST, LONGEST
from fabdesign.errors import InputError
from fabdesign.model import POINTS_PER_SIDE
from fabdesign.pages import PAPERS
from fabdesign.rig_limits_file import RigLimits, read_rig_limits
from fabdesign.study_file import FORMAT, Study, read_search, require_kind, require_searchable
from fabdesign.table import Table, load_toml
from fabdesign.units import from_mm, in_kpa, in_mm

HOLD = 2.0  # s, for which the pressures of a shape at rest are held on the device
TRACE_GRID = 21  # points a side: a trace asks for hundreds of motions
LEAST_TRIALS = 3  # to calibrate and trace on, beside those held out


@dataclass(frozen=True)
class VirtualRig:
    """Measures by `fabdesign rig`. truth: the ground truth of the specimens, which only the rig reads. element, step: m
    and s of its mesh and time steps; None: the rig's own."""

    truth: Path | None
    element: float | None = None
    step: float | None = None


@dataclass(frozen=True)
class Laboratory:
    """Puts a measurement set into `folder`/turn_K when asked. tail_length [m], paper: as `export` takes them."""

    folder: Path
    tail_length: float | None = None
    paper: str | None = "a4"


@dataclass(frozen=True)
class Trials:
    """What is run on a design beside its own pressures: `number` programs of `seconds` s each, the last `held_out` of
    them with role test."""

    number: int = 4
    seconds: float = 1.5
    held_out: int = 1


@dataclass(frozen=True)
class Learning:
    """What becomes of a turn's measurements. tolerance: m of excess, of the trace. train: the corrector's network,
    where there are `train_trials` of role fit."""

    trace: bool = True
    tolerance: float = 0.5e-3
    trace_grid: int = TRACE_GRID
    train: Literal["field", "paper"] | None = None
    train_trials: int = 20


@dataclass(frozen=True)
class StopRule:
    """The loop ends after `turns` turns beyond the first design, within `excess` [m] of the target on the device, and
    where a turn takes off less than the share `gain` of the least excess before."""

    turns: int = 2
    excess: float = 0.5e-3
    gain: float = 0.1


@dataclass(frozen=True, eq=False)
class LoopStudy:
    """search: the choice of every turn; its model is what is known at first."""

    search: Study
    source: VirtualRig | Laboratory
    rig_limits: RigLimits
    trials: Trials = Trials()
    learning: Learning = Learning()
    stop: StopRule = StopRule()
    points_per_side: int = POINTS_PER_SIDE

    @property
    def highest(self) -> float:
        """Pa, of any set point."""
        return min(self.search.limits.pressure[1], self.rig_limits.pressure)


def read_loop(path: Path | str) -> LoopStudy:
    """Read a study of kind "loop". Keys: docs/files.md. Raises InputError."""
    path = Path(path)
    root = load_toml(path, FORMAT, partial=True)
    require_kind(root, "loop")
    rig = read_rig_limits(root, path, pressure=np.inf, duration=LONGEST)
    source, trials, learning, stop = _source(root, path), _trials(root), _learning(root), _stop(root)
    points_per_side = root.integer("points_per_side", POINTS_PER_SIDE, least=COARSEST, most=FINEST)
    held = "hold" in root
    search = read_search(root, path)
    require_searchable(search, str(path))
    study = LoopStudy(_within(search, rig, path), source, rig, trials, learning, stop, points_per_side)
    if not held:
        study = replace(study, search=replace(study.search, hold=HOLD))
    _require_runnable(study, path)
    return study


def _within(search: Study, rig: RigLimits, path: Path) -> Study:
    """The search within what the rig can do: no higher pressure, no faster rise."""
    low, high = search.limits.pressure
    high = min(high, rig.pressure)
    if low >= high:
        raise InputError(
            f"{path}: limits: pressure from {in_kpa(low):g} kPa; expected less than the rig's {in_kpa(high):g} kPa"
        )
    limits = replace(search.limits, pressure=(low, high))
    return replace(search, limits=limits, rise=max(search.rise, high / rig.rate))


def _require_runnable(study: LoopStudy, path: Path) -> None:
    rig, search = study.rig_limits, study.search
    longest = max(search.rise + search.hold, study.trials.seconds)
    if longest > rig.duration:
        raise InputError(
            f"{path}: rig_limits: duration = {rig.duration:g}; a rise of {search.rise:g} s with its hold and the "
            f"trials take up to {longest:g} s"
        )
    most = search.design.channels if search.muscles is None else search.muscles.most
    if rig.channels is not None and most > rig.channels:
        raise InputError(f"{path}: up to {most} muscles; the rig has {rig.channels} channels")
    if isinstance(study.source, Laboratory) and study.source.tail_length is None:
        for name, kind in search.design.muscle_types.items():
            if kind.tail_length is None:
                raise InputError(
                    f"{path}: laboratory: muscle type {name} has no tail_length; expected one there, in m, for the cut "
                    "list"
                )


def _source(root: Table, path: Path) -> VirtualRig | Laboratory:
    rig, laboratory = root.table("rig", None), root.table("laboratory", None)
    if (rig is None) == (laboratory is None):
        raise InputError(f"{path}: expected one source of measurements, [rig] or [laboratory]")
    if rig is not None:
        key = rig.path("key", path.parent) if "key" in rig else None
        source = VirtualRig(
            truth=key,
            element=rig.number("element", None, least=0.002, most=0.05),
            step=rig.number("step", None, least=1e-4, most=0.01),
        )
        rig.finish()
        if source.truth is not None and not source.truth.is_file():
            raise InputError(f"{rig.where}: the ground truth {source.truth} is not there")
        return source
    assert laboratory is not None
    paper = laboratory.text("paper", "a4", choices=(*PAPERS, "none"))
    asked = Laboratory(
        folder=laboratory.path("folder", path.parent),
        tail_length=laboratory.number("tail_length", None, least=0, most=1),
        paper=None if paper == "none" else paper,
    )
    laboratory.finish()
    return asked


def _trials(root: Table) -> Trials:
    table, default = root.table("trials", None) or Table({}, ""), Trials()
    held_out = table.integer("held_out", default.held_out, least=0)
    trials = Trials(
        number=table.integer("number", max(default.number, LEAST_TRIALS + held_out), least=0, most=100),
        seconds=table.number("seconds", default.seconds, least=0.2, most=60),
        held_out=held_out,
    )
    if trials.number < LEAST_TRIALS - 1 + held_out:  # a shape's own rise is a trial too
        raise InputError(
            f"{root.where}: trials: number = {trials.number}, held_out = {held_out}; expected {LEAST_TRIALS - 1} more "
            "than are held out, to calibrate on"
        )
    table.finish()
    return trials


TRAINED: tuple[Literal["field", "paper"], ...] = ("field", "paper")


def _learning(root: Table) -> Learning:
    table, default = root.table("learning", None) or Table({}, ""), Learning()
    learning = Learning(
        trace=table.flag("trace", default.trace),
        tolerance=from_mm(table.number("tolerance", in_mm(default.tolerance), above=0)),
        trace_grid=table.integer("trace_grid", default.trace_grid, least=COARSEST, most=FINEST),
        train=table.text("train", None, choices=TRAINED),
        train_trials=table.integer("train_trials", default.train_trials, least=2),
    )
    table.finish()
    return learning


def _stop(root: Table) -> StopRule:
    table, default = root.table("stop", None) or Table({}, ""), StopRule()
    rule = StopRule(
        turns=table.integer("turns", default.turns, least=0, most=100),
        excess=from_mm(table.number("excess", in_mm(default.excess), least=0)),
        gain=table.number("gain", default.gain, least=-10, most=1),
    )
    table.finish()
    return rule
