"""Can a design be made, and are its values those of cloth and muscles? And studies and benches, as their commands will
check them: targets opened, start against limits, columns needed."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.files.bench_file import read_bench
from fabdesign.files.design_file import DesignPart
from fabdesign.formats.table import nearest
from fabdesign.formats.toml_file import parse_toml
from fabdesign.geometry.hung_cloth import at_rest, held_places
from fabdesign.nouns.bench import Bench
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.muscle import WIDEST, BenchTable, MuscleType, diameter_slip
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.layouts_file import LayoutsStudy
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.study_files.sensitivity_file import SensitivityStudy
from fabdesign.study_files.study_file import Kind, Study, StudyFile, read_head, require_searchable
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.study_files.unseen_file import FREE, UnseenStudy
from fabdesign.units import in_kpa, in_mm
from optimize.fit.free_parameters import fit_vector
from optimize.search.margins import bend_radius, clearance
from studies.benches import SIZES, require_columns, require_sizes
from studies.check.findings import BLOCKED, FABRIC, FREE_CONTRACTION, GRAVITY, MUSCLE_TYPE, Findings, beyond, failures
from studies.follow import wanted_of
from studies.layout_search.first_layouts import first_starts
from studies.layout_search.target import load_target

STUDIES: Mapping[Kind, type[StudyFile]] = {
    "optimize": Study,
    "sensitivity": SensitivityStudy,
    "layouts": LayoutsStudy,
    "unseen": UnseenStudy,
    "loop": LoopStudy,
    "follow": FollowStudy,
}
SPACING = 0.006  # m, that `optimize` keeps between muscles on one face where a study says nothing
_ROUNDING = 1e-6  # m
_ROWS = 4  # of a bench table, that a muscle's law is fitted to
_UPWARDS = 0.5  # cosine, from which gravity points back to the held places
_THICK = 0.1  # of the cloth's shorter side
_NAMED = 3  # pairs of muscles; of more the number is said


def design_findings(design: Design, where: str) -> Findings:
    """Return the findings on a design as a whole."""
    warnings = [*_fabric(design.fabric, FABRIC), *_types(design.muscle_types), *_scene(design)]
    problems = [
        f"muscle_types.{name}: bench has {len(kind.bench.force)} rows; expected at least {_ROWS}, for a law"
        for name, kind in design.muscle_types.items()
        if len(kind.bench.force) < _ROWS
    ]
    too_wide = _too_wide(design.muscle_types, min(design.fabric.width, design.fabric.height))
    problems += too_wide
    for number, muscle in enumerate(design.muscles):
        kind, called = design.muscle_types[muscle.type], f"muscles[{number}]"
        needed = muscle.length + 2 * (kind.tail_length or 0.0)
        if kind.stock_length is not None and needed > kind.stock_length + _ROUNDING:
            tails = f" with tails of {in_mm(kind.tail_length):g} mm" if kind.tail_length else ""
            problems.append(
                f"{called} needs {in_mm(needed):.1f} mm{tails}; expected at most stock_length, "
                f"{in_mm(kind.stock_length):g} mm of {kind.name}"
            )
        if kind.min_bend_radius is not None and len(muscle.path) > 2:
            radius = bend_radius(np.array(muscle.path))
            if radius < kind.min_bend_radius - _ROUNDING:
                problems.append(
                    f"{called} has a corner that no arc of more than {in_mm(radius):.1f} mm rounds; "
                    f"expected min_bend_radius, {in_mm(kind.min_bend_radius):g} mm of {kind.name}"
                )
        longest = max(float(np.linalg.norm(np.subtract(b, a))) for a, b in pairwise(muscle.path))
        if longest < 2 * muscle.fixed_point_pitch - _ROUNDING:
            warnings.append(
                f"{called}: fixed_point_pitch = {muscle.fixed_point_pitch:g} m leaves one interval in a leg of "
                f"{longest:.3g} m; a muscle bends the cloth between fixed points"
            )
    too_close, close = ([], []) if too_wide else spacing(design, SPACING)
    problems += too_close
    warnings += close
    return Findings(tuple(f"{where}: {line}" for line in problems)) + Findings.warned(where, warnings)


def part_findings(part: DesignPart, where: str) -> Findings:
    """Return the findings on a file that designs include."""
    known = {key: expected for key, expected in FABRIC.items() if key in part.keys}
    lines = [*(_fabric(part.fabric, known) if part.fabric else ()), *_types(part.types)]
    wide = tuple(f"{where}: {line}" for line in _too_wide(part.types, np.inf))
    return Findings(wide) + Findings.warned(where, lines)


def _too_wide(types: Mapping[str, MuscleType], side: float) -> list[str]:
    """Return lines on muscles as wide as the cloth's shorter side [m], or wider than any that is laced."""
    return [
        f"muscle_types.{name}: outer_diameter = {kind.outer_diameter:g} m; expected at most {WIDEST:g} m, and less "
        f"than the cloth{diameter_slip(kind.outer_diameter)}"
        for name, kind in types.items()
        if kind.outer_diameter > WIDEST or kind.outer_diameter >= side
    ]


