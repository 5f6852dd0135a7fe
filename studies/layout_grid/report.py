"""The folder of a grid: numbers and a page with the front as picture and table."""

from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from fabdesign.json_file import write_json
from fabdesign.layout_drawing import layout_svg
from fabdesign.output import write_text
from fabdesign.units import in_mm
from studies.layout_grid.result import WORDS, CellResult, GridResult
from studies.layouts.shape_picture import shape_png
from studies.layouts.wished import is_wished, measure_of
from studies.report import html_of, svg_of

MARKS = {"front": ">", "back": "<", "both": "D"}


def write_report(result: GridResult, out: Path) -> None:
    """Write `result.json` and `report.html` into the folder `out`."""
    write_json(out / "result.json", result.as_json())
    write_text(out / "report.html", render(result))


def render(result: GridResult) -> str:
    """HTML; links to the searches' own pages, else self-contained."""
    search = result.study.search
    return html_of(
        "layout_grid/report.html.j2",
        result=result,
        name=search.name,
        targets=next(f.result.targets for f in result.cells if f.result),
        front=result.front,
        rows=[(f, result.nearest(f.cell), result.statements(f.cell)) for f in result.cells],
        words=WORDS,
        measure=measure_of(search),
        wished=is_wished(search.targets),
        points_per_side=search.model.points_per_side if search.model else 41,
        picture=Markup(front_svg(result)),
        shapes=[_shapes(f) for f in _shown(result)],
        shown=_shown(result),
        layout=lambda f: Markup(layout_svg(f.result.design, f.result.pressures[0], search.limits.pressure[1])),
    )


def _shown(result: GridResult) -> list[CellResult]:
    """Cells with a shape, those of the front first."""
    front = result.front
    return [*front, *(f for f in result.cells if f.result and f not in front)]


def _shapes(own: CellResult) -> list[Markup]:
    """A picture a pose."""
    assert own.result is not None
    poses = zip(own.result.points, own.result.targets, strict=True)
    return [Markup(shape_png(points, target.points)) for points, target in poses]


def front_svg(result: GridResult) -> str:
    """Error against muscles: a mark a cell, hollow where a cell with fewer is nearer, the front as a line, the floor
    dashed."""
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    sound = [f for f in result.cells if f.result]
    for k, type_ in enumerate(result.study.types):
        for sides in result.study.sides:
            own = [f for f in sound if (f.cell.type, f.cell.sides) == (type_, sides)]
            if own:
                counts = [f.cell.muscles for f in own]
                reached = [in_mm(min(f.objective, _nearest(result, f))) for f in own]
                label = f"{type_}, {sides}"
                axes.plot(counts, reached, MARKS[sides], color=f"C{k}", linestyle=":", linewidth=0.8, label=label)
                worse = [f for f in own if f.objective > _nearest(result, f)]
                at = [f.cell.muscles for f in worse], [in_mm(f.objective) for f in worse]
                axes.plot(*at, MARKS[sides], color=f"C{k}", fillstyle="none")
    front = result.front
    most = max(f.cell.muscles for f in sound)
    steps = [*(f.cell.muscles for f in front), most], [*(in_mm(f.objective) for f in front), in_mm(front[-1].objective)]
    axes.step(*steps, where="post", color="#1c2430", linewidth=1.5, label="best with as many or fewer")
    if (floor := _floor(front[-1])) > 0:
        axes.axhline(in_mm(floor), color="#5a6675", linestyle="--", label="noise floor")
    axes.set(xlabel="muscles", ylabel=f"{measure_of(result.study.search)}, mm", ylim=(0, None))
    axes.set_xticks(np.unique([f.cell.muscles for f in sound]))
    axes.legend(fontsize="small", frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    return svg_of(figure)


def _nearest(result: GridResult, own: CellResult) -> float:
    best = result.nearest(own.cell)
    return best.objective if best else float("inf")


def _floor(own: CellResult) -> float:
    assert own.result is not None
    errors = own.result.errors
    return errors.chamfer_floor if own.result.study.objective == "chamfer" else errors.surface_floor


def as_text(result: GridResult) -> str:
    """For people: the front, a line a cell."""
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
