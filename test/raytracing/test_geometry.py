"""Geometry on plain arrays against worked numbers: roots, normals, nearest points of lines, weights of corners."""

import numpy as np
import pytest
import torch

from odak.raytracing import geometry

# Corners (1, 1, 2), (3, 1, 2) and (1, 4, 2): edges (2, 0, 0) and (0, 3, 0), normal (0, 0, 1).
TRIANGLE = np.array([[1.0, 1, 2], [3, 1, 2], [1, 4, 2]])
COLLINEAR = np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]])


def test_roots_and_quotients_where_they_exist():
    np.testing.assert_array_equal(geometry.safe_sqrt(np.array([9.0, 0.25, 0, -4])), [3, 0.5, 0, 0])
    value = torch.tensor([4.0, 0.0, -1.0], requires_grad=True)
    geometry.safe_sqrt(value).sum().backward()
    assert value.grad.tolist() == [0.25, 0, 0]
    quotient = geometry.safe_divide(np.array([6.0, 5, 0]), np.array([4.0, 0, 0]), np.array([True, False, False]))
    np.testing.assert_array_equal(quotient, [1.5, 0, 0])
    assert geometry.epsilon(np.zeros(1, dtype=np.float32)) == 2.0**-23 and geometry.epsilon(np.zeros(1)) == 2.0**-52


def test_missing_values():
    shown = np.array([True, False])
    np.testing.assert_array_equal(geometry.masked(np.array([1.0, 2]), shown), [1, np.nan])
    np.testing.assert_array_equal(geometry.masked(np.ones((2, 3)), shown), [[1] * 3, [np.nan] * 3])
    np.testing.assert_allclose(geometry.unit(np.array([[0.0, 3, -4], [0, 0, 0]])), [[0, 0.6, -0.8], [np.nan] * 3])
    # One component of one vector suffices to lose a ray.
    start, direction = np.ones((4, 3)), np.full((4, 3), 2.0)
    start[1, 2], direction[2, 0] = np.inf, np.nan
    starts, directions, kept = geometry.finite_rays(start, direction)
    np.testing.assert_array_equal(kept, [True, False, False, True])
    np.testing.assert_array_equal(starts[:, 0], [1, 0, 0, 1])
    np.testing.assert_array_equal(directions[:, 1], [2, 0, 0, 2])


def test_normals_of_triangles():
    np.testing.assert_allclose(geometry.triangle_normal(TRIANGLE), [0, 0, 1])
    np.testing.assert_allclose(geometry.triangle_normal(TRIANGLE[::-1]), [0, 0, -1])
    # Of length 1 for small and large triangles alike, and for a sliver whose angle is far above rounding.
    for corners in (1e-9 * TRIANGLE, 1e9 * TRIANGLE, np.array([[0.0, 0, 0], [1, 0, 0], [1, 1e-12, 0]])):
        np.testing.assert_allclose(geometry.triangle_normal(corners), [0, 0, 1])
    # An angle of up to four spacings of floats may be rounding alone.
    for spacings, exists in ((3.5, False), (4.5, True)):
        sliver = np.array([[0.0, 0, 0], [1, 0, 0], [1, spacings * 2.0**-52, 0]])
        assert np.isfinite(geometry.triangle_normal(sliver)).all() == exists
        assert np.isfinite(geometry.barycentric(np.zeros(3), sliver)).all() == exists
    assert np.isnan(geometry.triangle_normal(COLLINEAR)).all()


def test_barycentric_coordinates_return_the_point():
    u, v = np.array([0.25, -0.5, 1.5]), np.array([0.5, 2.0, 0.125])
    for corners in (TRIANGLE, np.array([[1.0, 2, 3], [4, 0, 1], [-2, 5, 2]])):
        p0, p1, p2 = corners
        points = p0 + u[:, None] * (p2 - p0) + v[:, None] * (p1 - p0) + 3 * geometry.triangle_normal(corners)
        np.testing.assert_allclose(geometry.barycentric(points, corners), (u, v), rtol=1e-12)
        np.testing.assert_allclose(geometry.barycentric(tuple(points.T), corners), (u, v), rtol=1e-12)
    assert np.isnan(geometry.barycentric(np.ones(3), COLLINEAR)).all()


@pytest.mark.parametrize(
    ("point", "inside"),
    [([1.5, 1.5, 9], True), ([0.9, 2, 2], False), ([2, 0.9, 2], False), ([2.5, 3, 2], False), ([2, 2.5, 2], True)],
)
def test_points_of_triangles(point, inside):
    """The last point lies on an edge."""
    assert geometry.is_on_triangle(np.array(point, dtype=float), *TRIANGLE) == inside


def test_nearest_points_of_lines():
    # Along x at z = 0 and along y at z = 5: the nearest points are (3, 0, 0) and (3, 0, 5).
    lines = [np.array(v, dtype=float) for v in ([1, 0, 0], [2, 0, 0], [3, 4, 5], [0, -0.5, 0])]
    np.testing.assert_allclose(geometry.nearest_on_lines(*lines), (1, 8))
    assert not geometry.crossing_of_lines(*lines)[2]
    lines[2][2] = 0
    t0, t1, cross = geometry.crossing_of_lines(*lines)
    assert cross and (t0, t1) == (1, 8)
    # Parallel: the foot of the perpendicular from the first start, 2 beyond the second start in units of 0.5.
    parallel = [np.array(v, dtype=float) for v in ([1, 0, 0], [2, 0, 0], [0, 3, 0], [0.5, 0, 0])]
    np.testing.assert_allclose(geometry.nearest_on_lines(*parallel), (0, 2))
    assert not geometry.crossing_of_lines(*parallel)[2]
    # A line on itself is parallel, not crossing; a direction without length has no foot.
    assert not geometry.crossing_of_lines(parallel[0], parallel[1], 2 * parallel[0], parallel[3])[2]
    assert geometry.nearest_on_lines(parallel[0], parallel[1], parallel[2], np.zeros(3)) == (0, 0)


