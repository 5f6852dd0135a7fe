"""The measurements of a turn: which pressure programs are run on a design, and where they are run: the virtual rig
measures at once, a laboratory is asked and answers with a set."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fabdesign.drawings.sewing import Sewing, export_design
from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.measurement_set import NewTrial, read_set, write_set
from fabdesign.files.pressure_file import constant_program, write_pressures
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import LEAST_HOLD, RESOLUTION, PressureProgram, limits, regulated, rising_program, slewed
from fabdesign.nouns.trial import MeasurementSet, Role, Trial
from fabdesign.output import WorkFolder, new_folder, write_text
from fabdesign.study_files.loop_file import Laboratory, LoopStudy, VirtualRig
from fabdesign.units import in_kpa

TICK = 0.05  # s, in which a regulator is commanded
PRESSURE_SHARES = (0.6, 1.3)  # of the design's own pressures, between which programs about them lie
IDLE = 0.35  # chance that a channel of the others has no pressure
LEAST_SHARE = 0.3  # of the highest pressure, of a channel that has some


@dataclass(frozen=True, eq=False)
class Asked:
    """Trials of a design in the order in which they are run: first a rise to each pose's own pressures."""

    design: Design
    programs: tuple[PressureProgram, ...]
    held_out: int  # the last so many

    def role(self, order: int) -> Role:
        return "test" if order >= len(self.programs) - self.held_out else "fit"


def programs_for(
    study: LoopStudy, design: Design, pressures: Array, times: Sequence[float | None], *, seed: int, last: bool = False
) -> Asked:
    """Return the programs for pressures (poses, channels) Pa, and the targets' times [s], None of a shape at rest.
    last: nothing is learned from what is measured, so that only the rises are asked for."""
    search, rig, trials = study.search, study.rig_limits, study.trials
    rises = [
        rising_program(row, search.rise, search.rise + search.hold) if time is None else constant_program(row, time)
        for row, time in zip(regulated(pressures, rig.resolution), times, strict=True)
    ]
    others = [] if last else _informative(study, design, pressures[0], np.random.default_rng([search.seed, seed]))
    programs = [*rises, *(within_rate(program, rig.rate, rig.resolution) for program in others)]
    return Asked(design, tuple(programs), 0 if last else trials.held_out)


def _informative(study: LoopStudy, design: Design, levels: Array, rng: np.random.Generator) -> list[PressureProgram]:
    """Return by turns a step on and off, a staircase, random levels; of pressures about the design's own and of any
    others. Levels hold for LEAST_HOLD s where the trials are long enough. Channels differ, so that no trial is near a
    bifurcation."""
    highest = np.minimum(limits(design), study.highest)
    seconds = study.trials.seconds
    count = max(2, int(seconds / LEAST_HOLD))
    times, stairs = seconds * np.arange(count) / count, np.minimum(np.arange(count) + 2, count - np.arange(count))
    by_turns = np.stack([np.arange(count) < count / 2, stairs / stairs.max()])
    chosen = []
    for number in range(study.trials.number):
        if number % 2 == 0:
            most = np.minimum(levels * rng.uniform(*PRESSURE_SHARES, len(levels)), highest)
        else:
            most = highest * np.where(rng.random(len(levels)) < IDLE, 0.0, rng.uniform(LEAST_SHARE, 1.0, len(levels)))
        if not most.any():
            most = LEAST_SHARE * highest
        kind = number % 3
        shares = by_turns[kind, :, None] if kind < 2 else rng.uniform(0.0, 1.0, (count, len(levels)))
        chosen.append(PressureProgram(times, regulated(shares * most, study.rig_limits.resolution), seconds))
    return chosen


def within_rate(program: PressureProgram, rate: float, resolution: float = RESOLUTION) -> PressureProgram:
    """Return the program as a regulator follows it that changes by at most `rate` Pa/s, in ticks, in whole `resolution`
    Pa."""
    if not np.isfinite(rate):
        return program
    times = np.asarray(TICK * np.arange(max(1, round(program.duration / TICK))), np.float64)
    rows = slewed(regulated(program.at(times), resolution), rate * TICK, resolution)
    return PressureProgram.of_rows(times, rows, duration=program.duration)


MEASURED = "measured"  # the folder of a turn's set
ASKED = "to_measure"  # the folder of what a laboratory is asked for
AGREE = 5e3  # Pa RMS, within which a trial's set points are those asked for
_INSTANTS = 9  # before a frame, at which they are compared

Counter = Callable[[int, int], None]


class Waiting(Exception):
    """A laboratory has been asked, and has not measured yet."""


def measure(study: LoopStudy, name: str, asked: Asked, work: WorkFolder, *, progress: Counter) -> None:
    """Keep what the source measured of `asked` in the turn of this name, as a set in the turn's folder. Its trials and
    its design are named after the turn, so that sets of several turns go together. Raises Waiting where a laboratory
    has been asked for it, InputError for a set of its that is not what was asked for."""
    folder = work.folder / name / MEASURED
    if isinstance(study.source, VirtualRig):
        with tempfile.TemporaryDirectory() as temporary:
            _keep(measured_on_rig(study.source, asked, Path(temporary) / "set", progress), asked, name, folder)
        return
    place = study.source.folder / name
    if not (place / "set.toml").is_file():
        ask(study.source, asked, work, name)
        raise Waiting
    result = read_set(place)
    _require_asked(result, asked, place)
    _keep(result, asked, name, folder)


