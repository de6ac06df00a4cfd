"""Colour-vision deficiencies: simulations against published matrices, losses against plain loops."""

import numpy as np
import pytest
import torch

from odak.learn import perception as p
from odak.learn.perception import color_vision_deficiency as cvd

EVERY = [
    (kind, method) for kind in cvd.DEFICIENCIES for method in cvd.METHODS if (kind, method) != ("tritan", "Vienot")
]


def rand(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def matrix_of(kind, severity=1.0, method="Machado"):
    primaries = torch.eye(3, dtype=torch.float64)[..., None, None]
    return p.simulate_color_vision_deficiency(primaries, kind, severity, method, linear=True)[..., 0, 0].T


def test_machado_against_the_published_matrices():
    # Machado, Oliveira and Fernandes (2009), severity 1.
    published = {
        "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    }
    for kind, expected in published.items():
        assert torch.allclose(matrix_of(kind), torch.tensor(expected, dtype=torch.float64), rtol=0, atol=1e-12)
        steps = [matrix_of(kind, step / 10) for step in range(11)]
        assert torch.allclose(steps[0], torch.eye(3, dtype=torch.float64), atol=1e-12)
        assert torch.allclose(matrix_of(kind, 0.37), 0.3 * steps[3] + 0.7 * steps[4], atol=1e-12)


def test_vienot_against_the_published_planes():
    # Viénot, Brettel and Mollon (1999), equations 4 and 5: L = 2.02344·M − 2.52581·S, M = 0.494207·L + 1.24827·S.
    rows = {"protan": (0, (0, 2.02344, -2.52581)), "deutan": (1, (0.494207, 0, 1.24827))}
    published = np.array([[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]])
    assert np.allclose(100 * cvd._RGB_TO_LMS, published, rtol=1e-5)
    for kind, (row, plane) in rows.items():
        projection = np.eye(3)
        projection[row] = plane
        expected = np.linalg.inv(published) @ projection @ published
        assert np.allclose(matrix_of(kind, method="Vienot").numpy(), expected, rtol=0, atol=2e-5)


def test_brettel_keeps_its_lights_and_loses_one_cone():
    to_rgb = np.linalg.inv(cvd._RGB_TO_LMS)
    lights = {nm: torch.tensor(to_rgb @ cvd._JUDD_VOS_TO_LMS @ np.array(xyz)) for nm, xyz in cvd._ANCHORS.items()}
    for row, kind in enumerate(cvd.DEFICIENCIES):

        def seen(rgb, kind=kind):
            image = torch.as_tensor(rgb).reshape(1, 3, 1, 1)
            return p.simulate_color_vision_deficiency(image, kind, 1.0, "Brettel", linear=True).flatten()

        for wavelength in cvd._ANCHORS_OF[kind]:
            assert torch.allclose(seen(lights[wavelength]), lights[wavelength], atol=1e-12)
        axis = torch.tensor(to_rgb[:, row] / np.abs(to_rgb[:, row]).max())
        for seed in range(20):
            colour = rand(3, seed=seed)
            result = seen(colour)
            # Colours that differ in the missing cone alone look alike, and what is seen looks as it is.
            assert torch.allclose(seen(colour + 0.1 * axis), result, atol=1e-12)
            assert torch.allclose(seen(result), result, atol=1e-12)
            others = np.delete(cvd._RGB_TO_LMS @ (result - colour).numpy(), row)
            assert np.abs(others).max() < 1e-13


def test_brettel_lights_agree_with_smith_and_pokorny():
    # Their tabulated fundamentals (1975) at 475, 485, 575 and 660 nm, each cone in units of its peak.
    table = {
        475: (0.0798, 0.157, 0.582),
        485: (0.128, 0.224, 0.362),
        575: (0.986, 0.732, 0.0013),
        660: (0.0914, 0.007, 0),
    }
    cones = np.array([cvd._JUDD_VOS_TO_LMS @ np.array(cvd._ANCHORS[wavelength]) for wavelength in table])
    assert np.allclose(cones / (0.6373, 0.3935, 0.02604), np.array(list(table.values())), rtol=5e-3, atol=1e-3)


@pytest.mark.parametrize(("kind", "method"), EVERY)
def test_simulation(kind, method):
    grey = rand(1, 1, 4, 4).expand(1, 3, 4, 4)
    assert torch.allclose(p.simulate_color_vision_deficiency(grey, kind, 1.0, method), grey, atol=1e-5)
    image = rand(2, 3, 4, 4, seed=1)
    seen = p.simulate_color_vision_deficiency(image, kind, 1.0, method)
    assert not torch.allclose(seen, image, atol=1e-2)
    assert torch.allclose(p.simulate_color_vision_deficiency(image, kind, 0.0, method), image, atol=1e-12)
    assert torch.allclose(p.simulate_color_vision_deficiency(image[0], kind, 1.0, method)[0], seen[0])
    # sRGB in and out is linear light inside.
    light = p.simulate_color_vision_deficiency(p.rgb_to_linear_rgb(image), kind, 1.0, method, linear=True)
    assert torch.allclose(p.linear_rgb_to_rgb(light), seen)
    small = image[:1, :, :2, :2].clone().requires_grad_()
    severity = torch.tensor(0.63, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda i, s: p.simulate_color_vision_deficiency(i, kind, s, method, linear=True),
        (small, severity),
        fast_mode=True,
    )


def test_simulation_refused():
    image = torch.rand(1, 3, 2, 2)
    for arguments, message in (
        (("green",), "deficiency must be one of"),
        (("protan", 1.5), "severity must be from 0 to 1"),
        (("protan", -0.1), "severity must be from 0 to 1"),
        (("protan", torch.ones(2)), "severity must be one number"),
        (("protan", 1.0, "Wald"), "method must be one of"),
        (("tritan", 1.0, "Vienot"), "take 'Brettel' for tritan"),
    ):
        with pytest.raises(ValueError, match=message):
            p.simulate_color_vision_deficiency(image, *arguments)
    with pytest.raises(ValueError, match="image must be pictures"):
        p.simulate_color_vision_deficiency(image[:, :2])


def test_patches_hold_their_pixels():
    image = rand(2, 3, 7, 6)
    patches, corners = p.extract_local_patches(image, 3, 2)
    assert corners == [(0, 0), (2, 0), (0, 2), (2, 2), (0, 4), (2, 4)]
    assert patches.shape == (2, 27, 6)
    for n, (x, y) in enumerate(corners):
        assert torch.equal(patches[..., n], image[..., y : y + 3, x : x + 3].flatten(1))


def plain_contrast_loss(one, two, size=4, stride=2, epsilon=1e-8):
    terms = []
    for a, b in zip(one, two, strict=True):
        for y in range(0, a.shape[1] - size + 1, stride):
            for x in range(0, a.shape[2] - size + 1, stride):
                s, t = (picture[:, y : y + size, x : x + size].std(correction=0) + epsilon for picture in (a, b))
                terms.append(1 - (2 * s * t + epsilon) / (s**2 + t**2 + epsilon))
    return torch.stack(terms).mean()


def test_local_contrast_against_a_loop():
    one, two = rand(2, 3, 9, 8), rand(2, 3, 9, 8, seed=1) ** 2
    assert p.local_contrast_loss(one, two).item() == pytest.approx(plain_contrast_loss(one, two).item(), rel=1e-12)
    assert p.local_contrast_loss(one, one).item() == 0
    losses = [p.local_contrast_loss(one, factor * one).item() for factor in (0.9, 0.7, 0.3)]
    assert 0 < losses[0] < losses[1] < 0.5
    assert losses[2] > max(0.1, losses[1])
    flat = torch.full((32, 2), 0.5, dtype=torch.float64)
    assert torch.allclose(p.compute_local_contrast_similarity(flat, flat), torch.ones(2, dtype=torch.float64))
    assert p.compute_local_contrast_similarity(flat, rand(32, 2)).max() < 1e-6


def test_colour_information():
    one = rand(1, 3, 9, 9)
    kernel = torch.linspace(-2.5, 2.5, 5, dtype=torch.float64)
    kernel = torch.exp(-(kernel**2) / 2) / np.sqrt(2 * np.pi)
    assert kernel.sum().item() ** 2 == pytest.approx(0.639, abs=1e-3)
    padded = torch.nn.functional.pad(one, (2, 2, 2, 2))
    weights = (kernel[:, None] * kernel).expand(3, 1, 5, 5)
    expected = torch.nn.functional.conv2d(padded, weights, groups=3).mean()
    assert p.color_information_loss(one, torch.zeros_like(one)).item() == pytest.approx(expected.item(), rel=1e-12)
    assert p.color_information_loss(one, one).item() == 0


def test_cvd_loss():
    one, two = rand(2, 3, 8, 8), rand(2, 3, 8, 8, seed=1)
    for alpha, beta in ((15.0, 1.0), (0.0, 2.0), (3.0, 0.0)):
        total, contrast, colour = p.cvd_loss(one, two, alpha, beta)
        assert total.item() == pytest.approx(alpha * contrast.item() + beta * colour.item(), rel=1e-12)
    assert [term.item() for term in p.cvd_loss(one, one)] == [0, 0, 0]
    assert 0 < p.cvd_loss(one, 0.999 * one)[0] < 0.1
    image = rand(1, 2, 5, 5).requires_grad_()
    assert torch.autograd.gradcheck(lambda i: p.cvd_loss(i, two[:1, :2, :5, :5])[0], image, fast_mode=True)
    flat = torch.full((1, 3, 8, 8), 0.5, requires_grad=True)
    p.cvd_loss(flat, torch.rand(1, 3, 8, 8))[0].backward()
    assert torch.isfinite(flat.grad).all()


def test_cvd_module_recolours():
    loss = p.CVDLoss("protan", method="Brettel").to(torch.device("cpu"))
    # Red and green of one luminance: nearly one colour for a protanope.
    target = torch.tensor([0.8, 0.3, 0.2, 0.2, 0.52, 0.2]).reshape(2, 3).T.reshape(1, 3, 1, 2)
    target = target.repeat_interleave(4, -1).repeat_interleave(8, -2)
    image = target.clone().requires_grad_()
    before = loss(image, target)
    optimizer = torch.optim.Adam([image], lr=0.02)
    for _ in range(20):
        optimizer.zero_grad()
        loss(image, target).backward()
        optimizer.step()
    assert loss(image, target) < 0.5 * before
    assert p.CVDLoss(severity=0.0)(target) < 1e-4


def test_losses_refused():
    good = torch.rand(1, 3, 8, 8)
    for function in (p.local_contrast_loss, p.color_information_loss, p.cvd_loss):
        for one, two, kind, message in (
            (good.numpy(), good, TypeError, "image must be a tensor"),
            (good, None, TypeError, "simulated_image must be a tensor"),
            (good[0], good[0], ValueError, r"image must be \[B, C, H, W\]"),
            (good, good[:, :1], ValueError, "one shape"),
            (good[..., :3], good[..., :3], ValueError, "sides at least 4"),
            (good * torch.nan, good, ValueError, "image must hold finite values"),
            (255 * good, good, ValueError, "image must hold finite values of about 0 to 1"),
        ):
            with pytest.raises(kind, match=message):
                function(one, two)
    with pytest.raises(ValueError, match="patch_size must be at most"):
        p.local_contrast_loss(good, good, patch_size=9)
    with pytest.raises(ValueError, match=r"\[D, N\]|the same shape"):
        p.compute_local_contrast_similarity(torch.ones(4, 2), torch.ones(4, 3))


def test_patches_that_hold_no_number_are_not_alike_by_a_number():
    patches = rand(4, 3)
    spoilt = patches.clone()
    spoilt[0, 1] = torch.nan
    assert p.compute_local_contrast_similarity(spoilt, patches).isnan().tolist() == [False, True, False]


def test_loss_names_the_picture_that_came():
    picture = torch.rand(1, 3, 8, 8)
    with pytest.raises(ValueError, match=r"^image must hold finite values"):
        p.CVDLoss()(torch.full_like(picture, torch.nan))
    with pytest.raises(ValueError, match=r"^image and target must have the same shape"):
        p.CVDLoss()(picture, picture[..., :-1])
    with pytest.raises(ValueError, match=r"^lc_patch_size must be at least 1"):
        p.cvd_loss(picture, picture, lc_patch_size=0)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_losses_of_half_precision_are_those_of_single(dtype):
    """Flat patches included: what keeps their similarity defined underflows in half precision."""
    picture = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    picture[..., :8] = 0.5
    picture = picture.to(dtype)
    loss, display = p.CVDLoss("protan"), p.display_color_hvs()
    for found, wanted in (
        (loss(picture), loss(picture.float())),
        (p.cvd_loss(picture, picture.flip(-1))[0], p.cvd_loss(picture.float(), picture.float().flip(-1))[0]),
        (display(picture, picture.flip(-1)), display(picture.float(), picture.float().flip(-1))),
    ):
        assert found.dtype == torch.float32
        assert torch.equal(found, wanted)
        assert found > 0
