"""Focal stacks of scenes of planes: closed cases, the composition by its definition, and both faces."""

import numpy as np
import pytest
import torch

import odak
from odak.learn.wave import incoherent_focal_stack_rgbd as torch_face
from odak.wave import incoherent_focal_stack_rgbd, propagate_beam

DX, COLOURS = 8e-6, [639e-9, 515e-9, 473e-9]
PLACES = [0.0, 1e-3, 3e-3]
PADDED = (True, False, True)


@pytest.fixture
def scene(random):
    targets, masks = random.random((3, 3, 12, 11)), (random.random((3, 12, 11)) > 0.5).astype(float)
    return targets * masks[:, None], masks


def spread(intensity, distance, wavelength, aperture=1.0):
    return propagate_beam(
        intensity.astype(complex), None, distance, DX, wavelength, "Incoherent Angular Spectrum", None, PADDED, aperture
    )


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0])
def test_composition_by_its_definition(scene, alpha):
    targets, masks = scene
    expected = np.zeros_like(targets)
    for n in range(3):
        for c, wavelength in enumerate(COLOURS):
            clear = 1.0
            for k in range(3):
                light, cover = (spread(v, PLACES[n] - PLACES[k], wavelength) for v in (targets[k, c], masks[k]))
                expected[n, c] += light * clear
                clear = clear * (1 - alpha * cover / cover.max())
    stack = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS, alpha=alpha)
    np.testing.assert_allclose(stack, expected / expected.max(), atol=1e-12)
    assert stack.max() == 1
    assert stack.min() >= 0


def test_one_plane_is_sharp(scene):
    targets, masks = scene[0][:1], scene[1][:1]
    stack = incoherent_focal_stack_rgbd(targets, masks, [0.02], DX, COLOURS)
    np.testing.assert_allclose(stack, targets / targets.max(), atol=1e-12)


def test_an_opaque_front_hides_what_is_behind(scene):
    targets, _ = scene
    masks = np.zeros((2, 12, 11))
    masks[0, :, :6], masks[1] = 3.0, 1.0
    front = targets[:2].copy()
    front[0] *= masks[0] > 0
    stack = incoherent_focal_stack_rgbd(front, masks, [1e-3, 1e-3], DX, COLOURS, alpha=1.0)
    seen = np.where(masks[0] > 0, front[0], front[1])
    np.testing.assert_allclose(stack[0], seen / seen.max(), atol=1e-12)
    # Half opaque, half of it comes through; without masks planes add up.
    half = incoherent_focal_stack_rgbd(front, masks, [1e-3, 1e-3], DX, COLOURS, alpha=0.5)
    seen = front[0] + front[1] * np.where(masks[0] > 0, 0.5, 1.0)
    np.testing.assert_allclose(half[1], seen / seen.max(), atol=1e-12)
    bare = incoherent_focal_stack_rgbd(front, 0 * masks, [1e-3, 1e-3], DX, COLOURS, alpha=1.0)
    np.testing.assert_allclose(bare[0], (front[0] + front[1]) / (front[0] + front[1]).max(), atol=1e-12)


def test_defocus_spreads_a_point_and_keeps_its_light():
    point = np.zeros((2, 1, 33, 33))
    point[0, 0, 16, 16] = 1
    stack = incoherent_focal_stack_rgbd(point, 0 * point, [0.0, 4e-3], DX, 515e-9)
    sharp, blurred = stack[:, 0]
    assert sharp[16, 16] == 1
    assert blurred[16, 16] < 0.5
    # Some of the light of a pixel's full cone leaves the padded picture's own window.
    assert 0.9 < blurred.sum() <= 1 + 1e-12
    np.testing.assert_allclose(blurred, blurred[::-1, ::-1], atol=1e-12)


