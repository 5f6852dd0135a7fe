"""Output that is whole or not there: write beside the goal, then rename."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from fabdesign.errors import InputError


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """A temporary path in `path`'s folder; it becomes `path` when the block ends well, and goes when it does not.

    Opened before anything is computed, so that a place that cannot be written is refused at once (InputError).
    Folders above `path` are made, and unmade after a failure.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected a file name to write to")
    made = _make_folders(path.parent)
    temporary = path.with_name(f".unfinished-{uuid4().hex}{path.suffix}")
    try:
        temporary.touch(exist_ok=False)
    except OSError as error:
        _unmake(made)
        raise _cannot_write(path, error) from None
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        _unmake(made)
        raise


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A temporary folder in `path`; its files move into `path` when the block ends well.

    Files that `path` already has under the same names are replaced, others stay. Raises InputError like `new_file`.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; expected a folder to write to")
    made = _make_folders(path)
    temporary = path / f".unfinished-{uuid4().hex}"
    try:
        temporary.mkdir()
    except OSError as error:
        _unmake(made)
        raise _cannot_write(path, error) from None
    try:
        yield temporary
        for source in sorted(p for p in temporary.rglob("*") if p.is_file()):
            goal = path / source.relative_to(temporary)
            goal.parent.mkdir(parents=True, exist_ok=True)
            source.replace(goal)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        _unmake(made)
        raise
    shutil.rmtree(temporary)


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all."""
    with new_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _make_folders(path: Path) -> list[Path]:
    """Make `path` and what is missing above it; the ones made, deepest first."""
    missing: list[Path] = []
    above = path
    while not above.exists() and above != above.parent:
        missing.append(above)
        above = above.parent
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _unmake(missing)
        raise _cannot_write(path, error) from None
    return missing


def _unmake(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return  # not empty, or never made


def _cannot_write(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written ({error.strerror})")
