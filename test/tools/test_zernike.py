"""Zernike polynomials against exact rational sums, the tables of their sources and their orthogonality."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import odak
from odak.tools import fringe_to_nm, noll_to_nm, osa_to_nm, zernike_norm, zernike_polynomial

# Born and Wolf 1999, table 9.1, as functions of x = ρ·cosθ and y = ρ·sinθ.
KNOWN = {
    (0, 0): lambda x, y: 1 + 0 * x,
    (1, 1): lambda x, y: x,
    (1, -1): lambda x, y: y,
    (2, 0): lambda x, y: 2 * (x**2 + y**2) - 1,
    (2, 2): lambda x, y: x**2 - y**2,
    (2, -2): lambda x, y: 2 * x * y,
    (3, 1): lambda x, y: (3 * (x**2 + y**2) - 2) * x,
    (3, -3): lambda x, y: 3 * x**2 * y - y**3,
    (4, 0): lambda x, y: 6 * (x**2 + y**2) ** 2 - 6 * (x**2 + y**2) + 1,
    (6, 0): lambda x, y: 20 * (x**2 + y**2) ** 3 - 30 * (x**2 + y**2) ** 2 + 12 * (x**2 + y**2) - 1,
}
NOLL = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0), (4, 2), (4, -2)]


def exact_radial(n, m, rho):
    """Return the sum of Born and Wolf, section 9.2.1, eq. 5, in exact fractions."""
    total = Fraction(0)
    for k in range((n - m) // 2 + 1):
        top = (-1) ** k * math.factorial(n - k)
        bottom = math.factorial(k) * math.factorial((n + m) // 2 - k) * math.factorial((n - m) // 2 - k)
        total += Fraction(top, bottom) * Fraction(rho) ** (n - 2 * k)
    return float(total)


@st.composite
def modes(draw, largest=40):
    n = draw(st.integers(0, largest))
    return n, 2 * draw(st.integers(0, n)) - n


@pytest.mark.parametrize("mode", KNOWN)
def test_known_polynomials(mode, random):
    x, y = random.uniform(-0.7, 0.7, (2, 50))
    value = zernike_polynomial(*mode, np.hypot(x, y), np.arctan2(y, x))
    np.testing.assert_allclose(value, KNOWN[mode](x, y), atol=1e-14)


@given(mode=modes(), rho=st.floats(0, 1))
def test_radial_part_is_the_exact_sum(mode, rho):
    n, m = mode[0], abs(mode[1])
    assert zernike_polynomial(n, m, rho, 0.0) == pytest.approx(exact_radial(n, m, rho), abs=1e-13)


def test_orthonormal_over_the_disc():
    nodes, weights = np.polynomial.legendre.leggauss(24)
    rho, area = (nodes + 1) / 2, weights * (nodes + 1) / 2  # ∫ ρ dρ from 0 to 1, twice
    theta = 2 * np.pi * np.arange(32) / 32
    list_of_modes = [osa_to_nm(j) for j in range(28)]
    values = np.stack([zernike_norm(*mode) * zernike_polynomial(*mode, rho[:, None], theta) for mode in list_of_modes])
    products = np.einsum("aij,bij,i->ab", values, values, area) / 32
    np.testing.assert_allclose(products, np.eye(28), atol=1e-12)


def test_single_indices_follow_their_tables():
    assert [noll_to_nm(j) for j in range(1, 14)] == NOLL
    # Wyant and Creath (1992), table 3: coma 7 and 8, spherical 9, trefoil 10 and 11, and so on.
    fringe = [(0, 0), (1, 1), (1, -1), (2, 0), (2, 2), (2, -2), (3, 1), (3, -1), (4, 0), (3, 3), (3, -3), (4, 2)]
    assert [fringe_to_nm(j) for j in range(1, 13)] == fringe and fringe_to_nm(25) == (8, 0)
    pairs = [(n, m) for n in range(11) for m in range(-n, n + 1, 2) if n + abs(m) <= 10]
    pairs.sort(key=lambda pair: (pair[0] + abs(pair[1]), -abs(pair[1]), pair[1] < 0))
    assert [fringe_to_nm(j) for j in range(1, 38)] == [*pairs, (12, 0)]
    assert [osa_to_nm(j) for j in range(6)] == [(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2)]


@given(j=st.integers(0, 10**6))
def test_single_indices_are_one_to_one(j):
    n, m = osa_to_nm(j)
    assert (n * (n + 2) + m) // 2 == j and abs(m) <= n and (n - m) % 2 == 0
    n, m = noll_to_nm(j + 1)
    # Noll (1976): j grows with n, then with |m|; even j are cosines.
    assert n * (n + 1) // 2 + abs(m) <= j + 1 <= n * (n + 1) // 2 + abs(m) + 1
    assert m == 0 or (m > 0) == ((j + 1) % 2 == 0)


def test_outside_the_disc_it_is_zero_and_so_is_its_gradient():
    rho = torch.tensor([0.5, 1.0, 1.0 + 1e-9, 3.0, 1e200], dtype=torch.float64, requires_grad=True)
    value = odak.learn.tools.zernike_polynomial(40, 0, rho, torch.zeros(5))
    assert value.dtype == torch.float64
    assert (value[2:] == 0).all() and abs(value[1] - 1) < 1e-13
    value.sum().backward()
    assert torch.isfinite(rho.grad).all() and (rho.grad[2:] == 0).all()


@pytest.mark.parametrize("mode", [(0, 0), (1, -1), (4, 2), (6, 0), (7, -3)])
def test_gradients_in_radius_and_angle(mode):
    rho = torch.tensor([0.1, 0.4, 0.9], dtype=torch.float64, requires_grad=True)
    theta = torch.tensor([0.3, -2.0, 1.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda r, t: zernike_polynomial(*mode, r, t), (rho, theta), fast_mode=True)


def test_libraries_agree(as_array, random):
    rho, theta = random.uniform(0, 1.2, (4, 5)), random.uniform(-3, 3, (4, 5))
    expected = zernike_polynomial(9, -5, rho, theta)
    np.testing.assert_allclose(np.asarray(zernike_polynomial(9, -5, as_array(rho), as_array(theta))), expected)
    assert zernike_polynomial(9, -5, rho.astype(np.float32), theta).dtype == np.float32
    # Computed in float64 and cast: half a unit in the last place of the input moves it by 9·2⁻²⁴ at most, near 1.
    single = zernike_polynomial(9, -5, rho.astype(np.float32), theta.astype(np.float32))
    np.testing.assert_allclose(single, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("n", "m", "error", "message"),
    [
        (2, 1, ValueError, "n − .m. even"),
        (2, 4, ValueError, "got m = 4 with n = 2"),
        (2, -4, ValueError, "m must be at least -2"),
        (-1, 0, ValueError, "n must be at least 0"),
        (2.0, 0, TypeError, "n must be an integer"),
    ],
)
def test_there_is_no_such_polynomial(n, m, error, message):
    with pytest.raises(error, match=message):
        zernike_polynomial(n, m, np.ones(2), np.zeros(2))
    with pytest.raises(error, match=message):
        zernike_norm(n, m)
