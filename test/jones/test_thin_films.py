"""Thin films against the characteristic matrix, Fresnel's formulas, published coatings and conservation of energy."""

import numpy as np
import pytest
import torch

from odak.jones import thin_film_stack
from odak.wave import thin_film_transfer

WAVELENGTH = 550e-9


def characteristic_matrix(wavelength, indices, thicknesses, angle, polarization):
    """Return r and T by the product of characteristic matrices (H. A. Macleod, Thin-Film Optical Filters, ch. 2)."""
    sine = indices[0] * np.sin(np.deg2rad(angle))
    normal = [np.sqrt(complex(n) ** 2 - sine**2) for n in indices]
    eta = normal if polarization == "s" else [complex(n) ** 2 / q for n, q in zip(indices, normal, strict=True)]
    matrix = np.eye(2, dtype=complex)
    for q, admittance, thickness in zip(normal[1:-1], eta[1:-1], thicknesses, strict=True):
        delta = 2 * np.pi * q * thickness / wavelength
        matrix = matrix @ np.array(
            [
                [np.cos(delta), -1j * np.sin(delta) / admittance],
                [-1j * admittance * np.sin(delta), np.cos(delta)],
            ]
        )
    b, c = matrix @ np.array([1, eta[-1]])
    r = (eta[0] * b - c) / (eta[0] * b + c)
    transmittance = 4 * eta[0].real * eta[-1].real / abs(eta[0] * b + c) ** 2
    return (r if polarization == "s" else -r), transmittance


@pytest.mark.parametrize("polarization", ["s", "p"])
@pytest.mark.parametrize("angle", [0.0, 30.0, 70.0, 89.0])
def test_equals_the_characteristic_matrix(angle, polarization):
    indices, thicknesses = [1.0, 2.1 + 0.02j, 1.4, 1.9 + 0.5j, 1.5], [80e-9, 120e-9, 30e-9]
    found = thin_film_stack(WAVELENGTH, indices, thicknesses, angle, polarization)
    r, transmittance = characteristic_matrix(WAVELENGTH, indices, thicknesses, angle, polarization)
    assert abs(found.r - r) < 1e-13
    assert abs(found.transmittance - transmittance) < 1e-13
    assert found.absorptance > 0


def test_published_coatings():
    quarter = [WAVELENGTH / 4 / n for n in (2.35, 1.46)]
    antireflection = thin_film_stack(WAVELENGTH, [1, 1.38, 1.52], [WAVELENGTH / 4 / 1.38])
    mirror = thin_film_stack(WAVELENGTH, [1, *[2.35, 1.46] * 8, 2.35, 1.52], [*quarter * 8, quarter[0]])
    assert antireflection.reflectance == pytest.approx(0.0126008, abs=5e-8)
    assert mirror.reflectance == pytest.approx(0.9994577, abs=5e-8)


def test_one_interface_follows_fresnel_and_brewster():
    incidence = np.deg2rad(40)
    refraction = np.arcsin(np.sin(incidence) / 1.5)
    c, d = np.cos(incidence), np.cos(refraction)
    p, s = (thin_film_stack(WAVELENGTH, [1, 1.5], [], 40, which) for which in "ps")
    assert p.r == pytest.approx((1.5 * c - d) / (1.5 * c + d))
    assert p.t == pytest.approx(2 * c / (1.5 * c + d))
    assert s.r == pytest.approx((c - 1.5 * d) / (c + 1.5 * d))
    assert s.t == pytest.approx(2 * c / (c + 1.5 * d))
    brewster = thin_film_stack(WAVELENGTH, [1, 1.5], [], np.rad2deg(np.arctan(1.5)), "p")
    assert abs(brewster.r) < 1e-15


