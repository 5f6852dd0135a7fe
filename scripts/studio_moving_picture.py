"""docs/studio.gif: a sitting at the studio in a headless chromium. From the repository's root, where chromium is:

python -m scripts.studio_moving_picture [FILE.gif]

Channels are pressed, an end of a muscle is dragged, a limit lights up and goes out. What is seen is the page as it is,
with a dot where the mouse is; frames are taken after each step, so the time that they take is not the page's.
"""

import contextlib
import io
import itertools
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from tests.browser import Page, browser_at
from tests.studio.test_studio_browser import holds, on_screen

OUT = Path("docs/studio.gif")
WINDOW, WIDTH = (1150, 640), 880  # px, of the browser and of the picture
COLOURS, VIVID, FRAME = 56, 60, 130  # a third of the picture's; of 255, from grey on; ms
ENDS = ((0.025, 0.192), (0.071, 0.192), (0.05, 0.192))  # (u, v) m: where the end of muscle 0 is dragged
_DOT = """(() => {
  const dot = document.createElement('div');
  dot.style = 'position:fixed; width:14px; height:14px; border-radius:7px; background:#e0303080; z-index:9999;'
    + 'pointer-events:none; border:2px solid #a01818; transform:translate(-50%, -50%)';
  document.body.append(dot);
  document.addEventListener('pointermove', e => { dot.style.left = e.clientX + 'px'; dot.style.top = e.clientY + 'px' },
    true);
  document.querySelector('.mantine-Notification-closeButton')?.click();
})()"""
_SLIDER = """(() => {
  let node = [...document.querySelectorAll('label')].find(label => label.innerText.trim() == 'Channel %d, kPa');
  while (node && !node.querySelector('[role=slider]')) node = node.parentElement;
  const box = node.querySelector('[role=slider]').parentElement.getBoundingClientRect();
  return [box.x, box.x + box.width, box.y + box.height / 2];
})()"""


class Film:
    """Frames of a tab."""

    def __init__(self, page: Page) -> None:
        self._page, self._frames = page, list[Image.Image]()

    def take(self, wait: float = 0.25, times: int = 1) -> None:
        """One picture after `wait` s, for so many frames."""
        time.sleep(wait)
        shot = Image.open(io.BytesIO(self._page.shot())).convert("RGB")
        size = (WIDTH, round(WIDTH * shot.height / shot.width))
        self._frames += [shot.resize(size, Image.Resampling.LANCZOS)] * times

    def write(self, path: Path) -> None:
        """With one palette for all frames."""
        palette = _palette(self._frames)
        first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in self._frames]
        first.save(path, save_all=True, append_images=others, duration=FRAME, loop=0, optimize=True)


def _palette(frames: list[Image.Image]) -> Image.Image:
    """Some colours by the pixels that have them, and some for what is rare: black, the red of a broken limit."""
    pixels = np.concatenate([np.asarray(frame).reshape(-1, 3)[::3] for frame in frames])
    colours = np.unique(pixels, axis=0)
    vivid = np.ptp(colours, axis=1) > VIVID
    palettes = [
        Image.fromarray(part[None]).quantize(COLOURS).getpalette() or []
        for part in (pixels, colours[vivid], colours[~vivid])
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for part in palettes for value in part[: 3 * COLOURS]])
    return palette


@contextlib.contextmanager
def studio(folder: Path, *arguments: str, window: tuple[int, int] = WINDOW) -> Iterator[Page]:
    """A tab on `fabdesign studio basic.toml`, or with other `arguments`, whose first shape is there."""
    write_design(build("basic"), folder / "basic.toml")
    command = [sys.executable, "-m", "fabdesign", "studio", *(arguments or ("basic.toml",)), "--no-browser"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        with browser_at(address, folder / "profile", width=window[0], height=window[1]) as page:
            page.wait(holds("Exact"), seconds=600)
            yield page
    finally:
        process.terminate()
        process.wait()


def press(page: Page, film: Film, channel: int, end: float) -> None:
    """Move a slider with the mouse to `end`, a share of its length."""
    left, right, y = page.run(_SLIDER % channel)
    page.mouse("Moved", left, y)
    page.mouse("Pressed", left, y, pressed=True)
    for share in np.linspace(0, end, 6)[1:]:
        page.mouse("Moved", left + share * (right - left), y, pressed=True)
        film.take()
    page.mouse("Released", left + end * (right - left), y)


def drag(page: Page, film: Film) -> None:
    """The lower end of muscle 0 along ENDS, with a rest at each."""
    at = [np.array(on_screen(page, end)) for end in ENDS]
    page.mouse("Moved", *at[0])
    page.mouse("Pressed", *at[0], pressed=True)
    for begin, end in itertools.pairwise(at):
        for share in np.linspace(0, 1, 9)[1:]:
            page.mouse("Moved", *(begin + share * (end - begin)), pressed=True)
            film.take()
        page.wait(holds("Limits broken" if end is at[1] else "all kept"), seconds=300)
        film.take(1.0, times=4)
    page.mouse("Released", *at[-1])


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else OUT
    with tempfile.TemporaryDirectory() as folder, studio(Path(folder)) as page:
        page.run(_DOT)
        film = Film(page)
        film.take(times=4)
        for channel, end in ((0, 0.75), (1, 0.75), (6, 0.6)):
            press(page, film, channel, end)
        page.wait(holds("Exact"), seconds=300)
        film.take(1.0, times=5)
        drag(page, film)
        page.wait(holds("Exact"), seconds=300)
        film.take(1.0, times=10)
        film.write(out)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
