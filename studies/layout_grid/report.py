"""The folder of a grid: numbers and a page with the front as picture and table."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from fabdesign.drawings.oblique import shape_png
from fabdesign.units import in_mm
from fabdesign.version import __version__
from studies.layout_grid.turns import WORDS, CellResult, GridResult
from studies.layout_search.target import is_wished, measure_of
from studies.layouts import ERRORS, WISHED, error_cells, target_texts
from studies.report import page
from studies.study import write_result

MARKS = {"front": ">", "back": "<", "both": "D"}
_HOW = """A cell may use any layout with as many muscles or fewer on its faces. Its mark is the nearest of those. A
hollow mark shows the result of the cell's own search where that is worse. The line, and bold rows in the table, show
the cells that no other beats with as many muscles or fewer. Each cell started at the results of the cells with fewer
muscles. Cells that gained most got more time. Errors, evaluations and seconds are of the cell's own search."""


def write_report(result: GridResult, out: Path) -> None:
    """Write `result.json` and `report.html` into the folder `out`."""
    write_result(out, result, result.study.search.name, _blocks(result))


def render(result: GridResult) -> str:
    """Return HTML; links to the searches' own pages, else self-contained."""
    return page.html_of(result.study.search.name, _blocks(result))


def _blocks(result: GridResult) -> Iterator[page.Block]:
    search, front = result.study.search, result.front
    wished, side = is_wished(search.targets), search.model.points_per_side if search.model else 41
    yield page.Title(search.name, 1)
    yield from target_texts(next(f.result.targets for f in result.cells if f.result))
    done = len(result.cells)
    if result.interrupted or result.total > done:
        yield page.Text(f"Not finished: {done} of {result.total} searches. The same command goes on from here.", "note")
    yield page.Picture(front_figure(result))
    measure = measure_of(search)
    what = f"{measure[0].upper()}{measure[1:]}" + ("" if wished else " to the target")
    yield page.Text(f"{what}, on the full model ({side} points a side). {_HOW}", "quiet")
    head = ("muscles", "type", "sides", "reached\nmm", "muscles used", *(WISHED if wished else ERRORS))
    rows = [_row(result, f, wished=wished) for f in result.cells]
    best = [k for k, f in enumerate(result.cells) if f in front]
    yield page.TableBlock((*head, "evaluations", "seconds", ""), rows, left_aligned=(1, 2, 4, len(head) + 2), bold=best)
    yield from page.texts("note", [line for f in result.cells for line in result.statements(f.cell)])
    yield page.Title("Shapes of all cells and the target")
    others = [f for f in result.cells if f.result and f not in front]
    explained = "Cells that no other beats with as many muscles or fewer come first."
    yield page.Text(f"{explained} Blue: the cloth's mid-surface. Red: the target.", "quiet")
    for f in [*front, *others]:
        searched = "" if f in front else " (own search)"
        yield page.Title(
            f"{f.cell.muscles} {f.cell.type}, {WORDS[f.cell.sides]}: {page.mm(f.objective)} mm{searched}", 3
        )
        yield from _shape(f)
    yield page.Text(f"Seed {search.seed}, fabdesign {__version__}.", "quiet")


def _row(result: GridResult, entry: CellResult, *, wished: bool) -> tuple[object, ...]:
    """Return the cells of a search: the nearest of its layouts, then what its own search came to."""
    best, search = result.nearest(entry.cell), entry.result
    used: tuple[str, ...] = ("", "")
    if best:
        faces = WORDS[best.sides_used] if best.sides_used else ""
        used = page.mm(best.objective), f"{len(best.pulling)} of {best.cell.muscles} {faces}"
    first = (entry.cell.muscles, entry.cell.type, entry.cell.sides, *used)
    if search is None:
        return (*first, entry.why)
    link = Markup('<a href="cells/{}/report.html">page</a>').format(entry.cell.name)
    return (*first, *error_cells(search.errors, wished=wished), len(search.history), f"{search.wall_s:.0f}", link)


def _shape(entry: CellResult) -> Iterator[page.Block]:
    """Yield the poses beside their targets, and the layout with what there is to say of it."""
    result = entry.result
    assert result is not None
    poses = enumerate(zip(result.points, result.targets, strict=True), start=1)
    alt = f"shape of {entry.cell.name} beside the target, pose "
    pictures = [page.Picture(shape_png(points, target.points), f"{alt}{pose}") for pose, (points, target) in poses]
    path = result.loading_path
    motion = path.sentences if path else ["The motion to this shape was not simulated."]
    layout = page.LayoutBlock(result.design, result.pressure[0], result.study.limits.pressure[1])
    outputs = page.texts("", [f"{name}: {', '.join(values)}" for name, values in result.outputs.items()])
    texts = page.texts("quiet", [page.sentence(result.stop_reason), *result.reach.sentences, *motion])
    yield page.Columns([pictures, [layout, *outputs, *texts]], "cell")


def front_figure(result: GridResult) -> Figure:
    """Return error against muscles: a mark a cell, hollow where a cell with fewer is nearer, the front as a line, the
    floor dashed."""
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    sound = [f for f in result.cells if f.result]
    for k, type_ in enumerate(result.study.types):
        for sides in result.study.sides:
            series = [f for f in sound if (f.cell.type, f.cell.sides) == (type_, sides)]
            if series:
                counts = [f.cell.muscles for f in series]
                nearest = [best.objective for f in series if (best := result.nearest(f.cell))]
                style: dict[str, Any] = {
                    "color": f"C{k}",
                    "linestyle": ":",
                    "linewidth": 0.8,
                    "label": f"{type_}, {sides}",
                }
                axes.plot(counts, in_mm(np.array(nearest)), MARKS[sides], **style)
                worse = [f for f, least in zip(series, nearest, strict=True) if f.objective > least]
                at = [f.cell.muscles for f in worse], [in_mm(f.objective) for f in worse]
                axes.plot(*at, MARKS[sides], color=f"C{k}", fillstyle="none")
    front = result.front
    most = max(f.cell.muscles for f in sound)
    steps = [*(f.cell.muscles for f in front), most], [*(in_mm(f.objective) for f in front), in_mm(front[-1].objective)]
    axes.step(*steps, where="post", color="#1c2430", linewidth=1.5, label="best with as many or fewer")
    if (floor := front[-1].result.floor if front[-1].result else 0.0) > 0:
        axes.axhline(in_mm(floor), color="#5a6675", linestyle="--", label="noise floor")
    axes.set(xlabel="muscles", ylabel=f"{measure_of(result.study.search)}, mm", ylim=(0, None))
    axes.set_xticks(np.unique([f.cell.muscles for f in sound]))
    axes.legend(fontsize="small", frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    return figure


def as_text(result: GridResult) -> str:
    """Return the front in words, a line a cell."""
    lines = [
        f"{f.cell.muscles} muscles, {f.cell.type}, {f.cell.sides}: {in_mm(f.objective):.3f} mm" for f in result.front
    ]
    lines += [
        f"{f.cell.name}: {name}: {', '.join(values)}"
        for f in result.front
        if f.result
        for name, values in f.result.outputs.items()
    ]
    lines += [f"{f.cell.name}: {f.why}" for f in result.cells if f.result is None]
    lines += [sentence for f in result.cells if f.result for sentence in result.statements(f.cell)]
    if result.interrupted:
        lines.append("interrupted; the same command goes on from here")
    return "\n".join(lines)
