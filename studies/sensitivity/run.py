"""A sweep from its file to its report. Its samples lie on disk: what is computed stays, whatever ends the process."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, SimulationError, note
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.runtime import working_time
from fabdesign.runtime.cluster import at_once as machines
from fabdesign.runtime.effort import duration
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import Database
from fabdesign.study_files.sensitivity_file import Output, SensitivityStudy
from studies.layout_search.target import LoadedTarget, load_target
from studies.prediction.forward_model import WithMuscleStates, forward_model, knows_muscles
from studies.prediction.stability import moves, to_either_side
from studies.sensitivity.report import write_report
from studies.sensitivity.result import Computed, SensitivityResult
from studies.sensitivity.variables import Inputs, Outputs, saltelli_rows, trajectories
from studies.study import Running, StudyRun, kept_content, simulator

FILE = "samples.sqlite"
ALGORITHM = 1  # of what samples hold: raised where kept ones are no longer what this code would compute
_RAISED = ("name", "methods", "samples", "trajectories", "seconds")  # what may grow, or changes no sample
_DROP_DAMAGED = "delete from samples where typeof(numbers) <> 'blob' or length(numbers) = 0 or length(numbers) % 8 <> 0"


class Samples(Database):
    """A SQLite file of one study's samples, by part (a method's design) and number in it."""

    schema = """
