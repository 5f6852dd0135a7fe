"""Measurement sets and trials: what is written is what is read, and every kind of damage."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.errors import InputError
from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.files.trial_file import read_trial, write_trial
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.trial import Accuracy

Arrays = dict[str, np.ndarray]


@st.composite
def trials(draw: st.DrawFn) -> TrialData:
    frames = draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    time = np.cumsum(rng.uniform(0.01, 0.1, frames))
    pressure = rng.integers(10_001, 10_000_000, (frames, draw(st.integers(0, 3)))) / 10  # to 0.1 Pa, above 1 kPa
    clouds = tuple(rng.integers(-3000, 3000, (rng.integers(1, 9), 3)) * 1e-4 for _ in range(frames))
    return TrialData(time, pressure, clouds)


def same(a: TrialData, b: TrialData) -> bool:
    pairs = [(a.time, b.time), (a.pressure, b.pressure), *zip(a.frames, b.frames, strict=True)]
    return all(np.array_equal(x, y) for x, y in pairs)


@settings(deadline=None)
@given(trial=trials())
def test_written_trial_reads_the_same(trial: TrialData, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("trial") / "t.npz"
    write_trial(trial, path)
    assert same(read_trial(path), trial)


def example(channels: int = 2) -> TrialData:
    rng = np.random.default_rng(1)
    cloud = rng.integers([-1000, -2000, 0], [1000, 0, 100], (50, 3)) * 1e-4
    return TrialData(np.array([0.1, 0.2]), np.full((2, channels), 3e5), (cloud, cloud[:40]))


def test_written_set_reads_the_same(tmp_path: Path) -> None:
    designs = {"cross": build("cross"), "vertical": build("vertical")}
    new = [NewTrial("000", "cross", 0, "fit", example()), NewTrial("001", "vertical", 1, "test", example(3))]
    about = {"name": "two", "description": "a test", "frame_rate": 10.0, "accuracy": Accuracy(0.03, 1.5)}
    write_set(tmp_path / "set", designs, iter(new), **about)
    read = read_set(tmp_path / "set")
    assert read.accuracy == about["accuracy"]
    assert (read.name, read.description, read.frame_rate, read.designs) == ("two", "a test", 10.0, designs)
    for trial, written in zip(read.trials, new, strict=True):
        assert (trial.name, trial.design_name, trial.order, trial.role) == (
            written.name,
            written.design_name,
            written.order,
            written.role,
        )
        assert same(trial.load(), written.data)
        assert trial.times.tolist() == [0.1, 0.2]
        assert trial.program.pressure.tolist() == [[3e5] * trial.design.channels]


def test_failed_set_leaves_nothing(tmp_path: Path) -> None:
    def trials_that_fail() -> object:
        yield NewTrial("000", "cross", 0, "fit", example())
        raise InputError("the second one fails")

    with pytest.raises(InputError, match="second"):
        write_set(tmp_path / "a" / "set", {"cross": build("cross")}, trials_that_fail(), name="x")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rig", ["rig_a", "rig_b", "rig_c"])
def test_measured_sets_are_sound(rig: str, data: Path) -> None:
    measured = read_set(data / rig)
    assert {trial.role for trial in measured.trials} == {"fit", "test"}
    trial = measured.trials[-1].load()
    assert trial.frames[0].shape == ((3362 if rig == "rig_a" else 1500), 3)
    assert np.ptp(trial.frames[0][:, 1]) == pytest.approx(0.2, abs=0.02)  # the cloth hangs 0.2 m down


def without(name: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {key: value for key, value in arrays.items() if key != name}


def changed(**values: object) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {**arrays, **{name: np.asarray(value) for name, value in values.items()}}


def times(name: str, factor: float) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {**arrays, name: arrays[name] * factor}


def with_nan(name: str) -> Callable[[Arrays], Arrays]:
    def put(arrays: Arrays) -> Arrays:
        array = arrays[name].astype(np.float64)
        array.flat[0] = np.nan
        return {**arrays, name: array}

    return put


def mostly_nan(arrays: Arrays) -> Arrays:
    points = arrays["points"].astype(np.float64)
    points[:30] = np.nan
    return {**arrays, "points": points}


DAMAGE = [
    (without("time"), "no array time"),
    (without("points"), "no array points"),
    (without("scale"), "no array scale"),
    (changed(time=[0.2, 0.1]), "does not rise"),
    (changed(time=[[0.1, 0.2]]), "time is"),
    (with_nan("time"), "does not rise"),
    (changed(time=[0.1, 0.2, 0.3]), "pressure is"),
    (changed(pressure=[[300.0], [300.0]]), "channel 1 has no pressure"),
    (changed(pressure=np.full((2, 3), 300.0)), "pressures for 3 channels"),
    (changed(pressure=[300.0, 300.0]), "pressure is"),
    (with_nan("pressure"), "has pressure NaN"),
    (times("pressure", -1), "has pressure -300 kPa"),
    (times("pressure", 4), "at most 1000 kPa"),
    (mostly_nan, "frame 0: of 50 points 30 not finite; expected at least half of them sound"),
    (changed(points=np.zeros((90, 2))), "points is"),
    (changed(points=np.array(["a"] * 90)), "points is"),
    (changed(points=np.zeros((0, 3)), offsets=[0, 0, 0]), "empty"),
    (changed(offsets=[0, 90, 90]), "frame 1: the cloud is empty"),
    (changed(offsets=[0, 50]), "offsets is"),
    (changed(offsets=[0, 50, 80]), "offsets do not rise"),
    (changed(offsets=[0, 95, 90]), "offsets do not rise"),
    (changed(scale=0.0), "scale"),
    (changed(scale=[1e-4, 1e-4]), "scale"),
    (changed(scale=0.1), "in millimetres?"),
    (lambda arrays: {**arrays, "points": np.array([None, 1], dtype=object)}, "damaged"),
]


@pytest.mark.parametrize(("damage", "problem"), DAMAGE, ids=[f"{i}-{row[1]}" for i, row in enumerate(DAMAGE)])
def test_damaged_trial_is_one_line(damage: Callable[[Arrays], Arrays], problem: str, tmp_path: Path) -> None:
    write_set(tmp_path, {"cross": build("cross")}, [NewTrial("000", "cross", 0, "fit", example())], name="x")
    path = tmp_path / "trials" / "000.npz"
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **damage(arrays))
    with pytest.raises(InputError, match=problem) as caught:
        read_set(tmp_path).trials[0].load()
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("part", [0, 10, 300, -40, -1])
def test_truncated_npz_is_one_line(part: int, tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    write_trial(example(), path)
    path.write_bytes(path.read_bytes()[:part])
    with pytest.raises(InputError, match="damaged or cut short"):
        read_trial(path)


@settings(max_examples=60, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_one_wrong_byte_never_gives_a_traceback(
    place: float, value: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("trial") / "t.npz"
    write_trial(example(), path)
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] = value
    path.write_bytes(content)
    try:
        read_trial(path)
    except InputError as error:
        assert "\n" not in str(error)


def test_a_trial_marked_as_encrypted_is_named(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    write_trial(example(), path)
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\x01\x02") + 8] |= 1  # general purpose flags of the first entry
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"t\.npz"):
        read_trial(path)


BAD_SETS = [
    ("measurement-set/1", "measurement-set/3", "measurement-set/3"),
    ('role = "fit"', 'role = "train"', "fit, test"),
    ('design = "cross"', 'design = "cros"', "did you mean cross"),
    ('file = "trials/000.npz"', 'file = "trials/001.npz"', "is not there"),
    ('cross = "cross.toml"', 'cross = "none.toml"', "no such file"),
    ("order = 0", "order = 0.5", "whole number"),
    ("order = 0", "order = 0\nrate = 3", "unknown key rate"),
    ('name = "x"', 'name = "x"\nframe_rate = 0', "above 0"),
    ("[designs]", "accuracy = {pressure = 2}\n[designs]", "accuracy: pressure = 2; expected a number from 0 to 1"),
    ("[designs]", "accuracy = {level = 1}\n[designs]", "unknown key level"),
    ("[designs]", "rig_limits = {rate = 0}\n[designs]", "rig_limits: rate = 0; expected a number above 0"),
]


@pytest.mark.parametrize(("old", "new", "problem"), BAD_SETS)
def test_bad_set_is_one_line(old: str, new: str, problem: str, tmp_path: Path) -> None:
    write_set(tmp_path, {"cross": build("cross")}, [NewTrial("000", "cross", 0, "fit", example())], name="x")
    path = tmp_path / "set.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=problem):
        read_set(tmp_path)