@pytest.mark.parametrize("polarization", ["s", "p"])
def test_total_and_frustrated_reflection(polarization):
    angles = np.array([41.0, np.rad2deg(np.arcsin(1 / 1.5)), 60.0])
    total = thin_film_stack(WAVELENGTH, [1.5, 1.0], [], angles, polarization)
    # At the critical angle the cosine behind is the root of a rounding error δ of 1 − sin²: 1 − R = 8·√(2δ) at most.
    np.testing.assert_allclose(total.reflectance[1:], 1, atol=8 * np.sqrt(2 * 8 * np.finfo(float).eps))
    assert total.reflectance[2] == pytest.approx(1, abs=1e-14)
    assert total.reflectance[0] < 0.9
    gap = thin_film_stack(WAVELENGTH, [1.5, 1.0, 1.5], [100e-9], 60.0, polarization)
    _, transmittance = characteristic_matrix(WAVELENGTH, [1.5, 1.0, 1.5], [100e-9], 60.0, polarization)
    assert gap.transmittance == pytest.approx(transmittance, abs=1e-13)
    assert gap.absorptance == pytest.approx(0, abs=1e-13)


def test_thick_absorbing_films_stay_finite():
    silver = thin_film_stack(WAVELENGTH, [1, 0.055 + 3.32j, 1.5], [1e-3], 45.0, "p")
    bulk = thin_film_stack(WAVELENGTH, [1, 0.055 + 3.32j], [], 45.0, "p")
    assert silver.r == pytest.approx(complex(bulk.r))
    assert silver.transmittance == 0


def test_gradients_and_faces():
    angle = torch.tensor([10.0, 50.0], dtype=torch.float64, requires_grad=True)
    index = torch.tensor(1.9, dtype=torch.float64, requires_grad=True)
    thickness = torch.tensor(0.13, dtype=torch.float64, requires_grad=True)
    for polarization in "sp":

        def response(angle, index, thickness, polarization=polarization):
            found = thin_film_stack(0.55, [1.0, index, 2.1 + 0.3j, 1.5], [thickness, 0.02], angle, polarization)
            return found.reflectance, found.transmittance, found.r.real, found.t.imag

        assert torch.autograd.gradcheck(response, (angle, index, thickness), fast_mode=True)
        tensors = response(angle, index, thickness)
        arrays = response(angle.detach().numpy(), 1.9, 0.13)
        for tensor, array in zip(tensors, arrays, strict=True):
            np.testing.assert_allclose(tensor.detach().numpy(), array, rtol=1e-12, atol=1e-14)


def test_results_have_the_shape_of_all_arguments():
    bare = thin_film_stack(np.linspace(400e-9, 700e-9, 5), [1.0, 1.5], [], np.zeros((2, 1)))
    assert bare.r.shape == bare.t.shape == bare.absorptance.shape == (2, 5)


@pytest.mark.parametrize("absorbing", [0.2 - 3.4j, np.array([1.5, 0.2 - 3.4j]), torch.tensor(0.2 - 3.4j)])
def test_indices_that_amplify_or_absorb_before_stack_are_refused(absorbing):
    with pytest.raises(ValueError, match=r"indices\[1\] must be n \+ iκ .*exp\(i\(kz − ωt\)\); got κ = -3\.4"):
        thin_film_stack(WAVELENGTH, [1.0, absorbing], [])
    with pytest.raises(ValueError, match=r"indices\[0\], of the incident medium, must not absorb; got κ = 3\.4"):
        thin_film_stack(WAVELENGTH, [absorbing.real - 1j * absorbing.imag, 1.0], [])
    with pytest.raises(ValueError, match=r"indices\[1\] must be n"):
        thin_film_transfer((4, 4), 1e-6, WAVELENGTH, [1.0, absorbing], [])


