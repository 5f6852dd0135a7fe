"""Only an InputError leaves a reader, whatever the file holds: 200 damaged copies of a sound file of every kind."""

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.motion_file import read_band
from fabdesign.files.trial_file import read_trial_pressures
from studies.check.files import inspect
from studies.report.result_folders import read_folder
from studies.view.items import items_of
from tests.samples import NAMES, mutations, write_samples

pytestmark = pytest.mark.filterwarnings("ignore")  # what damage brings; notes are not asked for
MUTATIONS = 200  # of each kind; a longer run: python -m pytest tests/hostile/test_fuzz.py after a change of this number
SHOWN = (".npz", ".ply", ".stl", ".asc")  # that `view` reads by another way than `check`


@pytest.fixture(scope="module")
def sound() -> Iterator[Path]:
    memory = Path("/dev/shm")  # where files are written in no time
    with TemporaryDirectory(dir=memory if memory.is_dir() and os.access(memory, os.W_OK) else None) as folder:
        write_samples(Path(folder))
        yield Path(folder)


@pytest.mark.parametrize("name", NAMES)
def test_only_an_input_error_leaves_a_reader(name: str, sound: Path) -> None:
    file = sound / name
    if not file.is_file():
        pytest.skip("the package that writes it is not installed")
    assert inspect(file).problems == ()
    refused = 0
    for damaged in mutations(file, MUTATIONS, seed=1):
        findings = inspect(damaged)  # which gives the line of an InputError, and lets all else out
        refused += bool(findings.problems)
        assert all(line and "\n" not in line for line in findings.problems)
        if damaged.suffix in SHOWN:
            try:
                items_of([damaged])
            except InputError as error:
                assert "\n" not in str(error)
    assert refused > MUTATIONS / 2


ODD = (
    np.float64(1), np.array("x"), np.array(["a", "b"]), np.zeros(0), np.zeros((0, 3)), np.zeros((2, 0, 3)),
    np.array(True), np.zeros(5, bool), np.array(1 + 2j), np.full((3, 3), np.nan), np.full((2, 2, 3), np.inf),
    np.array([-1, -2]), np.array([2**63 - 1, 1]), np.array(2**64 - 1, np.uint64), np.zeros((1, 1, 1, 1)),
    np.array([b"x"]), np.array(["2020"], "datetime64[Y]"), np.zeros(3, [("x", "f4")]), np.array([1e300, 1e308]),
)  # fmt: skip


@pytest.mark.parametrize("name", ["set/trials/000.npz", "motion.npz"])
def test_arrays_of_other_shapes_and_types(name: str, sound: Path) -> None:
    """Damaged bytes seldom pass the checksums of an npz; whole arrays that are odd do."""
    with np.load(sound / name) as archive:
        arrays = dict(archive)
    if name == "motion.npz":
        count = len(arrays["time"])
        arrays |= {"cloth_size": np.full(2, 0.2), "band90": np.zeros((count, 3, 3)), "muscle_sides": np.array([1, -1])}
        arrays |= {"muscle_points": np.zeros((count, 4, 3)), "muscle_begins": np.array([0, 2, 4])}
        arrays |= {"muscle_diameters": np.full(2, 0.002), "tension": np.zeros((count, 2))}
    file = sound / "odd.npz"
    for key in arrays:
        for odd in (
            *ODD,
            arrays[key].astype(str),
            arrays[key].astype(object),
            arrays[key].T,
            -arrays[key].astype(float),
        ):
            np.savez(file, **(arrays | {key: odd}))
            for read in (inspect, lambda path: items_of([path]), read_band, read_trial_pressures):
                try:
                    read(file)
                except InputError as error:
                    assert "\n" not in str(error)


def test_only_an_input_error_leaves_a_result(sound: Path) -> None:
    folder = sound / "made"
    folder.mkdir()
    (folder / ".fabdesign").write_text('{"format": "fabdesign.output/1", "made_by": "fuse", "files": ["result.json"]}')
    file = folder / "result.json"
    file.write_text('{"objective_mm": 1.5, "muscles": [{"type": "EM20"}], "designs": {"d": {"chamfer": null}}}')
    for name in (".fabdesign", "result.json"):
        content = (folder / name).read_bytes()
        for damaged in mutations(folder / name, MUTATIONS, seed=2):
            (folder / name).write_bytes(damaged.read_bytes())
            try:
                assert isinstance(read_folder(folder).figures, dict)
            except InputError as error:
                assert "\n" not in str(error)
        (folder / name).write_bytes(content)
