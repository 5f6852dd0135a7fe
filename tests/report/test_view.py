"""Side by side: what the page, the picture and the animation hold."""

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from fabdesign.cli.console import commands
from fabdesign.errors import InputError
from fabdesign.files.motion_file import write_motion
from fabdesign.files.pressure_file import constant_program
from fabdesign.files.trial_file import TrialData, write_trial
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.output import write_mark
from studies.view.items import compared, items_of
from studies.view.page import LEVELS, render_page
from studies.view.shapes import OVERLAY, key_of
from tests.analytic_cloth import AnalyticCloth
from tests.meshes import sheet, write_stl

PRESSURES = [320e3, 60e3, 210e3]
TIMES = np.array([0.2, 0.5, 1.0])


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A motion on 9 x 9 points, and a trial of it with other points in every frame."""
    motion = AnalyticCloth(9).motions([Case(build("vertical"), constant_program(PRESSURES))], [TIMES])[0]
    write_motion(tmp_path / "motion.npz", TIMES, motion)
    frames = tuple(frame[k::2] for k, frame in enumerate(motion))
    write_trial(TrialData(TIMES, np.tile(PRESSURES, (3, 1)), frames), tmp_path / "trial.npz")
    return tmp_path / "motion.npz", tmp_path / "trial.npz"


def test_the_page_holds_every_point_and_loads_nothing(files: tuple[Path, Path]) -> None:
    items = items_of(files)
    page = render_page("both", compared(items))
    assert not re.findall(r"(?:src|href)=|https?://", page)
    data = json.loads(re.findall(r'id="data">(.*?)</script>', page)[0])
    assert [panel["title"] for panel in data["items"]] == ["motion", "trial, measured"]
    for item, panel in zip(items, data["items"], strict=True):
        points = np.frombuffer(base64.b64decode(panel["points"]), "<i2").reshape(-1, 3) * data["scale"]
        shown = np.concatenate([np.asarray(frame) for frame in item.frames])
        assert panel["counts"] == [len(frame) for frame in item.frames]
        assert panel["times"] == TIMES.tolist()
        assert np.abs(points - shown).max() <= 0.5001 * np.abs(shown).max() / LEVELS * 2
    corners = np.frombuffer(base64.b64decode(data["items"][0]["triangles"]), "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(corners, items[0].triangles)
    assert data["items"][1]["triangles"] == ""


def test_a_trial_stands_beside_its_prediction(files: tuple[Path, Path], tmp_path: Path) -> None:
    from fabdesign.files.design_file import write_design

    write_design(build("vertical"), tmp_path / "d.toml")
    measured, predicted = items_of(files[1:], design=tmp_path / "d.toml", model=Model(), forward=AnalyticCloth(9))
    assert (measured.title, predicted.title) == ("trial, measured", "trial, predicted")
    np.testing.assert_allclose(predicted.frames[0][0::2], measured.frames[0], atol=1e-3)
    with pytest.raises(InputError, match="a lone trial; expected --design"):
        items_of(files[1:], model=Model(), forward=AnalyticCloth(9))


def test_a_folder_that_is_no_set_says_what_it_is_and_what_of_it_can_be_viewed(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    with pytest.raises(InputError, match=r"own: a folder without set\.toml; expected a motion, a measurement set"):
        items_of([tmp_path / "own"])
    result = tmp_path / "result"
    result.mkdir()
    write_mark(result, "optimize", ["report.html"])
    for name in ("report.html", "design.toml", "pressures.csv"):
        (result / name).touch()
    with pytest.raises(InputError) as refused:
        items_of([result])
    message = str(refused.value)
    assert message.startswith(f"{result}: holds what fabdesign optimize made, no measurement set; ")
    assert f"{result / 'report.html'} shows it" in message
    simulate = f"fabdesign simulate {result / 'design.toml'} --pressures {result / 'pressures.csv'} -o MOTION.npz"
    assert message.endswith(simulate) and "\n" not in message
    predicted = tmp_path / "predicted" / "trials"
    predicted.mkdir(parents=True)
    write_mark(predicted.parent, "predict", [])
    (predicted / "000.npz").touch()
    with pytest.raises(InputError, match=r"fabdesign predict made, .*trials/000\.npz can be viewed"):
        items_of([predicted.parent])


def test_a_corrector_has_a_panel_of_its_own(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fabdesign.files.design_file import write_design
    from studies.prediction.forward_model import sensed_model

    asked: list[Model] = []

    def without_weights(forward: AnalyticCloth, model: Model) -> Any:
        asked.append(model)
        return sensed_model(forward, model.without(["corrector"]))

    monkeypatch.setattr("studies.view.items.sensed_model", without_weights)
    write_design(build("vertical"), tmp_path / "d.toml")
    model = Model(corrector=tmp_path / "weights", corrector_hash="0")
    items = items_of(files[1:], design=tmp_path / "d.toml", model=model, forward=AnalyticCloth(9))
    assert [item.title for item in items] == ["trial, measured", "trial, simulated", "trial, corrected"]
    assert [one.corrector for one in asked] == [None, model.corrector]
    assert [item.predicts for item in items] == ["", "trial, measured", "trial, measured"]


def test_a_set_of_a_synthetic_rig_says_so(data: Path) -> None:
    item, *others = items_of([data / "rig_c"], trial="008")
    assert not others
    assert item.title.endswith("synthetic rig")
    _, predicted = items_of([data / "rig_c"], trial="008", model=Model(), forward=AnalyticCloth(9))
    assert predicted.title == item.title.replace("synthetic rig", "predicted")
    with pytest.raises(InputError, match="has no trial nine; expected one of 000"):
        items_of([data / "rig_c"], trial="nine")


def run(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(commands, ["view", *map(str, words)])
    if isinstance(result.exception, InputError):
        return 2, str(result.exception)
    return result.exit_code, result.output


def test_pictures_and_animations_are_images(files: tuple[Path, Path], tmp_path: Path) -> None:
    assert run(*files, "--time", "0.2", "--time", "1", "-o", tmp_path / "a.png")[0] == 0
    with Image.open(tmp_path / "a.png") as picture:
        colours = picture.convert("RGB").getcolors(1_000_000)
    assert colours is not None
    red, dark = (sum(n for n, (r, g, b) in colours if test(r, g, b)) for test in (_red, _dark))
    assert min(red, dark) > 300  # both panels are there
    assert run(*files, "-o", tmp_path / "a.gif")[0] == 0
    with Image.open(tmp_path / "a.gif") as animation:
        assert animation.n_frames == 13  # 0.8 s at 15 Hz


@pytest.mark.parametrize("size", [(1.0, 1.0), (1.2, 0.75), (0.6, 1.5)])
def test_a_picture_of_a_still_shape_is_filled_by_it(size: tuple[float, float], tmp_path: Path) -> None:
    points, triangles = sheet(8, 8, roll=25.0)
    write_stl(tmp_path / "s.stl", points * [*size, 1.0], triangles)
    assert run(tmp_path / "s.stl", "-o", tmp_path / "s.png")[0] == 0
    pixels = np.asarray(Image.open(tmp_path / "s.png").convert("RGB")).astype(int)
    down, across = np.nonzero((pixels[..., 1] - pixels[..., 0] > 15) & (pixels[..., 1] - pixels[..., 2] > 15))
    assert np.ptp(across) > 0.4 * pixels.shape[1]
    assert np.ptp(down) > 0.6 * pixels.shape[0]


def test_what_is_laid_over_has_a_colour_of_its_own_and_a_key(files: tuple[Path, Path], tmp_path: Path) -> None:
    """Its light differs from that of every other colour, so that it shows without colour vision too."""
    shares = {name: np.dot(colour, (0.21, 0.72, 0.07)) for name, colour in key_of(items_of(files), overlay=True)}
    (over,) = (light for name, light in shares.items() if name.startswith("overlaid"))
    assert all(abs(over - light) > 0.2 for name, light in shares.items() if not name.startswith("overlaid"))
    counts = []
    for more in ((), ("--overlay",)):
        assert run(*files, "--time", "1", *more, "-o", tmp_path / "a.png", "--force")[0] == 0
        pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
        counts.append(int((np.abs(pixels - 255 * np.array(OVERLAY)).max(axis=-1) < 25).sum()))
    assert counts[0] == 0 and counts[1] > 100
    page = render_page("both", compared(items_of(files)))
    assert all(name in page for name in shares) and "muscles</span>" not in page


def _red(r: int, g: int, b: int) -> bool:
    return r > 90 > max(g, b)


def _dark(r: int, g: int, b: int) -> bool:
    return max(r, g, b) < 80 and b > r + 10


def test_what_cannot_be_shown_is_refused_and_nothing_is_written(files: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "notes.md").write_text("text")
    far = tmp_path / "far.xyz"
    far.write_text("0 0 0\n200 0 0\n0 200 0\n")
    out = tmp_path / "out" / "p.html"
    for words, message in (
        ((tmp_path / "none.npz", "-o", out), "none.npz"),
        ((tmp_path / "notes.md", "-o", out), "notes.md"),
        ((far, "-o", out), "far.xyz: points are beyond 5 m; expected metres"),
        (
            (*files, "-o", tmp_path / "out" / "p.pdf"),
            "expected a name that ends in .html, .png, .gif, .mp4, .glb, .pvd, .rrd or .csv",
        ),
        ((*files, "--time", "1", "-o", out), "instants of a picture"),
        ((*files, "--marker", "a=0,0", "-o", out), "points in a table; expected an output that ends in .csv"),
        ((*files, "--marker", "a", "-o", out.with_suffix(".csv")), "--marker a: expected NAME=U,V"),
        ((*files, "-o", out.with_suffix(".csv")), "trial, measured: is a cloud or mesh, without named points"),
        ([files[0]] * 9 + ["-o", out], "9 panels; expected at most 8"),
    ):
        code, text = run(*words)
        assert (code, message in text, text.count("\n")) == (2, True, 0), text
        assert not (tmp_path / "out").exists()
