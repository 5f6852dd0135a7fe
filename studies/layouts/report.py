"""The page that shows what a study found: self-contained, for any browser, without a network."""

import platform
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from fabdesign.layout_drawing import layout_svg
from fabdesign.metrics import MANY_BEYOND, told_beyond
from fabdesign.model import Model
from fabdesign.pressure import poses_in_words
from studies.layouts.figures import convergence_figure, scene_figure
from studies.layouts.result import StudyResult
from studies.layouts.robustness import said as robust_said
from studies.layouts.shape_picture import shape_png
from studies.layouts.wished import asked_of, is_wished
from studies.report import PlotlyFigure, html_of, package_versions

PACKAGES = ("taichi", "nlopt", "numpy", "scipy")


@dataclass(frozen=True)
class Section:
    """One study of the page."""

    title: str
    result: StudyResult


def render_report(title: str, sections: Sequence[Section], *, more: str = "") -> str:
    """HTML of one or several studies of the same targets: errors, 3D overlay, layout, convergence, provenance; `more`
    is HTML that comes before the last."""
    figures: dict[str, PlotlyFigure] = {}
    for s, section in enumerate(sections):
        for pose in range(len(section.result.targets)):
            figures[f"scene-{s}-{pose}"] = scene_figure(section.result, pose)
        figures[f"curve-{s}"] = convergence_figure(section.result)
    first = sections[0].result
    return html_of(
        "layouts/report.html.j2",
        figures=figures,
        title=title,
        sections=sections,
        more=Markup(more),
        targets=first.targets,
        wished=is_wished(first.study.targets),
        asked=lambda result, pose: asked_of(result.study.targets[pose], result.points[pose], result.design.fabric),
        measured=any(target.measured for target in first.targets),
        synthetic=any(target.synthetic for target in first.targets),
        points_per_side=(first.study.model or Model()).points_per_side,
        capped=[
            f"{s.title}: {told_beyond(s.result.errors.beyond)}"
            for s in sections
            if s.result.errors.beyond >= MANY_BEYOND
        ],
        failed=lambda result: sum(entry.diverged for entry in result.history),
        layout=_layout,
        corners=lambda result: any(len(muscle.path) > 2 for muscle in result.design.muscles),
        poses_in_words=poses_in_words,
        robust_said=robust_said,
        robust_picture=_robust_picture,
        with_unit=_with_unit,
        provenance=_provenance(sections),
    )


def _with_unit(limit: str, margin: float) -> str:
    """A margin as people read it; lengths but for what is named here."""
    units = {"pressure": (1e-3, "kPa"), "contraction": (1e2, "%"), "channels": (1.0, ""), "air": (1e6, "cm^3")}
    factor, unit = units.get(limit, (1e3, "mm"))
    return f"{factor * margin:.0f}" if not unit else f"{factor * margin:.1f} {unit}"


def _robust_picture(result: StudyResult) -> Markup:
    """The result, its copies with scatter and the target."""
    copies = [shape[0] for shape in result.robust.shapes] if result.robust else []
    return Markup(shape_png(result.points[0], result.targets[0].points, copies))


def _layout(result: StudyResult, pose: int) -> Markup:
    return Markup(layout_svg(result.design, result.pressures[pose], result.study.limits.pressure[1]))


def _provenance(sections: Sequence[Section]) -> dict[str, str]:
    study = sections[0].result.study
    hashes = ", ".join(target.sha256[:12] for target in sections[0].result.targets)
    return {
        **({} if is_wished(study.targets) else {"target clouds, sha256": hashes}),
        "parameters": "data sheet" if study.model is None else "calibrated model",
        "search": "prox-linear local searches over NLopt (SLSQP), derivatives of shapes or differences in batches",
        "versions": package_versions(PACKAGES),
        "Python": f"{platform.python_version()} on {platform.system()}",
    }
