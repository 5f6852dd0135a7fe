"""A full disk, a file that may not grow, too little memory: a line, exit code 2, nothing half written. And a kept piece
that is damaged is said and done again."""

import errno
import os
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputNote
from fabdesign.formats.json_file import read_json
from fabdesign.nouns.catalogue import build
from fabdesign.output import work_folder
from fabdesign.runtime.store import ASIDE, Checkpoint, read_kept
from fabdesign.study_files.sensitivity_file import SensitivityStudy, Varied
from optimize.search.history import History
from optimize.search.multistart import search
from studies.sensitivity.run import run_sensitivity
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Hanging, Run, one_line
from tests.search.test_search import within

WRITING = {
    "new": "new cross -o {out}.toml",
    "simulate": "simulate cross.toml --pressures 100,0 -o {out}.npz",
    "meshes": "simulate cross.toml --pressures 100,0 --mesh {out}.ply -o {out}.npz",
    "predict": "predict --model model.toml set -o {out}",
    "evaluate": "evaluate --model model.toml set --all -o {out}",
    "export": "export cross.toml --tail-length 0.03 -o {out}",
    "view": "view motion.npz -o {out}.html",
    "picture": "view motion.npz --time 1 -o {out}.png",
}
DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "emptied": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "garbled": lambda content: bytes(np.random.default_rng(1).integers(0, 256, 4096, dtype=np.uint8)),
}


