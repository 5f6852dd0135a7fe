"""Reports of made results, in seconds: what tests look at as pages and what a person opens to see them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.study_files.layouts_file import Cell, LayoutsStudy
from fabdesign.study_files.study_file import Study, read_study
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.objective import Objective
from studies.benches.trace_report import render_bench
from studies.benches.tracing import examine
from studies.layout_grid.report import render
from studies.layout_grid.turns import CellResult, GridResult
from studies.layout_search.target import LoadedTarget, load_target
from studies.layouts.report import render_report
from studies.layouts.result import StudyResult
from studies.layouts.run import study_result
from studies.prediction.forward_model import forward_model
from tests.analytic_cloth import AnalyticCloth

CLOTHS = {"square": (0.2, 0.2), "wide": (0.24, 0.15), "tall": (0.12, 0.3)}  # m, across and down
KPA = np.array([[320e3, 150e3, 80e3, 260e3]])


def search_result(width: float, height: float, *, wish: bool = False) -> StudyResult:
    """Return what a search of a few evaluations on a cloth in closed form came to; sizes in m. wish: for the lower edge
    in place of a cloud."""
    design = build("basic", width=width, height=height, muscles=4, name="a long name of a layout for a page")
    target = wished(design) if wish else TargetFile(Path("target.ply"))
    study = Study("made", design, (target,))
    cloud = AnalyticCloth().equilibria([_case(design)])[0][::2].astype(float)
    cloud += np.random.default_rng(1).normal(0, 6e-4, cloud.shape)
    spaces = [DesignSpace(design, study.limits, KPA * share) for share in (0.2, 0.6, 0.9, 0.95, 1.0)]
    starts = [(space, space.encode(design, space.start_pressures)) for space in spaces]
    stages = [Stage("full model, positions and pressures", AnalyticCloth(), keep=2, rounds=1)]
    with History(":memory:", {}) as history:
        loaded = load_target(target, design) if wish else LoadedTarget(cloud, description="a cloud made for tests")
        evaluations = Evaluations(Objective([loaded]), starts, stages, history, seconds=100, evaluations=100)
        evaluations.evaluate(0, [(k, x) for k, (_, x) in enumerate(starts)])
        model = forward_model(AnalyticCloth(), None)
        return study_result(
            study, (loaded,), evaluations, model, "the limit of 5 evaluations is reached",
            verification="at rest",
        )  # fmt: skip


def wished(design: Design) -> TargetFile:
    """Return a target that asks for the lower edge and one corner."""
    edge = {"edge": "bottom", "forward": 0.04}
    corner = {"at": [0.0, design.fabric.height], "x": -0.05, "z": 0.05, "weight": 2}
    study = read_study({"design": design, "target": {"wishes": [edge, corner]}})
    return replace(study.targets[0], file=Path("study.toml"))


def search_page(width: float, height: float, *, wish: bool = False) -> str:
    """Return the page of `optimize`."""
    result = search_result(width, height, wish=wish)
    return render_report(result.design.name, {result.design.name: result})


def grid_page(width: float, height: float) -> str:
    """Return the page of `layouts`: a search, another of the same result, and one that found no layout."""
    result = search_result(width, height)
    cells = [Cell(f"{n}_EM20_{sides}", n, "EM20", sides, result.study) for n, sides in ((4, "both"), (5, "front"))]
    outcomes = [CellResult(cell, result, "") for cell in cells]
    outcomes.append(CellResult(replace(cells[0], name="9", muscles=9), None, "no room for nine muscles, 12 mm apart"))
    study = LayoutsStudy(result.study, (4, 5, 9), ("EM20",), ("both", "front"))
    return render(GridResult(study, tuple(outcomes), 3))


def bench_page() -> str:
    """Return the page of a trace of a bench with friction."""
    rng, records = np.random.default_rng(4), []
    from tests.tracing.test_trace_bench import cylinder

    for k, pressure in enumerate((1e5, 3e5, 5e5, 7e5)):
        records.append(BenchRecord(f"record {k}", cylinder(rng, pressure, 4e-3, 2.0), {}))
    bench = Bench("SLEEVE28B", "cylinder", (), "force", {}, tuple(records))
    return render_bench(examine(bench, 0.005))


def _case(design):
    from fabdesign.nouns.forward import Case

    return Case(design, constant_program(KPA[0]))


PAGES: dict[str, Callable[[], str]] = {
    **{f"search_{name}": (lambda size=size: search_page(*size)) for name, size in CLOTHS.items()},
    "wish": lambda: search_page(*CLOTHS["wide"], wish=True),
    "grid": lambda: grid_page(*CLOTHS["wide"]),
    "bench": bench_page,
}

if __name__ == "__main__":
    import sys

    for name, make in PAGES.items():
        Path(sys.argv[1], f"{name}.html").write_text(make(), encoding="utf-8")
