"""Fast distances against slow obvious ones; samples of a known surface."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sheets import rolled_sheet

from fabdesign.errors import InputError
from fabdesign.geometry.distances import chamfer, nearest_distances
from fabdesign.geometry.sensor_noise import SensorNoise, estimate_noise
from fabdesign.geometry.surface import Surface, capped_rms, face_triangles


def obvious_nearest(point, a, b, c):
    """Distance from a point to one triangle: to the plane's foot if it is inside, else to the nearest edge."""
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    foot, *_ = np.linalg.lstsq(np.stack([ab, ac], axis=1), point - a, rcond=None)
    if normal.any() and foot.min() >= 0 and foot.sum() <= 1:
        return np.linalg.norm(a + foot @ np.stack([ab, ac]) - point)
    distances = []
    for p, q in ((a, b), (b, c), (c, a)):
        length = (q - p) @ (q - p)
        t = np.clip((point - p) @ (q - p) / length, 0, 1) if length > 0 else 0.0
        distances.append(np.linalg.norm(p + t * (q - p) - point))
    return min(distances)


def test_chamfer_against_all_pairs():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(70, 3)), rng.normal(size=(50, 3))
    pairs = np.linalg.norm(a[:, None] - b, axis=2)
    assert chamfer(a, b) == pytest.approx(pairs.min(axis=1).mean() + pairs.min(axis=0).mean(), rel=1e-12)
    squared = (pairs**2).min(axis=1).mean() + (pairs**2).min(axis=0).mean()
    nearest = nearest_distances(a, b), nearest_distances(b, a)
    assert sum(np.square(each).mean() for each in nearest) == pytest.approx(squared, rel=1e-12)
    assert chamfer(a, b) == chamfer(b, a)
    assert chamfer(a, a) == 0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.01, 0.3, 5.0]), triangles=st.integers(1, 40))
def test_nearest_is_exact_on_any_triangles(seed, spread, triangles):
    """A soup of random triangles, large and small: no neat mesh helps the search here."""
    rng = np.random.default_rng(seed)
    vertices = np.repeat(rng.normal(size=(triangles, 3)), 3, axis=0) + spread * rng.normal(size=(3 * triangles, 3))
    surface = Surface(vertices, np.arange(3 * triangles).reshape(-1, 3))
    points = np.concatenate([rng.normal(size=(6, 3)), 3 * rng.normal(size=(3, 3)), vertices[:2]])
    nearest = surface.nearest(points)
    obvious = [min(obvious_nearest(p, *t) for t in vertices.reshape(-1, 3, 3)) for p in points]
    np.testing.assert_allclose(nearest.distance, obvious, rtol=1e-9, atol=1e-9)
    place = np.einsum("nc,ncd->nd", nearest.weights, vertices[surface.triangles[nearest.triangle]])
    np.testing.assert_allclose(np.linalg.norm(points - place, axis=1), nearest.distance, atol=1e-12)
    assert nearest.weights.min() >= -1e-12
    np.testing.assert_allclose(nearest.weights.sum(axis=1), 1)


def test_nearest_on_a_sheet_against_all_its_triangles():
    points = rolled_sheet(12.0, n=9)
    surface = Surface.of_faces(points)
    rng = np.random.default_rng(1)
    seen = points[::14] + 0.004 * rng.normal(size=points[::14].shape)
    nearest = surface.nearest(seen)
    obvious = [min(obvious_nearest(p, *t) for t in surface.vertices[surface.triangles]) for p in seen]
    np.testing.assert_allclose(nearest.distance, obvious, atol=1e-9)