def spacing(design: Design, least: float) -> tuple[list[str], list[str]]:
    """Return lines on pairs of muscles on one face that lie in each other's place, and on those that cross or lie less
    than `least` m apart."""
    overlapping, close = [], []
    for (i, a), (j, b) in combinations(enumerate(design.muscles), 2):
        if a.side != b.side:
            continue
        gap = clearance(np.array(a.path), np.array(b.path))
        wide = (design.muscle_types[a.type].outer_diameter + design.muscle_types[b.type].outer_diameter) / 2
        both = f"muscles[{i}] and muscles[{j}]"
        if gap < 0:
            close.append(f"{both} cross on the {a.side}; optimize keeps muscles of one face apart")
        elif gap < wide - _ROUNDING:
            expected = f"expected their diameter, {in_mm(wide):g} mm, or more{diameter_slip(wide)}"
            overlapping.append(f"{both} lie {in_mm(gap):.3g} mm apart on the {a.side}; {expected}")
        elif gap < least - _ROUNDING:
            close.append(f"{both} lie {in_mm(gap):.3g} mm apart on the {a.side}; optimize keeps {in_mm(least):g} mm")
    return _first(overlapping), _first(close)


def _first(lines: list[str]) -> list[str]:
    others = len(lines) - _NAMED
    return lines if others <= 1 else [*lines[:_NAMED], f"and so {others} more pairs of muscles on one face"]


def _fabric(fabric: Fabric, ranges: Mapping[str, object]) -> Iterator[str]:
    for key in ranges:
        yield from (f"fabric: {line}" for line in beyond(key, getattr(fabric, key), FABRIC[key]))
    short = min(fabric.width, fabric.height)
    if fabric.thickness > _THICK * short and {"width", "thickness"} <= ranges.keys():
        yield f"fabric: thickness = {fabric.thickness:g} m on a cloth of {short:g} m; expected a thin sheet"
    yield from (f"fabric: {line}" for line in beyond("gravity", float(np.linalg.norm(fabric.gravity)), GRAVITY))


def _types(types: Mapping[str, MuscleType]) -> Iterator[str]:
    for name, kind in types.items():
        for key, expected in MUSCLE_TYPE.items():
            yield from (f"muscle_types.{name}: {line}" for line in beyond(key, getattr(kind, key), expected))
        yield from (
            f"muscle_types.{name}: bench: {line}" for line in bench_table_lines(kind.bench, kind.outer_diameter)
        )
        highest = max(kind.bench.pressure)
        if kind.max_pressure is not None and kind.max_pressure > 1.05 * highest:
            yield (
                f"muscle_types.{name}: max_pressure = {in_kpa(kind.max_pressure):g} kPa, but its bench ends at "
                f"{in_kpa(highest):g}; beyond it the law is a guess"
            )


def bench_table_lines(bench: BenchTable, diameter: float | None = None) -> Iterator[str]:
    """Yield what is implausible in a bench table; with a muscle's diameter [m] its forces too."""
    pressure, contraction, force = (np.array(x) for x in (bench.pressure, bench.contraction, bench.force))
    most = pressure >= pressure.max() * (1 - 1e-9)
    pulls = contraction[most & (force > 0)]
    if len(pulls):
        yield from beyond("contraction that still pulls", float(pulls.max()), FREE_CONTRACTION)
    else:
        yield f"no tension at {in_kpa(pressure.max()):g} kPa; expected positive force_n where the muscle pulls"
    if len(np.unique(contraction[most])) > 1 and np.polyfit(contraction[most], force[most], 1)[0] >= 0:
        yield "force rises with contraction; expected it to fall (is contraction negative where the muscle shortens?)"
    if diameter is not None and len(pulls):
        blocked = float(np.abs(force[most]).max() / (pressure.max() * np.pi * diameter**2 / 4))
        yield from beyond("largest force over pressure times cross-section", blocked, BLOCKED)


