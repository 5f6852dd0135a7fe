"""The record of a loop so far, by which it goes on; `result.json`, and the page that shows errors on the device turn by
turn beside what each search predicted."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypedDict

import numpy as np
from markupsafe import Markup

from fabdesign.files.design_file import read_design
from fabdesign.files.pressure_file import read_pressures
from fabdesign.formats.json_file import plain
from fabdesign.geometry.metrics import Errors
from fabdesign.runtime.fingerprint import content_of, sha256
from fabdesign.runtime.store import read_arrays
from fabdesign.study_files.loop_file import LoopStudy, StopRule, VirtualRig
from fabdesign.units import in_mm
from fabdesign.version import SIMULATOR, __version__
from studies.layout_search.target import LoadedTarget
from studies.layouts import study_content
from studies.report import charts, page
from studies.study import write_result

_RAISED = ("stop", "search")  # more turns go further; the search's own content has its own way


# mm beside the targets: chamfer, surface_rms, their floors, excess; surface_beyond is the share of the points farther
# off than the cap; on the device also from_believed, the RMS of the measured from the predicted shape
ShapeErrors = dict[str, float]


def shape_errors(errors: Errors, **more: float) -> ShapeErrors:
    """Return the errors as the record has them."""
    return {**plain(errors), "excess": in_mm(errors.excess), **more}


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
    indistinguishable: list[str]
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
    device: ShapeErrors | None = None
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
    source: str = "rig"
    json_keys: ClassVar = (
        "name", "turns", "stop_reason", "waiting_for", "asked", "synthetic", "wall_s", "seed", "source",
        ("unit", lambda of: "mm"), ("best", "best.name"),
    )  # fmt: skip

    @property
    def best(self) -> Turn | None:
        """Return the turn whose device is nearest to the target, as measured."""
        measured = [turn for turn in self.turns if turn.device is not None]
        return min(measured, key=lambda turn: turn.device["excess"] if turn.device else np.inf, default=None)


def loop_content(study: LoopStudy, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Return what the pieces depend on, by field; of a rig's ground truth its hash."""
    source, where = study.source, dict[str, Any]()
    if isinstance(source, VirtualRig):
        where |= {"rig.element": source.element, "rig.step": source.step}
        where["rig.key"] = None if source.truth is None else sha256(source.truth)
    else:
        where["laboratory.folder"] = source.folder.resolve()
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


PREDICTED, DEVICE = "#92c5de", "#b2182b"


def write_report(
    outcome: LoopOutcome, study: LoopStudy, targets: Sequence[LoadedTarget], folder: Path, out: Path
) -> None:
    """Write `result.json` and `report.html` into `out`; the turns' folders lie in `folder`."""
    blocks = [*_head(outcome, targets)]
    for turn in outcome.turns:
        blocks += _turn(turn, study, targets, folder)
    last = page.Text(f"fabdesign {__version__}, seed {outcome.seed}, {outcome.wall_s:.0f} s.")
    write_result(out, outcome, f"{outcome.name}: loop", [*blocks, last])


def _head(outcome: LoopOutcome, targets: Sequence[LoadedTarget]) -> Iterator[page.Block]:
    """Yield where the loop stands, and the errors of all turns."""
    yield page.Title(outcome.name, 1)
    yield page.Text(as_sentence(outcome))
    if outcome.synthetic:
        yield page.Text(Markup("Measured on a <b>synthetic rig</b>, not on hardware."), "note")
    if outcome.waiting_for:
        what = "What to sew and to run: <code>{}</code>. The set is expected in <code>{}</code>."
        yield page.Text(Markup(what).format(outcome.asked, outcome.waiting_for), "note")
    yield page.Text(f"Target: {'; '.join(target.description for target in targets)}")
    yield page.Title("Excess over the noise floor, turn by turn")
    bars = []
    for turn in reversed(outcome.turns):
        if turn.device is not None:
            bars.append((f"{_name(turn)} on the device", turn.device["excess"], DEVICE))
        bars.append((f"{_name(turn)} predicted", turn.chosen["believed"]["excess"], PREDICTED))
    yield charts.bars("bars", bars, "mm", "excess over the noise floor")
    yield page.Text("""Excess of surface RMS between the target's points and the predicted shape, and between the
        target's points and the measured cloth.""")
    predicted = "predicted\nexcess, mm", "predicted\nChamfer (floor), mm"
    device = "excess", "surface RMS (floor)", "Chamfer (floor)", "from predicted"
    head = ("turn", *predicted, *(f"on the device\n{name}, mm" for name in device))
    yield page.TableBlock(head, [*map(_cells, outcome.turns)])


