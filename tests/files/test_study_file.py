"""Study files: what they say, what is taken where they do not, and one line for each mistake."""

from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from fabdesign.study_files.study_file import MuscleChoice, StudyLimits, read_study

ALL_KEYS = """
format = "fabdesign.study/1"
kind = "optimize"
design = "vertical.toml"
seed = 4
objective = "surface_rms"
start_pressures = [100, 150.5, 200]
[target]
file = "target.ply"
description = "a hand-made bowl"
[variables]
pressures = true
positions = true
muscles = { min = 2, max = 3, sides = ["front"] }
[limits]
pressure = [20.1, 300.0]
spacing = 0.01
edge = 0.002
seconds = 12
evaluations = 500
"""
SHORTEST = 'kind = "optimize"\ndesign = "vertical.toml"\n[target]\nfile = "target.ply"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_design(build("vertical"), tmp_path / "vertical.toml")
    (tmp_path / "target.ply").write_text("opened when the study runs")
    return tmp_path


def study(folder: Path, text: str) -> Path:
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


def test_every_key_is_read(folder: Path) -> None:
    read = read_study(study(folder, ALL_KEYS))
    assert read.design == build("vertical")
    assert (read.name, read.seed, read.objective) == ("study", 4, "surface_rms")
    assert read.targets[0].file == folder / "target.ply"
    assert read.targets[0].description == "a hand-made bowl"
    assert read.muscles == MuscleChoice(2, 3, ("front",))
    assert read.limits == StudyLimits((20.1e3, 300e3), 0.01, 0.002, 12.0, 500)
    assert read.start_pressures is not None
    np.testing.assert_array_equal(read.start_pressures, [100e3, 150.5e3, 200e3])


def test_defaults(folder: Path) -> None:
    read = read_study(study(folder, SHORTEST))
    assert (read.pressures, read.positions, read.muscles, read.objective) == (True, False, None, "chamfer")
    assert read.limits == StudyLimits()
    assert read.targets[0].frame == -1
    assert read_study(study(folder, SHORTEST + "[variables]\nmuscles = { max = 4 }")).positions


def test_several_targets_share_a_layout(folder: Path) -> None:
    text = SHORTEST.replace("[target]", "[[targets]]") + '[[targets]]\nfile = "target.ply"\n'
    assert len(read_study(study(folder, text)).targets) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SHORTEST.replace("vertical.toml", "none.toml"), "none.toml: no such file"),
        (SHORTEST.replace("target.ply", "none.ply"), "file .*none.ply is not there"),
        (SHORTEST.replace("optimize", "optimise"), 'kind = "optimise"; expected one of optimize'),
        (SHORTEST.replace("optimize", "sensitivity"), 'kind = "sensitivity"; expected "optimize"'),
        ('format = "fabdesign.study/2"\n' + SHORTEST, 'format is "fabdesign.study/2"'),
        ('kind = "optimize"\ndesign = "vertical.toml"\n', r"expected one \[target\]"),
        (SHORTEST + '[[targets]]\nfile = "target.ply"\n', r"expected one \[target\]"),
        (SHORTEST + "[variables]\npresures = true\n", "unknown key presures .did you mean pressures"),
        (SHORTEST + "[variables]\npressures = false\n", "nothing may change"),
        (SHORTEST + "[variables]\npressures = false\nmuscles = { max = 3 }\n", "muscles without pressures"),
        (SHORTEST + "[variables]\nmuscles = { min = 3, max = 2 }\n", "max = 2"),
        (SHORTEST + '[variables]\nmuscles = { max = 2, sides = ["left"] }\n', "sides"),
        (SHORTEST + "[variables]\nmuscles = { max = 2, corners = 9 }\n", "corners"),
        (SHORTEST + "[limits]\npressure = [0, 1200]\n", "at most 1000 kPa"),
        (SHORTEST + "[limits]\npressure = [300, 200]\n", "lowest, highest"),
        (SHORTEST + "[limits]\nseconds = 0\n", "seconds"),
        (SHORTEST + "[limits]\nedge = 0.1\n", "less than half the cloth"),
        ("start_pressures = [1, 2]\n" + SHORTEST, "3 pressures in kPa"),
    ],
)
def test_each_mistake_is_one_line(folder: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_study(study(folder, text))
    assert "\n" not in str(caught.value)


def test_a_design_without_muscles_is_refused_where_muscles_are_not_searched(folder: Path) -> None:
    bare = build("vertical")
    write_design(type(bare)("bare", bare.fabric, bare.muscle_types, ()), folder / "bare.toml")
    text = SHORTEST.replace("vertical", "bare")
    with pytest.raises(InputError, match="bare has no muscles"):
        read_study(study(folder, text))
    assert read_study(study(folder, text + "[variables]\nmuscles = { max = 2 }\n")).muscles == MuscleChoice(1, 2)
