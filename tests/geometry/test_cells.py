"""Cell lists against a tree over points and against all triangles, near and far; a trial's errors computed slowly."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from sheets import rolled_sheet

from fabdesign.geometry.distances import Cells
from fabdesign.geometry.metrics import DRAWS, trial_errors
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import CAP, Surface


def slow_to_surface(points, surface):
    """Distances to all triangles: the plane's foot where it is inside, else the nearest edge."""
    least = np.full(len(points), np.inf)
    for a, b, c in surface.vertices[surface.triangles]:
        normal = np.cross(b - a, c - a)
        inside = np.ones(len(points), dtype=bool)
        for p, q in ((a, b), (b, c), (c, a)):
            t = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            least = np.minimum(least, np.linalg.norm(points - p - t[:, None] * (q - p), axis=1))
            inside &= (points - p) @ np.cross(normal, q - p) >= 0
        height = np.abs((points - a) @ normal) / np.linalg.norm(normal)
        least = np.where(inside, np.minimum(least, height), least)
    return least


@pytest.mark.parametrize("off", [0.0, 0.004, 0.03, 1.0])
def test_points_and_triangles_near_and_far(off):
    """m off the sheet; at 1 m a point's cells hold nothing, and coarser ones are asked."""
    rng = np.random.default_rng(0)
    surface = Surface.of_faces(rolled_sheet(6.0, n=11))
    points = SensorNoise(0.0006, 0.05, 0.02).draw(surface, 200, rng) + [0, off, off]
    nearest = Cells.of_points(surface.vertices).nearest(points)
    distance, index = cKDTree(surface.vertices).query(points)
    np.testing.assert_allclose(np.sqrt(nearest.squared), distance, rtol=1e-12)
    assert np.mean(nearest.item == index) > 0.99  # a tie goes to any
    np.testing.assert_allclose(surface.distance(points), slow_to_surface(points, surface), atol=1e-12)


@pytest.mark.parametrize("cloud", [np.zeros((1, 3)), np.ones((7, 3)), np.linspace(0, 1, 30)[:, None] * [0, 0, 1.0]])
def test_clouds_without_extent(cloud):
    points = np.array([[0, 0, 0], [0.3, 0, 0.51], [50.0, 0, -2]])
    np.testing.assert_allclose(np.sqrt(Cells.of_points(cloud).nearest(points).squared), cKDTree(cloud).query(points)[0])


def test_what_is_farther_than_asked_is_infinitely_far():
    surface = Surface.of_faces(rolled_sheet(6.0, n=11))
    points = surface.vertices[::20] + np.linspace(0, 0.05, 13)[:, None] * [0, 0, 1]
    full, within_cap = surface.distance(points), surface.distance(points, within=CAP)
    assert 2 < np.sum(full < CAP) < len(full) - 2
    np.testing.assert_array_equal(within_cap, np.where(full < CAP, full, np.inf))


@pytest.mark.parametrize("off", [0.05, 3.0, 1e6, 1e30])
def test_points_beyond_every_cell_are_farther_than_asked(off):
    """Along each axis, both ways; a flat sheet has one cell along z."""
    flat = np.stack(
        [*(a.ravel() for a in np.meshgrid(np.linspace(0, 0.2, 41), np.linspace(-0.2, 0, 41))), np.zeros(41**2)]
    )
    points = np.concatenate([[0.1, -0.1, 0.0] + off * np.array(s) * np.eye(3) for s in (1.0, -1.0)])
    for sheet in (flat.T, rolled_sheet(6.0, n=41)[: 41**2]):
        surface = Surface.of_faces(np.concatenate([sheet + [0, 0, 0.001], sheet - [0, 0, 0.001]]))
        within_cap = surface.distance(points, within=CAP)
        full = surface.distance(points)
        np.testing.assert_array_equal(within_cap, np.where(full < CAP, full, np.inf))


def test_a_search_ends_whatever_is_asked():
    """Points that are nowhere are near nothing; slivers, one of them without a normal, hide nothing."""
    surface = Surface.of_faces(rolled_sheet(6.0, n=11))
    lost = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 1e6]])
    assert list(np.isfinite(surface.distance(lost))) == [False, False, True]
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(40, 2, 3))
    third = ends.mean(axis=1) + rng.choice([0, 1e-9, 1e-5, 1e-3], (40, 1)) * rng.normal(size=(40, 3))
    slivers = Surface(np.concatenate([ends, third[:, None]], axis=1).reshape(-1, 3), np.arange(120).reshape(-1, 3))
    points, along = rng.normal(size=(50, 3)), ends[:, 1] - ends[:, 0]
    share = np.einsum("pid,id->pi", points[:, None] - ends[:, 0], along) / np.square(along).sum(axis=1)
    off = points[:, None] - ends[:, 0] - np.clip(share, 0, 1)[..., None] * along
    np.testing.assert_allclose(slivers.distance(points), np.linalg.norm(off, axis=2).min(axis=1), atol=5e-3)


def test_triangles_without_an_area():
    """A segment, its third corner at an end or between, and a point; asked beside it, beyond its ends and off it."""
    a, b = np.zeros(3), np.array([1.0, 0, 0])
    points = np.array([[x, y, z] for x in (-1.0, 0.0, 0.25, 2.0) for y in (-1.0, 0.0, 0.5) for z in (-1.0, 0.0, 0.5)])
    for end, third in ((b, a), (b, b), (b, b / 4), (a, a)):
        surface = Surface(np.stack([a, end, third]), np.array([[0, 1, 2], [1, 2, 0], [2, 1, 0]]))
        on = np.clip(points[:, :1], 0, 1) * end
        np.testing.assert_allclose(surface.distance(points), np.linalg.norm(points - on, axis=1), atol=1e-12)


def test_errors_of_a_trial_are_those_computed_slowly():
    """Chamfer by a tree, surface by all triangles, the floors' draws by the same seed; to rounding."""
    rng, noise = np.random.default_rng(1), SensorNoise(0.0006, 0.01, 0.012)
    motion = np.stack([rolled_sheet(c, n=9) for c in (0.0, 4.0)])
    clouds = [noise.draw(Surface.of_faces(frame), 150, rng) + [0, 0, 0.003] for frame in motion]
    errors = trial_errors(clouds, motion, noise, seed=5)

    def slow(cloud, model):
        there, back = cKDTree(model).query(cloud)[0], cKDTree(cloud).query(model)[0]
        off = slow_to_surface(cloud, Surface.of_faces(model))
        return there.mean() + back.mean(), np.sqrt(np.mean(np.minimum(off, CAP) ** 2))

    again = np.random.default_rng(5)
    offsets = noise.stray_offsets([150] * DRAWS, again)
    drawn = [noise.draw(Surface.of_faces(motion[k // 10]), 150, again, offsets[k]) for k in range(DRAWS)]
    floors = [slow(cloud, motion[k // 10]) for k, cloud in enumerate(drawn)]
    expected = *np.mean([slow(c, m) for c, m in zip(clouds, motion, strict=True)], axis=0), *np.mean(floors, axis=0)
    got = errors.chamfer, errors.surface_rms, errors.chamfer_floor, errors.surface_floor
    np.testing.assert_allclose(got, expected, rtol=1e-9)
