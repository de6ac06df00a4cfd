"""Arrays of tilting mirrors: against sums over points of the mirrors in space, closed forms and a display's light."""

import math

import numpy as np
import pytest
import torch

from odak.learn.wave import Display, Free, Modulator, TiltingMirrors

PITCH, WAVELENGTH = 7.56e-6, 532e-9


def summed(mirrors, leaving, on=True, points=40):
    """Return the mean phase factor over Gauss-Legendre points of a mirror that is turned by Rodrigues' formula."""
    angle, axis = math.radians(mirrors.tilt if on else -mirrors.tilt), np.array([1, -1, 0]) / math.sqrt(2)
    crossed = np.cross(np.eye(3), axis)
    turn = np.eye(3) + math.sin(angle) * crossed + (1 - math.cos(angle)) * crossed @ crossed
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes = nodes * math.sqrt(mirrors.fill) * mirrors.pitch / 2
    places = np.stack(np.broadcast_arrays(nodes[:, None], nodes, 0.0), -1) @ turn.T
    inward = math.sin(math.radians(mirrors.incidence))
    coming = np.array([inward / math.sqrt(2), inward / math.sqrt(2), -math.cos(math.radians(mirrors.incidence))])
    phase = 2 * np.pi / mirrors.wavelength * places @ (np.asarray(leaving) - coming)
    return (np.exp(-1j * phase) * weights[:, None] * weights / 4).sum()


@pytest.mark.parametrize("on", [True, False])
@pytest.mark.parametrize("order", [None, (-4, -3), (0, 0), (-6, 1)])
@pytest.mark.parametrize("tilt, incidence", [(12.0, None), (17.0, 20.0), (8.0, -15.0)])
def test_efficiencies_equal_sums_over_points_of_mirrors_in_space(tilt, incidence, order, on):
    mirrors = TiltingMirrors(PITCH, WAVELENGTH, tilt, incidence, 0.85)
    expected = abs(0.85 * summed(mirrors, mirrors.direction(order), on)) ** 2
    assert mirrors.efficiency(order, on) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_an_order_at_the_blaze_has_all_of_the_light_that_mirrors_reflect_into_orders_of_full_ones():
    # In Littrow's arrangement, at the tilt, the blaze is where mλ/p = √2·sin(tilt).
    wavelength = math.sqrt(2) * PITCH * math.sin(math.radians(12)) / 4
    mirrors = TiltingMirrors(PITCH, wavelength, 12.0, 12.0, fill=1.0)
    assert mirrors.blaze == pytest.approx(-4) and mirrors.order == (-4, -4)
    assert mirrors.efficiency() == pytest.approx(1)
    assert mirrors.direction() == pytest.approx(
        (-math.sin(math.radians(12)) / math.sqrt(2),) * 2 + (math.cos(math.radians(12)),)
    )


@pytest.mark.parametrize("fill", [0.6, 0.9])
def test_all_orders_of_flat_mirrors_together_have_the_light_of_their_share(fill):
    mirrors = TiltingMirrors(200 * WAVELENGTH, WAVELENGTH, 0.0, fill=fill)
    share = sum(mirrors.efficiency((0, n)) for n in range(-190, 191))
    # Along one axis; 1/π² of 1/n² is what is beyond each end at most.
    assert share == pytest.approx(fill**1.5, abs=2 / (math.pi**2 * 190))


def test_a_mask_turns_flat_pixels_into_mirrors():
    mirrors = TiltingMirrors(PITCH, WAVELENGTH, 13.0, fill=0.9)
    mask = mirrors.mask((6, 8))
    assert mask.shape == (12, 16) and mask.dtype == torch.float32

    def expected(row, column):
        aside = np.array([(row - 6) / 12, (column - 8) / 16])
        middle = np.array(mirrors.direction()[:2]) + aside * WAVELENGTH / PITCH
        flat = np.sinc(math.sqrt(0.9) * aside).prod()
        return summed(mirrors, [*middle, math.sqrt(1 - (middle**2).sum())]).real / flat

    for row, column in ((1, 1), (6, 8), (3, 13)):
        assert float(mask[row, column]) == pytest.approx(expected(row, column), rel=1e-5)
    # The first frequency along an axis is the last one too.
    assert float(mask[0, 5]) == pytest.approx((expected(0, 5) + expected(12, 5)) / 2, rel=1e-5)
    # Without a tilt mirrors are flat pixels, but for the angle of their light, whose cosine changes nothing here.
    assert torch.allclose(TiltingMirrors(PITCH, WAVELENGTH, 0.0).mask((6, 8)), torch.ones(12, 16))


def test_light_of_a_display_of_mirrors_is_a_sum_of_the_plane_waves_that_they_light():
    mirrors, n, fine, distance = TiltingMirrors(PITCH, WAVELENGTH, 13.0), 32, 8, 1e-3
    phases = torch.from_numpy(np.random.default_rng(0).uniform(0, 6, (n, n)))
    lit = Display(Modulator((n, n), PITCH, None), WAVELENGTH, Free(distance, mask=mirrors.mask((n, n)))).double()
    cycles = np.fft.fftfreq(fine * n)
    envelope = np.fft.ifftshift(mirrors.mask((fine * n // 2,) * 2).double().numpy())
    envelope = envelope * np.multiply.outer(*[np.sinc(math.sqrt(0.9) * cycles)] * 2)
    axial = np.sqrt(WAVELENGTH**-2 - (cycles[:, None] / PITCH) ** 2 - (cycles / PITCH) ** 2)
    spectrum = np.fft.fft2(np.exp(1j * phases.numpy()), (fine * n,) * 2)
    expected = np.fft.ifft2(spectrum * envelope * np.exp(2j * np.pi * distance * axial))[:n, :n]
    found = lit.fields(phases)[0, 0, 0].numpy()

    def error(wanted):
        turn = np.vdot(wanted, found)
        return np.linalg.norm(found - wanted * turn / abs(turn)) / np.linalg.norm(wanted)

    # The ends of the order differ, which a mask of twice the pixels of the panel samples coarsely: 1.6 % here, 0.8 % of
    # 96 × 96 pixels.
    assert error(expected) < 0.02
    # Light that goes the other way, or across, is other light.
    assert error(expected.T) > 0.5
    turned = np.fft.ifft2(spectrum * envelope[::-1, ::-1] * np.exp(2j * np.pi * distance * axial))[:n, :n]
    assert error(turned) > 0.1


def test_orders_that_do_not_leave_and_other_arguments_are_refused():
    mirrors = TiltingMirrors(PITCH, WAVELENGTH)
    with pytest.raises(ValueError, match=r"order must be one that leaves the array, got \(12, 12\)"):
        mirrors.efficiency((12, 12))
    with pytest.raises(ValueError, match="order must be one that leaves the array with all its light"):
        TiltingMirrors(1.5 * WAVELENGTH, WAVELENGTH).mask((4, 4), (-1, -1))
    with pytest.raises(TypeError, match="order must be an integer, got float"):
        mirrors.direction((1.5, 0))
    with pytest.raises(ValueError, match="order must have 2 numbers, got 1"):
        mirrors.direction((1,))
    with pytest.raises(ValueError, match="tilt must be"):
        TiltingMirrors(PITCH, WAVELENGTH, -3.0)
    with pytest.raises(ValueError, match="incidence must be"):
        TiltingMirrors(PITCH, WAVELENGTH, incidence=90.0)
