"""Windows by their published properties, metamers by closed forms, and runs that were ended by their bits."""

import itertools
import math

import pytest
import torch

from odak._torch_private import forward_derivative
from odak._warnings import ConvergenceWarning
from odak.learn.perception import (
    METAMER_PAPERS,
    Metamer,
    PooledModel,
    Viewing,
    make_eccentricity_distance_maps,
)

VIEW = Viewing(0.4, 0.7)
SMALL = {"n_pyramid_levels": 3}


def noise(*shape, seed=11):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(("window", "scaling"), [("raised cosine", 0.5), ("Gaussian", 0.4)])
def test_windows_grow_as_their_scaling_and_are_longer_along_the_radius(window, scaling):
    """The half-maximum widths along the radius are the scaling times the eccentricity, around the gaze half of that."""
    model = PooledModel("luminance", scaling, VIEW, window=window)
    size = (192, 192)
    pool = model.pool(torch.zeros(1, 1, *size, dtype=torch.float64))
    means = pool.means.to_dense()
    torch.testing.assert_close(means.sum(1), torch.ones(len(means), dtype=torch.float64))
    angle, _ = make_eccentricity_distance_maps((0.5, 0.5), size, viewing=VIEW, dtype=torch.float64)
    rows, columns = torch.meshgrid(*(torch.arange(n) - (n - 1) / 2 for n in size), indexing="ij")
    turn = torch.atan2(rows, columns).flatten()
    counted = 0
    for weights in means:
        place = float((weights * angle.flatten()).sum())
        # Whole windows within the picture alone, wide enough for the pixels.
        if not 7 < math.degrees(place) < 12:
            continue
        half = weights > weights.max() / 2
        near = angle.flatten()[half]
        middle = torch.atan2((weights * turn.sin()).sum(), (weights * turn.cos()).sum())
        spread = torch.remainder(turn[half] - middle + math.pi, 2 * math.pi) - math.pi
        geometric = float((near.max() * near.min()).sqrt())
        assert float(near.max() - near.min()) / geometric == pytest.approx(scaling, rel=0.15)
        assert float(spread.max() - spread.min()) == pytest.approx(scaling / 2, rel=0.2)
        counted += 1
    assert counted > 10


def test_raised_cosines_add_up_to_one():
    pool = PooledModel("luminance", 0.5, VIEW).pool(torch.zeros(1, 1, 64, 64, dtype=torch.float64))
    areas = pool.weights[:, 0] ** 2
    # Windows, each with its area, restore the sum of weights at each pixel to one constant, but next to the fovea.
    angle, _ = make_eccentricity_distance_maps((0.5, 0.5), (64, 64), viewing=VIEW, dtype=torch.float64)
    outside = angle.flatten() > math.radians(1)
    covered = (pool.means.to_dense() * areas[:, None]).sum(0)[outside]
    assert float(covered.std() / covered.mean()) < 1e-10


def test_luminance_is_the_mean_of_each_window_and_quadratic_windows_are_wider_far_away():
    picture = noise(1, 1, 48, 48)
    for growth, scaling in (("linear", 0.4), ("quadratic", 2.0)):
        model = PooledModel("luminance", scaling, VIEW, growth=growth)
        pool = model.pool(picture)
        expected = pool.weights[:, 0] * (pool.means.to_dense() @ picture.flatten())
        torch.testing.assert_close(model(picture)[1].flatten(), expected)
    linear, quadratic = (
        PooledModel("luminance", s, VIEW, growth=g).pool(picture) for g, s in (("linear", 0.4), ("quadratic", 2.0))
    )
    angle, _ = make_eccentricity_distance_maps((0.5, 0.5), (48, 48), viewing=VIEW, dtype=torch.float64)
    # 2e² is wider than 0.4e beyond 0.2 rad, and narrower within.
    for near, larger in ((angle < 0.1, linear), (angle > 0.25, quadratic)):
        sizes = {
            id(pool): float(pool.means.to_dense()[:, near.flatten()].max(0).values.mean())
            for pool in (linear, quadratic)
        }
        assert min(sizes, key=lambda one: sizes[one]) == id(larger)


