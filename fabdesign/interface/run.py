"""The steps that all verbs share: read what came, open output, say how far they are, and compute here or elsewhere."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fabdesign.errors import InputError
from fabdesign.interface.verb import File, ModelLike, Progress, Say, SetLike, unheard, warn

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from fabdesign.nouns.forward import ForwardModel
    from fabdesign.nouns.model import Model
    from fabdesign.nouns.pressure import PressureProgram
    from fabdesign.nouns.trial import MeasurementSet, Role, Trial


Result = TypeVar("Result")


@dataclass(frozen=True)
class Run:
    """One call of a verb. force: replace output that exists. progress: is called with a line and the share of the work
    that is done (None where that is not known). say: hears what a person should know. effects: files of own effects.
    cluster: the address of a Dask scheduler whose workers compute."""

    force: bool = False
    progress: Progress = unheard
    say: Say = warn
    effects: Sequence[File] = ()
    cluster: str | None = None

    def __post_init__(self) -> None:
        for file in map(Path, self.effects):
            from fabdesign.effects import register_file
            from fabdesign.output import always_input

            register_file(file)
            always_input(file)

    @classmethod
    def of(cls, keys: dict[str, Any]) -> Run:
        """Take its own of other keywords."""
        return cls(**{field.name: keys.pop(field.name) for field in fields(cls) if field.name in keys})

    def model(self, model: ModelLike | None, without: Sequence[str] = ()) -> Model | None:
        """Return a model, or that of a file, less the parts `without`. Raises InputError for anything else."""
        from fabdesign.files.model_file import usable_model
        from fabdesign.nouns.model import Model

        if model is not None:
            require_kind("model", model, Model)
            return usable_model(model, without, say=self.say)
        if without:
            raise InputError(f"--without {','.join(without)}: there is no model; expected it with --model")
        return None

    @staticmethod
    def side(grid: int | None, model: Model | None) -> int:
        """Return points a side: as asked for, else those that the model's factors were found on."""
        from fabdesign.nouns.model import Model

        return grid or (model or Model()).points_per_side

    def known_model(self, model: ModelLike, without: Sequence[str]) -> Model:
        """Return the same where there must be one."""
        if (read := self.model(model, without)) is None:
            raise InputError("model: None; expected a model or its file")
        return read

    @staticmethod
    def sound(
        sets: Iterable[MeasurementSet], *, skip_bad: bool, roles: Collection[Role] = ("fit", "test")
    ) -> tuple[list[MeasurementSet], list[str]]:
        """Return the sets with their sound trials of these roles, and a line on each other one. Raises InputError for
        the first unless `skip_bad`."""
        from studies.measured.splits import Tolerance, sound_trials

        tolerance = Tolerance(skip_bad)
        return [sound_trials(one, tolerance, roles)[0] for one in sets], tolerance.skipped

    def warn_beyond(
        self, model: Model | None, programs: Sequence[PressureProgram], trials: Sequence[Trial] = ()
    ) -> None:
        """Say where a model extrapolates: designs that its corrector declines, pressures that it was not fitted to."""
        from studies.prediction.forward_model import extrapolated, not_corrected

        declined = [] if model is None else not_corrected(model, (trial.design for trial in trials))
        for line in (*declined, *extrapolated(model, programs)):
            self.say(line)

    def opened(self, opening: Callable[[], str | None]) -> Progress:
        """Return progress that begins with an estimate, once there is a first line: when the output is known to be
        free."""
        first = [opening]

        def show(line: str, share: float | None) -> None:
            while first:
                if estimate := first.pop()():
                    self.progress(estimate, None)
            self.progress(line, share)

        return show

    @contextmanager
    def computing(self, study: Any = None) -> Iterator[None]:
        """Return a context whose batches go where they are asked to: `cluster`, the environment's, that of the study's
        file, or here."""
        from fabdesign.runtime.cluster import VARIABLE, current, on_cluster

        address = self.cluster
        if address is None and current() is None:
            address = os.environ.get(VARIABLE)
            if address is None and isinstance(study, Path):
                from fabdesign.study_files.study_file import read_head

                address = read_head(study).cluster
        with on_cluster(address, say=self.say):
            yield

    def study(
        self, run: Callable[..., Result], study: Any, out: File | None, seconds: float | None, **how: Any
    ) -> Result:
        """Return what `run` makes of a study in its folder, or in one that goes afterwards."""
        with work_folder(out) as folder, self.computing(study):
            return run(study, folder, seconds=seconds, force=self.force, **how)

    def file(
        self, out: File | None, inputs: Iterable[Path], companions: Iterable[str] = ()
    ) -> AbstractContextManager[Path | None]:
        """Return a context with the unfinished file `out`; with None where none is asked for. companions: names of what
        is written beside it."""
        from fabdesign.output import new_files

        return nullcontext() if out is None else new_files(out, companions=companions, force=self.force, inputs=inputs)

    def folder(self, out: File | None, made_by: str, inputs: Iterable[Path]) -> AbstractContextManager[Path | None]:
        """Return the same with a folder. made_by: the command's name."""
        from fabdesign.output import new_folder

        return nullcontext() if out is None else new_folder(out, made_by=made_by, force=self.force, inputs=inputs)


