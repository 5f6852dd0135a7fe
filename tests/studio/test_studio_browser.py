"""A sitting at the studio in a real browser, with a cloth that costs nothing."""

import contextlib
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.design_file import read_design, write_design
from fabdesign.nouns.catalogue import build
from studies.check.files import inspect
from studies.studio.opening import open_files
from studies.studio.server import Gate, quiet_viser
from studies.studio.widgets.flat_view import Places
from tests.bending import AtOnce
from tests.browser import Page, browser_at, chromium
from tests.conftest import ROOT

viser = pytest.importorskip("viser", reason="no viser: pip install 'fabdesign[studio]'")
WAIT = 200  # s, for what takes one on an idle machine
pytestmark = pytest.mark.skipif(chromium() is None, reason="no chromium: apt install chromium")


@contextlib.contextmanager
def studio_at(tmp_path: Path, files: list[str]) -> Iterator[Page]:
    """A tab on a studio that has opened `files`."""
    from studies.studio.widgets.page import Page as StudioPage

    stopped = threading.Event()
    with contextlib.closing(Gate("127.0.0.1", None, first=18500)) as gate, quiet_viser(gate) as server:
        studio = StudioPage(server, open_files([Path(file) for file in files], None), AtOnce())
        runs = threading.Thread(target=studio.run, args=(stopped.is_set,))
        runs.start()
        try:
            with browser_at(gate.address, tmp_path / "profile", width=1150, height=640, frugal=True) as tab:
                yield tab
        finally:
            stopped.set()
            runs.join(10)
            studio.session.end()


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    """Of a studio that edits `basic.toml` beside a bent sheet as target, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr("studies.studio.search.PROGRAM", (sys.executable, "-m", "tests.bending"))
    write_design(build("basic"), tmp_path / "basic.toml")
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, 0.2, 41))
    np.savetxt(tmp_path / "bent.xyz", np.stack([u, -v, 0.5 * v**2], axis=-1).reshape(-1, 3))
    with studio_at(tmp_path, ["basic.toml", "bent.xyz"]) as tab:
        yield tab


def test_a_sitting(page: Page, tmp_path: Path) -> None:
    page.wait(exact(), seconds=WAIT)
    flat = edge(page)

    page.fill("Channel 0, kPa", "250", 0)  # the number of the slider
    page.wait(exact(other_than=flat), seconds=WAIT)
    bowed = edge(page)

    drag_end(page, (0.025, 0.192), (0.045, 0.192))
    page.wait(exact(other_than=bowed), seconds=WAIT)
    x = float(page.field("End 1")[2])
    assert 40 < x < 50

    assert "all kept" in page.text()
    page.fill("End 1", "71")
    page.wait(holds("muscles 0 and 1 lie 4.0 mm apart on the front; expected 6 mm"), seconds=WAIT)
    page.fill("End 1", "45")
    page.wait(holds("all kept"), seconds=WAIT)

    page.wait(exact(other_than=flat), seconds=WAIT)
    initial = chamfer(page)
    page.open_tab("Target")
    page.fill("Seconds", "600")
    page.run(WATCH_HEAD)
    page.press_button("Search from here")
    page.wait(holds("evaluations; "), seconds=WAIT)
    page.press_button("Stop, keep the best")
    page.wait(holds("kept in"), seconds=WAIT)
    page.open_tab("Results")
    texts = "[...document.querySelectorAll('#studio-results tr')].map(row => row.innerText)"
    rows = page.wait(f"(rows => rows.length == 3 && rows)({texts})", seconds=WAIT)
    heights = np.array([[int(x) for x in row.split(",")] for row in page.run("[...heights]")])
    assert np.ptp(heights, axis=0).max() < 10  # px: what is under the hand stays there, whatever the head says
    assert rows[1].startswith("own drawing\t8")
    assert rows[2].startswith("search 1: pressures\t8")
    page.wait(exact(other_than=f"Chamfer {initial}"), seconds=WAIT)
    assert float(chamfer(page)) < float(initial)

    page.open_tab("Files")
    page.press_button("Save")
    page.wait(holds("files in basic_studio"), seconds=WAIT)
    saved, result = tmp_path / "basic_studio", tmp_path / "basic_studio_search_1" / "result"
    for name in ("design.toml", "study.toml"):
        assert inspect(saved / name).problems == ()
    assert read_design(saved / "design.toml").muscles == read_design(result / "design.toml").muscles
    assert read_design(saved / "design.toml").muscles[0].path[1][0] == 0.045
    kpa = [
        [float(x) for x in (folder / "pressures.csv").read_text().splitlines()[-1].split(",")[1:]]
        for folder in (saved, result)
    ]
    assert kpa[0] == pytest.approx(kpa[1], abs=0.1)


WATCH_HEAD = """(() => {
  const height = name => document.getElementById('studio-' + name).offsetHeight;
  window.heights = new Set();
  setInterval(() => heights.add(['shape', 'scale', 'limits', 'message'].map(height).join()), 20);
})()"""  # collects the heights of the boxes above the sliders


def holds(text: str) -> str:
    """A JavaScript expression: whether the page says so."""
    return f"(document.body && document.body.innerText.includes({text!r}))"


def exact(*, other_than: str | None = None) -> str:
    """A JavaScript expression: whether the exact shape stands there with its distances, and no longer what stood."""
    changed = "" if other_than is None else f" && !{holds(other_than)}"
    return f"{holds('Exact')} && {holds('noise floor')}{changed}"


def chamfer(page: Page) -> str:
    """mm, what the page says of the distance to the target."""
    match = re.search(r"Chamfer ([0-9.]+) mm", page.text())
    assert match is not None
    return match[1]


def edge(page: Page) -> str:
    """What the page says of the lower edge."""
    match = re.search(r"lower edge, middle: .* mm;", page.text())
    assert match is not None
    return match[0]


def drag_end(page: Page, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """With the mouse, from one place (u, v) m of the flat front to another."""
    (x0, y0), (x1, y1) = (on_screen(page, point) for point in (begin, end))
    page.mouse("Moved", x0, y0)
    page.mouse("Pressed", x0, y0, pressed=True)
    for share in np.linspace(0.1, 1, 10):
        page.mouse("Moved", x0 + share * (x1 - x0), y0 + share * (y1 - y0), pressed=True)
    page.mouse("Released", x1, y1)


def on_screen(page: Page, point: tuple[float, float]) -> tuple[float, float]:
    """Pixels of a point of the flat front, seen from where the page's camera begins."""
    from studies.studio.widgets.flat_view import VIEW, eye_of

    left, top, width, height = page.run(
        "(box => [box.x, box.y, box.width, box.height])(document.querySelector('canvas').getBoundingClientRect())"
    )
    places = Places(0.2, 0.2)
    eye = np.array(eye_of(places, width / height))
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0, 1, 0]) / np.linalg.norm(np.cross(forward, [0, 1, 0]))
    to = places.flat(np.array([point]), "front")[0] - eye
    scale = height / 2 / np.tan(VIEW / 2) / (to @ forward)
    return left + width / 2 + scale * (to @ right), top + height / 2 - scale * (to @ np.cross(right, forward))
