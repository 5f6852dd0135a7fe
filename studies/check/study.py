"""Checks of studies and benches, as their commands will make them: targets opened, start against limits, columns
needed."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from fabdesign.files.bench_file import read_bench
from fabdesign.formats.table import nearest
from fabdesign.formats.toml_file import parse_toml
from fabdesign.nouns.bench import Bench
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.layouts_file import LayoutsStudy
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.study_files.sensitivity_file import SensitivityStudy
from fabdesign.study_files.study_file import read_head, read_study
from fabdesign.study_files.unseen_file import FREE, UnseenStudy
from optimize.fit.free_parameters import fit_vector
from studies.benches.records import SIZES, require_columns, require_sizes
from studies.check.design import design_findings, spacing
from studies.check.findings import Findings, failures
from studies.follow.target import wanted_of
from studies.layout_search.target import load_target


def study_findings(path: Path) -> Findings:
    """Return the findings of a study, its design and all its targets. Raises InputError for what reading refuses."""
    kind = read_head(path).kind
    if kind == "sensitivity":
        sweep = SensitivityStudy.read(path)
        findings = design_findings(sweep.design, f"{path}: design")
        targets = [sweep.target] if sweep.target else []
        return findings + failures(partial(load_target, target, sweep.design, seed=sweep.seed) for target in targets)
    if kind == "unseen":
        unseen = UnseenStudy.read(path)
        findings = failures([partial(fit_vector, unseen.free, where=f"{path}: {FREE}")])
        return findings + design_findings(unseen.unsewn.design, f"{path}: design") if unseen.unsewn else findings
    if kind == "loop":
        from studies.loop.run import open_study  # here: its report needs what a page is drawn with

        loop = LoopStudy.read(path)
        return design_findings(loop.search.design, f"{path}: design") + failures([partial(open_study, loop)])
    if kind == "follow":
        follow = FollowStudy.read(path)
        return design_findings(follow.design, f"{path}: design") + failures([partial(wanted_of, follow)])
    study = LayoutsStudy.read(path).search if kind == "layouts" else read_study(path)
    findings = design_findings(study.design, f"{path}: design")
    findings += failures(partial(load_target, target, study.design, seed=study.seed) for target in study.targets)
    least = study.limits.spacing
    _, close = spacing(study.design, least)
    if study.muscles is None and study.positions:
        lines = [f"{path}: {line}: the search starts outside its limits" for line in close]
        findings += Findings(warnings=tuple(lines))
    return findings


_TEXTS = ("format", "name", "specimen", "output", "description", "source")
_CONSTANTS = {"muscle": SIZES, "strip": ("width", "direction")}  # that a law's file takes; others are labels


def bench_findings(path: Path) -> Findings:
    """Return the findings on a bench and all its records. Raises InputError for what reading refuses."""
    bench = read_bench(path)
    findings = failures([partial(require_columns, bench, bench.records), partial(require_sizes, bench)])
    return findings + Findings(warnings=tuple(f"{path}: {line}" for line in _unread(path, bench)))


def _unread(path: Path, bench: Bench) -> Iterator[str]:
    for key, value in parse_toml(path).items():
        if isinstance(value, str) and key not in _TEXTS:
            yield f"{key} is a text that nothing reads{nearest(key, _TEXTS)}"
    wanted = [name for name in _CONSTANTS.get(bench.specimen, ()) if name not in bench.constants]
    for name in bench.constants:
        if meant := nearest(name, wanted):
            yield f"{name} is a constant that nothing reads{meant}"