def _scene(design: Design) -> Iterator[str]:
    gravity, held = np.array(design.fabric.gravity), held_places(design.fabric)
    if len(held) and gravity.any():
        hangs = at_rest(design.fabric, 5, 5).mean(axis=0) - held.mean(axis=0)
        if gravity @ hangs < -_UPWARDS * np.linalg.norm(gravity) * np.linalg.norm(hangs):
            yield f"fabric: gravity = {[*design.fabric.gravity]} pulls the cloth towards where it is held (its sign?)"
    used = {muscle.channel for muscle in design.muscles}
    unused = design.channels - len(used)
    if unused:
        first = next(channel for channel in range(design.channels) if channel not in used)
        yield f"channel {first} has no muscle; its pressures have to be given all the same ({unused} such channels)"
    for name, kind in design.muscle_types.items():
        reach = design.fabric.thickness / 2 + kind.outer_diameter
        if kind.axis_offset > reach:
            yield (
                f"muscle_types.{name}: axis_offset = {kind.axis_offset:g} m; expected at most half the thickness and "
                f"the muscle's diameter, {reach:g} m"
            )


def study_findings(path: Path) -> Findings:
    """Return the findings of a study, its design and all its targets. Raises InputError for what reading refuses."""
    kind = read_head(path).kind
    study: Any = STUDIES[kind].read(path)
    part = next((part for name in ("search", "unsewn") if (part := getattr(study, name, None))), study)
    design = getattr(part, "design", None)
    findings = Findings() if design is None else design_findings(design, f"{path}: design")
    return findings + _FURTHER[kind](study, path) if kind in _FURTHER else findings


def _of_sweep(sweep: SensitivityStudy, path: Path) -> Findings:
    return _targets([sweep.target] if sweep.target else [], sweep.design, sweep.seed)


def _of_loop(loop: LoopStudy, path: Path) -> Findings:
    from studies.loop import open_study

    return failures([partial(open_study, loop)])


def _of_grid(grid: LayoutsStudy, path: Path) -> Findings:
    """Return the findings of a grid, which goes on without the searches that have no layout."""
    findings = _targets(grid.search.targets, grid.search.design, grid.search.seed)
    return findings + Findings.warned(path, failures(partial(first_starts, cell.study) for cell in grid.cells).problems)


def _of_search(study: Study, path: Path) -> Findings:
    require_searchable(study, str(path))
    findings = _targets(study.targets, study.design, study.seed)
    findings += failures([partial(first_starts, replace(study, name=str(path)))])
    _, close = spacing(study.design, study.limits.spacing)
    outside = study.muscles is None and study.positions
    return findings + Findings.warned(
        path, (f"{line}: the search starts outside its limits" for line in close if outside)
    )


def _targets(targets: Iterable[TargetFile], design: Design, seed: int) -> Findings:
    return failures(partial(load_target, target, design, seed=seed) for target in targets)


_FURTHER: Mapping[Kind, Callable[[Any, Path], Findings]] = {  # beside the design, by kind
    "optimize": _of_search,
    "layouts": _of_grid,
    "loop": _of_loop,
    "sensitivity": _of_sweep,
    "unseen": lambda unseen, path: failures([partial(fit_vector, unseen.free, where=f"{path}: {FREE}")]),
    "follow": lambda follow, path: failures([partial(wanted_of, follow)]),
}
_TEXTS = ("format", "name", "specimen", "output", "description", "source")
_OF_A_STRIP = ("width", "direction")  # constants that a law's file takes; others are labels


def bench_findings(path: Path) -> Findings:
    """Return the findings on a bench and all its records. Raises InputError for what reading refuses."""
    bench = read_bench(path)
    findings = failures([partial(require_columns, bench, bench.records), partial(require_sizes, bench)])
    return findings + Findings.warned(path, _unread(path, bench))


def _unread(path: Path, bench: Bench) -> Iterator[str]:
    for key, value in parse_toml(path).items():
        if isinstance(value, str) and key not in _TEXTS:
            yield f"{key} is a text that nothing reads{nearest(key, _TEXTS)}"
    read = SIZES if bench.is_muscle else _OF_A_STRIP if bench.specimen == "strip" else ()
    wanted = [name for name in read if name not in bench.constants]
    for name in bench.constants:
        if meant := nearest(name, wanted):
            yield f"{name} is a constant that nothing reads{meant}"
