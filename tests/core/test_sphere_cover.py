import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, KDTree

from graceful_plan.core import greedy_cover, sphere_cover
from sizes import first_quick

_COVERED = 1e-9
sizes = st.floats(0.004, 0.08)


def _uncovered(points, cover):
    centres, radii = cover
    return float(np.max(np.min(np.linalg.norm(points[:, None] - centres, axis=-1) - radii, axis=1)))


def _in_box(half, rng, n=600):
    points = rng.uniform(-1.0, 1.0, (n, 3))
    axis = rng.integers(3, size=n // 2)
    points[np.arange(n // 2), axis] = np.sign(points[np.arange(n // 2), axis])  # half of the points on the faces
    corners = np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3)
    return np.concatenate([points, corners]) * half


def _in_cylinder(radius, half, rng, n=600):
    angle, rho, z = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.uniform(size=n)), rng.uniform(-half, half, n)
    rho[: n // 3] = radius
    z[n // 3 : 2 * n // 3] = half * np.sign(z[n // 3 : 2 * n // 3])
    rho[::7], z[::7] = radius, half  # points on the rim
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=1)


@pytest.mark.parametrize("half", [(0.3, 0.3, 0.3), (50.0, 50.0, 50.0), (500.0, 0.05, 0.05), (2.0, 2.0, 0.01)])
def test_large_boxes_get_large_spheres_and_not_many(half):
    protrusion = sphere_cover.roomy(half)
    cover = sphere_cover.box_cover(half, protrusion)
    assert protrusion > sphere_cover.MAX_PROTRUSION and len(cover[1]) < 1.5 * sphere_cover.MANY
    assert _uncovered(_in_box(np.array(half), np.random.default_rng(0)), cover) <= _COVERED * max(half)
    assert sphere_cover.roomy((0.15, 0.15, 0.15)) == sphere_cover.MAX_PROTRUSION


@given(st.tuples(sizes, sizes, sizes), st.integers(0, 99))
@settings(max_examples=8, deadline=None)
def test_box_is_covered_and_barely_exceeded(half, seed):
    cover = sphere_cover.box_cover(half)
    assert _uncovered(_in_box(np.array(half), np.random.default_rng(seed)), cover) <= _COVERED
    depth = np.min(np.array(half) - np.abs(cover[0]), axis=1)
    assert np.max(cover[1] - depth) <= sphere_cover.MAX_PROTRUSION + 1e-12


@given(sizes, sizes, st.integers(0, 99))
@settings(max_examples=8, deadline=None)
def test_cylinder_is_covered_and_barely_exceeded(radius, half, seed):
    centres, radii = sphere_cover.cylinder_cover(radius, half)
    assert _uncovered(_in_cylinder(radius, half, np.random.default_rng(seed)), (centres, radii)) <= _COVERED
    depth = np.minimum(radius - np.hypot(centres[:, 0], centres[:, 1]), half - np.abs(centres[:, 2]))
    assert np.max(radii - depth) <= sphere_cover.MAX_PROTRUSION + 1e-12


@given(st.floats(0.004, 0.2), st.floats(0.001, 0.4), st.integers(0, 99))
@settings(max_examples=8, deadline=None)
def test_capsule_is_covered_and_barely_exceeded(radius, half, seed):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(5000, 3))
    normal *= radius / np.linalg.norm(normal, axis=1, keepdims=True)
    surface = normal + np.outer(rng.uniform(-half, half, len(normal)), [0, 0, 1])
    surface[:1000] = normal[:1000] + np.outer(half * np.sign(normal[:1000, 2]), [0, 0, 1])
    centres, radii = sphere_cover.capsule_cover(radius, half)
    assert _uncovered(surface, (centres, radii)) <= _COVERED
    to_axis = np.hypot(np.hypot(centres[:, 0], centres[:, 1]), np.maximum(np.abs(centres[:, 2]) - half, 0.0))
    assert np.max(radii - (radius - to_axis)) <= sphere_cover.MAX_PROTRUSION + 1e-12


@pytest.mark.parametrize("semi_axes", [(0.05, 0.03, 0.04), (0.08, 0.08, 0.02), (0.02, 0.02, 0.1)])
def test_ellipsoid_is_covered_and_barely_exceeded(semi_axes):
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(5000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    cover = greedy_cover.ellipsoid_cover(semi_axes)
    assert _uncovered(unit * semi_axes, cover) <= _COVERED
    assert _greatest_height(cover, lambda p: (np.linalg.norm(p / semi_axes, axis=1) - 1) * min(semi_axes)) <= 0.01


def _greatest_height(cover, lower_bound_of_distance):
    """Greatest distance between the surfaces of the spheres and the body, by a lower bound of the distance."""
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(300, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return max(float(np.max(lower_bound_of_distance(c + r * unit))) for c, r in zip(*cover, strict=True))


def test_hull_of_a_cube_is_covered_and_barely_exceeded():
    half = np.array([0.03, 0.03, 0.03])
    corners = np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3) * half
    planes = np.concatenate([np.column_stack([s * np.eye(3), half]) for s in (1, -1)])
    cover = greedy_cover.hull_cover([(corners, planes)])
    assert _uncovered(_in_box(half, np.random.default_rng(0)), cover) <= _COVERED
    assert np.max(cover[1] - np.min(half - np.abs(cover[0]), axis=1)) <= sphere_cover.MAX_PROTRUSION + 1e-9


def test_hulls_of_many_faces_are_covered_by_few_of_them() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2500, 3))
    points *= np.array([0.05, 0.04, 0.09]) / np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    planes = np.column_stack([hull.equations[:, :3], -hull.equations[:, 3]])
    few = greedy_cover.fewer_planes(points, planes)
    assert len(few) < len(planes) / 4
    assert (points @ few[:, :3].T - few[:, 3]).max() < 1e-9  # every point is inside
    centres, radii = greedy_cover.hull_cover([(points, planes)])
    mixed = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(4), 1500), points[rng.integers(len(points), size=(1500, 4))])
    inside = np.concatenate([points, mixed])
    assert (np.linalg.norm(inside[:, None] - centres, axis=2) - radii).min(axis=1).max() < 1e-9
    depth = -greedy_cover.heights(centres, planes)[0]
    assert (radii - depth).max() < 0.01


