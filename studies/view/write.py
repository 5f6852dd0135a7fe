"""Which writer makes a file of panels, by the file's ending."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TypedDict

from fabdesign.output import write_text
from studies.view.items import Item

# the package that writes a kind of file, besides what is always there
_NEEDS = {".glb": "pygltflib", ".pvd": "meshio", ".rrd": "rerun", ".mp4": "imageio_ffmpeg"}
KINDS = (".html", ".png", ".gif", ".mp4", ".glb", ".pvd", ".rrd", ".csv")


class PanelNote(TypedDict, total=False):
    """A note on a panel: frames that a file keeps, its distance to what it is compared with."""

    frames_kept: int
    distance: dict[str, object]


Writer = Callable[[Sequence[Item], Path], list[PanelNote]]


def require_writer(kind: str) -> None:
    """Raise ModuleNotFoundError where the package that writes a kind is missing. An ffmpeg of the system serves too."""
    if kind in _NEEDS and not (kind == ".mp4" and shutil.which("ffmpeg")):
        import_module(_NEEDS[kind])


def writer(
    kind: str,
    times: Sequence[float] = (),
    markers: Mapping[str, tuple[float, float]] | None = None,
    *,
    overlay: bool = False,
) -> Writer:
    """Return what writes a file of a kind, one of KINDS, and answers a note on each panel, or none. times: s, of a
    picture. markers: (u, v) m, of a table. overlay: whether a panel shows what it is compared with, too."""
    if kind in (".html", ".png", ".gif", ".mp4"):
        return lambda items, path: _shown(items, path, kind, times, overlay)
    if kind == ".glb":
        from studies.view.gltf import kept, save_glb

        def glb(items: Sequence[Item], path: Path) -> list[PanelNote]:
            save_glb(items, path)
            return [{"frames_kept": len(kept(item))} for item in items]

        return glb
    if kind == ".pvd":
        from studies.view.vtk import save_series as save
    elif kind == ".rrd":
        from studies.view.rerun_file import save_recording as save
    else:
        from studies.view.markers import save_markers

        def save(items: Sequence[Item], path: Path) -> None:
            save_markers(items, path, markers or {})

    def plain(items: Sequence[Item], path: Path) -> list[PanelNote]:
        save(items, path)
        return []

    return plain


def _shown(items: Sequence[Item], path: Path, kind: str, times: Sequence[float], overlay: bool) -> list[PanelNote]:
    from studies.view.distance import distances

    apart = distances(items)
    if kind == ".html":
        from studies.view.page import render_page

        write_text(path, render_page(path.stem, items, apart, overlay=overlay))
    elif kind == ".png":
        from studies.view.picture import save_picture

        save_picture(items, path, apart, times, overlay=overlay)
    else:
        from studies.view.picture import save_animation

        save_animation(items, path, apart, overlay=overlay)
    return [{} if distance is None else {"distance": distance.as_json()} for distance in apart]
