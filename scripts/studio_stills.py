"""The pictures of docs/studio.md: the studio's page in a headless chromium. From the repository's root:

python -m scripts.studio_stills FOLDER                      # studio.png and studio_results.png
python -m scripts.studio_stills FOLDER MEASURED_SET MODEL   # studio_model.png and studio_measured.png
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from scripts.studio_moving_picture import studio
from tests.browser import Page
from tests.studio.test_studio_browser import holds

WINDOW, HIGH = (1400, 800), (1400, 960)  # px
SEARCH = 180  # s
RADIUS = 0.4  # m, of the bent sheet that is searched for
WAIT = 900  # s, on a machine with other work
TRIAL, FRAME = "001 (duo, fit)", 45  # of rig_c
_READY = """(() => {
  document.querySelector('.mantine-Notification-closeButton')?.click();
  for (let node = document.getElementById('studio-shape'); node; node = node.parentElement) node.scrollTop = 0;
})()"""


def shoot(page: Page, file: Path) -> None:
    page.run(_READY)
    time.sleep(3)  # until what was told to the browser is drawn
    file.write_bytes(page.shot())
    print(file)


def press(page: Page, pressures: dict[int, float]) -> None:
    """Channels' pressures, kPa, typed; the exact shape is there then."""
    for channel, pressure in pressures.items():
        before = page.run("document.body.innerText")
        page.fill(f"Channel {channel}, kPa", f"{pressure:g}", 0)
        page.wait(f"{holds('Exact')} && document.body.innerText != {before!r}", seconds=WAIT)
        time.sleep(2)
        page.wait(holds("Exact"), seconds=WAIT)


def choose(page: Page, label: str, option: str) -> None:
    """An option of a list that drops down."""
    x, y, _ = page.field(label)
    page.click(x, y)
    element = f"[...document.querySelectorAll('[role=option]')].find(e => e.innerText.trim() == {option!r})"
    page.wait(f"(e => e && (e.click() || true))({element})")


def layout(out: Path) -> None:
    with tempfile.TemporaryDirectory() as folder, studio(Path(folder), window=WINDOW) as page:
        press(page, {0: 250, 1: 200, 6: 150})
        shoot(page, out / "studio.png")


def results(out: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, 0.2, 41))
        sheet = np.stack([u, -RADIUS * np.sin(v / RADIUS), RADIUS * (1 - np.cos(v / RADIUS))], axis=-1)
        np.savetxt(Path(folder) / "bent.xyz", sheet.reshape(-1, 3))
        with studio(Path(folder), "basic.toml", "bent.xyz", window=HIGH) as page:
            page.wait(holds("noise floor"), seconds=WAIT)
            page.open_tab("Target")
            page.fill("Seconds", str(SEARCH))
            page.press_button("Search from here")
            page.wait(holds("kept in"), seconds=WAIT)
            page.open_tab("Results")
            page.wait(holds("evaluations; "), seconds=WAIT)
            page.wait(holds("Exact"), seconds=WAIT)
            shoot(page, out / "studio_results.png")


def measured(out: Path, measured_set: Path, model: Path) -> None:
    files = (str(measured_set.resolve()), "--model", str(model.resolve()))
    with tempfile.TemporaryDirectory() as folder, studio(Path(folder), *files, window=HIGH) as page:
        press(page, {0: 300, 1: 150})
        page.open_tab("Model")
        page.wait(holds("band: 90"), seconds=WAIT)
        shoot(page, out / "studio_model.png")
        page.open_tab("Motion")
        page.press_button("Errors of all trials")
        page.wait(holds("mean of 9"), seconds=WAIT)
        choose(page, "Trial", TRIAL)
        page.press_button("Show measured and predicted")
        page.wait(holds(f"{TRIAL}: 90 frames"), seconds=WAIT)
        page.press_button("Pause")
        page.fill("Frame", str(FRAME))
        page.wait(holds(", 1.5"), seconds=WAIT)
        shoot(page, out / "studio_measured.png")


def main() -> None:
    out, *files = [Path(name) for name in sys.argv[1:]]
    if files:
        measured(out, *files)
    else:
        layout(out)
        results(out)


if __name__ == "__main__":
    main()
