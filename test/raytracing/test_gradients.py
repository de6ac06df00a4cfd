"""Rays through graded-index media: closed forms, invariants, and the core's method on NumPy arrays."""

import math

import numpy as np
import torch

from odak.raytracing.gradients import (
    AxialGradient,
    FunctionGradient,
    RadialGradient,
    integrate,
    ray_equation,
    tableau,
    to_surface,
)

F64 = torch.float64
GRADIENT, BASE = 0.3, 1.6


def at_height(height):
    def level(point, way):
        return point[2] - height, way[2], abs(point[2]) + abs(height)

    return level


def start_of(gradient, points, slopes, base=BASE):
    index = gradient.squared(*points, base)[0] ** 0.5
    u, v = slopes
    w = (1 - u * u - v * v) ** 0.5
    return np.stack([*points, index * u, index * v, index * w, 0 * index])


def test_a_parabolic_rod_is_harmonic_for_skew_rays():
    """r(t) = r₀·cos ωt + T₀·sin ωt/ω with ω = n₀g (Luneburg 1964); path and energy by their closed forms."""
    rng = np.random.default_rng(1)
    points = (*(rng.uniform(-0.5, 0.5, (2, 20))), np.zeros(20))
    rod = RadialGradient([-(GRADIENT**2)])
    start = start_of(rod, points, rng.uniform(-0.2, 0.2, (2, 20)))
    length = 3 * math.pi / GRADIENT
    found = to_surface(rod, BASE, start, at_height(length), 1)
    assert bool(found.arrived.all())
    omega, t = BASE * GRADIENT, length / start[5]
    for axis in range(2):
        expected = start[axis] * np.cos(omega * t) + start[axis + 3] * np.sin(omega * t) / omega
        assert np.allclose(found.state[axis], expected, rtol=0, atol=2e-11)
    # n²: the integral of n₀²(1 − g²r²) over t, from r² of the harmonic motion.
    squared = start[0] ** 2 + start[1] ** 2
    slope = (start[3] ** 2 + start[4] ** 2) / omega**2
    mixed = (start[0] * start[3] + start[1] * start[4]) / omega
    s2 = np.sin(2 * omega * t) / (4 * omega)
    inside = squared * (t / 2 + s2) + slope * (t / 2 - s2) + mixed * np.sin(omega * t) ** 2 / omega
    assert np.allclose(found.state[6], BASE**2 * (t - GRADIENT**2 * inside), rtol=1e-12, atol=0)
    # Skewness, a constant of every rotationally symmetric medium.
    before, after = (s[0] * s[4] - s[1] * s[3] for s in (start, found.state))
    assert np.allclose(before, after, rtol=0, atol=1e-12)


def test_numpy_and_torch_take_the_same_steps():
    rod = RadialGradient([-0.09, 0.004])
    start = start_of(
        rod, (np.array([0.4, -0.1]), np.array([0.0, 0.3]), np.zeros(2)), np.array([[0.1, 0.0], [0.05, -0.1]])
    )
    by_numpy = to_surface(rod, BASE, start, at_height(8.0), 1)
    by_torch = to_surface(rod, BASE, torch.as_tensor(start), at_height(8.0), 1)
    assert by_numpy.steps == by_torch.steps
    assert np.allclose(by_numpy.state, by_torch.state.numpy(), rtol=0, atol=1e-12)


