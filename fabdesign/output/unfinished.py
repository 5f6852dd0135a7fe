"""Files and folders that are written unfinished and become their goal when all is well."""

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.output import atomic
from fabdesign.output.ownership import MARK, files_in, marked_files, others_in, read_mark, require_apart, write_mark
from fabdesign.runtime.supervisor import record

Inputs = Iterable[Path | str]
_COMPLETE = "complete"  # in a folder's scratch: the new content is whole, and is being moved to its place


@contextmanager
def new_files(
    path: Path | str, *, companions: Iterable[str] = (), force: bool = False, inputs: Inputs = ()
) -> Iterator[Path]:
    """Return a path to write to, of the same name, in a hidden folder beside `path`; it becomes `path` when the block
    ends well, and goes when it does not. So does whatever is written beside it.

    inputs: what the command reads, files and folders. Folders above `path` are made, and unmade after a failure.
    A companion that is there with the same content stays; one with other content is refused like `path`, before any
    file has moved. companions: names of those that are known now and refused now.
    Raises InputError for an input, with or without `force`; for a file that is there, unless `force`; where another
    process writes the same file; and where nothing can be written.
    """
    path, inputs = Path(path), [*inputs]
    goal = goal_of(path)
    if not path.name:
        raise InputError(f"{path}: is a folder; expected a file name to write to")
    for name in (path.name, *companions):
        place = goal if name == path.name else goal.with_name(name)
        _require_free_file(path.with_name(name), place, force, inputs)
    with atomic.scratch(path, goal.with_name(f"{atomic.PREFIX}-{goal.name}")) as held:
        folder = held.at / "new"
        _clear(folder, path)
        yield folder / goal.name
        moves = {folder / name: goal.with_name(name) for name in sorted(files_in(folder))}
        for source, place in moves.items():
            if place == goal or not (place.is_file() and place.read_bytes() == source.read_bytes()):
                _require_free_file(path.with_name(place.name), place, force, inputs)
        atomic.settle(moves)


new_file = new_files  # without companions


@contextmanager
def new_folder(path: Path | str, *, made_by: str, force: bool = False, inputs: Inputs = ()) -> Iterator[Path]:
    """Return a folder to write to, of the same name, hidden in `path`; its content becomes that of `path` when the
    block ends well. made_by: the command, for the mark.

    An empty `path` serves. One that this program made is refused unless `force`, which replaces all of its content by
    the new; one with anything else in it, and one that holds an input, always. Raises InputError otherwise like
    `new_file`.
    """
    with _held(Path(path), force, inputs) as held:
        _require_free_folder(Path(path), force)
        unfinished = _anew(held, Path(path))
        _clear(unfinished, Path(path))
        yield unfinished
        _replace_content(held.at, unfinished, made_by)


class WorkFolder:
    """`folder`: where the work goes on. `anew`: it is to take the place of content that is there; set `complete` to
    False and it does not, for now."""

    def __init__(self, folder: Path, made_by: str, hidden: Path, *, anew: bool) -> None:
        self.folder, self.anew, self.complete = folder, anew, True
        self._made_by, self._hidden = made_by, hidden
        folder.mkdir(parents=True, exist_ok=True)
        self.claim()

    def claim(self, *names: str) -> None:
        """Mark files of these names in `folder` as this program's, before they are there."""
        mark = read_mark(self.folder)
        if mark is None or not mark.files.issuperset(names):
            files = frozenset() if mark is None else mark.files
            write_mark(self.folder, self._made_by, files | set(names))

    def clear(self) -> None:
        """Drop what an earlier `--force` has left to go on from."""
        if self.anew:
            _clear(self.folder, self.folder)
            self.claim()

    @contextmanager
    def adding(self) -> Iterator[Path]:
        """Return an empty folder; when the block ends well, its files move into `folder`, over those of the same
        name."""
        piece = self._hidden / "piece"
        _clear(piece, self.folder)
        yield piece
        self.claim(*files_in(piece))
        _move(piece, self.folder)


@contextmanager
def work_folder(path: Path | str, *, made_by: str, force: bool = False, inputs: Inputs = ()) -> Iterator[WorkFolder]:
    """Return a folder that work goes on in: an empty one, or one that `made_by` made; only one process works there.

    force: the work begins anew in a hidden folder, and takes the place of the old when the block ends well, unless
    `complete` is False by then. Left so, or by an exception, the same call goes on there. Raises InputError like
    `new_folder`.
    """
    path = Path(path)
    with _held(path, force, inputs) as held:
        record(scratch=str(held.at), work=str(path))
        mark = read_mark(path)
        if mark is None or mark.made_by != made_by or force:
            _require_free_folder(path, force)
        anew = _anew(held, path)
        staged = force and marked_files(path) > {MARK}
        folder = anew if staged else path
        try:
            work = WorkFolder(folder, made_by, held.at, anew=staged)
            yield work
        except BaseException as error:
            lines = _leave(held, path)
            if not isinstance(error, Exception):  # a signal: whoever sent it is to know what stays
                for line in lines:
                    error.add_note(line)
            raise
        if staged and work.complete:
            _replace_content(held.at, anew, made_by)
        (held.release if staged and not work.complete else held.discard)()


