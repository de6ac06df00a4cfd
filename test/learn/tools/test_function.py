import numpy as np
import pytest
import torch
from scipy import interpolate, stats
from scipy.spatial.transform import Rotation

from odak.learn.tools import (
    compose_bspline_2d,
    decompose_bspline_2d,
    decompose_wavelet_like,
    evaluate_3d_gaussians,
    generate_bspline_basis_2d,
    reconstruct_wavelet_like,
)

double = {"dtype": torch.float64}


def test_basis_is_scipys():
    basis, grid = generate_bspline_basis_2d([5, 3], [11, 16], **double)
    assert basis.shape == (15, 176)
    for row, (i, j) in enumerate(np.ndindex(3, 5)):
        along_y, along_x = (
            interpolate.BSpline.basis_element(np.arange(k - 2.0, k + 3), extrapolate=False)(np.linspace(0, c - 1, n))
            for k, c, n in ((i, 3, 11), (j, 5, 16))
        )
        expected = np.nan_to_num(along_y)[:, None] * np.nan_to_num(along_x)
        assert np.allclose(basis[row].reshape(11, 16), expected, atol=1e-14)
    assert grid.shape == (5, 3, 2)
    assert grid[3, 1].tolist() == [0.5, 0.0]


def test_splines_sum_to_one_inside_and_to_five_sixths_at_edge():
    line = generate_bspline_basis_2d([8, 1], [1, 71], **double)[0].sum(0)
    assert torch.allclose(line[10:-10], torch.ones(51, **double), atol=1e-14)
    assert torch.allclose(line[[0, -1]], torch.full((2,), 5 / 6, **double), atol=1e-14)


@pytest.mark.parametrize(
    "counts, shape, weight", [([4, 5], (12, 14), 1e-6), ([1, 6], (9, 20), 0.3), ([9, 8], (6, 5), 1e-4)]
)
def test_decomposition_solves_the_dense_equations(counts, shape, weight):
    image = torch.rand(shape, generator=torch.Generator().manual_seed(1), **double)
    basis = generate_bspline_basis_2d(counts, shape, **double)[0]
    expected = torch.linalg.solve(basis @ basis.T + weight * torch.eye(len(basis), **double), basis @ image.ravel())
    found, factors, grid = decompose_bspline_2d(image, counts, weight)
    assert torch.allclose(found, expected, rtol=1e-7, atol=1e-8)
    assert grid.shape == (*counts, 2)
    assert torch.allclose(
        compose_bspline_2d(found, factors, shape), compose_bspline_2d(found, basis, shape), atol=1e-12
    )
    assert torch.equal(decompose_bspline_2d(image[None], counts, weight)[0], found)


def test_a_sum_of_splines_gives_its_coefficients_back():
    wanted = torch.randn(6 * 7, generator=torch.Generator().manual_seed(2), **double)
    basis = generate_bspline_basis_2d([6, 7], [40, 50], **double)[0]
    found, _, _ = decompose_bspline_2d(compose_bspline_2d(wanted, basis, [40, 50]), [6, 7], 0.0)
    assert torch.allclose(found, wanted, atol=1e-10)


def test_the_light_basis_passes_for_a_matrix():
    image = torch.rand(10, 12)
    found, basis, _ = decompose_bspline_2d(image, [4, 3])
    dense = generate_bspline_basis_2d([4, 3], [10, 12])[0]
    assert basis.shape == dense.shape
    assert basis._matrix is None
    for value in (found @ basis, torch.matmul(basis.T, found), basis.t() @ found):
        assert torch.allclose(value, found @ dense, atol=1e-6)
    assert torch.allclose(basis @ dense.T, dense @ dense.T, atol=1e-5)
    assert torch.allclose(basis[2], dense[2], atol=1e-7)
    assert np.allclose(np.asarray(basis), dense, atol=1e-7)
    assert len(basis) == 12


def test_layers_add_up_to_the_picture():
    y, x = torch.meshgrid(*(torch.linspace(-3, 3, 96) for _ in range(2)), indexing="ij")
    phase = torch.remainder(x**2 + y**2, 2 * torch.pi)
    coefficients, residuals, base = decompose_wavelet_like(phase, 3)
    assert [len(c) for c in coefficients] == [12**2, 6**2, 4**2]
    rebuilt = reconstruct_wavelet_like(coefficients, residuals, base)
    assert (rebuilt - phase).abs().max() < 2e-6
    exact = [layer.double() for layer in (phase, *decompose_wavelet_like(phase.double(), 3)[1])]
    assert torch.allclose(sum(exact[1:]) + decompose_wavelet_like(phase.double(), 3)[2], exact[0], atol=1e-14)
    # The base is a fit on the coarsest grid of what the finer grids hold.
    smooth = phase - residuals[0] - residuals[1]
    fit = compose_bspline_2d(*decompose_bspline_2d(smooth, [4, 4], 1e-8)[:2], [96, 96])
    assert torch.allclose(base, fit, atol=1e-5)
    assert base.var() < phase.var()


def test_gradients():
    image = torch.rand(5, 6, requires_grad=True, **double)
    assert torch.autograd.gradcheck(lambda i: decompose_bspline_2d(i, [3, 2])[0], image, fast_mode=True)
    assert torch.autograd.gradcheck(lambda i: decompose_wavelet_like(i, 1)[2], image, fast_mode=True)
    given = [torch.rand(2, 3, **double) + 0.5 for _ in range(4)] + [torch.rand(2, 1, **double)]
    assert torch.autograd.gradcheck(evaluate_3d_gaussians, [value.requires_grad_() for value in given], fast_mode=True)


def test_gaussians_are_scipys():
    points = torch.rand(6, 3, **double)
    centers, scales = torch.rand(2, 3, **double), torch.rand(2, 3, **double) + 0.3
    angles, opacity = torch.tensor([[10.0, 20, 30], [-50, 5, 80]], **double), torch.tensor([[0.5], [2.0]], **double)
    found = evaluate_3d_gaussians(points, centers, scales, angles, opacity)
    for j in range(2):
        turn = Rotation.from_euler("xyz", angles[j], degrees=True).as_matrix()
        covariance = turn.T @ np.diag(scales[j] ** 2) @ turn
        expected = opacity[j].item() * stats.multivariate_normal(centers[j], covariance).pdf(points)
        assert np.allclose(found[:, j], expected, rtol=1e-10)
    assert evaluate_3d_gaussians(points).shape == (6, 1)
    assert evaluate_3d_gaussians(points, centers).shape == (6, 2)
    whole = torch.tensor([[0, 1, -1]])
    assert torch.equal(evaluate_3d_gaussians(whole, centers), evaluate_3d_gaussians(whole.float(), centers))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: decompose_bspline_2d(torch.rand(2, 3, 4), [2, 2]), "image must be"),
        (lambda: decompose_bspline_2d(torch.rand(3, 4), [2, 0]), r"num_control_points\[1\] must be at least 1"),
        (lambda: decompose_bspline_2d(torch.rand(3, 4), [2, 2], -1.0), "regularization must be at least 0"),
        (lambda: compose_bspline_2d(torch.rand(4), torch.rand(4, 6), [2, 4]), "basis_matrix must be"),
        (lambda: decompose_wavelet_like(torch.rand(1, 4)), "image must have at least two samples"),
        (lambda: evaluate_3d_gaussians(torch.rand(1, 3), torch.rand(2, 3), torch.rand(3, 3)), "as many rows, or one"),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