def test_wrong_use_names_the_argument(as_array):
    with pytest.raises(ValueError, match="thicknesses must be two fewer than indices"):
        thin_film_stack(WAVELENGTH, [1, 1.38, 1.52], [])
    # Numbers that would give power from nothing, or a division by zero.
    for thin in (-1e-8, as_array(np.asarray([1e-7, -1e-8]))):
        with pytest.raises(ValueError, match=r"thicknesses\[1\] must be at least 0, got -1e-08"):
            thin_film_stack(WAVELENGTH, [1, 1.38, 1.38 + 0.1j, 1.52], [0.0, thin])
    for steep in (-120.0, as_array(np.asarray([0.0, -120.0]))):
        with pytest.raises(ValueError, match="angle must be from -90 to 90, got -120"):
            thin_film_stack(WAVELENGTH, [1, 1.52], [], steep)
    with pytest.raises(ValueError, match=r"indices\[1\] must not be 0"):
        thin_film_stack(WAVELENGTH, [1, as_array(np.asarray([1.4, 0.0])), 1.52], [1e-7])
    found = thin_film_stack(WAVELENGTH, [1, 1.38, 1.52], [0], as_array(np.asarray([-90.0, 90.0])))
    assert all(abs(float(found.reflectance[k]) - 1) < 1e-12 for k in (0, 1))


def test_unpolarised_light_is_the_mean_of_both_polarisations():
    angles = np.array([0.0, 30.0, 60.0])
    stack = (550e-9, (1.0, 1.38 + 0.02j, 1.52), (100e-9,), angles)
    mixed, s, p = (thin_film_stack(*stack, polarization=state) for state in ("unpolarized", "s", "p"))
    np.testing.assert_allclose(mixed.reflectance, (s.reflectance + p.reflectance) / 2, rtol=1e-15)
    np.testing.assert_allclose(mixed.reflectance + mixed.transmittance + mixed.absorptance, 1.0, rtol=1e-14)
    # A bare face at Brewster's angle: half of what s-polarised light reflects, ((n² − 1)/(n² + 1))²/2.
    face = thin_film_stack(550e-9, (1.0, 1.5), (), np.degrees(np.arctan(1.5)), polarization="unpolarized")
    assert abs(face.reflectance - (1.25 / 3.25) ** 2 / 2) < 1e-15
    assert mixed.r is None and mixed.t is None and "r=" not in repr(mixed)


@pytest.mark.parametrize("polarization", ["s", "p"])
@pytest.mark.parametrize("angle", [30.0, 30.000000000000004, 30 + 1e-9])
def test_a_gap_at_its_critical_angle_has_the_limit_of_the_characteristic_matrix(polarization, angle):
    """The matrix has a limit where waves of both directions are one: sin β/(n·cosθ) is 2πd/λ there."""
    thickness, n = 137e-9, 2.0
    turn, square = 2 * np.pi * thickness / WAVELENGTH, 1 - (n * np.sin(np.deg2rad(angle))) ** 2
    inside = n * np.cos(np.deg2rad(angle))
    share = 1.0 if polarization == "s" else 1 / n**2
    b, c = 1 - 1j * turn * inside * share, inside * share - 1j * turn * square
    expected = abs((inside * share * b - c) / (inside * share * b + c)) ** 2
    given = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
    found = thin_film_stack(WAVELENGTH, [n, 1.0, n], [thickness], given, polarization)
    # Terms of the order of the square, some 1e-10 at the third angle, are left out above.
    assert float(found.reflectance.detach()) == pytest.approx(expected, abs=1e-9)
    assert float(found.absorptance.detach()) == pytest.approx(0, abs=1e-14)
    (slope,) = torch.autograd.grad(found.reflectance, given)
    sides = [
        float(thin_film_stack(WAVELENGTH, [n, 1.0, n], [thickness], angle + h, polarization).reflectance)
        for h in (-1e-3, 1e-3)
    ]
    assert float(slope) == pytest.approx((sides[1] - sides[0]) / 2e-3, rel=1e-5)


def test_a_mirror_of_a_thousand_pairs_stays_within_the_range_of_numbers():
    indices = [1.0] + 1000 * [3.5, 1.4] + [1.5]
    found = thin_film_stack(WAVELENGTH, indices, [WAVELENGTH / 4 / n for n in indices[1:-1]])
    assert float(found.reflectance) == pytest.approx(1, abs=1e-12) and abs(complex(found.t)) < 1e-300
