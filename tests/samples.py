"""Sound files of every kind that is read, small, and what damages them."""

import random
import re
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fabdesign.clouds.ply import ply_bytes
from fabdesign.files.model_file import write_model
from fabdesign.files.motion_file import write_motion
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Covariance, Model, Parameter
from tests.command_line import Hanging, write_sound
from tests.meshes import sheet, write_obj, write_stl, write_xyz

CASES = Path(__file__).parent / "data" / "cases"
_TOKEN = re.compile(rb'"[^"\n]*"|[-+\w.]+')
_WORDS = [
    b"", b"0", b"-1", b"1e400", b"nan", b"inf", b"9" * 25, b"[]", b"{}", b'""', b"true", b"1.5", b"-0.0", b"65536",
    b'"\\u0000"', b'"' + b"x" * 300 + b'"', b"[[1]]", b"1_0", b";", b",", b"\xff", b"a.b", b"0,5", b"1979-05-27",
]  # fmt: skip
_HEAD = 'format = "fabdesign.study/1"\nkind = "{}"\ndesign = "cross.toml"\n'
_TARGET = '[target]\nfile = "set/trials/000.npz"\n'
_STUDIES = {
    "optimize": _TARGET + "frame = -1\n[variables]\npositions = true\nmuscles = { min = 1, max = 3 }\n"
    "[limits]\npressure = [0.0, 300.0]\nspacing = 0.006\nseconds = 3\n",
    "sensitivity": 'method = "morris"\ntrajectories = 4\n[parameters.pressure.0]\nlow = 1\nhigh = 9\n',
    "layouts": _TARGET + '[grid]\nmuscles = [1, 2]\nsides = ["front"]\n[limits]\nevaluations = 250\nseconds = 600\n',
    "unseen": 'model = "model.toml"\nsamples = 200\npressures = [[200, 200]]\n[rig_limits]\npressure = 250\n',
    "loop": _TARGET + '[rig]\nkey = "key.toml"\n[trials]\nseconds = 1.0\n[stop]\nturns = 1\n',
}
_TEXTS = {
    "key.toml": 'format = "fabdesign.key/1"\nseed = 3\n[parameters]\nbending = 1.1\n[[effects]]\nname = "filling_lag"\n'
    "[effects.parameters]\nfill = 0.1\n[sensing]\nframe_rate = 60.0\npoints = 500\nnoise_m = 0.0006\nstrays = 0.01\n",
    "part.toml": 'format = "fabdesign.design/1"\n[muscle_types.EM20]\nouter_diameter = 0.002\n'
    'mass_per_length = 0.0036\naxis_offset = 0.0009\nbench = "em20_bench.csv"\n',
    "bench.toml": 'format = "fabdesign.bench/1"\nspecimen = "strip"\ninput = ["stretch"]\noutput = "force_n"\n'
    'width = 0.02\n[[records]]\nfile = "record.csv"\n',
    "record.csv": "time_s,stretch,force_n\n0,1.0,0\n0.1,1.01,0.1\n0.2,1.02,0.2\n0.3,1.01,0.1\n",
    "law.toml": 'format = "fabdesign.bench-law/1"\n[law]\nspecimen = "actuator"\n'
    'output = "displacement"\ntable = "law.csv"\n',
    "law.csv": "pressure_kpa,displacement_m\n0,0\n100,0.01\n",
    "curve.csv": "strain,tension_n_per_m,direction\n0,0,both\n0.05,20,both\n0.1,50,both\n",
    "lab.csv": "Zeit [ms];Kanal 0 [bar];Kanal 1 [bar]\n0;1,5;0\n500;2,0;0,25\n",
    "mesh.off": "OFF\n4 2 0\n0 0 0\n0.1 0 0\n0.1 0.1 0\n0 0.1 0\n3 0 1 2\n3 0 2 3\n",
    "points.pts": "3\n0.1 0 0 7\n0 0.1 0 7\n0 0 0.1 7\n",
    "named.csv": "id;x_mm;y_mm;z_mm\n1;0,5;1;2\n2;3;4,5;6\n3;1;2;3\n",
}


NAMES = (
    *(f"{kind}.toml" for kind in _STUDIES), "cross.toml", "bare.toml", "model.toml", "key.toml", "part.toml",
    "bench.toml", "law.toml", "set/set.toml", "recording/recording.toml", "p.csv", "lab.csv", "sep_line.csv",
    "curve.csv", "record.csv", "named.csv", "em20_bench.csv", "set/trials/000.npz", "motion.npz", "points.npz",
    "points.npy", "points.pts", "points.xyz", "cloudcompare.asc", "mesh.ply", "mixed.ply", "mesh.obj", "mesh.off",
    "mesh.glb", "binary.stl", "ascii.stl", "binary.pcd", "ascii.pcd", "packed.pcd", "one.mcap", "markers.c3d",
)  # fmt: skip


