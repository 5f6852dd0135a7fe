"""Pressure programs: the meaning of rows, what is written is what is read, and bad input."""

import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.errors import InputError
from fabdesign.files.pressure_file import note_slight, read_pressures, write_pressures
from fabdesign.files.trial_file import program_of
from fabdesign.nouns.catalogue import build, standard
from fabdesign.nouns.pressure import PressureProgram
from studies.prediction.predict import frame_times

floats = partial(st.floats, allow_subnormal=False)  # the simulator's kernels flush those to zero
CROSS = build("cross")


@st.composite
def programs(draw: st.DrawFn) -> PressureProgram:
    steps = draw(st.lists(floats(0.01, 2.0), min_size=0, max_size=5))
    time = np.concatenate([[0.0], np.cumsum(steps)])
    row = st.tuples(floats(0, 1e6), floats(0, 1e6))
    pressure = np.array([draw(row) for _ in time])
    return PressureProgram.of_rows(time, pressure, duration=round(float(time[-1]) + draw(floats(0.01, 2.0)), 6))


@settings(deadline=None)
@given(program=programs())
def test_written_program_reads_the_same(program: PressureProgram, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("pressures") / "p.csv"
    write_pressures(program, path)
    read = read_pressures(path, CROSS)
    assert np.array_equal(read.time, program.time)
    assert np.array_equal(read.pressure, program.pressure)
    assert read.duration == pytest.approx(program.duration, abs=2e-9)


def test_rows_hold_to_the_next_and_the_last_for_one_interval(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("time_s,channel_0,channel_1\n0,100,0\n0.5,200,50.5\n0.75,0,0\n")
    program = read_pressures(tmp_path / "p.csv", CROSS)
    assert program.duration == 1.0
    expected = [[1e5, 0], [1e5, 0], [2e5, 50500], [0, 0], [0, 0]]
    assert program.at(np.array([0, 0.49, 0.5, 0.75, 5])).tolist() == expected
    assert frame_times(program, frame_rate=60).tolist() == [k / 60 for k in range(61)]
    assert frame_times(program, duration=0.5, frame_rate=10).tolist() == [k / 10 for k in range(6)]


@settings(deadline=None)
@given(program=programs(), first=floats(-1.0, 1.0), width=floats(1e-3, 1.0))
def test_means_are_integrals_over_widths(program: PressureProgram, first: float, width: float) -> None:
    # against 4,000 points of each interval; between two of them at most five jumps of 1 MPa and the start lie
    edges = first + width * np.arange(4)
    fine = first + width * (np.arange(3)[:, None] + (np.arange(4000) + 0.5) / 4000)
    sampled = np.where(fine[..., None] < 0, 0.0, program.at(fine.ravel()).reshape(3, 4000, 2)).mean(axis=1)
    assert program.means(edges) == pytest.approx(sampled, abs=6 * 1e6 / 4000)


def test_a_jump_counts_by_its_share_of_the_interval() -> None:
    program = PressureProgram(np.array([0.0, 0.5]), np.array([[100.0], [300.0]]), 1.0)
    means = program.means(np.array([-0.3, 0.1, 0.4, 0.8, 1.0]))
    assert means[:, 0] == pytest.approx([25.0, 100.0, 250.0, 300.0])


def test_constant_row_lasts_a_second_and_a_half() -> None:
    program = read_pressures("400, 0", CROSS)
    assert program.pressure.tolist() == [[4e5, 0]]
    assert len(frame_times(program, frame_rate=60)) == 91


def test_row_of_a_trial_holds_until_its_own_time() -> None:
    time = np.array([0.1, 0.2, 0.3, 0.4])
    pressure = np.array([[1.0], [1.0], [2.0], [3.0]])
    program = program_of(time, pressure)
    # (0, 0.2] 1; (0.2, 0.3] 2; (0.3, 0.4] 3
    assert program.at(np.array([0.05, 0.15, 0.25, 0.35])).ravel().tolist() == [1, 1, 2, 3]
    assert program.duration == 0.4
    assert len(program.time) == 3


def test_trial_with_a_frame_at_rest() -> None:
    program = program_of(np.array([0.0, 0.1, 0.2]), np.array([[9.0], [1.0], [2.0]]))
    assert program.time.tolist() == [0.0, 0.1]
    assert program.pressure.ravel().tolist() == [1, 2]


def test_trial_as_pressures(data: Path) -> None:
    program = read_pressures(str(data / "rig_a" / "trials" / "000.npz"), build("basic"))
    assert program.pressure.tolist() == [[4e5, 3e5, 3e5, 4e5, 2e5, 3e5, 4e5, 1e5]]
    assert program.duration == 1.5


def test_limit_of_a_muscle_type() -> None:
    kind = replace(CROSS.muscle_types["EM20"], max_pressure=3e5)
    with pytest.raises(InputError, match="350 kPa; expected at most 300 kPa"):
        read_pressures("300,350", replace(CROSS, muscle_types={"EM20": kind}))


BAD_ROWS = [
    ("400", "channel 1 has no pressure"),
    ("400,0,0", "pressures for 3 channels"),
    ("nan,0", "channel 0 has pressure NaN"),
    ("0,-1", "channel 1 has pressure -1 kPa"),
    ("0,1001", "at most 1000 kPa"),
    ("inf,0", "at most 1000 kPa"),
    ("400;0", "no such file"),
    ("400,zero", "no such file, and no row"),
    ("none.csv", "none.csv: no such file"),
    ("none.npz", "none.npz: no such file"),
]


@pytest.mark.parametrize(("spec", "problem"), BAD_ROWS)
def test_bad_row_is_one_line(spec: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as caught:
        read_pressures(spec, CROSS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("time_s,channel_0,channel_2\n0,1,2\n", "expected time_s,channel_0,channel_1"),
        ("time_s,channel_0,channel_1\n0.1,1,2\n", "first row at 0"),
        ("time_s,channel_0,channel_1\n0,1,2\n0,1,2\n", "does not rise"),
        ("time_s,channel_0,channel_1\n0,1\n", "line 2: 2 values"),
        ("time_s,channel_0,channel_1\n0,1,nan\n", "finite"),
        ("time_s,channel_0,channel_1\n0,1,-2\n", "from 0"),
        ("time_s,channel_0\n0,1\n", "channel 1 has no pressure"),
        ("", "is empty"),
    ],
)
def test_bad_csv_is_one_line(text: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(InputError, match=problem):
        read_pressures(tmp_path / "p.csv", CROSS)


def test_design_without_muscles_has_no_channels() -> None:
    with pytest.raises(InputError, match="expected 0 channels"):
        read_pressures("100", standard())


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("2bar,0", [200e3, 0.0]),
        ("200kPa, 0.2 MPa", [200e3, 200e3]),
        ("29psi,0.29BAR", [29 * 6894.757293168, 29e3]),
        ("1e2,200", [100e3, 200e3]),
    ],
)
def test_a_row_may_name_its_units(row: str, expected: list[float]) -> None:
    assert read_pressures(row, CROSS).pressure.tolist() == [expected]


@pytest.mark.parametrize("row", ["2bar,100", "2m,0", "2mPa,0", "bar,0", "2 bar 3,0"])
def test_a_row_whose_units_could_mean_two_things_is_refused(row: str) -> None:
    with pytest.raises(InputError, match=r"expected one at each|no row of pressures such as|no such file"):
        read_pressures(row, CROSS)


def test_bar_written_as_kilopascals_is_said() -> None:
    line = "2,2: the largest pressure is 2 kPa, and the muscles' benches go to 400 kPa: next to nothing moves;"
    for row, slight in (("2,2", True), ("0,0", False), ("2bar,2bar", False), ("20,0", False)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            note_slight(float(read_pressures(row, CROSS).pressure.max()), CROSS, row)
        assert [str(one.message).startswith(line) for one in caught] == [True] * slight