def _hull(seed: int, shift: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(seed).normal(size=(60, 3))
    points *= np.array([0.05, 0.06, 0.09]) / np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points + [0.0, 0.0, shift])
    return hull.points, np.column_stack([hull.equations[:, :3], -hull.equations[:, 3]])


@pytest.mark.parametrize("shift", first_quick([0.03, 0.0, 0.3]))
def test_overlapping_hulls_are_covered_together(shift: float) -> None:
    """The cover contains both hulls, no ball sticks out of both, and the shared part is covered once."""
    rng, hulls = np.random.default_rng(0), [_hull(0, 0.0), _hull(1, shift)]
    centres, radii = cover = greedy_cover.hull_cover(hulls)
    for points, _ in hulls:
        mixed = rng.dirichlet(np.ones(4), 4000)
        inside = np.einsum("nk,nki->ni", mixed, points[rng.integers(len(points), size=(4000, 4))])
        assert _uncovered(np.concatenate([points, inside]), cover) <= _COVERED
    depth = np.max([-greedy_cover.heights(centres, planes)[0] for _, planes in hulls], axis=0)
    assert (radii - depth).max() < 0.01
    alone = sum(len(greedy_cover.hull_cover([hull])[1]) for hull in hulls)
    assert len(radii) <= (0.7 if shift < 0.1 else 1.05) * alone


def test_no_ball_of_a_cover_is_idle() -> None:
    """Each ball contains a point that no other ball certainly covers."""
    points, planes = _hull(2, 0.0)
    pitch = 0.006
    near, height = greedy_cover.samples_of_convex(points, planes, pitch)
    gap = pitch * np.sqrt(5.0) / 4.0
    centres, radii = greedy_cover.greedy_cover(near, -height, sphere_cover.MAX_PROTRUSION, gap)
    covers = np.linalg.norm(near[:, None] - centres, axis=2) <= radii - gap + 1e-7
    assert covers.any(axis=1).all()
    assert (covers & (covers.sum(axis=1) == 1)[:, None]).any(axis=0).all()


@pytest.mark.parametrize(("points", "faces"), [(1, 1), (127, 3), (1000, 40)])
def test_heights_are_those_over_the_highest_face(points: int, faces: int) -> None:
    rng = np.random.default_rng(5)
    x, planes = rng.normal(size=(points, 3)), rng.normal(size=(faces, 4))
    over = x @ planes[:, :3].T - planes[:, 3]
    height, face = greedy_cover.heights(x, planes)
    np.testing.assert_allclose(height, over.max(axis=1), atol=1e-12)
    np.testing.assert_array_equal(face, over.argmax(axis=1))
    assert greedy_cover.heights(x[:0], planes)[0].shape == (0,)


