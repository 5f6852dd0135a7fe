"""Files as laboratories write them: what is plain to a person is read and said, what is not is refused in one line."""

import json
import re
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.clouds.cloud_file import read_cloud, read_geometry
from fabdesign.clouds.ply import write_ply
from fabdesign.clouds.recording import Recording, Sensor
from fabdesign.clouds.target_file import PlacedTarget, read_target
from fabdesign.errors import InputError, InputNote
from fabdesign.files.bench_file import read_record
from fabdesign.files.law_tables import read_bench_table, read_membrane_curve, write_bench_table
from fabdesign.files.pressure_file import constant_program, read_csv
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.csv_table import read_raw_table
from fabdesign.formats.lab_table import parse_heading
from fabdesign.geometry.distances import nearest_distances
from fabdesign.geometry.metrics import distance_to_faces
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.muscle import BenchTable
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.objective import Objective, Target
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line

pytestmark = pytest.mark.filterwarnings("ignore::fabdesign.errors.InputNote")
FABRIC = build("vertical").fabric
LAW = BenchTable((0.0, 0.0, 5e4, 5e4, 1e5, 1e5), (-0.02, 0.1) * 3, (5.45, -5.4, 6.18, -5.06, 8.5, -2.1))


def tube(count: int = 600, seed: int = 1) -> NDArray[np.float64]:
    """(count, 3) m on a half tube of 0.2 m of cloth, its axis down."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(-np.pi / 2, np.pi / 2, count), 0.2 / np.pi
    return np.stack([radius * np.sin(angle), -0.2 * rng.random(count), radius * (1 - np.cos(angle))], axis=1)


TUBE, MARKERS = tube(), tube(20, seed=2)


def notes_of(read: Callable[[], object]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read()
    assert all(issubclass(each.category, InputNote) for each in caught)
    return [str(each.message) for each in caught]


def target_of(file: Path, **how: object) -> PlacedTarget:
    return read_target(TargetFile(file, **how), FABRIC)  # type: ignore[arg-type]


def rows_of(bench: BenchTable) -> list[tuple[float, float, float]]:
    return sorted(zip(bench.pressure, bench.contraction, bench.force, strict=True))


def ascii_pcd(points: NDArray[np.float64], count: int | None = None) -> str:
    n = len(points) if count is None else count
    header = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
    header += f"WIDTH {n}\nHEIGHT 1\n"
    header += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA ascii\n"
    return header + "".join("{!r} {!r} {!r} 4294901760\n".format(*map(float, p)) for p in points)


def lzf(content: bytes, repeats: int) -> bytes:
    """A block that was written once and is repeated, as LZF has it: new bytes, then references that overlap."""
    packed = b"".join(bytes([len(content[i : i + 32]) - 1]) + content[i : i + 32] for i in range(0, len(content), 32))
    back, remaining = len(content) - 1, len(content) * (repeats - 1)
    while remaining:
        length = min(remaining, 264)
        length -= 1 if 0 < remaining - length < 3 else 0
        code = length - 2
        start = bytes([(min(code, 7) << 5) | (back >> 8)]) + (bytes([code - 7]) if code >= 7 else b"")
        packed, remaining = packed + start + bytes([back & 255]), remaining - length
    return packed


# --- the folder of cases, where it is there ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bench_semicolon.csv", "bench_units_row.csv", "bench_tabs.txt"])
def test_case_benches_are_the_law_that_they_were_made_of(name: str, data: Path) -> None:
    truth = rows_of(read_bench_table(data / "rig_e" / "em20_bench.csv"))
    (line,) = notes_of(lambda: read_bench_table(data / "cases" / name))
    assert "as pressure" in line
    rows = rows_of(read_bench_table(data / "cases" / name))
    np.testing.assert_allclose(rows, truth, rtol=0, atol=0.4 if "units" in name else 1e-9)  # psi with four digits


def test_case_pressures(data: Path) -> None:
    file = data / "cases" / "pressures_semicolon.csv"
    (line,) = notes_of(lambda: read_csv(file))
    assert "Kanal 0 [bar] as channel_0" in line
    program = read_csv(file)
    np.testing.assert_allclose(program.time, 0.3 * np.arange(6), atol=1e-12)
    np.testing.assert_array_equal(program.pressure[:, 0], 1e5 * np.array([0, 1, 2, 3, 1.5, 0]))
    np.testing.assert_array_equal(program.pressure[:, 1], 1e5 * np.array([0, 0, 0.5, 1, 2, 0]))


def test_case_markers_are_one_target(data: Path) -> None:
    cases = data / "cases"
    given = target_of(cases / "markers20.ply")
    assert given.markers
    assert len(given.points) == 20
    for name in ("points_only.obj", "lines_only.obj"):
        np.testing.assert_allclose(target_of(cases / name).points, given.points, atol=1e-6)
    for name in ("markers20.ply", "points_only.obj", "lines_only.obj"):
        fitted = target_of(cases / name, place="fit")
        np.testing.assert_allclose(fitted.points, given.points, atol=1e-6)
    for how in ({"unit": "mm", "rotation": (-90.0, 0.0, 0.0)}, {"unit": "mm", "place": "fit"}, {"place": "fit"}):
        placed = target_of(cases / "markers20_mm_zup.csv", **how)
        np.testing.assert_allclose(placed.points, given.points, atol=1e-4)  # tenths of a millimetre in the file
    with pytest.raises(InputError, match="has 3 points; expected at least 6"):
        target_of(cases / "three_points.ply")


def test_case_clouds_are_the_same_points_and_pose(data: Path) -> None:
    cases = data / "cases"
    cloud = read_cloud(cases / "cloud.npy")
    assert len(cloud) == 600
    np.testing.assert_allclose(read_cloud(cases / "cloud.pcd"), cloud, atol=1e-5)  # as many digits as stand there
    np.testing.assert_allclose(read_cloud(cases / "cloud.pts"), cloud, atol=1e-5)
    pose = target_of(cases / "cloud.npy", place="fit").placement
    for name, count in (("missing_pixels.ply", 60), ("one_far_point.ply", 1), ("some_nan.ply", 12)):
        (line,) = notes_of(lambda name=name: read_geometry(cases / name))  # type: ignore[misc]
        assert f"{count} of " in line
        placed = target_of(cases / name, place="fit")
        assert len(placed.points) == (588 if count == 12 else 600)
        assert placed.placement.rotation == pose.rotation
        np.testing.assert_allclose(placed.placement.translation, pose.translation, atol=5e-4)
        kept = target_of(cases / name).points
        assert nearest_distances(kept, cloud).max() < 1e-5  # the same cloud, less what was left out


# --- tables -----------------------------------------------------------------------------------------------------------

SEMICOLONS = """Druck [bar];Kontraktion [%];Kraft [N]
0,00;-2,0;5,45\n0,00;10,0;-5,4\n0,50;-2,0;6,18\n0,50;10,0;-5,06\n1,00;-2,0;8,5\n1,00;10,0;-2,1
"""
UNITS_ROW = """\ufeffpressure,contraction,force\r\nMPa,%,kN
0,-2,0.00545\n0,10,-0.0054\n.05,-2,.00618\n.05,10,-.00506\n0.1,-2,.0085\n0.1,10,-.0021
"""
TABS = """# rig 2\n# run 3\nforce_N\tpressure_mbar\tcontraction\toperator
5.45\t0\t-0.02\tA\n-5.4\t0\t.1\tA\n6.18\t500\t-.02\tB\n-5.06\t500\t.1\tB\n8.5\t1000\t-.02\tB\n-2.1\t1000\t.1\tB
"""
BLANKS = """contraction pressure_kPa force_N
-0.02 0 5.45\n0.1   0 -5.4\n-.02 50 6.18\n.1 50 -5.06\n-.02 100 8.5\n.1 100 -2.1
"""
BENCHES = {
    SEMICOLONS: "written with semicolons and decimal commas; read Druck [bar] as pressure",
    UNITS_ROW: "pressure in MPa as pressure, contraction in % as contraction, force in kN as force",
    TABS: "left operator",
    BLANKS: "written with blanks; read contraction as contraction, pressure_kPa as pressure, force_N as force",
}


@pytest.mark.parametrize("text", BENCHES, ids=["semicolons", "units row", "tabs", "blanks"])
def test_a_bench_is_the_same_law_however_it_is_written(text: str, tmp_path: Path) -> None:
    (tmp_path / "b.csv").write_text(text, encoding="utf-8", newline="")
    (line,) = notes_of(lambda: read_bench_table(tmp_path / "b.csv"))
    assert BENCHES[text] in line
    np.testing.assert_allclose(rows_of(read_bench_table(tmp_path / "b.csv")), rows_of(LAW), rtol=1e-12)
    write_bench_table(LAW, tmp_path / "own.csv")
    assert notes_of(lambda: read_bench_table(tmp_path / "own.csv")) == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[bar]", "[furlong]", "Druck [furlong] has the unit furlong"),
        ("Druck [bar]", "Druck", "Druck has no unit"),
        ("Druck [bar]", "Kraft [kN]", "2 columns hold the force|no column holds the pressure"),
        ("[bar]", "[N]", "no column holds the pressure"),
        ("0,50", "0.50", "not both"),
        ("5,45", "5,45;7", "4 values; the header names 3 columns"),
        ("5,45", "", "expected a finite number"),
        ("5,45", "1.000,5", "expected a finite number"),
        ("10,0", "110,0", "expected 1 - l/l0, no percentage"),
        ("0,00", "-0,10", "expected a gauge pressure from 0"),
    ],
)
def test_what_could_mean_two_things_is_refused(old: str, new: str, problem: str, tmp_path: Path) -> None:
    assert old in SEMICOLONS
    (tmp_path / "b.csv").write_text(SEMICOLONS.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_bench_table(tmp_path / "b.csv")
    assert any(part in str(caught.value) for part in problem.split("|")), caught.value
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "name", "symbol"),
    [
        ("pressure_kpa", "pressure", "kpa"),
        ("Pressure (MPa)", "pressure", "MPa"),
        ("force / N", "force", "N"),
        ("Kraft in N", "kraft", "N"),
        ("tension_n_per_m", "tension", "n_per_m"),
        ("channel_0", "channel_0", None),
        ("Kanal 3 [bar]", "kanal_3", "bar"),
        ("contraction", "contraction", None),
    ],
)
def test_headings(text: str, name: str, symbol: str | None) -> None:
    heading = parse_heading(text)
    assert (heading.name, heading.symbol) == (name, symbol)


def test_pressures_of_any_unit_and_channels_that_are_not_plain(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("t [ms];p left [psi];p right [psi]\n0;0;14,5038\n500;29,0076;0\n")
    (line,) = notes_of(lambda: read_csv(path))
    assert "p left [psi] as channel_0, p right [psi] as channel_1" in line
    np.testing.assert_allclose(read_csv(path).pressure, [[0, 1e5], [2e5, 0]], atol=1)
    np.testing.assert_allclose(read_csv(path).time, [0, 0.5])
    for header in ("t [ms];Kanal 1 [bar];Kanal 2 [bar]", "t;Kanal 0 [bar];Kanal 1 [bar]", "t [ms];Kanal 0;Kanal 1"):
        path.write_text(f"{header}\n0;0;1\n500;2;0\n")
        with pytest.raises(InputError, match=r"columns are .*; expected time_s,channel_0"):
            read_csv(path)


def test_records_and_curves(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("Zeit [ms];Druck [bar];Kraft [N];supply_bar\n0;0,5;1,5;7\n10;1;2;7\n")
    record = read_record(tmp_path / "r.csv", ("time_s", "pressure_kpa", "force_n"))
    expected = {"time": [0, 0.01], "pressure": [5e4, 1e5], "force": [1.5, 2], "supply_bar": [7, 7]}
    assert {name: column.tolist() for name, column in record.items()} == expected
    (tmp_path / "c.csv").write_text("Dehnung [%];tension [N/mm]\n0;0\n10;0,04\n")
    curve = read_membrane_curve(tmp_path / "c.csv")
    assert curve.strain[0] == (0.0, 0.1)
    assert curve.tension[1] == (0.0, 40.0)


@pytest.mark.parametrize(
    ("heading", "values", "column", "expected"),
    [
        ("Length [mm]", (200, 180), "contraction", (0.0, 0.1)),
        ("Length [mm]", (200, 220), "stretch", (1.0, 1.1)),
        ("Extension [mm]", (0, 20), "stretch", (1.0, 1.1)),
        ("Strain [%]", (0, 10), "stretch", (1.0, 1.1)),
    ],
)
def test_a_length_or_strain_of_a_bench_says_its_ratio(
    tmp_path: Path, heading: str, values: tuple[float, float], column: str, expected: tuple[float, float]
) -> None:
    file = tmp_path / "r.csv"
    file.write_text(f"{heading};Force [N]\n{values[0]};0\n{values[1]};1\n")
    np.testing.assert_allclose(read_record(file, (column,), rest_length=0.2)[column], expected, atol=1e-12)
    if "mm" in heading:
        with pytest.raises(InputError, match=rf"no column {column}; it has .*rest_length in \[constants\]"):
            read_record(file, (column,))


@settings(max_examples=40)
@given(st.lists(st.lists(st.integers(-(10**6), 10**6), min_size=3, max_size=3), min_size=1, max_size=5), st.booleans())
def test_numbers_read_back_the_same_with_any_separator(
    tmp_path_factory: pytest.TempPathFactory, numbers: list[list[int]], comma: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "t.csv"
    for mark in (";", "\t"):
        cells = [[f"{n / 1000:.3f}".replace(".", "," if comma else ".") for n in row] for row in numbers]
        path.write_text("\n".join(mark.join(row) for row in [["a", "b", "c"], *cells]))
        rows = read_raw_table(path).rows
        assert [[round(1000 * float(cell)) for cell in row] for _, row in rows] == numbers


@settings(max_examples=40)
@given(
    content=st.binary(max_size=200), suffix=st.sampled_from(["csv", "pcd", "pts", "npy", "xyz", "ply", "obj", "stl"])
)
def test_garbage_is_one_line_whatever_it_claims_to_be(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str
) -> None:
    path = tmp_path_factory.getbasetemp() / f"garbage.{suffix}"
    path.write_bytes(content)
    for read in (read_geometry, read_bench_table, read_csv):
        try:
            read(path)
        except InputError as error:
            assert "\n" not in str(error)


# --- clouds -----------------------------------------------------------------------------------------------------------


@settings(max_examples=12)
@given(
    points=st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 3), min_size=2, max_size=9, unique=True),
    cut=st.floats(0, 0.999),
)
def test_clouds_of_every_kind_read_back_and_no_cut_is_accepted(
    tmp_path_factory: pytest.TempPathFactory, points: list[tuple[float, float, float]], cut: float
) -> None:
    folder, cloud = tmp_path_factory.getbasetemp(), np.array(points) + [2, 2, 2]  # none at the origin
    body = cloud.astype("<f8").tobytes()
    header = ascii_pcd(cloud).split("DATA")[0].replace(" rgb", "").replace("F F F U", "F F F")
    header = header.replace("SIZE 4 4 4 4", "SIZE 8 8 8").replace("COUNT 1 1 1 1", "COUNT 1 1 1")
    files = {
        "a.pcd": ascii_pcd(cloud).encode(),
        "b.pcd": f"{header}DATA binary\n".encode() + body,
        "c.pts": "\n".join([str(len(cloud)), *("{!r} {!r} {!r} 7".format(*map(float, p)) for p in cloud)]).encode(),
    }
    for name, content in files.items():
        (folder / name).write_bytes(content)
        np.testing.assert_array_equal(read_geometry(folder / name).points, cloud)
        last = 0 if name == "b.pcd" else len(content.split()[-1])  # a cut within the last number cannot be seen
        (folder / name).write_bytes(content[: int(cut * (len(content) - last - 1))])
        with pytest.raises(InputError):
            read_geometry(folder / name)
    np.save(folder / "d.npy", cloud)
    np.testing.assert_array_equal(read_geometry(folder / "d.npy").points, cloud)
    content = (folder / "d.npy").read_bytes()
    (folder / "d.npy").write_bytes(content[: int(cut * len(content))])
    with pytest.raises(InputError):
        read_geometry(folder / "d.npy")


def test_compressed_pcd(tmp_path: Path) -> None:
    """x, y and z alike, so that what is repeated is a reference to what came before."""
    one = np.linspace(0.01, 0.9, 40).astype("<f4")
    packed = lzf(one.tobytes(), 3)
    header = ascii_pcd(np.zeros((0, 3)), 40).replace(" rgb", "").replace("4 4 4 4", "4 4 4").replace("F F F U", "F F F")
    header = header.replace("COUNT 1 1 1 1", "COUNT 1 1 1").replace("ascii", "binary_compressed")
    sizes = struct.pack("<II", len(packed), 3 * one.nbytes)
    (tmp_path / "a.pcd").write_bytes(header.encode() + sizes + packed)
    np.testing.assert_array_equal(read_geometry(tmp_path / "a.pcd").points, np.stack([one] * 3, axis=1))
    for damaged in (b"\xff" * len(packed), b"\x00" * len(packed)):
        (tmp_path / "a.pcd").write_bytes(header.encode() + sizes + damaged)
        with pytest.raises(InputError, match="damaged"):
            read_geometry(tmp_path / "a.pcd")


def test_an_ascii_pcd_may_have_a_field_without_values(tmp_path: Path) -> None:
    head = "FIELDS time x y z w\nSIZE 4 4 4 4 4\nTYPE F F F F F\nCOUNT 0 1 1 1 0\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(head + "1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(read_geometry(tmp_path / "a.pcd").points, [[1, 2, 3], [4, 5, 6]])


PCD = ascii_pcd(TUBE[:3])


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.pcd", PCD.replace("POINTS 3", "POINTS 4"), "width times height is 3"),
        ("a.pcd", PCD.replace("WIDTH 3", "WIDTH 2").replace("POINTS 3", "POINTS 2"), "has 3 rows; its header says 2"),
        ("a.pcd", PCD.replace("FIELDS x y z", "FIELDS x y w"), "its fields are not x, y, z"),
        ("a.pcd", PCD.replace("TYPE F F F", "TYPE F F Q"), "a size, type or number that is none"),
        ("a.pcd", PCD.replace("DATA ascii", "DATA zipped"), "its data are zipped"),
        ("a.pcd", PCD.replace("WIDTH 3", "WIDTH -3"), "a size, type or number that is none"),
        ("a.pcd", PCD.replace("4294901760\n", "4294901760 1\n", 1), "not as long as the others"),
        ("a.pcd", "", "has no PCD header"),
        ("a.pcd", "ply\nformat ascii 1.0\n", "its header has the line"),
        ("a.pts", "3\n0 0 1\n0 1 1\n", "has 2 points; its first line says 3"),
        ("a.pts", "2\n0 0 1\n0 1\n", "is no row of numbers as the first"),
        ("a.pts", "1\n0 0\n", "is no point"),
        ("a.pts", "0 0 1\n", "is no count"),
        ("a.pts", "0\n", "the cloud is empty"),
        ("a.npy", b"", "damaged or no npy"),
        ("a.npy", b"\x93NUMPY\x01\x00", "damaged or no npy"),
        ("a.csv", "x_mm,y_mm,z_m\n1,2,3\n", "names the units mm, mm, m"),
        ("a.csv", "marker,x,y,z\nM1,1,2\n", "is no row of numbers"),
        ("a.c3d", b"", "C3D"),
        ("a.c3d", b"\x02\x50" + b"\xff" * 600, "C3D"),
    ],
)
def test_unsound_clouds_are_one_line(name: str, content: str | bytes, problem: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=problem) as caught:
        read_geometry(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_texts_in_other_encodings_are_read_and_said(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "b.csv"
    path.write_bytes(("# Prüfstand 3, 20 °C\n" + SEMICOLONS).encode(encoding))
    assert f"{path}: read as {encoding} text" in notes_of(lambda: read_bench_table(path))
    np.testing.assert_allclose(rows_of(read_bench_table(path)), rows_of(LAW), rtol=1e-12)
    cloud = tmp_path / "c.asc"
    cloud.write_bytes("# Gerät 2\n0 0 0\n0.1 0 0\n".encode(encoding))
    assert len(read_geometry(cloud).points) == 2
    path.write_bytes(SEMICOLONS.encode(encoding) + b"\x00\x01\xd8")
    with pytest.raises(InputError, match=r"b\.csv: is not a text file$"):
        read_bench_table(path)


def test_a_header_of_cloudcompare_and_an_image_of_points(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text("//X Y Z R G B\n1 2 3 0 0 0\n4 5 6 0 0 0\n")
    (tmp_path / "b.asc").write_text("// scan of 3 May\n1 2 3 9\n4 5 6 9\n")
    np.save(tmp_path / "c.npy", np.array([[[1, 2, 3]], [[4, 5, 6]]], np.float32))
    for name in ("a.asc", "b.asc", "c.npy"):
        np.testing.assert_array_equal(read_geometry(tmp_path / name).points, [[1, 2, 3], [4, 5, 6]])


def test_npy_of_another_shape_and_length(tmp_path: Path) -> None:
    for wrong in (np.zeros((4, 2)), np.array(["a"]), np.zeros(3)):
        np.save(tmp_path / "a.npy", wrong)
        with pytest.raises(InputError, match=r"expected an npy with points \(n, 3\)"):
            read_geometry(tmp_path / "a.npy")


def test_text_clouds_with_names_units_and_gaps(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("\ufeffMarker;x;y;z\n;mm;mm;mm\nM1;1,5;2;3\nM2;;;\nM3;4;5;6,5\n", encoding="utf-8")
    with pytest.warns(InputNote, match="m.csv: written with semicolons and decimal commas"):
        geometry = read_geometry(path)
    assert geometry.unit == "mm"
    np.testing.assert_array_equal(geometry.points, [[1.5, 2, 3], [4, 5, 6.5]])
    with pytest.raises(InputError, match='its header says mm; expected unit = "mm"'):
        target_of(path, unit="cm")


def test_a_c3d_is_markers_in_its_own_unit(tmp_path: Path) -> None:
    c3d = pytest.importorskip("c3d", reason="the optional package c3d is not installed")
    frames = 1e3 * np.stack([MARKERS, MARKERS + [0, 0, 0.01]])
    writer = c3d.Writer(point_rate=100)
    for frame in frames:
        table = np.concatenate([frame, np.zeros((20, 2))], axis=1)
        table[0, 3] = -1  # not seen
        writer.add_frames([(table, np.zeros((0, 1)))])
    writer.set_point_labels([f"M{i}" for i in range(20)])
    with (tmp_path / "m.c3d").open("wb") as stream:
        writer.write(stream)
    geometry = read_geometry(tmp_path / "m.c3d", frame=1)
    assert geometry.unit == "mm"
    np.testing.assert_allclose(geometry.points, frames[1, 1:], atol=0.01)
    assert len(target_of(tmp_path / "m.c3d", frame=0).points) == 19
    content = (tmp_path / "m.c3d").read_bytes()
    (tmp_path / "m.c3d").write_bytes(content.replace(b"mm  ", b"ft  ", 1))
    with pytest.raises(InputError, match="its unit is 'ft'; expected one of m, cm, mm, in"):
        read_geometry(tmp_path / "m.c3d")
    (tmp_path / "m.c3d").write_bytes(content[:-512])
    with pytest.raises(InputError, match="C3D"):
        read_geometry(tmp_path / "m.c3d")


# --- what a depth sensor adds -----------------------------------------------------------------------------------------

SPOILT = {
    "nan": (np.full((12, 3), np.nan), "12 of 612 points are left out \\(12 not finite\\)"),
    "origin": (np.zeros((60, 3)), "60 of 660 points are left out \\(60 without depth\\)"),
    "camera": (np.full((30, 3), [0.3, 0.1, 0.4]), "30 of 630 points are left out \\(30 without depth\\)"),
    "far": (np.array([[1e4, 0, 0]]), "1 of 601 points are left out \\(1 far off\\)"),
    "metres away": (np.array([[0, 0, 3.0], [0, 2.0, 0]]), "2 of 602 points are left out \\(2 far off\\)"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_target_is_the_same_without_what_a_sensor_adds(kind: str, tmp_path: Path) -> None:
    added, line = SPOILT[kind]
    write_ply(tmp_path / "clean.ply", TUBE)
    write_ply(tmp_path / "spoilt.ply", np.concatenate([TUBE, added]))
    clean, spoilt = (target_of(tmp_path / f"{name}.ply", place="fit") for name in ("clean", "spoilt"))
    np.testing.assert_allclose(spoilt.points, clean.points, atol=1e-9)
    assert spoilt.placement == clean.placement
    notes = notes_of(lambda: read_target(TargetFile(tmp_path / "spoilt.ply", place="fit"), FABRIC))
    assert any(re.search(line, note) for note in notes), notes


def test_more_than_half_is_refused(tmp_path: Path) -> None:
    for bad in (np.nan, 0.0):
        write_ply(tmp_path / "c.ply", np.concatenate([TUBE[:10], np.full((11, 3), bad)]))
        with pytest.raises(InputError, match=r"of 21 points 11 .*; expected at least half of them sound"):
            read_geometry(tmp_path / "c.ply")


def test_a_marker_at_the_origin_is_one(tmp_path: Path) -> None:
    write_ply(tmp_path / "c.ply", np.concatenate([MARKERS, np.zeros((1, 3))]))
    assert notes_of(lambda: read_geometry(tmp_path / "c.ply")) == []


def test_a_trial_is_read_without_them_and_says_so_once(folder: Path, run: Run) -> None:
    path = folder / "set" / "trials" / "001.npz"
    clean = read_trial(path)
    with np.load(path) as arrays:
        content = dict(arrays)
    points = np.concatenate([content["points"] * float(content["scale"]), np.full((3, 3), np.nan), [[0, 0, 50.0]]])
    offsets = content["offsets"].copy()
    offsets[-1] += 4
    np.savez(path, **(content | {"points": points, "offsets": offsets, "scale": np.float64(1)}))
    trial = read_trial(path, size=0.2)
    np.testing.assert_allclose(np.concatenate(trial.frames), np.concatenate(clean.frames))
    code, _, err = run("check", folder / "set")
    assert code == 0
    (line,) = [line for line in err.splitlines() if line.startswith("note: ")]
    assert "001.npz, 1 of 2 frames: 4 of 804 points are left out (3 not finite, 1 far off)" in line
    _, out, _ = run("check", folder / "set", "--json")
    assert len(json.loads(out)["files"][str(folder / "set")]["notes"]) == 1


def test_a_recordings_frame_is_read_without_them(tmp_path: Path) -> None:
    seen = tube(200) + [0, 0, 0.6]  # before the camera
    added = np.concatenate([np.full((5, 3), np.nan), np.zeros((40, 3)), [[0, 0, 9e3]]])
    (tmp_path / "frames" / "0000").mkdir(parents=True)
    write_ply(tmp_path / "frames" / "0000" / "left.ply", np.concatenate([seen, added]))
    sensor = Sensor("left", np.eye(4))
    program = constant_program([0.0])
    recording = Recording(tmp_path, "r", build("cross"), np.array([0.1]), (sensor,), program)
    np.testing.assert_allclose(recording.frame(sensor, 0), seen, atol=1e-6)
    assert sum("left out" in line for line in notes_of(lambda: recording.frame(sensor, 0))) == 1


def test_a_command_says_once_how_a_table_was_read(folder: Path, run: Run, hanging: type) -> None:
    (folder / "p.txt").write_text("Zeit [ms]\tKanal 0 [bar]\tKanal 1 [bar]\n0\t1\t0,5\n500\t2\t0\n")
    code, _, err = run("simulate", folder / "cross.toml", "--pressures", folder / "p.txt", "-o", folder / "out.npz")
    assert code == 0, err
    (line,) = [line for line in err.splitlines() if line.startswith("note: ")]
    assert "written with tabs and decimal commas; read Zeit [ms] as time, Kanal 0 [bar] as channel_0" in line
    np.testing.assert_array_equal(hanging.asked[0].program.pressure, [[1e5, 5e4], [2e5, 0]])  # type: ignore[attr-defined]


# --- markers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, 90.0, 0.0)])
def test_markers_in_any_frame_about_their_own_origin_are_found(
    turn: tuple[float, float, float], tmp_path: Path
) -> None:
    np.save(tmp_path / "m.npy", 1e3 * Rotation.from_euler("xyz", turn, degrees=True).apply(MARKERS))
    fitted = target_of(tmp_path / "m.npy", unit="mm", place="fit")
    assert fitted.turned_over is not None
    both = [
        fitted.points,
        fitted.turned_over.apply(1e3 * Rotation.from_euler("xyz", turn, degrees=True).apply(MARKERS)),
    ]
    assert min(np.abs(points - MARKERS).max() for points in both) < 1e-6


def test_markers_moved_elsewhere_need_a_rotation_and_are_good_to_their_spacing(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", MARKERS + [0.5, 1.0, -2.0])
    with pytest.raises(InputError, match="expected one of them as rotation"):
        target_of(tmp_path / "m.npy", place="fit")
    placed = target_of(tmp_path / "m.npy", place="fit", rotation=(0.0, 0.0, 0.0))
    assert np.abs(placed.points - MARKERS).max() < np.sqrt(0.2 * 0.2 / 20)


def test_distances_of_markers_go_one_way_and_have_their_slope() -> None:
    """Markers 20 mm before the front face of a flat cloth: 20 mm, however few they are. Slope by finite differences."""
    cloth = _flat()
    before = np.array([[-0.052, -0.051, 0.021], [0.031, -0.103, 0.021], [0.001, -0.152, 0.021]])
    assert distance_to_faces(before, cloth) == pytest.approx(0.020, abs=1e-9)
    objective = Objective([Target(before, markers=True)])
    assert objective.value(cloth[None]) == pytest.approx(0.020, abs=1e-9)
    value, slope = objective.gradient(cloth[None])
    assert value == pytest.approx(0.020, abs=1e-9)
    rng = np.random.default_rng(1)
    move = 1e-6 * rng.standard_normal(cloth.shape)
    change = objective.value((cloth + move)[None]) - objective.value((cloth - move)[None])
    assert np.sum(slope[0] * 2 * move) == pytest.approx(change, rel=1e-3)


def _flat() -> NDArray[np.float64]:
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, -0.2, 41))
    faces = [np.stack([u, v, np.full_like(u, z)], axis=-1).reshape(-1, 3) for z in (1e-3, -1e-3)]
    return np.concatenate(faces)


def test_a_search_runs_on_markers_and_says_what_it_measures(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", MARKERS)
    study = Study("m", build("vertical"), (TargetFile(tmp_path / "m.npy"),), limits=StudyLimits(evaluations=8))
    run_study(study, tmp_path / "out", forward=AnalyticCloth())
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["targets"] == ["m.npy, 20 markers: their mean distance to the cloth, one way, in place of Chamfer"]
    assert result["chamfer"] == pytest.approx(result["objective_mm"])
    assert result["chamfer_floor"] < 1e-6 < result["chamfer"]


def test_three_points_are_one_line(folder: Path, run: Run) -> None:
    write_ply(folder / "three.ply", np.array([[0, 0, 0], [0.1, 0, 0], [0, -0.1, 0]]))
    (folder / "study.toml").write_text(
        'kind = "optimize"\ndesign = "cross.toml"\n[target]\nfile = "three.ply"\nplace = "fit"\n'
    )
    one_line(run("check", folder / "study.toml"), "three.ply: has 3 points; expected at least 6")
    one_line(run("optimize", folder / "study.toml", "-o", folder / "out"), "expected at least 6")
