"""The steps that studies of all kinds share: the file read, a folder that goes on, models that compute, what its kept
pieces depend on, and the two files that every result has."""

from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypedDict, TypeVar

from fabdesign.formats.json_file import write_json
from fabdesign.nouns.forward import ForwardModel
from fabdesign.output import WorkFolder, work_folder, write_text
from fabdesign.runtime.fingerprint import content_of
from fabdesign.version import SIMULATOR
from studies.report import page

Form = TypeVar("Form")


class Running(TypedDict, total=False):
    """How a study is run. seconds: in place of the study's limit. force: anew, in a folder of another or the same
    study; its old content stays until there is a new result."""

    seconds: float | None
    force: bool


class Simulated(Running, total=False):
    """The models that compute, besides. forward: by default the simulator with the study's grid. coarse: a cheaper one
    beside it, by default one of its own, or `forward` where that is given."""

    forward: ForwardModel | None
    coarse: ForwardModel | None


@dataclass(frozen=True)
class StudyRun(Generic[Form]):
    """A study to be run, with the files that it was read from."""

    study: Form
    inputs: tuple[Path, ...]
    force: bool

    @staticmethod
    def of(study: Form | Path | str, read: Callable[[Path], Form], how: Running) -> "StudyRun[Form]":
        """Return a study, read where it is a file. Raises InputError."""
        file = Path(study) if isinstance(study, Path | str) else None
        form: Any = study if file is None else read(file)
        if (seconds := how.get("seconds")) is not None:
            form = within(form, seconds)
        return StudyRun(form, () if file is None else (file,), how.get("force", False))

    def folder(self, out: Path | str, made_by: str, inputs: Iterable[Path | str]) -> AbstractContextManager[WorkFolder]:
        """Return a context with the folder that the study goes on in. inputs: besides its own file."""
        return work_folder(out, made_by=made_by, force=self.force, inputs=[*self.inputs, *inputs])


def within(study: Any, seconds: float) -> Any:
    """Return a study of any kind with another limit of seconds."""
    for part in ("search", "limits"):
        if hasattr(study, part):
            return replace(study, **{part: within(getattr(study, part), seconds)})
    return replace(study, seconds=seconds)


def simulator(points_per_side: int, study: Any = None, **options: Any) -> ForwardModel:
    """Return the simulator; with a study it has that one's shapes at rest. It loads and starts Taichi."""
    from sim import Simulator

    if study is not None:
        options = {"rise": study.rise, "hold": study.hold} | options
    return Simulator(points_per_side, **options)


def kept_content(study: Any, but: Collection[str], more: Mapping[str, Any], algorithm: int) -> dict[str, str]:
    """Return what kept pieces depend on, by field (`content_of`). algorithm: raised where they are no longer what the
    code would compute."""
    return {"simulator": str(SIMULATOR), "algorithm": str(algorithm)} | content_of(study, but, more)


def write_result(out: Path, content: Any, title: str, blocks: Iterable[page.Block]) -> None:
    """Write `result.json` and `report.html` into the folder `out`."""
    write_json(out / "result.json", content)
    write_text(out / "report.html", page.html_of(title, blocks))