def measured_on_rig(source: VirtualRig, asked: Asked, out: Path, progress: Counter) -> MeasurementSet:
    from studies.rig import DEFAULT, RigSession, run_rig

    changed = {name: value for name in ("element", "step") if (value := getattr(source, name)) is not None}
    designs = [(asked.design, asked.programs)]
    session = RigSession(designs, source.truth, asked.held_out, replace(DEFAULT, **changed))
    run_rig(session, out, progress=progress)
    return read_set(out)


def _keep(measured: MeasurementSet, asked: Asked, name: str, folder: Path) -> None:
    """Keep the set with its trials' names and roles as the loop has them."""
    trials = sorted(measured.trials, key=lambda trial: trial.order)
    roles = ("test" if trial.role == "test" else asked.role(trial.order) for trial in trials)
    renamed = (
        NewTrial(f"{name}_{trial.order:03d}", name, trial.order, role, trial.load())
        for trial, role in zip(trials, roles, strict=True)
    )
    about, rate = measured.description, measured.frame_rate
    with new_folder(folder, made_by="loop", force=True) as unfinished:  # in place of what a killed run left
        write_set(unfinished, {name: trials[0].design}, renamed, name=name, description=about, frame_rate=rate)


def ask(source: Laboratory, asked: Asked, work: WorkFolder, name: str) -> None:
    """Write what to sew and what to run: design, template, cut list, a CSV a trial, and a page that says it."""
    folder = work.folder / name / ASKED
    sewing = Sewing(source.paper, tail_length=source.tail_length)
    export_design(asked.design, folder / "sew", sewing, stem="design", force=(folder / "sew").exists())
    with work.adding() as files:
        at = files / name / ASKED
        at.mkdir(parents=True)
        write_design(asked.design, at / "design.toml")
        for order, program in enumerate(asked.programs):
            write_pressures(program, at / f"{order:03d}.csv")
        write_text(at / "README.txt", _request(source, asked, name))


def _request(source: Laboratory, asked: Asked, name: str) -> str:
    lines = [
        "Sew design.toml (templates and cut list: sew/), a rested specimen, and run on it, in this order:",
        "",
        *(
            f"  order {order}: {order:03d}.csv, {program.duration:g} s, role {asked.role(order)}"
            for order, program in enumerate(asked.programs)
        ),
        "",
        f"Put the measurement set (set.toml, one design, these orders) into {source.folder / name}",
        "and run the same command again. Where the specimen's muscles lie elsewhere than drawn, the set's design file",
        "says where.",
    ]
    return "\n".join(lines) + "\n"


def _require_asked(measured: MeasurementSet, asked: Asked, place: Path) -> None:
    """Raise InputError unless the set has the design and the trials that were asked for."""
    by_order: dict[int, Trial] = {}
    for trial in measured.trials:
        if trial.order in by_order or trial.design_name != measured.trials[0].design_name:
            raise InputError(f"{place}: several trials of order {trial.order} or several designs; expected one design")
        by_order[trial.order] = trial
    if len(measured.designs) != 1:
        raise InputError(f"{place}: {len(measured.designs)} designs; expected the one that was asked for")
    sewn = measured.trials[0].design
    made, wanted = ([(m.type, m.side, m.channel) for m in design.muscles] for design in (sewn, asked.design))
    if made != wanted:
        raise InputError(
            f"{place}: design {sewn.name} has {len(made)} muscles of other types, sides or channels than the "
            f"{len(wanted)} asked for; expected to_measure/design.toml, its paths corrected at most"
        )
    for order, program in enumerate(asked.programs):
        if order not in by_order:
            raise InputError(f"{place}: no trial of order {order}; expected {order:03d}.csv as it was asked for")
        off = _apart(by_order[order], program)
        if off > AGREE:
            raise InputError(
                f"{place}: order {order} ran other pressures than {order:03d}.csv, {in_kpa(off):.0f} kPa RMS off; "
                "expected what was asked for"
            )
    if extra := sorted(set(by_order) - set(range(len(asked.programs)))):
        raise InputError(f"{place}: a trial of order {extra[0]}; {len(asked.programs)} were asked for")


def _apart(ran: Trial, asked: PressureProgram) -> float:
    """Return Pa RMS by which a trial's set points lie outside those asked for within two frames; infinite where it
    ended before."""
    times, recorded = ran.times, ran.program.at(ran.times - 1e-6)
    interval = float(np.median(np.diff(times, prepend=0.0)))
    if times[-1] < asked.duration - 2 * interval or recorded.shape[1] != asked.pressure.shape[1]:
        return float("inf")
    instants = times[:, None] - 2 * interval * np.linspace(0, 1, _INSTANTS) - 1e-6
    wanted = asked.at(np.maximum(instants, 0.0).ravel()).reshape(len(times), _INSTANTS, -1)
    outside = recorded - np.clip(recorded, wanted.min(axis=1), wanted.max(axis=1))
    return float(np.sqrt(np.mean(np.square(outside))))
