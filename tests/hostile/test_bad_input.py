"""Bad input of every command: one line that says what came, where and what was expected; exit 2; nothing written.

THE table of the product: a row is what to run in the folder of `damaged` and what the line says; OUT is never made.
"""

import importlib
import io
import os
import re
import shutil
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.design_file import write_design
from fabdesign.files.model_file import write_model
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.model import EffectTerm, Model
from tests.command_line import Run, one_line, write_sound

BAD = [
    ("simulate none.toml --pressures 1,2 -o OUT", "none.toml: no such file"),
    ("simulate cross.toml --pressures none.csv -o OUT", "none.csv: no such file"),
    ("simulate cross.toml --pressures none.npz -o OUT", "none.npz: no such file"),
    ("simulate cross.toml -o OUT", "expected --pressures"),
    ("simulate cross.toml --pressures 1 -o OUT", "channel 1 has no pressure"),
    ("simulate cross.toml --pressures 1,2,3 -o OUT", "pressures for 3 channels"),
    ("simulate cross.toml --pressures nan,1 -o OUT", "NaN"),
    ("simulate cross.toml --pressures=-5,1 -o OUT", "-5 kPa"),
    ("simulate cross.toml --pressures 1001,0 -o OUT", "at most 1000 kPa"),
    ("simulate cross.toml --pressures 1,2 --model none.toml -o OUT", "none.toml: no such file"),
    ("simulate cross.toml --pressures 1,2 --model cross.toml -o OUT", 'this version reads "fabdesign.model/1"'),
    (
        "simulate cross.toml --pressures 1,2 --model effects.toml -o OUT",
        "did you mean filling_lag",
    ),
    ("simulate cross.toml --pressures 1,2 --without rig -o OUT", "there is no model"),
    ("simulate cross.toml --pressures 1,2 --model model.toml --without rigg -o OUT", "did you mean rig"),
    ("simulate cross.toml --pressures 1,2 --effects none.py -o OUT", "none.py: expected a Python file with effects"),
    ("simulate cross.toml --pressures 1,2 --effects empty.py -o OUT", "declares no effect"),
    ("simulate cross.toml --pressures 1,2 --effects broken.py -o OUT", "SyntaxError"),
    ("simulate cross.toml --pressures 1,2 --rise 2 -o OUT", "expected them with --equilibrium"),
    ("simulate cross.toml --pressures 1,2 --equilibrium --rise 1e9 -o OUT", "is not in the range 0.01<=x<=60"),
    ("simulate cross.toml --pressures 1,2 --duration -1 -o OUT", "above 0"),
    ("simulate cross.toml --pressures 1,2 --frame-rate 0 -o OUT", "above 0"),
    ("simulate cross.toml --pressures 1,2 --frame-rate fast -o OUT", "valid number"),
    ("simulate cross.toml --pressures 1,2", "Missing option"),
    ("simulate cross.toml --pressures 1,2 --equilibrium --duration 1 -o OUT", "a shape at rest has none"),
    ("simulate cross.toml --pressures 1,2 --mesh OUT.stl -o OUT", ".ply or .obj"),
    ("simulate cross.toml --pressures 1,2 --mesh file/OUT.ply -o OUT", "cannot be written"),
    ("simulate newer.toml --pressures 1,2 -o OUT", "fabdesign.design/7"),
    ("simulate outside.toml --pressures 1,2 -o OUT", "lies outside the cloth"),
    ("simulate cross.toml --pressures 1,2 -o file/OUT", "cannot be written"),
    ("predict set --model none.toml -o OUT", "none.toml: no such file"),
    ("predict none --model model.toml -o OUT", "none: no such file"),
    ("predict set/trials/000.npz --model model.toml -o OUT", "expected --design"),
    ("predict set --model model.toml --design cross.toml -o OUT", "no --design"),
    ("predict cut.npz --model model.toml --design cross.toml -o OUT", "cut short"),
    ("predict set/trials/000.npz --model model.toml --design bare.toml -o OUT", "expected 0 channels"),
    ("predict set --model model.toml -o file/OUT", "cannot be written"),
    ("predict set --model model.toml -o file", "expected a folder"),
    ("check none.toml", "no such file"),
    ("check cut.npz", "cut short"),
    ("check cut.ply", "cut.ply"),
    ("check newer.toml", "fabdesign.design/7"),
    ("check set/trials", "a folder without"),
    ("check picture.png", "is not a text file"),
    ("new basik -o OUT", "did you mean basic"),
    ("new basic --muscles none -o OUT", "valid integer"),
    ("new basic -o set", "is a folder"),
    ("new basic -o file/OUT", "cannot be written"),
    ("export none.toml -o OUT", "no such file"),
    ("export cross.toml -o OUT", "EM20 has no tail_length"),
    ("export cross.toml --tail-length 30 -o OUT", "tail length = 30 m; expected 0 to 1 m"),
    (
        "export cross.toml --tail-length 0.03 --seam-allowance nan -o OUT",
        "seam-allowance': 'nan' is not a finite",
    ),
    ("export cross.toml --tail-length 0.03 --paper a3 -o OUT", "'a4', 'letter', 'none'"),
    ("export cross.toml --tail-length 0.03 -o file", "expected a folder"),
    ("export cross.toml --tail-length 0.03 -o file/OUT", "cannot be written"),
    ("optimize none.toml -o OUT", "none.toml: no such file"),
    ("optimize bare_study.toml -o OUT", "has no muscles"),
    ("optimize empty_study.toml -o OUT", "empty.npz frame 0: the cloud is empty"),
    ("optimize mm_study.toml -o OUT", "in millimetres?"),
    ("optimize ply_study.toml -o OUT", "cut.ply"),
    ("optimize good_study.toml -o file/OUT", "cannot be written"),
    ("rig none.toml --pressures 1,2 -o OUT", "none.toml: no such file"),
    ("rig cross.toml --pressures 1,2 3 -o OUT", "3: channel 1 has no pressure"),
    ("rig cross.toml --pressures 1,2 --key cross.toml -o OUT", 'this version reads "fabdesign.key/1"'),
    ("rig cross.toml --pressures 1,2 -o file/OUT", "cannot be written"),
    ("evaluate none --model model.toml", "none: no such file"),
    ("evaluate set --model none.toml", "none.toml: no such file"),
    ("evaluate set --model effects.toml", "unknown effect filing_lag"),
    ("evaluate set --model model.toml -o OUT", "no trial of role test"),
    ("evaluate set --model model.toml -o file/OUT", "cannot be written"),
    ("calibrate none -o OUT", "none: no such file"),
    ("fuse none -o OUT", "none: no such file"),
    ("fuse set -o OUT", "recording.toml: no such file"),
    ("fuse set --convention up -o OUT", "'forward', 'backward'"),
    ("demo -o file/OUT", "cannot be written"),
    ("exprt cross.toml", "No such command"),
    # sizes: estimated before anything is begun
    ("simulate cross.toml --pressures 1,2 --duration 1e9 -o OUT", "a motion of 1e+09 s; expected at most 3600 s"),
    ("simulate cross.toml --pressures 1,2 --duration nan -o OUT", "'nan' is not a finite number"),
    ("simulate cross.toml --pressures 1,2 --duration inf -o OUT", "'inf' is not a finite number"),
    (
        "simulate cross.toml --pressures 1,2 --frame-rate 1e9 -o OUT",
        "1.5e+09 frames in 1.5 s with 41 grid points a side take 2.3e+05 GB; expected at most 2 GB",
    ),
    ("simulate cross.toml --pressures 1,2 --frame-rate nan -o OUT", "'nan' is not a finite number"),
    ("simulate cross.toml --pressures 1,2 --duration 3000 -o OUT", "180001 frames in 3000 s"),
    ("simulate cross.toml --pressures 1,2 --grid 100000 -o OUT", "100000 is not in the range 9<=x<=161"),
    ("simulate cross.toml --pressures 1,2 --grid -1 -o OUT", "-1 is not in the range 9<=x<=161"),
    ("simulate cross.toml --pressures far.csv -o OUT", "far.csv line 3: time_s = 1e+09; expected at most 3600 s"),
    ("simulate cross.toml --pressures huge.csv -o OUT", "huge.csv line 2: channel_0 = '1e999999'; expected a finite"),
    ("simulate cross.toml --pressures 1,1e999999 -o OUT", "no row of pressures such as 400,0,200 (kPa)"),
    ("simulate cross.toml --pressures LONG -o OUT", "pressures for 400 channels; expected 2 channels"),
    ("simulate cross.toml --pressures far.npz -o OUT", "far.npz"),
    ("simulate cross.toml --pressures claims.npz -o OUT", "claims.npz: is damaged or cut short"),
    ("simulate cross.toml --pressures bomb.npz -o OUT", "bomb.npz: unpacks to 700 MB"),
    ("simulate cross.toml --pressures array.npz -o OUT", "array.npz: holds one array"),
    ("simulate cross.toml --pressures sparse.npz -o OUT", "sparse.npz: is damaged or cut short"),
    ("simulate cross.toml --pressures endless.npz -o OUT", "endless.npz: is no plain file"),
    ("simulate cross.toml --pressures endless.csv -o OUT", "endless.csv: is no plain file; expected a text file"),
    ("simulate cross.toml --pressures field.csv -o OUT", "field.csv: is no sound table"),
    ("simulate fine.toml --pressures 1,2 -o OUT", "fixed_point_pitch = 0.0002; expected a number from 0.001"),
    ("simulate crowd.toml --pressures 1,2 -o OUT", "crowd.toml: 300 muscles; expected at most 256"),
    ("simulate channel.toml --pressures 1,2 -o OUT", "channel = 1000000000; expected a whole number from 0 to 255"),
    ("simulate endless.toml --pressures 1,2 -o OUT", "endless.toml: is no plain file; expected a text file"),
    ("simulate pipe.toml --pressures 1,2 -o OUT", "pipe.toml: is no plain file; expected a text file"),
    ("simulate sparse.toml --pressures 1,2 -o OUT", "sparse.toml: has 10000 MB; expected a text file of at most 2 MB"),
    (
        "simulate hung.toml --pressures 1,2 -o OUT",
        'hung = [[0.0, 0.0], "left", true]; expected a list of [u, v] points',
    ),
    ("simulate nested.toml --pressures 1,2 -o OUT", "nested.toml: is not sound TOML: nested too deep"),
    ("simulate digits.toml --pressures 1,2 -o OUT", "digits.toml: is not sound TOML"),
    (
        "simulate cross.toml --pressures 1,2 --model wild.toml -o OUT",
        "factor = 1E+9; expected a number from 0.001 to 1000",
    ),
    (
        "simulate cross.toml --pressures 1,2 --model grid.toml -o OUT",
        "points_per_side = 100000; expected a whole number",
    ),
    ("predict far.npz --model model.toml --design cross.toml -o OUT", "far.npz"),
    ("predict set --model model.toml --grid 100000 -o OUT", "100000 is not in the range 9<=x<=161"),
    ("evaluate set --model endless.toml", "endless.toml: is no plain file"),
    ("check endless.toml", "endless.toml: is no plain file"),
    ("check pipe.csv", "pipe.csv: is no plain file"),
    ("check sparse.csv", "sparse.csv: has 10000 MB; expected a text file of at most 50 MB"),
    ("new basic --pitch 0.0002 -o OUT", "fixed points 0.0002 m apart; expected at least 0.001 m"),
    ("new basic --pitch -1 -o OUT", "fixed points -1 m apart; expected at least 0.001 m"),
    ("new basic --pitch nan -o OUT", "'nan' is not a finite number"),
    ("new basic --width inf -o OUT", "'inf' is not a finite number"),
    ("new basic --muscles 100000 -o OUT", "muscles = 100000; expected 1 to 256"),
    ("new basic --muscles 1000000000000 -o OUT", "muscles = 1000000000000; expected 1 to 256"),
    ("new basic --muscles 250 -o OUT", "250 muscles lie 1.600 mm apart; expected at least their diameter, 2.000 mm"),
    ("calibrate set --grid 100000 -o OUT", "100000 is not in the range 9<=x<=161"),
    ("calibrate set --seed -1 -o OUT", "-1 is not in the range x>=0"),
    ("calibrate endless.toml -o OUT", "endless.toml: is no plain file"),
    ("fuse none --points 1000000000 -o OUT", "1000000000 is not in the range 1<=x<=100000"),
    ("fuse none --points 0 -o OUT", "0 is not in the range 1<=x<=100000"),
    ("fuse none --seed -1 -o OUT", "-1 is not in the range x>=0"),
    (
        "rig cross.toml --pressures 1,2 --test-trials -3 -o OUT",
        "test_trials = -3; expected 0 to 1, the number of programs",
    ),
    (
        "rig cross.toml --pressures 1,2 --key wild_key.toml -o OUT",
        "membrane = 1E+9; expected a number from 0.001 to 1000",
    ),
    (
        "rig cross.toml --pressures 1,2 --key rate_key.toml -o OUT",
        "frame_rate = 1E+9; expected a number above 0 to 1000",
    ),
    ("rig cross.toml --pressures 1,2 --key points_key.toml -o OUT", "points = 1000000000; expected a whole number"),
    ("rig cross.toml --pressures hour.csv -o OUT", "program 0: 3600 s of a cloth of 0.2 by 0.2 m"),
    ("rig wide.toml --pressures 1,2 -o OUT", "1.5 s of a cloth of 10 by 10 m"),
    ("optimize crowd_study.toml -o OUT", "max = 1000000000; expected a whole number from 1 to 256"),
    ("optimize good_study.toml --seconds nan -o OUT", "'nan' is not a finite number"),
    ("optimize good_study.toml --seconds -1 -o OUT", "-1.0 is not in the range x>0"),
    ("optimize endless.toml -o OUT", "endless.toml: is no plain file"),
    ("check swapped", "are y and z exchanged?"),
    ("calibrate swapped -o OUT", "are y and z exchanged?"),
    ("evaluate swapped --model model.toml --all", "are y and z exchanged?"),
    ("check flipped", "is y turned round?"),
    ("evaluate flipped --model model.toml --all", "is y turned round?"),
    ("check megapascals", "the largest pressure is 0.2 kPa; expected kPa (is it in MPa?)"),
    ("predict megapascals --model model.toml -o OUT", "expected kPa (is it in MPa?)"),
    ("calibrate pascals -o OUT", "the largest pressure is 200000 kPa; expected kPa (is it in Pa?)"),
    ("check milliseconds", "a frame every 100 s; expected seconds (is it in milliseconds?)"),
    ("predict milliseconds --model model.toml -o OUT", "expected seconds (is it in milliseconds?)"),
    ("check twice", "order = 0 is that of 000.npz too"),
    ("calibrate twice -o OUT", "order = 0 is that of 000.npz too"),
    ("check short.toml", "muscles[0] needs 200.0 mm; expected at most stock_length, 190 mm of EM20"),
    ("check sharp.toml", "expected min_bend_radius, 300 mm of EM20"),
    ("check overlapping.toml", "lie 1 mm apart on the front; expected their diameter, 2 mm"),
    ("check coarse.toml", "fixed_point_pitch = 20; expected metres (is it in millimetres?)"),
    ("check ply_study.toml", "cut.ply"),
    ("check key.toml", "unknown parameter bendin"),
    ("check bench", "no column stretch, which a strip needs"),
    ("calibrate bench -o OUT", "no column stretch, which a strip needs"),
    ("check included.toml", "include law.toml: law.toml is the law of an actuator; a design has muscles and a cloth"),
    ("simulate included.toml --pressures 1,2 -o OUT", "is the law of an actuator; a design has muscles and a cloth"),
    ("fuse none none -o OUT", "none: no such file"),
]


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that are not sound, beside those that are. One folder for all rows, as none may change it."""
    folder = tmp_path_factory.mktemp("damaged")
    for heavy in ("sim", "studies.fusion.fuse", "studies.demo.run", "studies.rig"):  # no row's time is an import's
        importlib.import_module(heavy)
    write_sound(folder)
    design = (folder / "cross.toml").read_text()
    (folder / "newer.toml").write_text(design.replace("design/1", "design/7"))
    (folder / "outside.toml").write_text(design.replace("0.185", "0.385"))
    trial = (folder / "set" / "trials" / "000.npz").read_bytes()
    (folder / "cut.npz").write_bytes(trial[: len(trial) // 2])
    (folder / "file").write_text("in the way")
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n")
    write_model(Model(effects=(EffectTerm("filing_lag"),)), folder / "effects.toml")
    (folder / "empty.py").write_text("NOTHING = 1\n")
    (folder / "broken.py").write_text("def\n")
    with np.load(folder / "set" / "trials" / "000.npz") as archive:
        arrays = dict(archive)
    np.savez(folder / "mm.npz", **{**arrays, "scale": np.float64(0.1)})
    np.savez(folder / "empty.npz", **{**arrays, "points": np.zeros((0, 3)), "offsets": np.zeros(3, int)})
    header = (
        "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (folder / "cut.ply").write_text(header + "0 0 0\n0 0 0.1\n")
    for name, start, target in (
        ("good", "cross.toml", "set/trials/000.npz"),
        ("bare", "bare.toml", "set/trials/000.npz"),
        ("empty", "cross.toml", "empty.npz"),
        ("mm", "cross.toml", "mm.npz"),
        ("ply", "cross.toml", "cut.ply"),
    ):
        lines = ['kind = "optimize"', f'design = "{start}"', "[target]", f'file = "{target}"']
        (folder / f"{name}_study.toml").write_text("\n".join(lines))
    _endless(folder)
    _oversized(folder)
    _impossible(folder)
    return folder


def _impossible(folder: Path) -> None:
    """Measured sets, designs and benches that are well formed and cannot be."""
    for name, array, change in (
        ("swapped", "points", lambda p: p[:, [0, 2, 1]]),
        ("flipped", "points", lambda p: p * [1, -1, 1]),
        ("megapascals", "pressure", lambda kpa: kpa / 1e3),
        ("pascals", "pressure", lambda kpa: kpa * 1e3),
        ("milliseconds", "time", lambda s: s * 1e3),
    ):
        shutil.copytree(folder / "set", folder / name)
        file = folder / name / "trials" / "002.npz"
        with np.load(file) as archive:
            arrays = dict(archive)
        np.savez(file, **{**arrays, array: change(arrays[array])})
    shutil.copytree(folder / "set", folder / "twice")
    text = (folder / "twice" / "set.toml").read_text()
    (folder / "twice" / "set.toml").write_text(text.replace("order = 1", "order = 0"))
    design = (folder / "cross.toml").read_text()
    write_design(_hook(None, stock=0.19), folder / "short.toml")
    (folder / "coarse.toml").write_text(design.replace("fixed_point_pitch = 0.02", "fixed_point_pitch = 20"))
    write_design(_hook(0.3), folder / "sharp.toml")
    write_design(_hook(None, beside=0.001), folder / "overlapping.toml")
    law = '[law]\nspecimen = "actuator"\noutput = "displacement"\ntable = "law.csv"\n'
    (folder / "law.toml").write_text(f'format = "fabdesign.bench-law/1"\n{law}')
    (folder / "law.csv").write_text("pressure_kpa,displacement_m\n0,0\n100,0.01\n")
    (folder / "included.toml").write_text(design.replace("[fabric]", 'include = ["law.toml"]\n\n[fabric]', 1))
    (folder / "key.toml").write_text('format = "fabdesign.key/1"\n[parameters]\nbendin = 1.1\n')
    (folder / "bench").mkdir()
    (folder / "bench" / "r.csv").write_text("draw,force_n\n0,0\n0.1,1\n")
    (folder / "bench" / "bench.toml").write_text(
        'format = "fabdesign.bench/1"\nspecimen = "strip"\ninput = ["draw"]\noutput = "force_n"\n'
        '[[records]]\nfile = "r.csv"\n'
    )


def _hook(radius: float | None, *, stock: float | None = None, beside: float | None = None) -> Design:
    """A muscle of 0.2 m round a corner, with a least bend radius and a stock [m]; or two straight ones so far apart."""
    design = build("vertical", muscles=1)
    kind = replace(design.muscle_types["EM20"], min_bend_radius=radius, stock_length=stock)
    path = ((0.05, 0.05), (0.15, 0.05), (0.15, 0.15))
    muscles = [replace(design.muscles[0], path=path)]
    if beside is not None:
        muscles = [replace(design.muscles[0], path=((x, 0.0), (x, 0.2))) for x in (0.1, 0.1 + beside)]
    return replace(design, muscle_types={"EM20": kind}, muscles=tuple(muscles))


def _endless(folder: Path) -> None:
    """What never ends, or claims to be larger than a machine."""
    for kind in ("toml", "csv", "npz"):
        (folder / f"endless.{kind}").symlink_to("/dev/zero")
        os.mkfifo(folder / f"pipe.{kind}")
        with (folder / f"sparse.{kind}").open("wb") as stream:
            stream.truncate(10_000_000_000)
    member = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(member, header)
    with zipfile.ZipFile(folder / "claims.npz", "w") as archive:
        archive.writestr("time.npy", member.getvalue() + bytes(64))
    with (
        zipfile.ZipFile(folder / "bomb.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("time.npy", "w", force_zip64=True) as bomb,
    ):
        for _ in range(70):
            bomb.write(bytes(10_000_000))
    with (folder / "array.npz").open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, header)


def _oversized(folder: Path) -> None:
    """Files of a sound form with sizes and counts that nobody means."""
    design, model = (folder / "cross.toml").read_text(), (folder / "model.toml").read_text()
    muscle = design[design.index("[[muscles]]") :].split("[[muscles]]")[1]
    (folder / "fine.toml").write_text(design.replace("fixed_point_pitch = 0.02", "fixed_point_pitch = 0.0002"))
    (folder / "crowd.toml").write_text(design + 298 * f"\n[[muscles]]{muscle}")
    (folder / "channel.toml").write_text(design.replace("channel = 1", "channel = 1000000000"))
    (folder / "wide.toml").write_text(
        design.replace("width = 0.2", "width = 10.0").replace("height = 0.2", "height = 10.0")
    )
    hung = 'hung = [[0.0, 0.0], "left", true]'
    (folder / "hung.toml").write_text(re.sub("(?m)^hung = .*", hung, design))
    (folder / "nested.toml").write_text("a = " + 100_000 * "[")
    (folder / "digits.toml").write_text("a = " + 10_000 * "9")
    (folder / "wild.toml").write_text(model.replace("factor = 1.1", "factor = 1e9"))
    (folder / "grid.toml").write_text(model.replace("points_per_side = 41", "points_per_side = 100000"))
    for name, lines in (
        ("wild", "[parameters]\nmembrane = 1e9"),
        ("rate", "[sensing]\nframe_rate = 1e9"),
        ("points", "[sensing]\npoints = 1000000000"),
    ):
        (folder / f"{name}_key.toml").write_text(f'format = "fabdesign.key/1"\n{lines}\n')
    for name, row in (("far", "1e9,2,3"), ("huge", "1,1e999999,2"), ("hour", "1800,2,3")):
        (folder / f"{name}.csv").write_text(f"time_s,channel_0,channel_1\n0,1,2\n{row}\n")
    (folder / "huge.csv").write_text("time_s,channel_0,channel_1\n0,1e999999,2\n")
    (folder / "field.csv").write_text("time_s,channel_0,channel_1\n0,1," + 200_000 * "2")
    with np.load(folder / "set" / "trials" / "000.npz") as archive:
        np.savez(folder / "far.npz", **{**archive, "time": np.array([0.1, 1e9])})
    study = (folder / "good_study.toml").read_text()
    (folder / "crowd_study.toml").write_text(study + "\n[variables]\nmuscles = { max = 1000000000 }\n")


@pytest.mark.parametrize(("line", "problem"), BAD, ids=[line for line, _ in BAD])
@pytest.mark.usefixtures("hanging")
def test_bad_input(line: str, problem: str, run: Run, damaged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path: path.lstat().st_mtime_ns for path in damaged.rglob("*") if not path.is_dir()}
    monkeypatch.chdir(damaged)
    begin = time.process_time()
    one_line(run(*line.replace("LONG", ",".join(400 * ["1"])).split()), problem)
    assert time.process_time() - begin < 2.0
    assert {path: path.lstat().st_mtime_ns for path in damaged.rglob("*") if not path.is_dir()} == before
    assert not list(damaged.rglob("OUT*"))
