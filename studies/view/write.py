"""The writers of panels by the file's ending, and named points of a cloth over time, as a CSV."""

import shutil
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.csv_table import write_rows
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.output import write_text
from studies.view.exchange import save_recording, save_series
from studies.view.items import Item, compared

# the package that writes a kind of file, besides what is always there
_NEEDS = {".glb": "pygltflib", ".pvd": "meshio", ".rrd": "rerun", ".mp4": "imageio_ffmpeg"}
KINDS = (".html", ".png", ".gif", ".mp4", ".glb", ".pvd", ".rrd", ".csv")


def require_writer(kind: str) -> None:
    """Raise ModuleNotFoundError where the package that writes a kind is missing. An ffmpeg of the system serves too."""
    if kind in _NEEDS and not (kind == ".mp4" and shutil.which("ffmpeg")):
        import_module(_NEEDS[kind])


def write_panels(
    items: Sequence[Item],
    path: Path,
    *,
    times: Sequence[float] = (),
    markers: Mapping[str, tuple[float, float]] | None = None,
    overlay: bool = False,
) -> list[dict[str, object]]:
    """Write panels as the kind of file that the name's ending says, one of KINDS; return a note on each, or none:
    `frames_kept` in a file, or its `distance` to what it is compared with.

    times: s, of a picture. markers: (u, v) m, of a table. overlay: whether a panel shows what it is compared with, too.
    """
    kind = path.suffix.lower()
    if kind == ".glb":
        from studies.view.gltf import save_glb

        return save_glb(items, path)
    if kind in (".pvd", ".rrd"):
        (save_series if kind == ".pvd" else save_recording)(items, path)
        return []
    if kind == ".csv":
        save_markers(items, path, markers or {})
        return []
    items = compared(items)
    if kind == ".html":
        from studies.view.page import render_page

        write_text(path, render_page(path.stem, items, overlay=overlay))
    else:
        from studies.view.picture import save_animation, save_picture

        if kind == ".png":
            save_picture(items, path, times, overlay=overlay)
        else:
            save_animation(items, path, overlay=overlay)
    return [{} if item.apart is None else {"distance": item.apart} for item in items]


# shares of width and height from the upper left corner, seen from the front
USUAL = {"lower_left": (0.0, 1.0), "lower_middle": (0.5, 1.0), "lower_right": (1.0, 1.0), "middle": (0.5, 0.5)}


def save_markers(items: Sequence[Item], path: Path, markers: Mapping[str, tuple[float, float]]) -> None:
    """Write a row a panel and frame: `panel`, `time_s` (empty of a still shape), and x, y, z in m of every marker,
    which lies on the mid-surface.

    markers: (u, v) m in fabric coordinates; without any, those of USUAL. Raises InputError for a panel that is no
    cloth, for one whose size is not known, and for a marker beside the cloth.
    """
    names = [*(markers or USUAL)]
    rows = []
    for item in items:
        if not item.is_cloth:
            raise InputError(f"{item.title}: is a cloud or mesh, without named points; expected motions of a cloth")
        places = [_place(item, name, *markers[name]) for name in names] if markers else [*USUAL.values()]
        for time, points in zip(item.times, item.frames, strict=True):
            places_at = at_places(Shape.of(points).middle, places)
            at = f"{time:.6f}" if item.moves else ""
            rows.append([item.title, at, *(f"{value:.6f}" for value in places_at.ravel())])
    columns = [f"{name}_{axis}_m" for name in names for axis in "xyz"]
    write_rows(path, ["panel", "time_s", *columns], rows)


def _place(item: Item, name: str, u: float, v: float) -> tuple[float, float]:
    if item.size is None:
        raise InputError(f"{item.title}: does not say its cloth's size; expected a motion simulated by this version")
    share = np.array([u, v]) / item.size
    if (share < -1e-9).any() or (share > 1 + 1e-9).any():
        width, height = item.size
        raise InputError(f"marker {name} at {u:g}, {v:g} m: expected a place on the cloth, {width:g} by {height:g} m")
    return float(share[0]), float(share[1])
