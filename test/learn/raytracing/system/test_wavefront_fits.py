"""Fits of wavefronts by Zernike's and Forbes' polynomials."""

import math

import pytest
import torch

from odak.learn.raytracing.system import Wavefront, load_system, pupil_samples, q_fit, wavefront, zernike_fit
from odak.raytracing import QbfsAsphere
from odak.tools import fringe_to_nm, noll_to_nm, osa_to_nm, zernike_norm

F64 = torch.float64


def test_orders_of_zernike_polynomials_name_the_same_wavefront():
    """The fringe coefficient of a mode is Noll's times its norm; OSA's only stands elsewhere."""
    found = wavefront(load_system("cooke_triplet"))
    (noll, left), (osa, same), (fringe, _) = (
        zernike_fit(found, n, order) for n, order in ((36, "noll"), (36, "osa"), (37, "fringe"))
    )
    torch.testing.assert_close(left, same, rtol=1e-6, atol=1e-9)
    place = {noll_to_nm(j): j - 1 for j in range(1, 37)}
    for j in range(36):
        torch.testing.assert_close(osa[..., j], noll[..., place[osa_to_nm(j)]], rtol=0, atol=1e-8)
    # The modes that both sets have, where what the others leave is small: the polynomials are orthogonal.
    for j in range(1, 17):
        mode = fringe_to_nm(j)
        expected = noll[..., place[mode]] * zernike_norm(*mode) if mode in place else None
        if expected is not None:
            torch.testing.assert_close(fringe[..., j - 1], expected, rtol=0, atol=2e-4)
    with pytest.raises(ValueError, match="1 to 37"):
        zernike_fit(found, 38, "fringe")


def flat_wavefront(pupil, path):
    """Return a `Wavefront` of given path differences, whose rays all arrive."""
    path = path.expand(1, 1, -1)
    zero = torch.zeros_like(path)
    return Wavefront(path, zero[..., 0], pupil, torch.stack([zero, zero], -1), zero.to(torch.int8))


def test_wavefront_of_shape_of_q_asphere_has_its_coefficients():
    """The asphere evaluates Forbes' recurrence of 2010."""
    given = [0.3, -0.2, 0.1, 0.05, -0.04]
    pupil = pupil_samples("rings", 8)
    height = QbfsAsphere(0.0, given, 1.0).sag(*pupil.T).height
    found = q_fit(flat_wavefront(pupil, 0.7 + 0.4 * pupil.square().sum(-1) + height), radial=5, azimuthal=1)
    torch.testing.assert_close(found.cosine[0, 0, 0], torch.tensor(given, dtype=F64), atol=1e-12, rtol=0)
    torch.testing.assert_close(found.base[0, 0], torch.tensor([0.7, 0.4], dtype=F64), atol=1e-12, rtol=0)
    assert float(torch.cat([found.cosine[0, 0, 1], found.sine[0, 0].flatten()]).abs().max()) < 1e-12
    assert float(found.residual.max()) < 1e-12


def test_squares_of_q_coefficients_sum_to_mean_square_gradient():
    """Of a polynomial in x and y, its gradient by autograd, on another grid, uniform in the arc sine of the radius."""
    powers = [(i, j) for i in range(8) for j in range(8 - i)]
    given = torch.randn(len(powers), generator=torch.Generator().manual_seed(7), dtype=F64)

    def polynomial(x, y):
        return sum(a * x**i * y**j for a, (i, j) in zip(given, powers, strict=True))

    pupil = pupil_samples("rings", 10)
    found = q_fit(flat_wavefront(pupil, polynomial(*pupil.T)), radial=4, azimuthal=7)
    assert float(found.residual.max()) < 1e-11
    radius, angle = torch.meshgrid(
        torch.sin((torch.arange(40, dtype=F64) + 0.5) * math.pi / 80),
        torch.arange(32, dtype=F64) * math.pi / 16,
        indexing="ij",
    )
    x, y = (radius * angle.cos()).requires_grad_(), (radius * angle.sin()).requires_grad_()
    departure = polynomial(x, y) - found.base[0, 0, 1] * (x * x + y * y)
    gradient = torch.autograd.grad(departure.sum(), (x, y))
    expected = sum(value.square() for value in gradient).mean()
    total = found.cosine.square().sum() + found.sine.square().sum()
    torch.testing.assert_close(total, expected, rtol=1e-10, atol=0)


def test_fits_of_fields_with_pupil_points_of_their_own():
    lens = load_system("cooke_triplet")
    points = torch.stack(
        [pupil_samples("rings", 5), 0.8 * pupil_samples("rings", 5), pupil_samples("rings", 5).flip(0)]
    )
    together = wavefront(lens, points)
    for fit in (lambda lag: zernike_fit(lag, 11)[0], lambda lag: q_fit(lag, 2, 3).sine):
        found = fit(together)
        for i, field in enumerate(lens.fields):
            alone = fit(wavefront(lens, points[i], fields=[field]))
            torch.testing.assert_close(found[:, i], alone[:, 0], rtol=1e-8, atol=1e-8)