@contextmanager
def work_folder(out: File | None) -> Iterator[Path]:
    """Return a folder to work in: the one that is asked for, or one that goes afterwards."""
    if out is not None:
        yield Path(out)
        return
    with tempfile.TemporaryDirectory(prefix="fabdesign_") as folder:
        yield Path(folder) / "work"


def simulator(points_per_side: int, **options: Any) -> ForwardModel:
    """Return the simulator, which loads Taichi."""
    from sim import Simulator

    return Simulator(points_per_side, **options)


def all_sets(measured: SetLike | Sequence[SetLike]) -> list[MeasurementSet]:
    """Return measurement sets, read where they are files. Raises InputError for anything else, also for a bench."""
    from fabdesign.files.bench_file import is_bench
    from fabdesign.files.measurement_set import read_set
    from fabdesign.nouns.trial import MeasurementSet

    many = several("measurement sets", measured, MeasurementSet)
    if not many:
        raise InputError("no measurement set; expected one or more")
    for one in many:
        require_kind("measurement set", one, MeasurementSet)
        if not isinstance(one, MeasurementSet) and is_bench(Path(one)):
            raise InputError(f"{one}: a bench; expected measurement sets")
    return [one if isinstance(one, MeasurementSet) else read_set(one) for one in many]


def benches_of(measured: Any) -> list[Path]:
    """Return those of the measured things that are benches. Raises InputError where other things are beside them."""
    from fabdesign.files.bench_file import is_bench

    many = [measured] if isinstance(measured, Path | str) else [*measured] if isinstance(measured, list | tuple) else []
    benches = [Path(one) for one in many if isinstance(one, Path | str) and is_bench(Path(one))]
    if benches and len(benches) < len(many):
        raise InputError(f"{benches[0]}: a bench; expected benches alone, or measurement sets")
    return benches


def paths_of(*given: Any) -> list[Path]:
    """Return those of the arguments that are files or folders, and where measured sets lie: never written over."""
    from fabdesign.nouns.trial import MeasurementSet

    flat = [x for each in given for x in (each if isinstance(each, list | tuple) else [each])]
    sets = {trial.file.parent.parent for x in flat if isinstance(x, MeasurementSet) for trial in x.trials}
    return [*(Path(x) for x in flat if isinstance(x, Path | str)), *sorted(sets)]


def several(what: str, given: Any, kind: type) -> Sequence[Any]:
    """Return a list of what came: of one thing of a kind, or one file, that alone."""
    return [given] if isinstance(given, kind | Path | str) else many_of(what, given)


def many_of(what: str, given: Any) -> Sequence[Any]:
    """Return a list of what came. Raises InputError for what is none."""
    if isinstance(given, str | dict) or not isinstance(given, Iterable):
        raise InputError(f"{what}: {as_given(given)}; expected a list of them")
    return [*given]


def require_kind(what: str, given: Any, kind: type) -> None:
    """Raise InputError for what is neither of a kind nor the name of a file."""
    if not isinstance(given, kind | Path | str):
        raise InputError(f"{what}: {as_given(given)}; expected a {kind.__name__} or its file")


def as_given(given: Any) -> str:
    """Return what came, in at most 60 letters."""
    text = " ".join(repr(given).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
