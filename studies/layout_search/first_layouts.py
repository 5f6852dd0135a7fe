"""Where the search of a study begins, and begins anew; and the stages in which it goes from the coarse model to the
fine one."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fabdesign.errors import InputError
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.runtime.effort import MUSCLES
from fabdesign.study_files.study_file import Study
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace, Vector, by_muscle, starts_of
from optimize.search.objective import Objective
from optimize.search.search_state import FurtherStarts
from optimize.search.slopes import jacobians_for
from optimize.search.starts import Start, catalogue_starts, layout_starts, pressure_starts, thinned_starts
from optimize.search.variations import pulling, variations, with_corners, with_idle
from studies.layout_search.target import LoadedTarget
from studies.prediction.forward_model import without_resistance
from studies.study import Simulated, simulator

PRESSURE_STARTS = 31  # screened before pressures are searched
LAYOUT_STARTS = 64  # drawn and screened before layouts are searched; a multiple of what the simulator takes at once
VARIATIONS = 24  # of the best, screened by every other restart,
ADDITIONS = 16  # and as many places of a muscle more, each with
PULL = 0.4  # of the pressure range: past the threshold of a braided muscle, so that a pull shows
THINNED_STARTS = 72  # of the design's own muscles, where it has more than the layout may


def stated_start(study: Study) -> tuple[DesignSpace, Vector]:
    """Return the study's own design under its start pressures, by default the middle of the limits."""
    middle = np.mean(study.limits.pressure)
    stated = np.full(study.design.channels, middle) if study.start_pressures is None else study.start_pressures
    pressures = np.tile(stated, (len(study.targets), 1))
    space = DesignSpace(study.design, study.limits, pressures, vary_pressures=study.pressures)
    return space, space.encode(study.design, pressures)


def earlier_starts(study: Study) -> list[Start]:
    """Return the earlier result that the study begins with, if any.

    Raises InputError where it is no layout of this study: other muscles where they stay, too many or too few, another
    number of poses, a limit broken.
    """
    earlier = study.earlier
    if earlier is None:
        return []
    poses = len(study.targets)
    if len(earlier.pressures) != poses:
        raise InputError(f"{earlier.file}: has pressures of {len(earlier.pressures)} poses; expected {poses}")
    design = replace(study.design, muscles=earlier.design.muscles)
    if study.muscles is None and not study.positions and design.muscles != study.design.muscles:
        raise InputError(
            f"{earlier.file}: has other muscles than the study's design; expected the same where they stay"
        )
    if study.muscles is not None and len(design.muscles) not in study.muscles.counts:
        raise InputError(
            f"{earlier.file}: has {len(design.muscles)} muscles; expected {study.muscles.least} to {study.muscles.most}"
        )
    if design.channels > (study.limits.channels or MUSCLES):
        raise InputError(f"{earlier.file}: has {design.channels} channels; expected at most {study.limits.channels}")
    if unknown := {muscle.type for muscle in design.muscles} - set(design.muscle_types):
        raise InputError(
            f"{earlier.file}: has muscles of type {', '.join(sorted(unknown))}; the study's design has none"
        )
    space = DesignSpace(design, study.limits, earlier.pressures, vary_pressures=study.pressures)
    return [(space, space.encode(design, earlier.pressures))]


def first_starts(study: Study) -> list[Start]:
    """Return the study's own design, an earlier result, the catalogue's layouts, and what is drawn by the study's
    seed."""
    limits, poses = study.limits, len(study.targets)
    space, stated = stated_start(study)
    if study.muscles is None:
        drawn = pressure_starts(space, PRESSURE_STARTS if study.pressures else 0, study.seed)
        return [*earlier_starts(study), *drawn]
    choice, design = study.muscles, study.design
    drawn = catalogue_starts(design, limits, poses, choice)
    drawn += layout_starts(design, limits, poses, choice, number=LAYOUT_STARTS, seed=study.seed)
    sides = {muscle.side for muscle in design.muscles}
    if len(design.muscles) in choice.counts and sides <= set(choice.sides):
        fits = design.channels <= (limits.channels or MUSCLES)  # else with shared channels, where that keeps the limits
        drawn = [*([(space, stated)] if fits else starts_of([by_muscle((space, stated))], space)), *drawn]
    elif len(design.muscles) > choice.most and sides <= set(choice.sides):
        drawn += thinned_starts(space, choice.most, number=THINNED_STARTS, seed=study.seed)
    drawn = [*earlier_starts(study), *drawn]
    if not drawn:
        raise InputError(f"{study.name}: no layout of {choice.least} muscles keeps the limits; expected wider ones")
    return drawn


