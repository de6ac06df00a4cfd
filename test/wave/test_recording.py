"""Recorded holograms against the fields that they were made of, closed forms and the formula of N steps."""

import math
import sys

import numpy as np
import pytest
import torch

from odak import SamplingWarning, wave
from odak.learn import wave as learned

SHAPE, PITCH, WAVELENGTH = (72, 96), (3e-6, 2e-6), 532e-9


def limited_field(radius, seed=0):
    """Return a random field whose frequencies are at most `radius` in cycles per metre."""
    draw = np.random.default_rng(seed)
    fy, fx = (np.fft.fftfreq(n, step) for n, step in zip(SHAPE, PITCH, strict=True))
    spectrum = draw.normal(size=(*SHAPE, 2)) @ [1, 1j] * (fy[:, None] ** 2 + fx**2 <= radius**2)
    return np.fft.ifft2(spectrum) * 30


def periodic_reference(periods, amplitude=2.0):
    """Return a reference with whole periods across the camera, and its frequency in cycles per metre."""
    frequency = [k / (n * step) for k, n, step in zip(periods, SHAPE, PITCH, strict=True)]
    angles = [math.degrees(math.asin(f * WAVELENGTH)) for f in frequency]
    return wave.reference_wave(SHAPE, PITCH, WAVELENGTH, angles, amplitude), math.hypot(*frequency)


def test_reference_is_a_plane_wave():
    reference, _ = periodic_reference((5, -7), 0.5)
    k, l = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]  # noqa: E741
    expected = np.exp(2j * np.pi * (5 * (k - 36) / SHAPE[0] - 7 * (l - 48) / SHAPE[1])) / 2
    np.testing.assert_allclose(reference, expected, atol=1e-11)
    with pytest.warns(SamplingWarning, match="reference_wave is .* beyond Nyquist"):
        wave.reference_wave(SHAPE, PITCH, WAVELENGTH, (0.0, 9.0))


def test_off_axis_field_is_exact_where_the_orders_are_apart():
    reference, carrier = periodic_reference((18, 24))
    field = limited_field(0.99 * carrier / 3)
    found = wave.off_axis_field(wave.recorded_intensity(field, reference), reference, PITCH)
    np.testing.assert_allclose(found, field, atol=1e-10)
    # Twice the band overlaps the light of the object with itself.
    wide = limited_field(0.66 * carrier)
    recorded = wave.recorded_intensity(wide, reference)
    with pytest.warns(SamplingWarning, match="the field's band is wider"):
        wave.off_axis_field(recorded, reference, PITCH)
    with pytest.warns(SamplingWarning, match="or overlaps the light of the object"):
        found = wave.off_axis_field(recorded, reference, PITCH, 0.66 * carrier)
    assert np.linalg.norm(found - wide) > 0.02 * np.linalg.norm(wide)


def test_phase_shifting_field_is_exact_for_any_steps():
    field, reference = limited_field(math.inf), periodic_reference((3, 0))[0]
    for steps in ((0.0, 0.7, 2.9), tuple(np.arange(5) * 2 * np.pi / 5), (0.1, 1.0, 2.0, 4.0, 5.0)):
        recorded = wave.recorded_intensity(field, reference, steps)
        assert recorded.shape == (len(steps), *SHAPE)
        np.testing.assert_allclose(wave.phase_shifting_field(recorded, reference, steps), field, atol=1e-12)
    steps = np.arange(4) * np.pi / 2
    recorded = wave.recorded_intensity(field, reference, steps)
    by_formula = ((recorded[0] - recorded[2]) + 1j * (recorded[1] - recorded[3])) / (4 * reference.conj())
    np.testing.assert_allclose(wave.phase_shifting_field(recorded, reference, steps), by_formula, atol=1e-12)


def test_noise_of_more_steps_averages():
    field, reference, draw = limited_field(math.inf), periodic_reference((3, 0))[0], np.random.default_rng(1)
    errors = []
    for count in (3, 12):
        steps = np.arange(count) * 2 * np.pi / count
        recorded = wave.recorded_intensity(field, reference, steps)
        found = wave.phase_shifting_field(recorded + 0.01 * draw.normal(size=recorded.shape), reference, steps)
        errors.append(np.sqrt(np.mean(np.abs(found - field) ** 2)))
    # The variance of (b + ic)/2 is σ²/N, and |r| = 2.
    np.testing.assert_allclose(errors, 0.01 / 2 / np.sqrt([3, 12]), rtol=0.03)


def test_a_recorded_object_is_refocused():
    """A slit recorded out of focus, found again by propagation back."""
    n, pitch, distance = 128, 4e-6, 6e-3
    slit = np.zeros((n, n))
    slit[44:84, 60:68] = 1
    there = wave.propagate_beam(slit + 0j, None, distance, pitch, WAVELENGTH, "Angular Spectrum")
    steps = (0.0, 2.1, 4.2)
    reference = wave.reference_wave((n, n), pitch, WAVELENGTH, (0.5, 1.0))
    found = wave.phase_shifting_field(wave.recorded_intensity(there, reference, steps), reference, steps)
    back = wave.propagate_beam(found, None, -distance, pitch, WAVELENGTH, "Angular Spectrum")
    again = wave.propagate_beam(there, None, -distance, pitch, WAVELENGTH, "Angular Spectrum")
    np.testing.assert_allclose(back, again, atol=1e-12)
    assert np.abs(back)[44:84, 60:68].mean() > 0.9 and np.abs(back)[:, :40].max() < 0.2


