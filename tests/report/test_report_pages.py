"""Pages of results in a browser: no text leaves the page or its picture, no legend lies over axes, no scene is cut."""

import base64
import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.browser import Page, browser_at, chromium
from tests.report_pages import PAGES

WIDTHS = 1200, 1600  # px
OUTSIDE = """(() => {
  const lost = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const inside = (a, b) => a.left >= b.left - 1 && a.right <= b.right + 1
    && a.top >= b.top - 1 && a.bottom <= b.bottom + 1;
  const root = document.documentElement;
  const page = {left: 0, top: 0, right: root.clientWidth, bottom: root.scrollHeight};
  for (let node; (node = walker.nextNode());) {
    if (!node.textContent.trim() || node.parentElement.closest('script, style, .modebar, .hoverlayer')) continue;
    const range = document.createRange(); range.selectNodeContents(node);
    const box = range.getBoundingClientRect();
    if (!box.width) continue;
    const at = {left: box.left, right: box.right, top: box.top + scrollY, bottom: box.bottom + scrollY};
    if (!inside(at, page)) lost.push(['page', node.textContent]);
    const picture = node.parentElement.closest('svg');
    if (picture && !inside(box, picture.getBoundingClientRect())) lost.push(['picture', node.textContent]);
    const table = node.parentElement.closest('table');
    if (table && !inside(box, table.getBoundingClientRect())) lost.push(['table', node.textContent]);
    if (table && box.height > 120) lost.push(['narrow', node.textContent]);
    if (!picture && /[0-9]/.test(node.textContent) && node.parentElement.matches('td:not(:first-child):not(.left)')
        && !node.parentElement.closest('.left') && box.height > 28) lost.push(['broken', node.textContent]);
  }
  return lost;
})()"""
OVERLAPS = """(() => {
  const meet = (a, b) => a.width && b.width && a.left < b.right - 1 && b.left < a.right - 1
    && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  const found = [];
  for (const figure of document.querySelectorAll('.js-plotly-plot')) {
    const boxes = selector => [...figure.querySelectorAll(selector)].map(e => e.getBoundingClientRect());
    const axes = boxes('.nsewdrag, .xtitle, .ytitle, .xaxislayer-above, .yaxislayer-above');
    for (const legend of boxes('.legend .bg')) if (axes.some(box => meet(legend, box))) found.push(figure.id);
  }
  return found;
})()"""
UNTITLED = """[...document.querySelectorAll('.js-plotly-plot .cartesianlayer')].filter(e => e.children.length)
  .map(e => e.closest('.js-plotly-plot')).filter(f => !f.querySelector('.xtitle')).map(f => f.id)"""
NAMES = "[...document.querySelectorAll('#candidates .yaxislayer-above text')].map(e => e.textContent)"
READY = """document.readyState == 'complete' && (!document.getElementById('figures') || typeof Plotly != 'undefined'
  && [...document.querySelectorAll('.js-plotly-plot')].length == Object.keys(JSON.parse(figures.textContent)).length)"""

FITTED = """(() => { const fits = [...document.querySelectorAll('.js-plotly-plot')].every(
  figure => Math.abs(figure._fullLayout.width - figure.clientWidth) < 2);
  return fits && new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true)))); })()"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    pytest.importorskip("websockets")
    if chromium() is None:
        pytest.skip("no chromium here")
    with browser_at("about:blank", tmp_path_factory.mktemp("profile"), width=WIDTHS[0]) as tab:
        yield tab


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, files = tmp_path_factory.mktemp("pages"), {}
    for name, make in PAGES.items():
        files[name] = folder / f"{name}.html"
        files[name].write_text(make(), encoding="utf-8")
    return files


def drawn_edges(page: Page, selector: str) -> int:
    """Return how many pixels of a scene's outermost frame are not white: what is cut off lies there."""
    box = page.run(
        f"(b => [b.x + scrollX, b.y + scrollY, b.width, b.height])(document.querySelector({json.dumps(selector)})"
        ".getBoundingClientRect())"
    )
    clip = dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": 1}
    data = page.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)["data"]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("L"))
    assert (pixels < 200).sum() > 1000, "nothing is drawn"
    frame = np.concatenate([pixels[:2].ravel(), pixels[-2:].ravel(), pixels[:, :2].ravel(), pixels[:, -2:].ravel()])
    return int((frame < 200).sum())


@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_cut_or_covered(name: str, page: Page, made: dict[str, Path]) -> None:
    address = made[name].as_uri()
    page.call("Page.navigate", url=address)
    page.wait(f"location.href == {json.dumps(address)} && {READY}", seconds=60)
    for width in WIDTHS:
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        page.wait(FITTED, seconds=60)
        assert page.run(OUTSIDE) == [], width
        assert page.run(OVERLAPS) == [], width
        assert page.run(UNTITLED) == [], width
        if page.run("Boolean(document.querySelector('.gl-container'))"):
            assert drawn_edges(page, ".js-plotly-plot") == 0, width
    if name == "wish":  # ended by a limit: said where it is seen
        notes = page.run("[...document.querySelectorAll('.note')].map(e => e.textContent)")
        assert "limit of 5 evaluations" in notes[0] and "mm from what was asked for" in notes[1]
    if name == "bench":
        assert len(page.run(NAMES)) == 5 and "braid_hysteresis" in page.run(NAMES)  # every one, the winner too