create table if not exists samples (part text, number integer, numbers blob, primary key (part, number));
create table if not exists spent (id integer primary key check (id = 0), wall real, cpu real);
insert or ignore into spent values (0, 0, 0);
"""
    holds = "another study"

    def __init__(self, path: Path | str, content: Mapping[str, str]) -> None:
        super().__init__(path, content)
        with self.writing() as file:
            dropped = file.execute(_DROP_DAMAGED).rowcount
        if dropped:
            note(f"{path}: {dropped} samples are damaged; they are computed again")

    def of(self, part: str) -> dict[int, Array]:
        """Return the numbers of each sample that is there."""
        rows = self.rows("select number, numbers from samples where part = ?", part)
        return {number: np.frombuffer(numbers) for number, numbers in rows}

    def add(self, part: str, values: Mapping[int, Array], *, wall: float, cpu: float) -> None:
        """Add samples, and the seconds that they took."""
        rows = [(part, int(n), np.asarray(v, float).tobytes()) for n, v in values.items()]
        with self.writing() as file:
            file.executemany("insert or replace into samples values (?, ?, ?)", rows)
            file.execute("update spent set wall = wall + ?, cpu = cpu + ?", (wall, cpu))

    @property
    def spent(self) -> tuple[float, float]:
        """Return s by the clock and of the processor, all sessions together."""
        [(wall, cpu)] = self.rows("select wall, cpu from spent")
        return float(wall), float(cpu)


def sweep_content(study: SensitivityStudy, target: Array | None) -> dict[str, str]:
    """Return what the samples depend on, by field."""
    more: dict[str, Any] = {f"functions.{name}": _text_of(function) for name, function in study.functions.items()}
    if target is not None:
        more["target.points"] = sha256(target)
    if study.target is not None and study.target.weighting is not None:
        more["target.regions"] = repr(study.target.weighting.regions)
    return kept_content(study, (*_RAISED, "target", "functions"), more, ALGORITHM)


def _text_of(function: Output) -> str:
    """Return that by which a function is known again in another session: what it does, not where it lies."""

    def content(code: Any) -> list[Any]:
        inner = [content(c) if hasattr(c, "co_code") else repr(c) for c in code.co_consts]
        return [code.co_code.hex(), code.co_names, inner]

    code = getattr(inspect.unwrap(function), "__code__", None)
    return repr(type(function)) if code is None else sha256(repr(content(code)))


BATCH = 128  # samples in one call: twice what the simulator takes side by side
CHECKED = 8, 32  # samples at least and at most of which it is looked whether they snap
_SHARE = 16  # every so many-th row is looked at


@dataclass(frozen=True)
class Progress:
    """part: what is under way. remaining: s that the rest takes at the pace so far; None before the first batch."""

    part: str
    done: int
    total: int
    remaining: float | None

    def __str__(self) -> str:
        rest = "" if self.remaining is None or not self.remaining else f", {duration(self.remaining)} left"
        return f"{self.part}: {self.done} of {self.total} samples{rest}"


def run_sensitivity(
    study: SensitivityStudy | Path | str,
    out: Path | str,
    *,
    forward: ForwardModel | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    on_interrupt: Literal["raise", "end"] = "raise",
    **how: Unpack[Running],
) -> SensitivityResult:
    """Compute the samples of a study and write `result.json`, `samples.csv` and `report.html` into `out`.

    forward: by default the simulator with the study's grid. The same study goes on in its folder after an interruption,
    and further with more samples, trajectories or seconds; another study is refused there (InputError), unless `force`.
    on_interrupt: Ctrl-C is raised, or ends with what is done, where that is enough for a statement.
    Raises SimulationError where too many samples fail for a statement.
    """
    run = StudyRun.of(study, SensitivityStudy.read, how)
    study = run.study
    target = load_target(study.target, study.design, seed=study.seed) if study.target else None
    with run.folder(out, "sensitivity", [study.target.file] if study.target else []) as work:
        content = sweep_content(study, None if target is None else target.points)
        with Samples.of_work(work, FILE, content) as store:
            forward = simulator(study.points_per_side, study) if forward is None else forward
            result = _Sweep(study, target, store, forward, progress, on_interrupt).run()
        with work.adding() as files:
            write_report(result, files)
    return result


@dataclass
class _Sweep:
    """The samples of a study, which are computed into its store."""

    study: SensitivityStudy
    target: LoadedTarget | None
    store: Samples
    simulator: ForwardModel
    progress: Callable[[Progress], None]
    on_interrupt: Literal["raise", "end"]
    interrupted: bool = False

    def __post_init__(self) -> None:
        study, forward, self.inputs = self.study, self.simulator, Inputs(self.study)
        tensions = "largest_tension" in study.outputs
        if tensions and not knows_muscles(forward):
            raise InputError(f"largest_tension: {type(forward).__name__} knows no tensions; expected the simulator")
        self._tensions = WithMuscleStates(forward) if tensions else None
        predictor = forward_model(self._tensions or forward, study.model)
        self._forward = replace(predictor, model=Model())  # a case brings all of it
        rest, fabric = self._at_rest(), study.design.fabric
        self.outputs = Outputs(study.outputs, fabric, rest, self.target, study.at, study.functions)

    def run(self) -> SensitivityResult:
        study, computed, parts = self.study, {}, {}
        if "morris" in study.methods:
            parts["morris"] = trajectories(len(self.inputs.names), study.trajectories, study.seed)
        if "sobol" in study.methods:
            groups = [*self.inputs.groups.values()]
            parts["sobol"] = saltelli_rows(len(self.inputs.names), groups, study.samples, study.seed)
        checked = self._checked(parts)
        self._total = sum(cube.shape[0] * cube.shape[1] for cube in parts.values()) + 3 * len(checked)
        self._done, self._begun, self._computed = 0, working_time.seconds(), 0
        in_time = True
        for part, cube in parts.items():
            values = self.inputs.values(cube.reshape(-1, cube.shape[-1]), part)
            samples = self._all(part, values, self._outputs_of, cases=1) if in_time else self.store.of(part)
            in_time = in_time and len(samples) >= len(values)
            outputs = _filled(samples, cube.shape[:2], len(self.outputs.columns))
            computed[part] = Computed(cube, values.reshape(cube.shape), outputs)
        snapping = f"snapping of {[*parts][-1]}"
        moves = self._all(snapping, checked, self._moves_of, cases=3) if in_time else self.store.of(snapping)
        wall, cpu = self.store.spent
        if self.interrupted:  # a part of which nothing is there says nothing; the others do
            computed = {part: samples for part, samples in computed.items() if len(samples.outputs)}
        if not computed:
            raise KeyboardInterrupt
        return SensitivityResult(
            study=study,
            inputs=self.inputs,
            watched=self.outputs.columns,
            computed=computed,
            moves=np.array([moves[k] for k in sorted(moves)]).reshape(-1, 2),
            complete=in_time and len(moves) >= len(checked),
            interrupted=self.interrupted,
            wall_s=wall,
            cpu_s=cpu,
        )

    def _checked(self, parts: dict[str, Array]) -> Array:
        """Return (n, inputs) values of the samples of which it is looked whether they snap: those that begin the
        rows."""
        if not self.study.design.channels:
            return np.empty((0, len(self.inputs.names)))
        part, cube = [*parts.items()][-1]
        count = min(max(CHECKED[0], len(cube) // _SHARE), CHECKED[1], len(cube))
        return self.inputs.values(cube[:count, 0], part)

    def _all(
        self, part: str, values: Array, compute: Callable[[Array], list[Array]], *, cases: int
    ) -> dict[int, Array]:
        """Return what the store has of a part, with what is missing computed, as long as there is time."""
        done = self.store.of(part)
        missing = [k for k in range(len(values)) if k not in done]
        self._done += cases * (len(values) - len(missing))
        self._say(part)
        at_once = max(1, machines(BATCH) // cases)
        for begin in range(0, len(missing), at_once):
            if self.study.seconds is not None and self.store.spent[0] >= self.study.seconds:
                break
            numbers = missing[begin : begin + at_once]
            wall, cpu = working_time.seconds(), working_time.processor.seconds()
            try:
                new = compute(values[numbers])
            except KeyboardInterrupt:
                if self.on_interrupt == "raise":
                    raise
                self.interrupted = True
                break
            added = dict(zip(numbers, new, strict=True))
            self.store.add(part, added, wall=working_time.seconds() - wall, cpu=working_time.processor.seconds() - cpu)
            done |= added
            self._done += cases * len(numbers)
            self._computed += cases * len(numbers)
            self._say(part)
        return {k: v for k, v in done.items() if k < len(values)}

    def _say(self, part: str) -> None:
        pace = (working_time.seconds() - self._begun) / self._computed if self._computed else None
        remaining = None if pace is None else pace * (self._total - self._done)
        self.progress(Progress(part, self._done, self._total, remaining))

    def _outputs_of(self, values: Array) -> list[Array]:
        frames = self._shapes([self.inputs.case(row) for row in values])
        tensions = [motion.tension for motion in self._tensions.last] if self._tensions else [None] * len(values)
        return [self.outputs.of(f, t) for f, t in zip(frames, tensions, strict=True)]

    def _moves_of(self, values: Array) -> list[Array]:
        signs = (None, *to_either_side(self.study.design))
        shapes = self._shapes([self.inputs.case(row, spread) for row in values for spread in signs])
        last = [np.asarray(shape[-1], float) for shape in shapes]
        return [moves(*last[3 * k : 3 * k + 3]) for k in range(len(values))]

    def _shapes(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """Return (T, 3362, 3) m of each case at the study's times, or at rest."""
        if not self.study.at:
            return [shape[None] for shape in self._forward.equilibria(cases)]
        return self._forward.motions(cases, [np.array(self.study.at)] * len(cases))

    def _at_rest(self) -> Array:
        """Return (3362, 3) m without pressure, in the middle of all ranges."""
        case = self.inputs.case(self.inputs.centre, np.zeros(self.study.design.channels))
        shape = self._forward.equilibria([case])[0]
        if not np.isfinite(shape).all():
            raise SimulationError(f"{self.study.name}: no shape at rest without pressure was found")
        return np.asarray(shape, float)


def _filled(outputs: dict[int, Array], shape: tuple[int, ...], columns: int) -> Array:
    """Return (whole rows, samples a row, columns): the rows before the first of which a sample is not there."""
    rows, each = shape
    complete = next((k for k in range(rows * each) if k not in outputs), rows * each) // each
    return np.array([outputs[k] for k in range(complete * each)]).reshape(complete, each, columns)
