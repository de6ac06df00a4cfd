"""Incoherent imaging against closed forms: pupils and their transfer functions; scenes made of planes."""

import numpy as np
import pytest
import scipy.special
import torch
from physics import coordinates

import odak
from odak.learn.perception import slice_rgbd_targets
from odak.learn.wave import incoherent_focal_stack_rgbd as torch_face
from odak.wave import (
    incoherent_focal_stack_rgbd,
    modulation_transfer_function,
    optical_transfer_function,
    point_spread_function,
    propagate_beam,
    pupil_function,
)

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
            for k in (2, 1, 0):
                light, cover = (spread(v, PLACES[n] - PLACES[k], wavelength) for v in (targets[k, c], masks[k]))
                expected[n, c] += light * clear
                clear = clear * (1 - alpha * cover)
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
    masks[0], masks[1, :, :6] = 1.0, 3.0
    # Planes are given furthest first.
    front = targets[:2].copy()
    front[1] *= masks[1] > 0
    stack = incoherent_focal_stack_rgbd(front, masks, [1e-3, 1e-3], DX, COLOURS, alpha=1.0)
    seen = np.where(masks[1] > 0, front[1], front[0])
    np.testing.assert_allclose(stack[0], seen / seen.max(), atol=1e-12)
    # Half opaque, half of it comes through; without masks planes add up.
    half = incoherent_focal_stack_rgbd(front, masks, [1e-3, 1e-3], DX, COLOURS, alpha=0.5)
    seen = front[1] + front[0] * np.where(masks[1] > 0, 0.5, 1.0)
    np.testing.assert_allclose(half[1], seen / seen.max(), atol=1e-12)
    bare = incoherent_focal_stack_rgbd(front, 0 * masks, [1e-3, 1e-3], DX, COLOURS, alpha=1.0)
    np.testing.assert_allclose(bare[0], (front[0] + front[1]) / (front[0] + front[1]).max(), atol=1e-12)


def test_a_defocused_occluder_holds_back_as_much_as_it_covers():
    targets, masks = np.zeros((2, 1, 64, 64)), np.zeros((2, 64, 64))
    targets[0] = 1
    masks[0], masks[1, 32, 32] = 1, 1
    places, colour = [2e-3, 0.0], 515e-9
    covered = incoherent_focal_stack_rgbd(targets, masks, places, DX, colour, alpha=1.0)
    bare = incoherent_focal_stack_rgbd(targets, 0 * masks, places, DX, colour)
    # The blur neither adds nor takes light, so that one opaque pixel holds back that of one pixel, sharp or not.
    for held_back in (bare - covered).sum((1, 2, 3)):
        assert 0.9 < held_back < 1.1