def test_sign_and_order_of_the_faces():
    """At rest the front looks along +z: above it and below the back are outside, between them inside."""
    surface = Surface.of_faces(rolled_sheet(n=5))
    nearest = surface.nearest(np.array([[0.01, -0.1, 0.0013], [0.01, -0.1, 0.0008], [0.01, -0.1, -0.0014]]))
    np.testing.assert_allclose(nearest.signed, [0.0003, -0.0002, 0.0004], atol=1e-12)
    assert list(nearest.triangle < 32) == [True, True, False]
    assert surface.areas.sum() == pytest.approx(2 * 0.2**2)
    assert face_triangles(2, 3).shape == (8, 3)
    with pytest.raises(ValueError, match="not two faces"):
        Surface.of_faces(np.zeros((10, 3)))


def test_capped_rms():
    """sqrt((3^2 + 4^2 + 10^2) / 3) with the last one capped from 50."""
    assert capped_rms(np.array([0.003, -0.004, 0.050])) == pytest.approx(np.sqrt(125 / 3) * 1e-3)


def test_samples_lie_on_the_surface_evenly():
    """A square and a triangle of a quarter of its area get points in proportion, about its middle."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 0, 0], [5.5, 0, 0], [5, 1, 0]], dtype=float)
    surface = Surface(vertices, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]]))
    points, triangle = surface.sample(20_000, np.random.default_rng(0))
    square = points[points[:, 0] < 2]
    assert len(square) / 20_000 == pytest.approx(0.8, abs=0.012)  # four standard errors
    np.testing.assert_allclose(square.mean(axis=0), [0.5, 0.5, 0], atol=0.01)
    np.testing.assert_allclose(surface.normals_of(triangle), np.tile([0, 0, 1.0], (20_000, 1)))
    again = np.random.default_rng(0)  # the places are those of numpy's own choice
    np.testing.assert_array_equal(triangle, again.choice(3, size=20_000, p=surface.areas / surface.areas.sum()))


@pytest.mark.parametrize(
    ("count", "curvature", "truth"),
    [
        (1500, 0.0, SensorNoise(0.0006, 0.003, 0.012)),
        (1500, 10.0, SensorNoise(0.0006, 0.003, 0.012)),
        (3362, 20.0, SensorNoise(0.0006, 0.003, 0.012)),
        (3362, 10.0, SensorNoise(0.0003, 0.01, 0.012)),
        (3362, 10.0, SensorNoise(0.001, 0.0, 0.0)),
    ],
)
def test_noise_is_recovered_from_clouds_alone(count, curvature, truth):
    rng = np.random.default_rng(2)
    surface = Surface.of_faces(rolled_sheet(curvature))
    offsets = truth.stray_offsets([count] * 6, rng)  # their number is no chance: the sampling error would be 20 %
    noise = estimate_noise([truth.draw(surface, count, rng, each) for each in offsets], 0.002)
    assert noise.sigma == pytest.approx(truth.sigma, rel=0.05)
    assert noise.strays == pytest.approx(truth.strays, rel=0.1)
    assert noise.stray_reach == pytest.approx(truth.stray_reach, rel=0.1)


def test_strays_far_off_are_counted():
    """Even in a box 50 mm wider than the cloth: their share, and twice their mean distance as the reach."""
    rng = np.random.default_rng(3)
    surface = Surface.of_faces(rolled_sheet(10.0))
    frames = [SensorNoise(0.0006, 0.0, 0.0).draw(surface, 1500, rng) for _ in range(6)]
    for frame in frames:
        frame[:15] = rng.uniform(frame.min(axis=0) - 0.05, frame.max(axis=0) + 0.05, (15, 3))
    off = np.concatenate([surface.nearest(frame[:15]).distance for frame in frames])
    noise = estimate_noise(frames, 0.002)
    assert noise.sigma == pytest.approx(0.0006, rel=0.05)
    assert noise.strays == pytest.approx(np.sum(off > 0.003) / 9000, rel=0.1)
    assert noise.stray_reach == pytest.approx(2 * off.mean(), rel=0.15)


def test_noise_needs_enough_points():
    with pytest.raises(InputError, match="too few"):
        estimate_noise([np.zeros((20, 3))], 0.002)
