"""The search's objective: its derivative against central differences, its measures against slow obvious ones."""

from collections.abc import Sequence

import numpy as np
import pytest

from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import MeasureName
from optimize.search.design_space import DesignSpace
from optimize.search.margins import Limits
from optimize.search.objective import Objective, Target
from tests.analytic_cloth import AnalyticCloth

PRESSURES = np.array([[300e3, 100e3, 0.0, 200e3, 0.0, 50e3, 250e3, 0.0]])


@pytest.fixture
def space() -> DesignSpace:
    return DesignSpace(build("basic"), Limits(), PRESSURES)


def shape_of(space: DesignSpace) -> np.ndarray:
    x = space.encode(space.design, PRESSURES)
    return Objective([Target(np.zeros((1, 3)), 1.5)]).shapes(AnalyticCloth(), [space.decode(x)])[0]


def test_chamfer_is_the_sum_of_both_mean_nearest_distances(space: DesignSpace) -> None:
    shape = shape_of(space)
    cloud = shape[0][::7] + 0.003
    apart = np.linalg.norm(cloud[:, None] - shape[0][None], axis=2)
    expected = apart.min(axis=0).mean() + apart.min(axis=1).mean()
    assert Objective([Target(cloud)]).value(shape) == pytest.approx(expected, rel=1e-12)


def test_several_targets_count_alike(space: DesignSpace) -> None:
    shape, far_target = shape_of(space), Target(np.full((10, 3), 0.5))
    shape_target = Target(shape[0])
    both = Objective([shape_target, far_target]).value(np.concatenate([shape, shape]))
    assert both == pytest.approx((Objective([shape_target]).value(shape) + Objective([far_target]).value(shape)) / 2)


@pytest.mark.parametrize(("measure", "markers"), [("chamfer", False), ("surface_rms", False), ("chamfer", True)])
def test_gradient_is_the_derivative(space: DesignSpace, measure: MeasureName, markers: bool) -> None:
    rng = np.random.default_rng(5)
    shape = shape_of(space)
    cloud = shape[0] + rng.normal(0, 2e-3, shape[0].shape)
    objective = Objective([Target(cloud[:: 17 if markers else 1], markers=markers)], measure=measure)
    _, slope = objective.gradient(shape)
    direction = np.stack([np.sin(20 * shape[..., 1]), np.cos(15 * shape[..., 0]), np.ones(shape.shape[:2])], axis=-1)
    h = 1e-7
    ahead, behind = (objective.gradient(shape + s * h * direction)[0] for s in (1, -1))
    assert np.sum(slope * direction) == pytest.approx((ahead - behind) / (2 * h), rel=1e-4)


class Wave:
    """A forward model whose cloth is z = 0.02 sin(20 u + 10 v) at any number of points."""

    def __init__(self, side: int) -> None:
        self.side = side

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        raise AssertionError("a target without a time asks for equilibria")

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        u, v = np.meshgrid(*[np.linspace(0, 0.2, self.side)] * 2)
        face = np.stack([u - 0.1, -v, 0.02 * np.sin(20 * u + 10 * v)], axis=-1).reshape(-1, 3)
        return [
            np.concatenate([np.add(face, (0, 0, 1e-3)), np.subtract(face, (0, 0, 1e-3))]).astype(np.float32)
            for _ in cases
        ]


def test_a_coarse_grid_is_interpolated(space: DesignSpace) -> None:
    # cubic spline: error below h^4 max|f| / 384 inside, some ten times that at the ends; h = 10 mm, f = 0.02 20^4
    layout = space.decode(space.encode(space.design, PRESSURES))
    objective = Objective([Target(np.zeros((1, 3)))])
    coarse, fine = (objective.shapes(Wave(side), [layout])[0] for side in (21, 41))
    assert coarse.shape == fine.shape
    assert np.abs(coarse - fine).max() < 10 * 0.01**4 * 0.02 * 20**4 / 384


def test_nan_is_nan_and_not_a_small_number(space: DesignSpace) -> None:
    shape = shape_of(space)
    shape[0, 7, 1] = np.nan
    assert np.isnan(Objective([Target(np.zeros((3, 3)))]).value(shape))


def test_poses_count_by_their_weights() -> None:
    rng = np.random.default_rng(4)
    shape = rng.normal(size=(2, 50, 3))
    targets = [Target(rng.normal(size=(40, 3))) for _ in range(2)]
    alone = [Objective([target]).value(pose[None]) for target, pose in zip(targets, shape, strict=True)]
    weighted = Objective(targets, weights=(3.0, 1.0))
    assert weighted.value(shape) == pytest.approx((3 * alone[0] + alone[1]) / 4)
    assert Objective(targets).value(shape) == pytest.approx(np.mean(alone))
    value, slope = weighted.gradient(shape)
    step = 1e-6 * rng.normal(size=shape.shape)
    assert weighted.gradient(shape + step)[0] - value == pytest.approx(float((slope * step).sum()), rel=1e-2)
