"""Cloud files: what is sound reads back the same, what is not is refused in one line."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.clouds.cloud_file import read_cloud, read_geometry
from fabdesign.clouds.ply import read_ply, write_ply
from fabdesign.errors import InputError
from tests.meshes import sheet, write_obj, write_stl, write_xyz

DATA = Path(os.environ.get("FABDESIGN_DATA", Path(__file__).resolve().parents[2] / "../shared/data"))
SQUARE = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def one_line(error):
    assert "\n" not in str(error.value)
    return True


@pytest.fixture
def write(tmp_path):
    def write_file(content, name="cloud.ply"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def ascii_ply(rows, count=None, extra=""):
    header = f"ply\nformat ascii 1.0\ncomment made here\nelement vertex {len(rows) if count is None else count}\n"
    header += "property double x\nproperty double y\nproperty double z\n" + extra + "end_header\n"
    return header + "".join(f"{row}\n" for row in rows)


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_of_either_order_with_other_properties_and_polygons(write, order):
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = (
        f"ply\r\nformat {name} 1.0\r\nelement vertex 4\r\n"
        "property float x\r\nproperty uchar red\r\nproperty float y\r\n"
        "property float z\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
    )
    body = b"".join(struct.pack(order + "fBff", x, 7, y, z) for x, y, z in SQUARE)
    ply = read_ply(write(header.encode() + body + struct.pack(order + "B4i", 4, 0, 1, 2, 3)))
    np.testing.assert_allclose(ply.points, SQUARE, atol=1e-8)
    np.testing.assert_array_equal(ply.triangles, FACES)


def test_ascii_with_faces(write):
    faces = "element face 2\nproperty list uchar int vertex_index\n"
    rows = [" ".join(map(str, p)) for p in SQUARE]
    ply = read_ply(write(ascii_ply([*rows, "3 0 1 2", "3 0 2 3"], count=4, extra=faces)))
    np.testing.assert_array_equal(ply.points, SQUARE)
    np.testing.assert_array_equal(ply.triangles, FACES)


@settings(max_examples=20, deadline=None)
@given(
    points=st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 3), min_size=1, max_size=20),
    cut=st.floats(0, 1, exclude_max=True),
)
def test_written_reads_back_and_no_cut_is_accepted(tmp_path_factory, points, cut):
    path = tmp_path_factory.mktemp("ply") / "cloud.ply"
    write_ply(path, np.array(points), FACES[:, :1].repeat(3, axis=1) * 0)
    np.testing.assert_array_equal(read_ply(path).points, points)
    content = path.read_bytes()
    path.write_bytes(content[: int(cut * len(content))])
    with pytest.raises(InputError) as error:
        read_ply(path)
    assert one_line(error)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (ascii_ply(["0 0 0", "1 1 1"], count=3), "ends after 2 of 3 vertex rows"),
        (ascii_ply(["0 0 0", "1 1 1"], count=1), "1 rows more"),
        (ascii_ply(["0 0 0", "1 1"]), "vertex row 1 has 2 values"),
        (ascii_ply(["0 0 zero"]), "vertex row 0 is no row of numbers"),
        (ascii_ply(["0 0 0"]).replace("double z", "double w"), "no x, y, z"),
        (ascii_ply(["0 0 0"]).replace("double z", "half z"), "property half z"),
        (ascii_ply(["0 0 0"]).replace("ascii 1.0", "ascii 2.0"), "format ascii 2.0"),
        (ascii_ply(["0 0 0"]).replace("end_header", ""), "no PLY header"),
        ("solid cube\n", "no PLY header"),
        (
            ascii_ply(["0 0 0", "3 0 0 9"], 1, "element face 1\nproperty list uchar int vertex_indices\n"),
            "vertex 9 of 1",
        ),
    ],
)
def test_unsound_ply_is_refused(write, content, message):
    with pytest.raises(InputError, match=message) as error:
        read_ply(write(content))
    assert one_line(error)


def test_clouds_that_no_computation_should_see(write, tmp_path):
    for content, message in [
        (ascii_ply([]), "empty"),
        (ascii_ply(["0 0 1", "nan 0 0", "0 0 nan"]), "of 3 points 2 not finite; expected at least half of them sound"),
        (ascii_ply(["0 -100 3", "90 -190 0"]), "is it in millimetres"),
    ]:
        with pytest.raises(InputError, match=message):
            read_cloud(write(content))
    with pytest.raises(InputError, match="no such file"):
        read_cloud(tmp_path / "none.ply")
    with pytest.raises(InputError, match=r"of no kind that is read; expected a cloud or mesh \(.ply, .pcd, .pts, .obj"):
        read_cloud(write("x", "cloud.doc"))
    with pytest.raises(InputError, match="damaged or cut short"):
        read_cloud(write(b"PK\x03\x04 cut", "cloud.npz"))
    np.savez(tmp_path / "other.npz", vertices=SQUARE)
    with pytest.raises(InputError, match="no array points; it has vertices"):
        read_cloud(tmp_path / "other.npz")
    np.savez(tmp_path / "words.npz", points=np.array(["one", "two"]))
    with pytest.raises(InputError, match=r"points is \(2,\) <U3; expected numbers"):
        read_cloud(tmp_path / "words.npz")
    np.save(tmp_path / "one", SQUARE)
    with pytest.raises(InputError, match="holds one array; expected an npz"):
        read_cloud((tmp_path / "one.npy").rename(tmp_path / "one.npz"))


def test_clouds_and_meshes_from_their_files(tmp_path):
    write_ply(tmp_path / "cloud.ply", SQUARE)
    np.testing.assert_allclose(read_cloud(tmp_path / "cloud.ply"), SQUARE, atol=1e-8)
    np.savez(tmp_path / "points.npz", points=SQUARE)
    np.testing.assert_array_equal(read_cloud(tmp_path / "points.npz"), SQUARE)
    write_ply(tmp_path / "mesh.ply", SQUARE, FACES)
    assert read_geometry(tmp_path / "mesh.ply").is_mesh
    drawn = read_geometry(tmp_path / "mesh.ply").sample(50, np.random.default_rng(3))
    assert drawn.shape == (50, 3)
    assert np.ptp(drawn[:, :2], axis=0).min() > 0.08
    again = read_geometry(tmp_path / "mesh.ply").sample(50, np.random.default_rng(3))
    np.testing.assert_array_equal(drawn, again)


POINTS, TRIANGLES = sheet(4, 3, roll=9.0)


@pytest.mark.parametrize("kind", ["obj", "ascii.stl", "binary.stl", "ply"])
def test_a_mesh_is_the_same_surface_from_every_kind_of_file(tmp_path, kind):
    path = tmp_path / f"sheet.{kind}"
    if kind == "obj":
        write_obj(path, POINTS, TRIANGLES)
    elif kind == "ply":
        write_ply(path, POINTS, TRIANGLES)
    else:
        write_stl(path, POINTS, TRIANGLES, ascii=kind.startswith("ascii"))
    read = read_geometry(path)
    assert read.is_mesh
    np.testing.assert_allclose(read.points[read.triangles], POINTS[TRIANGLES], atol=1e-8)


@pytest.mark.parametrize(
    ("name", "mark", "header"),
    [
        ("a.xyz", " ", ""),
        ("a.xyz", "\t", "# made here"),
        ("a.csv", ",", ""),
        ("a.csv", ";", "X;Y;Z"),
        ("a.csv", ",", "x,y,z"),
    ],
)
def test_clouds_as_text(tmp_path, name, mark, header):
    read = read_geometry(write_xyz(tmp_path / name, POINTS, mark=mark, header=header))
    assert not read.is_mesh
    np.testing.assert_array_equal(read.points, POINTS)


def test_columns_go_by_their_header_and_what_follows_xyz_is_left(write):
    np.testing.assert_array_equal(read_cloud(write("id,z,x,y\n7,.3,.1,.2\n", "a.csv")), [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(read_cloud(write("0.1 0.2 0.3 255 0 0\n", "a.xyz")), [[0.1, 0.2, 0.3]])


def test_obj_polygons_relative_corners_and_a_cloud(write):
    square = "v 0 0 0\nv 1 0 0 # corner\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\n"
    for face in ("f 1//1 2//1 3//1 4//1\n", "f -4 -3 \\\n -2 -1\n"):
        np.testing.assert_array_equal(read_geometry(write(square + face, "a.obj")).triangles, FACES)
    assert not read_geometry(write(square, "a.obj")).is_mesh


@pytest.mark.parametrize("kind", ["obj", "ascii.stl", "binary.stl"])
def test_a_mesh_that_is_cut_short_is_refused(tmp_path, kind):
    path = tmp_path / f"sheet.{kind}"
    points, triangles = sheet(12, 12)
    if kind == "obj":
        write_obj(path, points, triangles)
    else:
        write_stl(path, points, triangles, ascii=kind.startswith("ascii"))
    content = path.read_bytes()
    for share in (0.1, 0.4, 0.72, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        if kind != "obj" or share > 0.6:  # an obj's vertices alone are a sound cloud
            with pytest.raises(InputError) as error:
                read_geometry(path)
            assert one_line(error)


STL = (
    "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n"
)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", "no mesh at all", "has 14 bytes; a header has 84"),
        ("a.stl", b"\0" * 200, "has 200 bytes; its 0 facets need 84"),
        ("a.stl", STL.replace("endsolid s", ""), "a solid has no end"),
        ("a.stl", STL.replace("vertex 1 0 0\n", ""), "facet 0 is not whole"),
        ("a.stl", STL.replace("vertex 1 0 0", "vertex 1 0 one"), "a word where a number should be"),
        ("a.stl", STL.replace("vertex 1 0 0", "vertex 1 0 nan"), "1 of 3 points are not finite"),
        ("a.stl", STL.replace("vertex 1 0 0", "vertex 0 2 0"), "its triangles have no area"),
        ("a.stl", "solid s\nendsolid s\n", "has no triangles"),
        ("a.obj", "v 0 0\n", 'line 1: "v 0 0" is no whole vertex or face'),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", 'line 3: "f 1 2" is no whole'),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2 3\n", "a face names vertex 3 of 2"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 0 1 2\n", "line 4"),
        ("a.obj", "garbage 1 2 3\n", 'line 1: "garbage 1 2 3"'),
        ("a.obj", "# nothing\n", "has no vertices"),
        ("a.xyz", "0 0 0\n0 1\n", 'line 2: "0 1" is no row of numbers as the first'),
        ("a.xyz", "0 0 0\n0 1 one\n", 'line 2: "0 1 one" is no row'),
        ("a.xyz", "0 0 1\n0 nan 1\n0 nan 2\n", "of 3 points 2 not finite"),
        ("a.xyz", "# nothing\n", "the cloud is empty"),
        ("a.csv", "u,v\n1,2\n", 'line 1: "u,v" is neither a point nor a header'),
        ("a.csv", "1,2,3,4\n", "has no header"),
        ("a.csv", b"\xff\xfe\x00", "is not a text file"),
    ],
)
def test_unsound_meshes_and_texts_are_refused(write, name, content, message):
    with pytest.raises(InputError, match=message) as error:
        read_geometry(write(content, name))
    assert one_line(error)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".xyz", ".csv", ".off"])
def test_files_without_end_are_refused_before_they_are_read(tmp_path, suffix):
    if suffix == ".off":
        pytest.importorskip("trimesh", reason="the optional package trimesh is not installed")
    path = tmp_path / f"large{suffix}"
    with path.open("wb") as stream:
        stream.truncate(10**10)  # sparse: takes no room
    with pytest.raises(InputError, match=r"has 10000 MB; expected .* of at most"):
        read_geometry(path)
    (tmp_path / f"device{suffix}").symlink_to("/dev/zero")
    with pytest.raises(InputError, match="is no plain file"):
        read_geometry(tmp_path / f"device{suffix}")


def test_ply_faces_of_several_lengths_and_odd_lists(write):
    extra = "element face {}\nproperty list uchar int vertex_indices\n"
    rows = [" ".join(map(str, p)) for p in SQUARE]
    read = read_ply(write(ascii_ply([*rows, "4 0 1 2 3", "3 0 1 2"], 4, extra.format(2))))
    np.testing.assert_array_equal(read.triangles, [*FACES, FACES[0]])
    for face in ("3 0 1 inf", "3 0 1 1.5", "inf 0 1 2", "3 0 1", "3 0 1 2 3"):
        with pytest.raises(InputError):
            read_ply(write(ascii_ply([*rows, face], 4, extra.format(1))))
    with pytest.raises(InputError, match="face has no properties"):
        read_ply(write(ascii_ply(rows, extra="element face 1000000000000\n").replace("ascii", "binary_big_endian")))


def test_other_meshes_through_trimesh(write):
    pytest.importorskip("trimesh", reason="the optional package trimesh is not installed")
    rows = ["OFF", "4 2 0", *("{} {} {}".format(*p) for p in SQUARE), "3 0 1 2", "3 0 2 3", ""]
    assert read_cloud(write("\n".join(rows), "mesh.off")).shape == (3362, 3)
    with pytest.raises(InputError, match=r"cannot be read as a mesh|no triangles"):
        read_cloud(write("no mesh at all", "bad.off"))


@pytest.mark.skipif(not (DATA / "rig_c").exists(), reason="shared/data is not here")
def test_frame_of_a_measured_trial():
    path = DATA / "rig_c/trials/000.npz"
    assert read_geometry(path, frame=3).points.shape == (1500, 3)
    with pytest.raises(InputError, match="frame 90; expected -90 to 89"):
        read_geometry(path, frame=90)
    assert len(read_cloud(DATA / "recording_basic/reference/back_left.ply")) == 3685