def test_statistics_have_gradients_and_the_energy_of_a_grating_does_not_depend_on_its_phase():
    model = PooledModel("texture", 0.8, VIEW, n_pyramid_levels=2, n_orientations=2, fovea=3.0)
    picture = noise(1, 1, 32, 32).requires_grad_()
    weights = [noise(*one.shape, seed=3) for one in model(picture)]

    def total(one):
        return torch.stack([(w * s).sum() for w, s in zip(weights, model(one), strict=True)]).sum()

    direction = noise(1, 1, 32, 32, seed=5) - 0.5
    (slope,) = torch.autograd.grad(total(picture), picture)
    step = 1e-6
    change = total(picture.detach() + step * direction) - total(picture.detach() - step * direction)
    assert float((slope * direction).sum()) == pytest.approx(float(change) / (2 * step), rel=1e-5)
    energy = PooledModel("energy", 0.5, VIEW, n_pyramid_levels=2)
    x = torch.arange(64, dtype=torch.float64)
    found = [energy((0.5 + 0.3 * torch.cos(1.3 * x + p)).expand(1, 1, 64, 64))[3][0, 0] for p in (0.0, 1.5)]
    # Windows that hold no pixel near the border, where the pyramid does not see the whole of a band.
    border = torch.ones(64, 64, dtype=torch.float64)
    border[8:-8, 8:-8] = 0
    within = energy.pool(border[None, None]).means.to_dense() @ border.flatten() == 0
    assert int(within.sum()) > 20
    assert float(((found[0] / found[1])[within] - 1).abs().max()) < 0.06


def test_a_model_without_statistics_of_orientations_has_metamers_that_differ():
    picture = noise(1, 1, 32, 32)
    made = Metamer(PooledModel("luminance", 0.5, VIEW), picture, samples=2).run(150)
    assert max(made.distances) < 0.01 and "converged within 1 %" in repr(made)
    for one, two in (*made.pairs(), *made.pairs(original=True)):
        assert float((one - two).square().mean().sqrt()) > 0.05
    assert made.pictures.shape == (2, 1, 1, 32, 32) and float(made.pictures.min()) >= 0
    for curve in made.curves:
        assert len(curve) == 150 and all(b <= a for a, b in itertools.pairwise(curve))
    # The distance is what the model says.
    model, start = made.model, Metamer(made.model, picture, samples=2).pictures[1]

    def apart(one):
        return sum((a - b).square().mean() for a, b in zip(model(one), model(picture), strict=True) if a.numel()) ** 0.5

    assert float(apart(made.pictures[1]) / apart(start)) == pytest.approx(made.distances[1], rel=1e-6)


def test_coarse_structures_change_first():
    picture = noise(1, 1, 32, 32)
    made = Metamer(lambda one: one, picture)
    before = made.pictures[0]
    with pytest.warns(ConvergenceWarning, match="not converged after 25 evaluations: the statistics are"):
        made.run(25)
    assert "did not converge: statistics" in repr(made)
    spectrum = torch.fft.rfft2(made.pictures[0] - before).abs()[0, 0]
    frequency = torch.hypot(torch.fft.fftfreq(32)[:, None], torch.fft.rfftfreq(32))
    low, high = spectrum[frequency <= 1 / 16].square().sum(), spectrum[frequency > 1 / 16].square().sum()
    # Bounds alone change finer structures.
    assert float(high) < 0.2 * float(low)


def test_no_stage_ends_farther_than_it_begins():
    """The second stage starts where the first ended: after few evaluations it is as near as the curve says."""
    model, picture = PooledModel("energy", 0.5, VIEW, **SMALL), 0.3 * noise(1, 1, 32, 32)
    made = Metamer(model, picture, limit=0.9)
    start = made.pictures[0]
    for count in (25, 3):
        made.run(count)
        errors = [
            sum((a - b).square().mean() for a, b in zip(model(one), model(picture), strict=True) if a.numel())
            for one in (made.pictures[0], start)
        ]
        assert float(errors[0] / errors[1]) ** 0.5 == pytest.approx(made.distances[0], rel=1e-6)
    assert made.curves[0][27] < made.curves[0][24]


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_windows_and_their_adjoint_are_the_sparse_matrix(kind):
    pool = PooledModel("luminance", 0.5, VIEW).pool(torch.zeros(1, 1, 24, 32, dtype=kind))
    values = noise(2, 9, 24, 32).to(kind).requires_grad_()
    matrix, weights = pool.means.to_dense(), noise(2, 9, len(pool.means), 1, seed=2).to(kind).requires_grad_()
    found = pool(values)
    torch.testing.assert_close(found[..., 0], values.flatten(2) @ matrix.T)
    (slope,) = torch.autograd.grad((found * weights).sum(), values, create_graph=True)
    torch.testing.assert_close(slope.flatten(2), weights[..., 0] @ matrix)
    # The gradient is linear in the weights, and its derivative is the product with the matrix again.
    (again,) = torch.autograd.grad((slope * values).sum(), weights)
    torch.testing.assert_close(again, found)
    # Forward mode, and a batch of torch.func.
    torch.testing.assert_close(forward_derivative(pool, values.detach(), values.detach())[1], found)
    torch.testing.assert_close(torch.func.vmap(pool)(values.detach()[:, None])[:, 0], found)