def _leave(held: atomic.Scratch, path: Path) -> list[str]:
    """Give up a work folder before its work has ended. Return what is to be said of what it keeps."""
    anew = _anew(held, path)
    folder = anew if marked_files(anew) else path
    kept = marked_files(folder) > {MARK}
    if not kept:  # nothing was done
        (folder / MARK).unlink(missing_ok=True)
    (held.release if marked_files(anew) else held.discard)()
    return [f"{path} keeps what was done, and the same command goes on from there"] if kept else []


def given_up(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Give up what a process held that was killed, by its records (`supervisor`): what it left unfinished
    goes, and its work folders stay. Return what is to be said of those: of the outermost."""
    kept: list[str] = []
    scratches = {Path(one["scratch"]): one.get("work") for one in records if "scratch" in one}  # the last of each
    for at, work in reversed(scratches.items()):
        if (held := atomic.abandoned(at)) is not None:
            _finish_move(at)
            if work is None:
                held.discard()
            else:
                kept += _leave(held, Path(work))
    for one in reversed(records):
        if "file" in one:
            Path(one["file"]).unlink(missing_ok=True)
        atomic.unmake([Path(folder) for folder in one.get("made", ())])
    return kept[-1:]


def goal_of(path: Path) -> Path:
    """Return where a path leads. Raises InputError for links that lead to themselves."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # the latter before Python 3.13
        raise InputError(f"{path}: its links lead to themselves; expected another place to write to") from None


def _require_free_file(path: Path, goal: Path, force: bool, inputs: Inputs) -> None:
    if goal.is_dir():
        raise InputError(f"{path}: is a folder; expected a file name to write to")
    require_apart(path, inputs)
    if goal.exists() and not goal.is_file():
        raise InputError(f"{path}: is not a regular file; expected another file name to write to")
    if goal.exists() and not force:
        raise InputError(f"{path}: exists; --force replaces it")


@contextmanager
def _held(path: Path, force: bool, inputs: Inputs) -> Iterator[atomic.Scratch]:
    """Return the scratch of the folder `path`, which is made; an interrupted move is finished first."""
    goal = goal_of(path)
    if goal.exists() and not goal.is_dir():
        raise InputError(f"{path}: is a file; expected a folder to write to")
    require_apart(path, inputs)
    if read_mark(goal) is None:
        _require_free_folder(path, force)  # nothing is locked, swept or written in a folder of other files
    with atomic.scratch(path, goal / atomic.PREFIX) as held:
        _finish_move(held.at)
        try:
            yield held
        finally:  # a signal may have come between the moves
            _finish_move(held.at)


def _require_free_folder(folder: Path, force: bool) -> None:
    if (other := next(others_in(folder), None)) is not None:  # at the first: it may be a home folder
        raise InputError(
            f"{folder}: holds {other}, which fabdesign did not make there; expected a new folder, or an empty one"
        )
    if not force and next(files_in(folder), None) is not None:
        mark = read_mark(folder)
        by = "" if mark is None else f", made by fabdesign {mark.made_by}"
        raise InputError(f"{folder}: exists{by}; --force replaces it")


def _anew(held: atomic.Scratch, path: Path) -> Path:
    """Return where new content of the folder `path` lies until it is complete."""
    return held.at / "new" / path.resolve().name


def _clear(folder: Path, goal: Path) -> None:
    """Make an empty folder, whatever a killed process left there."""
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
    except OSError as error:
        raise atomic.cannot_write(goal, error) from None


def _replace_content(hidden: Path, new: Path, made_by: str) -> None:
    """Replace the content of a goal by that of `new`, which lies in the goal's hidden folder."""
    write_mark(new, made_by, {*files_in(new)} - {MARK})
    for name in files_in(new):
        atomic.flush_file(new / name)
    with atomic.atomic_file(hidden / _COMPLETE) as marker:
        marker.write_bytes(os.fsencode(new.name))
    _finish_move(hidden)


def _finish_move(hidden: Path) -> None:
    """Do, or go on with, what `_replace_content` began; the mark moves last, so that it can always go on."""
    if not (hidden / _COMPLETE).exists():
        return
    goal, new = hidden.parent, hidden / "new" / os.fsdecode((hidden / _COMPLETE).read_bytes())
    mark = read_mark(new)
    if mark is not None:
        for name in marked_files(goal) - mark.files - {MARK}:
            (goal / name).unlink(missing_ok=True)
            with suppress(OSError):
                for above in Path(name).parents:
                    (goal / above).rmdir()
        _move(new, goal)
    (hidden / _COMPLETE).unlink()


def _move(source: Path, goal: Path) -> None:
    names = sorted(files_in(source), key=lambda name: name == MARK)
    for name in names:
        (goal / name).parent.mkdir(parents=True, exist_ok=True)
    atomic.settle({source / name: goal / name for name in names})
