"""The studio's page in a real browser, with a cloth that costs nothing."""

import contextlib
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fabdesign.catalogue import build
from fabdesign.design_file import read_design, write_design
from studies.check.files import inspect
from studies.studio.gate import Gate
from studies.studio.opening import open_files
from studies.studio.scene import Places
from tests.bending import AtOnce
from tests.browser import Page, browser_at, chromium

viser = pytest.importorskip("viser", reason="no viser: pip install 'fabdesign[studio]'")
pytestmark = pytest.mark.skipif(chromium() is None, reason="no chromium: apt install chromium")


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    """A tab on a studio that edits `basic.toml`, in a folder of its own."""
    from studies.studio.server import Studio, quiet_viser

    monkeypatch.chdir(tmp_path)
    write_design(build("basic"), tmp_path / "basic.toml")
    stopped = threading.Event()
    with quiet_viser() as server, contextlib.closing(Gate("127.0.0.1", None, server.get_port(), first=18500)) as gate:
        studio = Studio(server, open_files([Path("basic.toml")], None), AtOnce())
        runs = threading.Thread(target=studio.run, args=(stopped.is_set,))
        runs.start()
        try:
            with browser_at(gate.address, tmp_path / "profile", width=1150, height=640) as tab:
                yield tab
        finally:
            stopped.set()
            runs.join(10)
            studio.session.end()


def test_a_layout_is_drawn_saved_and_sound(page: Page, tmp_path: Path) -> None:
    page.wait(holds("Exact"), seconds=60)
    flat = edge(page)

    page.fill("Channel 0, kPa", "250", 0)  # the number of the slider
    page.wait(f"{holds('Exact')} && !{holds(flat)}", seconds=30)
    bowed = edge(page)

    drag_end(page, (0.025, 0.192), (0.045, 0.192))
    page.wait(f"{holds('Exact')} && !{holds(bowed)}", seconds=30)
    x = float(page.field("Corner 1")[2])
    assert 40 < x < 50

    assert "all kept" in page.text()
    page.fill("Corner 1", "71")
    page.wait(holds("muscles 0 and 1 lie 4.0 mm apart on the front; expected 6 mm"), seconds=30)
    page.fill("Corner 1", "45")
    page.wait(holds("all kept"), seconds=30)

    page.press("Files")
    page.press("Save")
    page.wait(holds("files in basic_studio"), seconds=60)
    saved = tmp_path / "basic_studio" / "design.toml"
    assert inspect(saved).problems == ()
    assert read_design(saved).muscles[0].path[1][0] == 0.045
    assert (tmp_path / "basic_studio" / "pressures.csv").read_text().splitlines()[-1].split(",")[1] == "250"


def holds(text: str) -> str:
    """A JavaScript expression: whether the page says so."""
    return f"(document.body && document.body.innerText.includes({text!r}))"


def edge(page: Page) -> str:
    """What the page says of the lower edge."""
    found = re.search(r"lower edge, middle: .* mm;", page.text())
    assert found is not None
    return found[0]


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
    from studies.studio.page import VIEW, eye_of

    left, top, width, height = page.run(
        "(box => [box.x, box.y, box.width, box.height])(document.querySelector('canvas').getBoundingClientRect())"
    )
    places = Places(0.2, 0.2)
    eye = np.array(eye_of(places))
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0, 1, 0]) / np.linalg.norm(np.cross(forward, [0, 1, 0]))
    to = places.flat(np.array([point]), "front")[0] - eye
    scale = height / 2 / np.tan(VIEW / 2) / (to @ forward)
    return left + width / 2 + scale * (to @ right), top + height / 2 - scale * (to @ np.cross(right, forward))