def test_snells_invariant_of_an_axial_gradient():
    """n·sin θ is constant, and the height is the integral of its tangent over depth, by Gauss–Legendre quadrature."""
    axial = AxialGradient([0.05, -0.004, 2e-4])
    start = start_of(axial, (np.zeros(3), np.zeros(3), np.zeros(3)), np.array([[0.0, 0.1, 0.3], [0.3, 0.0, -0.2]]))
    found = to_surface(axial, BASE, start, at_height(6.0), 1)
    assert np.allclose(found.state[3:5], start[3:5], rtol=0, atol=1e-14)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    depth, weights = 3 * (nodes + 1), 3 * weights
    index = BASE + 0.05 * depth - 0.004 * depth**2 + 2e-4 * depth**3
    invariant = np.hypot(start[3], start[4])
    root = (index**2 - invariant[:, None] ** 2) ** 0.5
    assert np.allclose(np.hypot(*found.state[:2]), invariant * (weights / root).sum(-1), rtol=1e-12, atol=0)
    assert np.allclose(found.state[6], (weights * index**2 / root).sum(-1), rtol=1e-12, atol=0)


def test_maxwells_fish_eye_images_every_point_onto_its_antipode():
    """n = 2/(1 + r²): rays are circles through −p/|p|², and all paths between the two points are equal."""

    def fish_eye(x, y, z, base):
        return 2 / (1 + x * x + y * y + z * z)

    medium = FunctionGradient.of(fish_eye)
    source = torch.tensor([0.3, -0.2, -0.8], dtype=F64)
    # Steep enough that the circles do not meet the image plane anywhere before.
    ways = 0.5 * torch.randn(3, 16, generator=torch.Generator().manual_seed(3), dtype=F64).clamp(-1, 1)
    ways[2] = 1.0
    ways = ways / ways.norm(dim=0)
    index = fish_eye(*source, 1.0)
    start = torch.cat([source[:, None].expand(3, 16), index * ways, torch.zeros(1, 16, dtype=F64)])
    image = -source / source.square().sum()
    found = to_surface(medium, 1.0, start, at_height(image[2]), 1)
    assert bool(found.arrived.all())
    assert torch.allclose(found.state[:3], image[:, None].expand(3, 16), rtol=0, atol=1e-9)
    assert torch.allclose(found.state[6], torch.tensor(math.pi, dtype=F64), rtol=1e-10, atol=0)


def test_function_gradients_have_derivatives_of_their_formula():
    place = torch.randn(3, 5, generator=torch.Generator().manual_seed(4), dtype=F64)
    by_function = FunctionGradient.of(lambda x, y, z, n, a: n * (1 + a * (x * x + y * y)) ** 0.5, [-0.01])
    for a, b in zip(by_function.squared(*place, BASE), RadialGradient([-0.01]).squared(*place, BASE), strict=True):
        assert torch.allclose(a, b.expand_as(a), rtol=0, atol=1e-13)


def test_the_order_of_the_method():
    """Halving a fixed step divides the error by about 2⁸; a step's tableau is that of an explicit method."""
    assert np.allclose(tableau().A[:12].sum(-1)[:12], tableau().C[:12])
    rod = RadialGradient([-(GRADIENT**2)])
    start = start_of(rod, (np.array([0.5]), np.array([0.0]), np.zeros(1)), np.array([[0.1], [0.0]]))
    from odak.raytracing.gradients import step

    errors = []
    for count in (5, 10):
        state = start
        for _ in range(count):
            state, _ = step(ray_equation(rod, BASE), state, 10.0 / count)
        omega = BASE * GRADIENT
        expected = start[0] * math.cos(omega * 10) + start[3] * math.sin(omega * 10) / omega
        errors.append(abs(float(state[0, 0] - expected[0])))
    assert 100 < errors[0] / errors[1] < 1500


def test_steps_adapt_to_each_ray():
    """A bump along the way of one of two rays, against its integral; a coarse tolerance would miss it."""

    def field(state):
        bump = np.exp(-((state[1] - 5) ** 2)) * (state[2] > 0)
        return np.stack([bump, 1 + 0 * bump, 0 * bump])

    start = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]])

    def remaining(state, time):
        return 10 - time, abs(10 - time) < 1e-13

    found = integrate(field, start, np.ones_like(start), remaining)
    assert abs(found.state[0, 0] - math.erf(5) * math.pi**0.5) < 1e-9
    assert found.state[0, 1] == 0
