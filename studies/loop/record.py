"""The record of a loop so far: its pieces, by which it goes on, and `result.json`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np

from fabdesign.formats.json_file import plain
from fabdesign.runtime.fingerprint import content_of, sha256
from fabdesign.study_files.loop_file import LoopStudy, StopRule, VirtualRig
from fabdesign.units import in_mm
from fabdesign.version import SIMULATOR
from studies.layout_search.target import LoadedTarget
from studies.layouts.kept_result import study_content

_RAISED = ("stop", "search")  # more turns go further; the search's own content has its own way


class ShapeErrors(TypedDict):
    """The errors of a shape beside the targets, mm; surface_beyond: the share of the points farther off than the
    cap."""

    chamfer: float
    chamfer_floor: float
    surface_rms: float
    surface_floor: float
    surface_beyond: float
    excess: float


class DeviceErrors(ShapeErrors):
    """from_believed: mm RMS of the measured from the predicted shape."""

    from_believed: float


class ChosenDesign(TypedDict):
    """The design that a search chose; believed: the errors that it predicts."""

    believed: ShapeErrors
    stop_reason: str
    evaluations: int
    reach: list[str]
    muscles: int


class TracedEffects(TypedDict):
    """The verdict of a trace. excess: mm over the noise, by what it is of; None where it is not known."""

    verdict: str
    effects: list[str]
    indistinguishable: list[list[str]]
    excess: dict[str, float | None]


class Learned(TypedDict):
    """The gain from a turn's measurements. said: lines for people. trace: None where it was not asked for or could not
    be. held_out: mm of surface excess `before` and `after` on trials of role test, None without any."""

    said: list[str]
    trace: TracedEffects | None
    factors: Mapping[str, float]
    effects: list[str]
    corrector: bool
    held_out: Mapping[str, float] | None


@dataclass(frozen=True)
class Turn:
    """device: None while a measurement is waited for. learned: None in the last turn. All as `result.json` has it."""

    number: int
    name: str
    chosen: ChosenDesign
    device: DeviceErrors | None = None
    learned: Learned | None = None


@dataclass(frozen=True)
class LoopOutcome:
    """stop_reason: why the loop ended; empty while a measurement is waited for, and then `waiting_for` says where."""

    name: str
    turns: tuple[Turn, ...]
    stop_reason: str = ""
    waiting_for: str | None = None
    asked: str | None = None  # the folder that says what is to be measured
    synthetic: bool = False
    wall_s: float = 0.0
    seed: int = 1
    source: str = field(default="rig")

    @property
    def best(self) -> Turn | None:
        """The turn whose device is nearest to the target, as measured."""
        measured = [turn for turn in self.turns if turn.device is not None]
        return min(measured, key=lambda turn: turn.device["excess"] if turn.device else np.inf, default=None)

    def as_json(self) -> dict[str, Any]:
        """Return what result.json holds."""
        return plain(self) | {"unit": "mm", "best": self.best and self.best.name}


def loop_content(study: LoopStudy, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Return what the pieces depend on, by field; of a rig's ground truth its hash."""
    source = study.source
    where: dict[str, Any]
    if isinstance(source, VirtualRig):
        where = {"rig.element": source.element, "rig.step": source.step}
        where["rig.key"] = None if source.truth is None else sha256(source.truth)
    else:
        where = {"laboratory.folder": source.folder.resolve()}
    content = content_of(study, (*_RAISED, "source"), where)
    return {"simulator": str(SIMULATOR)} | content | study_content(study.search, targets)


def stop_reason(rule: StopRule, excess: Sequence[float]) -> str | None:
    """Return why the loop ends, in a sentence, by the excess [m] on the device after each turn, the first design's
    first; None: it goes on."""
    *before, now = excess
    if now <= rule.excess:
        return f"near enough: {in_mm(now):.2f} mm over the noise floor on the device, within {in_mm(rule.excess):g} mm"
    if len(before) >= rule.turns:
        return f"turns used: {rule.turns}"
    if before and now > (1 - rule.gain) * min(before):
        return (
            f"no further gain: {in_mm(now):.2f} mm over the noise floor on the device, {in_mm(min(before)):.2f} "
            f"before; a turn that gains less than {rule.gain:.0%} is the last"
        )
    return None