def test_statistics_over_their_deviations_have_no_unit():
    pictures = noise(6, 1, 32, 32)
    model = PooledModel("texture", 0.8, VIEW, n_orientations=2, fovea=3.0, **SMALL)
    scaled, half = model.over_deviations(pictures), model.over_deviations(pictures / 2)
    units = []
    for one, two in zip(model(pictures), scaled(pictures), strict=True):
        # One unit for each statistic, whatever the window.
        units.append(one.abs().sum((0, 2), keepdim=True) / two.abs().sum((0, 2), keepdim=True))
        torch.testing.assert_close(one, units[-1] * two)
    luminance = model.pool(pictures)(pictures)
    assert float(units[1]) == pytest.approx(float(luminance.std()), rel=1e-9)
    # A gaze outside of the picture has no pixels around it.
    beside = PooledModel("luminance", 0.5, Viewing(0.4, 0.7, gaze=(-0.5, 0.5))).over_deviations(pictures)
    assert beside(pictures)[0].shape == (6, 1, 0) and bool(beside(pictures)[1].isfinite().all())
    # Pictures of half the contrast are twice as far from one another.
    for one, two in zip(scaled(pictures)[:3], half(pictures)[:3], strict=True):
        torch.testing.assert_close(2 * one, two)


def test_a_run_that_was_ended_goes_on_to_the_same_bits(tmp_path):
    picture, model = noise(1, 1, 32, 32).float(), PooledModel("luminance", 0.5, VIEW)
    whole = Metamer(model, picture, samples=2, limit=0.9).run(210)
    calls = []

    def ended():
        calls.append(1)
        if len(calls) == 160:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Metamer(model, picture, samples=2).run(210, ended, tmp_path / "run.pt")
    again = Metamer(model, picture, samples=2, limit=0.9).resume(tmp_path / "run.pt")
    assert [len(curve) for curve in again.curves] == [100, 0]
    again.run(210)
    assert torch.equal(again.pictures, whole.pictures) and again.curves == whole.curves
    with pytest.raises(ValueError, match="path must be of the same model"):
        Metamer(model, picture, samples=2, seed=7).resume(tmp_path / "run.pt")


def test_starts():
    picture = noise(1, 1, 16, 16)
    near, far = Metamer(torch.square, picture, "picture"), Metamer(torch.square, picture)
    assert float((near.pictures - picture).abs().max()) < 0.1 < float((far.pictures - picture).abs().max())
    assert not torch.equal(*Metamer(torch.square, picture, samples=2).pictures)
    other = noise(1, 1, 16, 16, seed=4)
    assert torch.equal(Metamer(torch.square, picture, other).pictures[0], other)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda p: Metamer(torch.square, p, p, samples=2), "samples must be 1 from one picture"),
        (lambda p: Metamer(torch.square, p, "displaced"), "start must be one of 'noise', 'picture'"),
        (lambda p: Metamer(torch.square, p, limit=1.0), "limit must be"),
        (lambda p: PooledModel("colour"), "statistics must be"),
        (lambda p: PooledModel(scaling=0), "scaling must be"),
        (lambda p: PooledModel(viewing=Viewing(gaze=[(0.1, 0.2), (0.3, 0.4)])), "viewing must have one gaze"),
        (lambda p: PooledModel().over_deviations(p), "pictures must be two or more, got 1"),
        (lambda p: PooledModel.of_paper("Nobody 1900"), "paper must be"),
    ],
)
def test_refused(call, named):
    with pytest.raises((ValueError, TypeError), match=named):
        call(noise(1, 1, 8, 8))


def test_every_paper_makes_a_model():
    picture = noise(1, 3, 32, 32)
    for paper, settings in METAMER_PAPERS.items():
        model = PooledModel.of_paper(paper, VIEW, **SMALL)
        assert (model.statistics, model.scaling) == (settings.statistics, settings.scaling)
        assert all(one.isfinite().all() for one in model(picture))