def test_faces_agree_and_precision_follows():
    reference, carrier = periodic_reference((18, 24))
    field = limited_field(carrier / 4)
    angles = [math.degrees(math.asin(k / (n * s) * WAVELENGTH)) for k, n, s in zip((18, 24), SHAPE, PITCH, strict=True)]
    twin = learned.reference_wave(SHAPE, PITCH, WAVELENGTH, angles, 2.0, dtype=torch.float64)
    np.testing.assert_allclose(twin.numpy(), reference, atol=1e-12)
    assert learned.reference_wave(SHAPE, PITCH, WAVELENGTH, angles).dtype == torch.complex64
    tensor, steps = torch.from_numpy(field), (0.0, 1.0, 3.0)
    for recorded, find in (
        (wave.recorded_intensity(field, reference), lambda i, r: wave.off_axis_field(i, r, PITCH)),
        (wave.recorded_intensity(field, reference, steps), lambda i, r: wave.phase_shifting_field(i, r, steps)),
    ):
        own = learned.recorded_intensity(tensor, twin, None if recorded.ndim == 2 else steps)
        np.testing.assert_allclose(own.numpy(), recorded, atol=1e-12)
        np.testing.assert_allclose(find(own, twin).numpy(), find(recorded, reference), atol=1e-12)
        assert find(own.float(), twin.to(torch.complex64)).dtype == torch.complex64


def test_slopes():
    draw = torch.Generator().manual_seed(0)
    field = torch.randn(4, 5, dtype=torch.complex128, generator=draw, requires_grad=True)
    angles = torch.tensor([2.0, 5.0], dtype=torch.float64, requires_grad=True)
    steps = torch.tensor([0.0, 1.0, 2.5], dtype=torch.float64, requires_grad=True)

    def found(field, angles, steps):
        reference = learned.reference_wave((4, 5), 2e-6, WAVELENGTH, angles)
        one = learned.off_axis_field(learned.recorded_intensity(field, reference), reference, 2e-6, 1e5)
        return one, learned.phase_shifting_field(
            learned.recorded_intensity(field, reference, steps), reference, steps * 2
        )

    assert torch.autograd.gradcheck(found, (field, angles, steps), fast_mode=True)

    def found_from_lists(field, angles, steps):
        return found(field, (angles[0], 5.0), steps)[1], learned.recorded_intensity(field, field, (0.0, steps[1]))

    assert torch.autograd.gradcheck(found_from_lists, (field, angles, steps), fast_mode=True)


def test_unwrapping_gives_back_a_smooth_phase():
    pytest.importorskip("skimage")
    y, x = np.mgrid[-1:1:60j, -1:1:70j]
    phase = 25 * (x**2 - 0.6 * y**2) + 3 * x
    wrapped = np.angle(np.exp(1j * phase))
    found = wave.unwrap_phase(wrapped)
    np.testing.assert_allclose(found - found.mean(), phase - phase.mean(), atol=1e-9)
    np.testing.assert_allclose((found - wrapped) / (2 * np.pi), np.rint((found - wrapped) / (2 * np.pi)), atol=1e-9)
    assert abs(found.mean()) <= np.pi
    mask = x**2 + y**2 < 0.8
    noisy = np.where(mask, wrapped, np.random.default_rng(0).uniform(-3, 3, wrapped.shape))
    part = wave.unwrap_phase(noisy, mask)
    np.testing.assert_allclose((part - phase)[mask] - (part - phase)[mask].mean(), 0, atol=1e-9)
    np.testing.assert_array_equal(part[~mask], noisy[~mask])
    tensor = torch.from_numpy(wrapped).requires_grad_()
    twin = learned.unwrap_phase(tensor)
    np.testing.assert_allclose(twin.detach().numpy(), found, atol=1e-12)
    assert torch.equal(torch.autograd.grad(twin.sum(), tensor)[0], torch.ones_like(tensor))


def test_unwrapping_without_its_package_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.restoration", None)
    with pytest.raises(ImportError, match="pip install scikit-image"):
        wave.unwrap_phase(np.zeros((4, 4)))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda r: wave.off_axis_field(np.ones(SHAPE), np.ones(SHAPE), PITCH), ValueError, "bandwidth must be given"),
        (lambda r: wave.off_axis_field(np.ones((4, 4)), r, PITCH), ValueError, "reference must be .* with the rows"),
        (lambda r: wave.phase_shifting_field(np.ones((2, *SHAPE)), r, (0, 1)), ValueError, "phase_steps must be three"),
        (lambda r: wave.phase_shifting_field(np.ones((3, *SHAPE)), r, (0, 0, 1)), ValueError, "phase_steps must be th"),
        (lambda r: wave.phase_shifting_field(np.ones((2, *SHAPE)), r, (0, 1, 2)), ValueError, "holograms must be"),
        (lambda r: wave.reference_wave(SHAPE, PITCH, WAVELENGTH, (1.0,)), ValueError, "angles"),
        (lambda r: wave.unwrap_phase(np.ones((2, *SHAPE))), ValueError, "phase must be"),
    ],
)
def test_bad_arguments_are_named(call, error, message):
    with pytest.raises(error, match=message):
        call(periodic_reference((18, 24))[0])


def test_phases_that_are_integers_are_unwrapped():
    turns = np.asarray([[0, 3, 6, 2], [1, 4, 0, 3]], np.uint8)
    np.testing.assert_allclose(wave.unwrap_phase(turns), wave.unwrap_phase(turns.astype(float)), rtol=1e-6)