def test_slice_edges_are_the_positions_of_planes(scene):
    targets, masks = scene
    plain = incoherent_focal_stack_rgbd(targets, masks, PLACES, DX, COLOURS)
    edges = incoherent_focal_stack_rgbd(targets, masks, [*PLACES, 9e-3], DX, COLOURS)
    np.testing.assert_array_equal(edges, plain)
    slices, covers = slice_rgbd_targets(torch.ones(3, 4, 4), torch.linspace(0, 1, 16).reshape(4, 4), [0.0, 0.5, 1.0])
    assert torch_face(slices, covers, [0.0, 1e-3, 2e-3], DX, COLOURS).shape == (2, 3, 4, 4)
    with pytest.raises(ValueError, match="distances must contain 3 or 4 numbers"):
        incoherent_focal_stack_rgbd(targets, masks, [*PLACES, 1.0, 2.0], DX, COLOURS)


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
    # A pupil of one colour blurs that colour alone, and keeps its light.
    pupil = disc((24, 22), DX, 0.2 / DX)
    blurred = incoherent_focal_stack_rgbd(
        targets, masks, PLACES, DX, COLOURS, apertures=[1.0, pupil, 1.0], alpha=0.0, zero_padding=(True, False, False)
    )
    sharp = incoherent_focal_stack_rgbd(
        targets, masks, PLACES, DX, COLOURS, alpha=0.0, zero_padding=(True, False, False)
    )
    scale = sharp[:, 0].max() / blurred[:, 0].max()
    np.testing.assert_allclose(blurred[:, [0, 2]] * scale, sharp[:, [0, 2]], atol=1e-12)
    np.testing.assert_allclose((blurred * scale).sum((-2, -1)), sharp.sum((-2, -1)), rtol=1e-9)
    assert np.abs(blurred[:, 1] * scale - sharp[:, 1]).max() > 0.1
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
    assert torch_face is odak.learn.wave.incoherent_focal_stack_rgbd


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"targets": np.ones((3, 12, 11))}, ValueError, r"targets must be \[P, C, m, n\]"),
        ({"targets": [[1.0]]}, TypeError, "targets must be an array"),
        ({"targets": np.ones((3, 3, 12, 11), complex)}, TypeError, "targets must be real"),
        ({"masks": np.ones((2, 12, 11))}, ValueError, r"masks must be \[P, m, n\] or"),
        ({"distances": [0.0, 1e-3]}, ValueError, "distances must contain 3 or 4 numbers"),
        ({"wavelengths": COLOURS[:2]}, ValueError, "wavelengths must contain 3 numbers"),
        ({"wavelengths": [639e-9, 515e-9, -1.0]}, ValueError, "wavelengths must be positive"),
        ({"apertures": [1.0, 1.0]}, ValueError, "apertures must be one or 3"),
        ({"apertures": np.ones((12, 11))}, ValueError, "apertures must be numbers or shaped like"),
        ({"alpha": 1.5}, ValueError, "alpha must be between 0 and 1, got 1.5"),
    ],
)
def test_refused(scene, change, kind, message):
    arguments = {"targets": scene[0], "masks": scene[1], "distances": PLACES, "dx": DX, "wavelengths": COLOURS}
    with pytest.raises(kind, match=message):
        incoherent_focal_stack_rgbd(**(arguments | change))


METHOD = "Incoherent Angular Spectrum"


def disc(shape, dx, radius):
    fy, fx = (np.fft.fftshift(np.fft.fftfreq(n, dx)) for n in shape)
    return (np.hypot(fy[:, None], fx) <= radius).astype(float)


@pytest.mark.parametrize("distance", [0.0, 2e-3, -2e-3])
def test_point_through_disc_keeps_its_energy_and_is_airy_pattern(distance):
    point = np.zeros((64, 64))
    point[32, 32] = 3.0
    pupil = disc((64, 64), DX, 1 / (8 * DX))
    image = propagate_beam(point, None, distance, DX, 532e-9, METHOD, aperture=pupil)
    assert image.sum() == pytest.approx(3.0, rel=1e-12)
    assert image.min() >= -1e-15
    if distance == 0:
        np.testing.assert_allclose(image, 3 * point_spread_function(pupil), atol=1e-15)
        r = np.hypot(*coordinates((64, 64), DX))
        v = np.where(r > 0, 2 * np.pi * r / (8 * DX), 1e-9)
        np.testing.assert_allclose(image / image.max(), (2 * scipy.special.j1(v) / v) ** 2, atol=0.02)


@pytest.mark.parametrize("shape", [(8, 9), (7, 6)])
def test_transfer_function_is_autocorrelation_of_kernel_pupil(shape, random):
    """The sum over all pairs of frequencies, written out."""
    pupil = random.normal(size=shape) + 1j * random.normal(size=shape)
    kernel = odak.wave.get_propagation_kernel(*shape, DX, 532e-9, 5e-4, "AS", dtype=np.complex128)
    coherent = np.fft.ifftshift(pupil * kernel)
    expected = np.zeros(shape, complex)
    for row in range(shape[0]):
        for column in range(shape[1]):
            expected[row, column] = (np.roll(coherent, (-row, -column), (0, 1)) * coherent.conj()).sum()
    expected /= expected[0, 0]
    found = np.fft.ifftshift(optical_transfer_function(pupil * kernel))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    light = random.random(shape)
    image = propagate_beam(light, None, 5e-4, DX, 532e-9, METHOD, aperture=pupil)
    np.testing.assert_allclose(image, np.fft.ifft2(np.fft.fft2(light) * expected).real, atol=1e-12)
    assert image.min() >= 0


