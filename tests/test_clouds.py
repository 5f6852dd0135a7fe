"""Cloud files: what is sound reads back the same, what is not is refused in one line."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.cloud_file import read_cloud, read_mesh
from fabdesign.errors import InputError
from fabdesign.ply import read_ply, write_ply

DATA = Path(os.environ.get("FABDESIGN_DATA", Path(__file__).resolve().parents[1] / "../shared/data"))
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
        (ascii_ply(["0 0 0", "nan 0 0"]), "1 of 2 points are not finite"),
        (ascii_ply(["0 -100 3", "90 -190 0"]), "is it in millimetres"),
    ]:
        with pytest.raises(InputError, match=message):
            read_cloud(write(content))
    with pytest.raises(InputError, match="no such file"):
        read_cloud(tmp_path / "none.ply")
    with pytest.raises(InputError, match="expected a cloud"):
        read_cloud(write("x", "cloud.xyz"))
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
    assert read_mesh(tmp_path / "mesh.ply").areas.sum() == pytest.approx(0.01)
    drawn = read_cloud(tmp_path / "mesh.ply", points=50, seed=3)
    assert drawn.shape == (50, 3)
    assert np.ptp(drawn[:, :2], axis=0).min() > 0.08
    np.testing.assert_array_equal(drawn, read_cloud(tmp_path / "mesh.ply", points=50, seed=3))


def test_foreign_meshes_through_trimesh(write):
    pytest.importorskip("trimesh", reason="the optional package trimesh is not installed")
    rows = [f"v {x} {y} {z}" for x, y, z in SQUARE] + ["f 1 2 3", "f 1 3 4"]
    assert read_cloud(write("\n".join(rows), "mesh.obj"), points=10).shape == (10, 3)
    with pytest.raises(InputError, match=r"cannot be read as a mesh|no triangles"):
        read_cloud(write("no mesh at all", "bad.stl"))


@pytest.mark.skipif(not (DATA / "rig_c").exists(), reason="shared/data is not here")
def test_frame_of_a_measured_trial():
    path = DATA / "rig_c/trials/000.npz"
    assert read_cloud(path, frame=3).shape == (1500, 3)
    with pytest.raises(InputError, match="frame 90; expected -90 to 89"):
        read_cloud(path, frame=90)
    assert len(read_cloud(DATA / "recording_basic/reference/back_left.ply")) == 3685