def test_covers_are_as_small_as_those_of_the_algorithm_in_numpy() -> None:
    """Rounding decides between equal candidates, so balls may differ, but hardly their number."""
    points, planes = _hull(2, 0.0)
    near, height = greedy_cover.samples_of_convex(points, planes, 0.012)
    gap = 0.012 * np.sqrt(5.0) / 4.0
    _, radii = greedy_cover.greedy_cover(near, -height, sphere_cover.MAX_PROTRUSION, gap)
    assert len(radii) == pytest.approx(_numpy_cover(near, -height, sphere_cover.MAX_PROTRUSION, gap), rel=0.05)


def _numpy_cover(points: np.ndarray, depth: np.ndarray, protrusion: float, pitch: float) -> int:
    """Return the number of balls before those are dropped that are not needed, less the dropped ones."""
    reach = np.maximum(np.maximum(depth, 0.0) + protrusion - pitch, 0.0)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    covers = apart <= reach[:, None]  # [ball, point]
    order, picked = np.argsort(depth, kind="stable"), []
    shell = int(np.searchsorted(depth[order], 2.0 * pitch))
    for part in (order[:shell], order[shell:]):
        left = np.zeros(len(points), dtype=bool)
        left[part] = True
        left &= ~covers[picked].any(axis=0)
        while left.any():
            point = next(k for k in part if left[k])
            able = np.flatnonzero(covers[:, point])
            deepest = able[np.argsort(-depth[able], kind="stable")[:40]]
            spread = able[np.linspace(0, len(able) - 1, min(len(able), 40)).astype(int)]
            able = np.union1d(deepest, spread)
            picked.append(able[np.argmax((covers[able] & left).sum(axis=1))])
            left &= ~covers[picked[-1]]
    times, needed = covers[picked].sum(axis=0), len(picked)
    for k in sorted(range(len(picked)), key=lambda k: covers[picked[k]].sum()):
        if times[covers[picked[k]]].min() > 1:
            times[covers[picked[k]]] -= 1
            needed -= 1
    return needed


@pytest.mark.parametrize("pitch", [0.01, 0.02])
def test_samples_are_near_everything_in_a_hull(pitch: float) -> None:
    """The spacing is that of a body-centred cubic lattice."""
    points, planes = _hull(3, 0.0)
    near, height = greedy_cover.samples_of_convex(points, planes, pitch)
    assert height.max() < 1e-5
    rng = np.random.default_rng(1)
    inside = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(4) / 4, 3000), points[rng.integers(60, size=(3000, 4))])
    farthest = KDTree(near).query(inside)[0].max()
    assert farthest <= np.sqrt(5.0) / 4.0 * pitch + 1e-5
    assert farthest > 0.4 * pitch


def test_a_sheet_keeps_all_its_faces() -> None:
    points = np.column_stack([np.random.default_rng(0).uniform(size=(200, 2)), np.zeros(200)])
    planes = np.tile([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, -1.0, 0.0]], (80, 1))
    assert greedy_cover.fewer_planes(points, planes) is planes


@given(st.integers(1, 30), st.integers(0, 999))
@settings(max_examples=50, deadline=None)
def test_enclosing_sphere_encloses(n, seed):
    rng = np.random.default_rng(seed)
    centres, radii = rng.normal(size=(n, 3)), rng.uniform(0.01, 0.5, n)
    bound = sphere_cover.enclosing_sphere(centres, radii)
    assert np.all(np.linalg.norm(centres - bound[:3], axis=1) + radii <= bound[3] + 1e-9)
    if n == 1:
        assert bound[3] == pytest.approx(radii[0])


@pytest.mark.parametrize("semi_axes", [(0.1, 0.2, 0.3), (0.1, 0.1, 0.1), (0.02, 0.5, 0.5), (0.1, 0.1, 0.4)])
def test_depths_in_an_ellipsoid_equal_the_nearest_of_many_points(semi_axes) -> None:
    rng, axes = np.random.default_rng(0), np.array(semi_axes)
    unit = rng.normal(size=(60_000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    points = np.concatenate([unit[:20] * axes * rng.uniform(0.0, 1.0, (20, 1)), np.zeros((1, 3)), np.eye(3) * axes])
    depth = greedy_cover._ellipsoid_depth(points, axes)
    nearest = np.array([np.linalg.norm(unit * axes - point, axis=1).min() for point in points])
    assert (depth <= nearest + 1e-8).all() and np.abs(depth - nearest).max() < 0.01
    np.testing.assert_allclose(depth[-3:], 0.0, atol=1e-8)
