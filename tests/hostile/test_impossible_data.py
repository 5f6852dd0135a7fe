"""Measured data that cannot be: other axes, units and places are named with their cause, sound trials pass."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.errors import InputError
from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.formats.lab_table import require_measured_pressures, require_seconds
from fabdesign.geometry.hung_cloth import require_on_cloth
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.fabric import Fabric

Array = np.ndarray
DESIGN = build("cross")
TIMES = np.arange(1, 7) / 30


def bent(radius: float, *, fabric: Fabric = DESIGN.fabric, points: int = 400, seed: int = 0) -> Array:
    """(n, 3) m: a cloth bent to `radius` about its width, its middle below its hung edge."""
    rng = np.random.default_rng(seed)
    u, s = rng.uniform(0, fabric.width, points), rng.uniform(0, fabric.height, points)
    all_along = np.linspace(0, fabric.height, 1000)

    def place(v: Array) -> Array:
        return radius * np.array([1 - np.cos(v / radius), -np.sin(v / radius)])  # (z, y), tangent to -y at the edge

    z, y = place(all_along).mean(axis=1)
    angle = np.arctan2(z, -y)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    z, y = turn @ place(s)
    faces = rng.choice([-0.5, 0.5], points) * fabric.thickness
    return np.stack([u - fabric.width / 2, y, z + faces], axis=1) + rng.normal(0, 6e-4, (points, 3))


FLAT = [bent(10.0, seed=i) for i in range(len(TIMES))]


@settings(max_examples=60)
@given(radius=st.floats(0.02, 5), seed=st.integers(0, 1000), points=st.integers(40, 800), late=st.booleans())
def test_every_bend_of_a_hanging_cloth_is_sound(radius: float, seed: int, points: int, late: bool) -> None:
    """From nearly flat to a roll of one and a half turns."""
    clouds = [bent(radius, points=points, seed=seed + i) for i in range(3)]
    require_on_cloth(clouds, np.arange(1, 4) / 30 + late, DESIGN.fabric, "trial")


@pytest.mark.parametrize("width", [0.1, 0.2, 0.6])
def test_a_cloth_of_another_size_or_support_is_sound(width: float) -> None:
    fabric = replace(DESIGN.fabric, width=width)
    require_on_cloth([bent(0.1, fabric=fabric)], TIMES[:1] + 1, fabric, "trial")
    corners = replace(fabric, hung=((0.0, 0.0), (width, 0.0)))
    require_on_cloth([bent(0.5, fabric=fabric)], TIMES[:1], corners, "trial")
    fallen = bent(10.0, fabric=fabric) - [0, 3, 0]
    require_on_cloth([fallen], TIMES[:1], replace(fabric, hung="none"), "trial")


def test_a_clamped_cloth_held_out_by_its_muscles_is_sound() -> None:
    held_out = FLAT[0][:, [0, 2, 1]] * [1, 1, -1]
    clamped = replace(DESIGN.fabric, support="clamped")
    require_on_cloth([held_out], np.array([1.5]), clamped, "trial")
    with pytest.raises(InputError, match="exchanged"):
        require_on_cloth([held_out], np.array([0.03]), clamped, "trial")  # not so soon after rest


PLACES: list[tuple[Callable[[Array], Array], str]] = [
    (lambda p: p[:, [0, 2, 1]], "are y and z exchanged"),
    (lambda p: p[:, [0, 2, 1]] * [1, 1, -1], "are y and z exchanged, with z down"),
    (lambda p: p * [1, -1, 1], "is y turned round"),
    (lambda p: p * [1, -1, -1], "is y turned round"),
    (lambda p: p[:, [1, 0, 2]], "are x and y exchanged"),
    (lambda p: p[:, [2, 1, 0]], "are x and z exchanged"),
    (lambda p: p * 1e3, "in millimetres"),
    (lambda p: p * 1e2, "in centimetres"),
    (lambda p: p / 0.0254, "in inches"),
    (lambda p: p * 1e-3, "to metres twice"),
    (lambda p: p + [0, 0, 0.335], "middle is 335 mm off"),
    (lambda p: p + [0, 0.1, 0], "above where the cloth is held"),
]


@pytest.mark.parametrize(("spoil", "cause"), PLACES, ids=[cause for _, cause in PLACES])
def test_another_frame_or_unit_is_named(spoil: Callable[[Array], Array], cause: str) -> None:
    with pytest.raises(InputError, match=cause) as caught:
        require_on_cloth([spoil(cloud) for cloud in FLAT], TIMES, DESIGN.fabric, "trial")
    assert "\n" not in str(caught.value)


def written(folder: Path, **changed: object) -> Path:
    pressure = np.full((len(TIMES), DESIGN.channels), 4e5)
    write_set(
        folder,
        {"cross": DESIGN},
        [NewTrial(f"{i:03d}", "cross", i, "fit", TrialData(TIMES, pressure, tuple(FLAT))) for i in range(2)],
        name="x",
    )
    path = folder / "trials" / "000.npz"
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, **{key: change(arrays[key]) for key, change in changed.items()}})
    return path


@pytest.mark.parametrize(
    ("changed", "cause"),
    [
        ({"pressure": lambda kpa: kpa / 1e3}, "is 0.4 kPa; expected kPa .is it in MPa"),
        ({"pressure": lambda kpa: kpa * 1e3}, "is 400000 kPa; expected kPa .is it in Pa"),
        ({"time": lambda s: 1e3 * s}, "a frame every 33.33 s; expected seconds .is it in milliseconds"),
        ({"time": lambda s: 1e6 * s}, "in microseconds"),
    ],
)
def test_units_are_named_by_whatever_reads_the_trial(changed: dict[str, object], cause: str, tmp_path: Path) -> None:
    path = written(tmp_path, **changed)
    trial = read_set(tmp_path).trials[0]
    for read in (trial.load, lambda: trial.program):
        with pytest.raises(InputError, match=cause) as caught:
            read()
        assert str(path) in str(caught.value)


def test_trial_in_exchanged_axes_is_refused_where_it_is_loaded(tmp_path: Path) -> None:
    written(tmp_path, points=lambda p: p[:, [0, 2, 1]])
    first, second = read_set(tmp_path).trials
    with pytest.raises(InputError, match=r"000\.npz: .*are y and z exchanged"):
        first.load()
    assert len(second.load().frames) == len(TIMES)


def test_the_same_order_twice_is_refused(tmp_path: Path) -> None:
    written(tmp_path)
    text = (tmp_path / "set.toml").read_text()
    (tmp_path / "set.toml").write_text(text.replace("order = 1", "order = 0"))
    with pytest.raises(InputError, match=r"order = 0 is that of 000\.npz too"):
        read_set(tmp_path)


@given(
    kpa=st.lists(st.floats(1.1, 1000), min_size=1, max_size=5),
    zeros=st.integers(0, 3),
    interval=st.floats(1e-3, 7.9),
    frames=st.integers(1, 50),
)
def test_plain_units_pass(kpa: list[float], zeros: int, interval: float, frames: int) -> None:
    require_measured_pressures(1e3 * np.array(kpa + [0.0] * zeros), "x")
    require_measured_pressures(np.zeros(3), "x")
    require_seconds(interval * np.arange(1, frames + 1), "x")


def test_all_measured_trials_are_sound(data: Path) -> None:
    for folder in sorted(data.glob("rig_*")):
        for trial in read_set(folder).trials[:: 6 if folder.name == "rig_a" else 1]:
            assert trial.load().frames