@pytest.mark.parametrize("axis", range(3))
def test_lines_cross_to_seven_digits(axis):
    """By 1e-5 of the distance between the starts, here 100 along x, whichever way they pass each other."""
    aside, across, along = np.roll(np.eye(3), axis, axis=1)
    for gap, crosses in ((0.9e-3, True), (1.1e-3, False)):
        found = geometry.crossing_of_lines(np.zeros(3), across, 100 * across - gap * aside - 50 * along, along)
        np.testing.assert_allclose(found[:2], (100, 50))
        assert found[2] == crosses


def test_lines_cross_wherever_they_start():
    """What is allowed follows the distance between the starts, not their distance from the origin."""
    far = np.array([1e3, 0, 0])
    across, along, gap = np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1e-4])
    assert not geometry.crossing_of_lines(far, across, far + across + gap, along)[2]
    assert geometry.crossing_of_lines(far, across, far + across, along)[2]
    # Directions of any length: what is parallel is an angle.
    for length in (1e-6, 1e6):
        found = geometry.crossing_of_lines(np.zeros(3), length * across, across, length * along)
        assert found[2] and found[0] == pytest.approx(1 / length)
        assert not geometry.crossing_of_lines(np.zeros(3), length * across, along, across)[2]
    found = geometry.crossing_of_lines(np.zeros(3), 1e-9 * across, across, along)
    assert found[2] and found[0] == pytest.approx(1e9)
    for spacings, crosses in ((3.5, False), (4.5, True)):
        nearly = across + spacings * 2.0**-52 * along
        assert (geometry.nearest_on_lines(np.zeros(3), across, along, nearly)[0] != 0) == crosses
    # A parameter of 1e9 has a rounding error, for which 9e-7 is allowed here beside 2e-8.
    for gap, crosses in ((2e-7, True), (2e-6, False)):
        start = 1e-3 * across + [0, 0, gap]
        assert geometry.crossing_of_lines(np.zeros(3), 1e-12 * across, start, along)[2] == crosses


def test_rays_within_sheared_triangles():
    """Areas of edges over their sum are the barycentric coordinates of where the ray passes."""
    start, direction = np.array([0.2, -0.1, 1.0]), np.array([0.1, 0.3, 2.0])
    corners = np.array([[0.0, 0, 5], [2, 0, 6], [0, 3, 4]])
    weights = np.array([0.2, 0.5, 0.3])
    through = start + 1.5 * direction
    corners += through - weights @ corners
    shear = geometry.shear_of(direction)
    np.testing.assert_allclose(shear, (0.05, 0.15))
    moved = [geometry.sheared(corner, start, shear) for corner in corners]
    areas = np.array(geometry.edge_areas(*moved))
    np.testing.assert_allclose(areas / areas.sum(), weights)
    np.testing.assert_allclose(weights @ np.array(moved), [0, 0, 3], atol=1e-12)
    # Twice the area of the triangle across the ray, negative where the corners run counter-clockwise.
    edge1, edge2 = (np.array(moved[i])[:2] - np.array(moved[0])[:2] for i in (1, 2))
    assert areas.sum() == pytest.approx(edge1[1] * edge2[0] - edge1[0] * edge2[1])


@pytest.mark.parametrize(
    ("areas", "inside"),
    [
        ((1, 2, 3), True),
        ((-1, -2, -3), True),
        ((0, 2, 3), True),
        ((-1, 0, -3), True),
        ((-1, 2, 3), False),
        ((1, -2, 3), False),
        ((1, 2, -3), False),
        ((0, 0, 0), False),
    ],
)
def test_signs_of_areas(areas, inside):
    assert geometry.encloses(*(np.array(float(area)) for area in areas)) == inside


def test_normals_of_corners_on_a_sphere_are_radial():
    """Weights of Max (1999): exact for a corner whose neighbours lie with it on a sphere."""
    angles = np.array([0.1, 1.0, 2.9, 4.0, 5.1])
    heights = np.array([0.9, 0.5, 0.8, 0.3, 0.7])
    radius = np.sqrt(1 - heights**2)
    ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), heights], axis=-1)
    edge1 = ring - [0, 0, 1]
    edge2 = np.roll(edge1, -1, axis=0)
    normal = (geometry.corner_weights(edge1, edge2)[:, None] * np.cross(edge1, edge2)).sum(axis=0)
    np.testing.assert_allclose(normal / np.linalg.norm(normal), [0, 0, 1], atol=1e-12)
    assert geometry.corner_weights(np.array([2.0, 0, 0]), np.array([0, 3.0, 0])) == 1 / 36
    assert geometry.corner_weights(np.zeros(3), np.ones(3)) == 0