@pytest.mark.parametrize("n", [256, 512])
def test_a_round_lens_has_the_closed_forms(n):
    """Modulation transfer after Goodman (2005), eq. 6-31; Airy pattern; Strehl ratio exp(−σ²)."""
    dx, wavelength, aperture = 1e-6, 500e-9, 500e-9 / 8e-6
    pupil = pupil_function((n, n), dx, wavelength, aperture)
    relative = np.clip(np.abs(np.arange(n) - n // 2) / (n * dx) * wavelength / (2 * aperture), 0, 1)
    expected = 2 / np.pi * (np.arccos(relative) - relative * np.sqrt(1 - relative**2))
    # The rim of a sampled pupil is one sample wide, a share 1/(3·radius) of its area.
    np.testing.assert_allclose(modulation_transfer_function(pupil)[n // 2], expected, atol=0.4 / (n / 8))
    spread = point_spread_function(pupil)
    assert spread.sum() == pytest.approx(1) and spread.min() >= 0
    v = 2 * np.pi * aperture / wavelength * (np.arange(n) - n // 2) * dx
    v[n // 2] = 1e-9
    np.testing.assert_allclose(spread[n // 2] / spread.max(), (2 * scipy.special.j1(v) / v) ** 2, atol=1e-4)
    for mode in ((2, 0), (3, 1), (4, -2)):
        aberrated = point_spread_function(pupil_function((n, n), dx, wavelength, aperture, {mode: 0.2}))
        centre = aberrated[n // 2, n // 2] / spread.max()
        assert centre == pytest.approx(np.exp(-(0.2**2)), abs=2e-3)


def test_an_obscured_pupil_on_rectangular_pixels():
    pupil = pupil_function((200, 100), (1e-6, 2e-6), 500e-9, 0.05, obscuration=0.5)
    transmitted = (np.abs(pupil) > 0.5).sum() * 1 / (200e-6 * 200e-6)
    assert transmitted == pytest.approx(np.pi * (0.05 / 500e-9) ** 2 * 0.75, rel=0.03)
    assert pupil[100, 50] == 0


def test_faces_and_gradients_of_a_pupil():
    arguments = ((24, 22), 1e-6, 550e-9)
    expected = pupil_function(*arguments, 0.12, {(2, 0): 0.3, (3, -1): 0.2})
    assert pupil_function(*arguments, np.array([0.1, 0.12])).shape == (2, 24, 22)

    def spread(aperture, focus):
        face = odak.learn.wave.pupil_function(*arguments, aperture, {(2, 0): focus, (3, -1): 0.2})
        return odak.learn.wave.point_spread_function(face)

    values = tuple(torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.12, 0.3))
    found = spread(*values).detach().numpy()
    np.testing.assert_allclose(found, point_spread_function(expected), atol=1e-15)
    assert torch.autograd.gradcheck(spread, values, fast_mode=True)
    single = odak.learn.wave.pupil_function(*arguments, 0.12, dtype=torch.float32)
    assert single.dtype == torch.complex64
    with pytest.raises(TypeError, match="aberrations must be a mapping"):
        pupil_function(*arguments, 0.1, [0.3])
    with pytest.raises(ValueError, match="numerical_aperture must be positive"):
        pupil_function(*arguments, -0.1)


def test_pupils_that_cannot_be(as_array):
    with pytest.warns(
        odak.SamplingWarning, match=r"numerical_aperture of 0\.5 .* end at 0\.133: give a dx of at most 5\.32e-07"
    ):
        pupil_function((32, 32), (1e-6, 2e-6), 532e-9, as_array(np.asarray([0.1, 0.5])))
    for share in (-0.1, 1.2):
        with pytest.raises(ValueError, match="obscuration must be within 0 … 1"):
            pupil_function((32, 32), 1e-6, 532e-9, 0.2, obscuration=as_array(np.asarray(share)))