def write_samples(folder: Path) -> None:
    """Write a sound file of every kind, those of NAMES, beside what they name."""
    write_sound(folder)
    covariance = Covariance(("membrane",), np.array([[1e-3]]))
    write_model(Model({"membrane": Parameter(1.1, (1.0, 1.2))}, covariance=covariance), folder / "model.toml")
    for name, text in _TEXTS.items():
        (folder / name).write_text(text)
    for kind, text in _STUDIES.items():
        (folder / f"{kind}.toml").write_text(_HEAD.format(kind) + text)
    shutil.copytree(CASES / "dropped_frame", folder / "recording")
    shutil.copy(CASES / "sep_line.csv", folder)
    cloud = (CASES / "cloudcompare.asc").read_text().splitlines()
    (folder / "cloudcompare.asc").write_text("\n".join([*cloud[:2], "20", *cloud[3:23], ""]))
    shutil.copy(CASES / "empty_message" / "clouds.mcap", folder / "one.mcap")
    points, triangles = sheet(3, 3, roll=9.0)
    write_obj(folder / "mesh.obj", points, triangles)
    write_stl(folder / "binary.stl", points, triangles)
    write_stl(folder / "ascii.stl", points, triangles, ascii=True)
    write_xyz(folder / "points.xyz", points)
    (folder / "mesh.ply").write_bytes(ply_bytes(points, triangles))
    _ascii_ply(folder / "mixed.ply", points)
    _pcd(folder, points)
    np.save(folder / "points.npy", points)
    np.savez(folder / "points.npz", points=points)
    case = Case(build("cross"), constant_program([1e5, 0.0], 0.3))
    write_motion(folder / "motion.npz", np.array([0.1, 0.2]), Hanging().motions([case], [np.arange(2.0)])[0][:, ::41])
    _optional(folder, points, triangles)


def mutated(content: bytes, rng: random.Random) -> bytes:
    """The content with one to three changes: bytes, stretches, the end, or, of a text, words."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(len(content) + 1)
        length = rng.choice((1, 2, 8, 64))
        kind = rng.randrange(7)
        if kind == 0:
            content = content[:at] + bytes(rng.randrange(256) for _ in range(length)) + content[at + length :]
        elif kind == 1:
            content = content[:at] + content[at + length :]
        elif kind == 2:
            content = content[:at] + content[at : at + length] + content[at:]
        elif kind == 3:
            content = content[:at]
        elif words := list(_TOKEN.finditer(content[:20000])):
            word = rng.choice(words)
            content = content[: word.start()] + rng.choice(_WORDS) + content[word.end() :]
    return content


def _ascii_ply(path: Path, points: np.ndarray) -> None:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(head + "".join("{} {} {}\n".format(*p) for p in points) + "3 0 1 4\n4 0 1 5 4\n")


def _pcd(folder: Path, points: np.ndarray) -> None:
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\nPOINTS {0}\nDATA {1}\n"
    body = points.astype("<f4").tobytes()
    (folder / "binary.pcd").write_bytes(head.format(len(points), "binary").encode() + body)
    rows = "".join("{} {} {}\n".format(*p) for p in points)
    (folder / "ascii.pcd").write_text(head.format(len(points), "ascii") + rows)
    columns = np.ascontiguousarray(points.T.astype("<f4")).tobytes()
    packed = b"".join(bytes([len(columns[i : i + 32]) - 1]) + columns[i : i + 32] for i in range(0, len(columns), 32))
    sizes = struct.pack("<II", len(packed), len(columns))
    (folder / "packed.pcd").write_bytes(head.format(len(points), "binary_compressed").encode() + sizes + packed)


def _optional(folder: Path, points: np.ndarray, triangles: np.ndarray) -> None:
    """What only optional packages write."""
    import trimesh

    (folder / "mesh.glb").write_bytes(trimesh.Trimesh(points, triangles, process=False).export(file_type="glb"))
    try:
        import c3d
    except ImportError:
        return
    writer = c3d.Writer(point_rate=100)
    writer.add_frames([(np.concatenate([points, np.zeros((len(points), 2))], axis=1), np.zeros((0, 1)))] * 2)
    writer.set_point_labels([f"M{i}" for i in range(len(points))])
    with (folder / "markers.c3d").open("wb") as stream:
        writer.write(stream)


def mutations(file: Path, number: int, seed: int) -> Iterator[Path]:
    """So many damaged copies of a file, one after another in its place beside what it names."""
    content, rng = file.read_bytes(), random.Random(f"{seed} {file.name}")
    damaged = file.with_name(f"damaged{file.suffix}")
    for _ in range(number):
        damaged.write_bytes(mutated(content, rng))
        yield damaged
    damaged.unlink()
