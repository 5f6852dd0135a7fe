"""A cloth that passes through itself is told from one that bends, rolls and folds without."""

import numpy as np
import pytest

from fabdesign.geometry.surface import pierced
from fabdesign.nouns.catalogue import build
from tests.layers import depth
from tests.sheets import rolled_sheet

TURN = 2 * np.pi / 0.2  # 1/m: the sheet's ends meet


@pytest.mark.parametrize(
    ("curvature", "through"), [(0.0, False), (0.9 * TURN, False), (-0.9 * TURN, False), (1.3 * TURN, True)]
)
def test_a_roll_passes_through_itself_when_its_ends_do(curvature: float, through: bool) -> None:
    assert (pierced(_wavy(rolled_sheet(curvature))) is not None) == through


def test_a_fold_on_itself_does_not_unless_it_is_pushed_through() -> None:
    for gap, through in ((0.004, False), (0.0005, False), (-0.002, True)):
        assert (pierced(_folded(gap)) is not None) == through


@pytest.mark.parametrize("seed", range(6))
def test_it_answers_as_the_slow_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = _wavy(rolled_sheet(rng.uniform(0.85, 1.25) * TURN, n=21), rng.uniform(0.0, 0.02))
    middle = points.reshape(2, 21, 21, 3).mean(axis=0)
    assert (pierced(points) is not None) == np.isinf(depth(middle, build("vertical")))


def _wavy(points: np.ndarray, height: float = 0.003) -> np.ndarray:
    """Shifted by what depends on x: places at which edges and triangles would lie in one plane are avoided."""
    return points + [[0.0, 0.0, 1.0]] * (height * np.sin(31 * points[:, :1]))


def _folded(gap: float) -> np.ndarray:
    """A hairpin about the x axis whose legs end `gap` [m] apart: negative, crossed."""
    n, radius = 41, 0.01
    u, v = np.meshgrid(np.linspace(0, 0.2, n), np.linspace(0, 0.2, n))
    leg = (0.2 - np.pi * radius) / 2
    angle = np.clip((v - leg) / radius, 0, np.pi)
    y = -np.minimum(v, leg) - radius * np.sin(angle) + np.maximum(v - leg - np.pi * radius, 0)
    back = np.maximum(v - leg - np.pi * radius, 0) / leg  # 0 ... 1 along the second leg
    z = radius * (1 - np.cos(angle)) + back * (gap - 2 * radius)
    face = np.stack([u - 0.1, y, z], axis=-1).reshape(-1, 3)
    return np.concatenate([face, face])