def further_starts(study: Study) -> FurtherStarts | None:
    """Return what gives the starts of further restarts; None where nothing can be drawn anew."""
    return partial(_drawn_anew, study) if study.muscles is not None or study.pressures else None


def _drawn_anew(study: Study, restart: int, best: Start) -> tuple[list[Start], bool]:
    """Return the starts of a restart, and whether they owe nothing to the best: by turns those near it, and others."""
    seed, choice, poses = study.seed + 1000 * restart, study.muscles, len(study.targets)
    if choice is None:
        return pressure_starts(stated_start(study)[0], PRESSURE_STARTS, seed)[1:], True
    if restart % 2 == 0:
        return layout_starts(study.design, study.limits, poses, choice, number=LAYOUT_STARTS, seed=seed), True
    choice = choice if study.positions else replace(choice, corners=0)
    drawn = [*variations(best, choice, number=VARIATIONS, seed=seed), *with_corners(best, choice.corners)]
    count = len(best[0].design.muscles)
    if count + 1 in choice.counts:
        # one muscle more at a share of the pressure: what it promises shows when these are screened; of several poses
        # each takes it pulling or idle
        more = with_idle(best, count=count + 1, sides=choice.sides, number=ADDITIONS, seed=seed)
        drawn += [*(more if poses > 1 else []), *pulling(more, count, PULL)]
    return drawn, False


COARSE = 21  # points a side, of the simulator on which a search begins


def forward_models(how: Simulated, study: Study, targets: Sequence[LoadedTarget]) -> tuple[ForwardModel, ForwardModel]:
    """Return the fine and the coarse model given, or the simulator, for a study with its targets; a single one given
    serves for both."""
    fine, coarse = how.get("forward"), how.get("coarse")
    if fine is not None:
        return fine, coarse or fine
    # the coarse one's shapes at rest stand for frames of the targets (optimize.search.objective)
    times = [target.time for target in targets if target.time is not None]
    hold = study.hold if len(times) < len(targets) else min(study.hold, max(0.0, max(times) - study.rise))
    fine = simulator((study.model or Model()).points_per_side, study)
    return fine, coarse or simulator(COARSE, study, tolerance=1e-6, hold=hold)


def stages_of(study: Study, coarse: Predictor, fine: Predictor, objective: Objective) -> list[Stage]:
    """Return the stages. Slopes are those without forces against motion, where derivatives are known."""
    known = jacobians_for(coarse, objective) is not None
    bare = without_resistance(coarse) if known else None
    if study.muscles is not None:
        return [
            Stage("pressures of drawn layouts", coarse, keep=10, rounds=1, until=0.4, slopes=bare, at_rest=True),
            Stage("layouts", coarse, keep=4, rounds=4, vary_positions=study.positions, until=0.5, slopes=bare),
            Stage("best layouts", coarse, keep=2, rounds=12, vary_positions=study.positions, until=0.65, slopes=bare),
            Stage("full model", fine, keep=1, rounds=32, vary_positions=study.positions, slopes=bare or coarse),
        ]
    return [
        Stage("coarse model", coarse, keep=2, rounds=8, vary_positions=study.positions, until=0.5, slopes=bare),
        Stage("full model", fine, keep=2, rounds=8, vary_positions=study.positions, slopes=bare or coarse),
    ]