def written(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextmanager
def no_larger_file(most: int) -> Iterator[None]:
    """A context in which no file may have more than `most` bytes, as by `ulimit -f`."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("command", WRITING)
def test_a_disk_that_is_full_is_a_line(
    command: str, folder: Path, run: Run, hanging: type[Hanging], monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """First the disk, when what is written is to be flushed; then a limit of a file's size, while it is written."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLCONFIGDIR", str(folder))
    assert run(*["simulate", "cross.toml", "--pressures", "100,0", "-o", "motion.npz"])[0] == 0
    words = WRITING[command].format(out="out").split()
    before = written(folder)

    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", full)
        result = run(*words)
    one_line(_without_progress(result), "cannot be written (No space left on device): ")
    assert "free" in result[2]
    assert written(folder) == before
    with no_larger_file(200):
        result = run(*words)
    one_line(_without_progress(result), "cannot be written (File too large): ")
    assert "200 bytes here (ulimit -f)" in result[2]
    assert written(folder) == before
    assert run(*words)[0] == 0


def test_what_is_missing_is_said_where_it_is_known(folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    with no_larger_file(1000):
        one_line(
            run("new", "cross", "-o", "new/n.toml"), "needs 2.97 kB, a file may have 1 kB here (ulimit -f), 1.97 kB"
        )
    assert not (folder / "new").exists()


def test_too_little_memory_is_a_line(
    folder: Path, run: Run, hanging: type[Hanging], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of numpy, of Taichi and of the system."""
    monkeypatch.chdir(folder)
    for error in (
        MemoryError("Unable to allocate 6.85 GiB for an array with shape (9, 9)"),
        RuntimeError("[host_memory_pool.cpp:allocate_raw_memory@62] Virtual memory allocation (1073741824 B) failed."),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
    ):

        def fail(*of: object, error: Exception = error) -> list[np.ndarray]:
            raise error

        monkeypatch.setattr(hanging, "motions", fail)
        result = run(*["simulate", "cross.toml", "--pressures", "100,0", "-o", "m.npz"])
        one_line(result, "memory is short (")
        assert "llocat" in result[2] and ("available" in result[2] or "ulimit" in result[2])
        assert not (folder / "m.npz").exists()


def _without_progress(result: tuple[int, str, str]) -> tuple[int, str, str]:
    progress = re.compile(r"(predict|evaluat)ed \d|\d+ trials, \d+ cores?: about ")
    lines = [line for line in result[2].splitlines(keepends=True) if not progress.match(line)]
    return result[0], result[1], "".join(lines)


def sweep() -> SensitivityStudy:
    varied = Varied("pressure.0", "pressure", (0,), 100.0, 300.0, "kPa")
    rested = np.full(3, 200e3)
    return SensitivityStudy(
        "s", build("vertical"), (varied,), False, ("tip",), rested, methods=("morris",), trajectories=4
    )


def sensitivity(place: Path) -> object:
    result = run_sensitivity(sweep(), place / "sweep", forward=AnalyticCloth()).to_json()
    return {key: value for key, value in result.items() if key not in ("wall_s", "cpu_s")}


def optimize(place: Path) -> object:
    with History(place / "history.sqlite", "a") as history:
        evaluations = within(history, evaluations=12)
        search(evaluations)
        assert evaluations.best is not None
        return evaluations.best.value, [entry.objective for entry in history.entries()]


def pieces(place: Path) -> object:
    """Arrays and a value, of work that depends on one thing."""
    with work_folder(place / "work", made_by="test") as work:
        checkpoint = Checkpoint(work, {"seed": "1"})
        arrays = checkpoint.arrays("motion", lambda: {"x": np.arange(500.0)})
        return arrays["x"].tolist(), checkpoint.get("verdict", lambda: {"name": "none"}), checkpoint.spent >= 0


KEPT = {
    "sweep/samples.sqlite": sensitivity,
    "history.sqlite": optimize,
    "work/pieces/content.json": pieces,
    "work/pieces/motion.npz": pieces,
    "work/pieces/verdict.json": pieces,
}


@pytest.mark.filterwarnings("ignore::fabdesign.errors.InputNote")
@pytest.mark.parametrize("name", KEPT)
def test_a_kept_piece_that_is_damaged_is_said_and_done_again(name: str, tmp_path: Path) -> None:
    work = KEPT[name]
    expected = work(tmp_path)
    assert work(tmp_path) == expected
    piece = tmp_path / name
    sound = piece.read_bytes()
    for damage, damaged in DAMAGES.items():
        piece.write_bytes(damaged(sound))
        if damage == "emptied" and piece.suffix == ".sqlite":  # an empty file is a new database
            assert work(tmp_path) == expected
        else:
            with pytest.warns(InputNote, match=f"{piece.name}: damaged .*again$"):
                assert work(tmp_path) == expected
        assert work(tmp_path) == expected
    assert piece.with_name(piece.name + ASIDE).exists() == (piece.suffix == ".sqlite")


@pytest.mark.parametrize("state", ["", '{"stage": 0, "be', "\x00\x01"])
def test_a_search_whose_state_is_damaged_begins_anew(state: str, tmp_path: Path) -> None:
    expected = optimize(tmp_path)
    file = sqlite3.connect(tmp_path / "history.sqlite")
    with file:
        file.execute("update checkpoint set state = ?", (state,))
    file.close()
    with pytest.warns(InputNote, match=r"its checkpoint is damaged; the search begins anew$"):
        assert optimize(tmp_path) == expected


def test_what_is_damaged_in_a_kept_file_is_said_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "verdict.json"
    for text, problem in (
        ('{"found": 1,\n "seconds" 2}', "line 2 column 12"),
        ("[1, 2]", "expected a table at the top"),
    ):
        file.write_text(text)
        with pytest.warns(InputNote, match=rf"^{file}: damaged \(.*{problem}.*\); it is computed again$"):
            assert read_kept(file, read_json) is None
    assert read_kept(tmp_path / "none.json", read_json) is None  # which is nothing to say


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_kept_beside_is_done_again_too(damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """How a grid shared its time, and a motion of the rig in the user's cache."""
    from studies.layout_grid.run import turns_kept
    from studies.rig import specimen

    file = tmp_path / "turns.json"
    file.write_bytes(DAMAGES[damage](b'{"spent": 3.0, "cells": {}}\n'))
    with pytest.warns(InputNote, match=r"turns.json: damaged .*; how the time was shared is computed again$"):
        assert turns_kept(file) == ({}, 0.0)
    monkeypatch.setattr(specimen, "digest_of", lambda task: "task")
    monkeypatch.setattr(specimen, "user_cache", lambda kind: tmp_path)
    monkeypatch.setattr(specimen, "computed_points", lambda task: np.arange(6.0))
    assert specimen.control_points(None).tolist() == [*range(6)]  # type: ignore[arg-type]
    kept = tmp_path / "task.npy"
    kept.write_bytes(DAMAGES[damage](kept.read_bytes()))
    with pytest.warns(InputNote, match=r"task.npy: damaged .*; it is computed again$"):
        assert specimen.control_points(None).tolist() == [*range(6)]  # type: ignore[arg-type]