def test_options(scene):
    targets, masks = scene
    plain = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS)
    each = np.broadcast_to(masks[:, None], targets.shape)
    np.testing.assert_array_equal(incoherent_focal_stack_rgbd(targets, each, PLACES, DX, COLOURS), plain)
    for apertures in ([1.0, 1.0, 1.0], np.ones((24, 22)), [np.ones((24, 22)), 1.0, np.ones((24, 22))]):
        stack = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS, apertures=apertures)
        np.testing.assert_allclose(stack, plain, atol=1e-12)
    # One colour dimmed: its own aperture and no other's.
    dimmed = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS, apertures=[1.0, 0.5, 1.0], alpha=0.0)
    bright = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS, alpha=0.0)
    ratio = dimmed / bright
    np.testing.assert_allclose(ratio[:, 0], ratio[:, 2].mean(), rtol=1e-9)
    np.testing.assert_allclose(ratio[:, 1], ratio[:, 0].mean() / 2, rtol=1e-9)
    assert not incoherent_focal_stack_rgbd(0 * targets, masks, PLACES, DX, COLOURS).any()
    unpadded = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS, (False, False, False))
    assert unpadded.shape == targets.shape


def test_every_library_gives_the_same(scene, as_array):
    targets, masks = scene
    expected = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS)
    stack = incoherent_focal_stack_rgbd(as_array(targets), as_array(masks), PLACES, DX, COLOURS)
    assert type(stack) is type(as_array(targets))
    np.testing.assert_allclose(np.asarray(stack), expected, atol=1e-10)
    single = as_array(targets.astype(np.float32))
    stack = incoherent_focal_stack_rgbd(single, as_array(masks > 0), PLACES, DX, COLOURS)
    assert np.asarray(stack).dtype == np.float32
    np.testing.assert_allclose(np.asarray(stack), expected, atol=1e-5)


def test_gradients(scene, random):
    targets = torch.from_numpy(scene[0][:2, ..., :4, :3]).requires_grad_()
    # No two samples of a mask are equal, as the largest of several has no gradient.
    masks = torch.from_numpy(random.random((2, 4, 3))).requires_grad_()
    lengths = torch.tensor([1.0, 3.0], dtype=torch.float64, requires_grad=True)
    alpha = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)

    def stack(light, cover, places, hold):
        return torch_face(light + 0.1, cover + 0.1, 1e-3 * places, DX, torch.tensor(COLOURS), alpha=hold)

    assert torch.autograd.gradcheck(stack, (targets, masks, lengths, alpha), atol=1e-6, fast_mode=True)
    assert torch_face is odak.learn.wave.incoherent_propagation.incoherent_focal_stack_rgbd


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"targets": np.ones((3, 12, 11))}, ValueError, r"targets must be \[P, C, m, n\]"),
        ({"targets": [[1.0]]}, TypeError, "targets must be an array"),
        ({"targets": np.ones((3, 3, 12, 11), complex)}, TypeError, "targets must be real"),
        ({"masks": np.ones((2, 12, 11))}, ValueError, r"masks must be \[P, m, n\] or"),
        ({"distances": [0.0, 1e-3]}, ValueError, "distances must hold 3 numbers"),
        ({"wavelengths": COLOURS[:2]}, ValueError, "wavelengths must hold 3 numbers"),
        ({"wavelengths": [639e-9, 515e-9, -1.0]}, ValueError, "wavelengths must be positive"),
        ({"apertures": [1.0, 1.0]}, ValueError, "apertures must be one or 3"),
        ({"apertures": np.ones((12, 11))}, ValueError, "apertures must be numbers or shaped like"),
        ({"alpha": 1.5}, ValueError, "alpha must be between 0 and 1, got 1.5"),
        ({"dx": 0.0}, ValueError, "dx must be positive"),
    ],
)
def test_refused(scene, change, kind, message):
    arguments = {"targets": scene[0], "masks": scene[1], "distances": PLACES, "dx": DX, "wavelengths": COLOURS}
    with pytest.raises(kind, match=message):
        incoherent_focal_stack_rgbd(**(arguments | change))