def _name(turn: Turn) -> str:
    return turn.name.replace("_", " ")


def _cells(turn: Turn) -> list[object]:
    """Return a turn's row of the table, mm."""
    believed, device = turn.chosen["believed"], turn.device
    predicted = [_name(turn), believed["excess"], f"{believed['chamfer']:.2f} ({believed['chamfer_floor']:.2f})"]
    if device is None:
        return [*predicted, "not measured yet"]
    surface = f"{device['surface_rms']:.2f} ({device['surface_floor']:.2f})"
    chamfer = f"{device['chamfer']:.2f} ({device['chamfer_floor']:.2f})"
    return [*predicted, device["excess"], surface, chamfer, device["from_believed"]]


def _turn(turn: Turn, study: LoopStudy, targets: Sequence[LoadedTarget], folder: Path) -> Iterator[page.Block]:
    """Yield what was chosen, the shape that came of it, and what its measurements show."""
    chosen, learned, search = turn.chosen, turn.learned, folder / turn.name / "search"
    yield page.Title(_name(turn).capitalize())
    reach = " ".join(chosen["reach"])
    yield page.Text(f"Search: {chosen['evaluations']} evaluations, {chosen['stop_reason']}. {reach}")
    design = read_design(search / "design.toml")
    pressures = read_pressures(search / "pressures.csv", design).pressure[-1]
    layout = page.LayoutBlock(design, pressures, study.search.limits.pressure[1])
    yield page.Columns([*([] if turn.device is None else [[_scene(turn, targets, folder)]]), [layout]], "cell")
    if not learned:
        return
    yield page.Title("What its measurements show", 3)
    lines = [*learned["said"]]
    if held_out := learned["held_out"]:
        before, after = held_out["before"], held_out["after"]
        lines.append(f"held-out trials: {before:.2f} mm excess over the noise before, {after:.2f} mm after")
    yield from page.texts("", lines)
    factors = [(name.replace("_", " "), f"{factor:.3f}") for name, factor in learned["factors"].items()]
    yield page.TableBlock(("factor", "on the data sheet"), factors)
    if learned["effects"]:
        yield page.Text(f"Effects of the model: {', '.join(learned['effects']).replace('_', ' ')}.")


def as_sentence(outcome: LoopOutcome) -> str:
    """Return where the loop stands."""
    measured = [turn.device["excess"] for turn in outcome.turns if turn.device is not None]
    best = outcome.best
    if best is None or best.device is None:
        return f"A design is chosen. Its measurements are expected in {outcome.waiting_for}."
    sentence = f"The first design is {measured[0]:.2f} mm over the noise floor on the device"
    if len(measured) > 1:
        sentence += f"; the nearest, {_name(best)}, is {best.device['excess']:.2f} mm over it"
    if outcome.waiting_for is not None:
        return f"{sentence}. The next measurements are expected in {outcome.waiting_for}."
    return f"{sentence}. Ended: {outcome.stop_reason}."


def as_text(outcome: LoopOutcome) -> str:
    """Return the text for the terminal: a line a turn, and what comes next."""
    lines, device = [], "on the device (synthetic rig)" if outcome.synthetic else "on the device"
    for turn in outcome.turns:
        predicted = f"predicted {turn.chosen['believed']['excess']:.2f} mm"
        on = "not measured yet" if turn.device is None else f"{device} {turn.device['excess']:.2f} mm"
        lines.append(f"{_name(turn)}: {predicted}, {on} over the noise floor")
        lines += [f"  {line}" for line in (turn.learned["said"] if turn.learned else ())]
    if outcome.waiting_for is not None:
        lines.append(
            f"waiting for a measurement set in {outcome.waiting_for}; what to sew and to run: {outcome.asked}; then "
            "run the same command again"
        )
    else:
        lines.append(f"ended: {outcome.stop_reason}")
    return "\n".join(lines)


def _scene(turn: Turn, targets: Sequence[LoadedTarget], folder: Path) -> page.Chart:
    """Return of the first pose the target, the measured cloth, and the shape that the search predicted."""
    shapes = read_arrays(folder / turn.name / "shapes.npz")
    named = (("measured", shapes["device"], DEVICE), ("predicted", shapes["believed"], PREDICTED))
    cloths = [
        charts.cloth_mesh(name, poses[0].astype(float), color=colour, opacity=0.7) for name, poses, colour in named
    ]
    return charts.scene(turn.name, [charts.target_cloud(targets[0].points), *cloths])
