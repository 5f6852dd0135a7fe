"""How far what is sewn may lie from a result's shape, by the model's calibrated intervals."""

from dataclasses import replace

import numpy as np

from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.spread import half_widths, spread_of
from optimize.search.design_space import DesignSpace
from optimize.search.objective import Objective
from studies.intervals.draws import drawn_models
from studies.intervals.regions import region_terms
from studies.layout_search.first_layouts import limits_of
from studies.layouts.result import StudyResult


def expected_within(result: StudyResult, objective: Objective, coarse: Predictor) -> float | None:
    """m: half the width of the 90 % intervals along the cloth's normal, mean over poses and regions. None of a model
    without. coarse: moves the drawn models."""
    spread = spread_of(coarse.model)
    if spread is None:
        return None
    space = DesignSpace(result.design, limits_of(result.study), result.pressures, vary_pressures=False)
    models = drawn_models(coarse.model) if spread.covariance else []
    others = [objective.shapes(replace(coarse, model=model), [(space, np.empty(0))])[0] for model in models]
    terms = region_terms(result.rest, result.points, others, result.design.fabric)
    return float(half_widths(spread, *terms).mean())
