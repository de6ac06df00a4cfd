"""What callers may pass to propagate_beam, and what they get back."""

import warnings
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from physics import coordinates, gaussian_beam, relative_error, unwrapped_propagation

import odak
from odak.learn import wave as torch_wave
from odak.tools.matrix import crop_center, zero_pad
from odak.wave.methods import METHODS

WAVELENGTH, DX, DISTANCE = 532e-9, 8e-6, 2e-3
NAMES = [method.name for method in METHODS if method.name != "custom"]
SPECTRAL = ["Angular Spectrum", "Bandlimited Angular Spectrum", "Transfer Function Fresnel", "Impulse Response Fresnel"]


def propagate(field, method="Angular Spectrum", **options):
    return odak.wave.propagate_beam(field, None, DISTANCE, DX, WAVELENGTH, method, **options)


@pytest.fixture
def field(random):
    return random.normal(size=(12, 15)) + 1j * random.normal(size=(12, 15))


@pytest.mark.parametrize("method", SPECTRAL)
@pytest.mark.parametrize("shape", [(12, 15), (11, 14)])
def test_padding_and_cropping_are_what_they_say(method, shape, random):
    field = random.normal(size=shape) + 1j * random.normal(size=shape)
    wide = propagate(zero_pad(field), method)
    np.testing.assert_allclose(propagate(field, method, zero_padding=(True, False, False)), wide, atol=1e-12)
    np.testing.assert_allclose(
        propagate(field, method, zero_padding=(True, False, True)), crop_center(wide, shape), atol=1e-12
    )
    np.testing.assert_allclose(
        propagate(field, method, zero_padding=(False, False, True)), crop_center(propagate(field, method)), atol=1e-12
    )


@pytest.mark.parametrize("method", [name for name in NAMES if not name.startswith("Fraunhofer")])
def test_spectrum_padding_halves_the_pitch(method, field):
    coarse = propagate(field, method, zero_padding=(True, False, True))
    fine = propagate(field, method, zero_padding=(True, True, True))
    assert fine.shape == (24, 30)
    # Same centre (n // 2), same values at the samples that both have.
    rows = np.arange(12) * 2 + 24 // 2 - 2 * (12 // 2)
    columns = np.arange(15) * 2 + 30 // 2 - 2 * (15 // 2)
    # Windows of two sizes are summed by two rules, each within its tolerance.
    bound = 1e-4 * np.abs(coarse).max() if method in ("Linear Angular Spectrum", "auto") else 1e-9
    np.testing.assert_allclose(np.abs(fine[np.ix_(rows, columns)] - coarse).max(), 0, atol=bound)


def test_spectrum_padding_interpolates_between_samples(field):
    """Against the sum of the plane waves of the coarse result at each sample of the fine one."""
    coarse, fine = (propagate(field, zero_padding=(True, halved, False)) for halved in (False, True))

    def interpolation(n):
        places, samples, waves = (np.arange(2 * n) - n) / 2, np.arange(n) - n // 2, np.arange(n) - n // 2
        return np.exp(2j * np.pi / n * waves * (places[:, None] - samples)[..., None]).mean(-1)

    down, across = map(interpolation, coarse.shape)
    np.testing.assert_allclose(fine, down @ coarse @ across.T, atol=1e-12)


def test_lengths_that_do_not_fit_together_are_named(field):
    lengths = np.full(3, DISTANCE), DX, np.full(2, WAVELENGTH)
    with pytest.raises(ValueError, match=r"broadcast together: field \[\], distance \[3\].* wavelength \[2\]"):
        odak.wave.propagate_beam(field, None, *lengths, "Angular Spectrum")


def test_spectrum_padding_leaves_fraunhofer_alone(field):
    np.testing.assert_array_equal(
        propagate(field, "Fraunhofer", zero_padding=(False, True, False)), propagate(field, "Fraunhofer")
    )


def test_aperture_is_applied_once_and_centred(field):
    mask = np.zeros((12, 15))
    mask[6, 7] = 0.5
    result = propagate(field, aperture=mask)
    mean = field.mean() * np.exp(2j * np.pi * (DISTANCE / WAVELENGTH % 1))
    np.testing.assert_allclose(result, 0.5 * mean * np.ones((12, 15)), atol=1e-9)
    np.testing.assert_allclose(propagate(field, aperture=0.5), 0.5 * propagate(field), atol=1e-12)
    with pytest.raises(ValueError, match=r"aperture .*\(12, 15\).*\(5, 5\)"):
        propagate(field, aperture=np.ones((5, 5)))


def test_custom_kernel_is_centred(field):
    kernel = odak.wave.get_propagation_kernel(12, 15, DX, WAVELENGTH, DISTANCE, "AS", dtype=np.complex128)
    expected = propagate(field)
    np.testing.assert_allclose(odak.wave.custom(field, kernel), expected, atol=1e-12)
    np.testing.assert_allclose(propagate(field, "custom", kernel=kernel), expected, atol=1e-12)
    np.testing.assert_allclose(odak.wave.custom(field, None), field, atol=1e-12)
    padded = odak.wave.get_propagation_kernel(24, 30, DX, WAVELENGTH, DISTANCE, "AS", dtype=np.complex128)
    np.testing.assert_allclose(
        propagate(field, "custom", kernel=padded, zero_padding=(True, False, True)),
        propagate(field, zero_padding=(True, False, True)),
        atol=1e-12,
    )
    with pytest.raises(ValueError, match=r"kernel must be .* of the shape of the propagated field"):
        odak.wave.custom(field, kernel[:5])
    with pytest.raises(ValueError, match="kernel is for propagation_type 'custom'"):
        propagate(field, "AS", kernel=kernel)


@pytest.mark.parametrize("method", NAMES)
def test_batches_equal_loops(method, random):
    fields = random.normal(size=(2, 3, 8, 9)) + 1j * random.normal(size=(2, 3, 8, 9))
    result = propagate(fields, method, zero_padding=(True, False, True))
    for i in range(2):
        for j in range(3):
            np.testing.assert_allclose(
                result[i, j], propagate(fields[i, j], method, zero_padding=(True, False, True)), atol=1e-10
            )


@pytest.mark.parametrize("method", NAMES)
def test_wavelengths_per_channel_and_distances_per_plane(method, random):
    field = random.normal(size=(3, 8, 9)) + 1j * random.normal(size=(3, 8, 9))
    wavelengths, distances = np.array([638e-9, 520e-9, 450e-9]), np.array([1e-3, -2e-3])
    result = odak.wave.propagate_beam(field, None, distances[:, None], DX, wavelengths, method)
    assert result.shape == (2, 3, 8, 9)
    for i, distance in enumerate(distances):
        for j, wavelength in enumerate(wavelengths):
            one = odak.wave.propagate_beam(field[j], None, float(distance), DX, float(wavelength), method)
            np.testing.assert_allclose(result[i, j], one, atol=1e-10)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_precision_follows_the_input(method, dtype, field):
    result = propagate(field.astype(dtype), method)
    expected = np.zeros(0, dtype).real.dtype if method.startswith("Incoherent") else dtype
    assert result.dtype == expected
    assert relative_error(result, propagate(field, method)) < (3e-6 if dtype == np.complex64 else 1e-12)


def test_real_and_integer_fields_are_fields_of_phase_zero():
    ones = np.ones((6, 6))
    np.testing.assert_allclose(propagate(ones), propagate(ones + 0j))
    np.testing.assert_allclose(propagate(ones.astype(np.int64)), propagate(ones + 0j))
    assert propagate(ones.astype(np.float32)).dtype == np.complex64


def test_input_is_not_modified(field):
    kept = field.copy()
    field.setflags(write=False)
    for method in NAMES:
        propagate(field, method, zero_padding=(True, True, True))
    np.testing.assert_array_equal(field, kept)


@pytest.mark.parametrize(
    ("alias", "name"),
    [
        ("TR Fresnel", "Transfer Function Fresnel"),
        ("tf fresnel", "Transfer Function Fresnel"),
        ("IR Fresnel", "Impulse Response Fresnel"),
        ("bandlimited angular spectrum", "Bandlimited Angular Spectrum"),
        ("AS", "Angular Spectrum"),
        ("ASAS", "Adaptive Sampling Angular Spectrum"),
        ("rs", "Rayleigh-Sommerfeld"),
    ],
)
def test_aliases_in_any_case(alias, name, field):
    np.testing.assert_array_equal(propagate(field, alias), propagate(field, name))


def test_named_functions_are_the_methods(field):
    for function, name in (
        (odak.wave.angular_spectrum, "AS"),
        (odak.wave.band_limited_angular_spectrum, "BLAS"),
        (odak.wave.transfer_function_fresnel, "TR Fresnel"),
        (odak.wave.impulse_response_fresnel, "IR Fresnel"),
        (odak.wave.seperable_impulse_response_fresnel, "IR Fresnel"),
        (odak.wave.band_extended_angular_spectrum, "BEAS"),
        (odak.wave.adaptive_sampling_angular_spectrum, "ASAS"),
        (odak.wave.rayleigh_sommerfeld, "RS"),
        (odak.wave.fraunhofer, "Fraunhofer"),
        (odak.wave.incoherent_angular_spectrum, "Incoherent Angular Spectrum"),
    ):
        np.testing.assert_array_equal(
            function(field, 2 * np.pi / WAVELENGTH, DISTANCE, DX, WAVELENGTH), propagate(field, name)
        )


def test_zero_distance_returns_the_field(field):
    for method in ("AS", "BLAS", "TR Fresnel", "RS", "BEAS", "ASAS", "auto"):
        np.testing.assert_allclose(odak.wave.propagate_beam(field, None, 0, DX, WAVELENGTH, method), field, atol=1e-12)
    for method in ("IR Fresnel", "Fraunhofer", "Seperable Impulse Response Fresnel"):
        with pytest.raises(ValueError, match="distance must not be zero"):
            odak.wave.propagate_beam(field, None, 0.0, DX, WAVELENGTH, method)


def test_scale_puts_samples_between_pixels():
    shape, distance = (128, 128), 0.1
    field = gaussian_beam(shape, DX, 1.5e-4, 0.0, WAVELENGTH)
    fine = odak.wave.impulse_response_fresnel(field, None, distance, DX, WAVELENGTH, scale=2)
    assert fine.shape == (256, 256)
    expected = gaussian_beam((256, 256), DX / 2, 1.5e-4, distance, WAVELENGTH)
    inner = np.s_[64:192, 64:192]
    assert relative_error(fine[inner], expected[inner]) < 1e-2
    with pytest.raises(ValueError, match="scale is for the impulse-response methods"):
        propagate(field, "AS", scale=2)


def test_averaging_over_a_pixel_is_a_mean_of_shifted_beams():
    field = np.zeros((64, 64), complex)
    field[32, 32] = 1
    distance = 0.05
    averaged = odak.wave.impulse_response_fresnel(field, None, distance, DX, WAVELENGTH, samples=(1, 40, 1, 1))
    x = (np.arange(64) - 32) * DX
    # A row of points across the pixel is a sinc envelope far away (Fraunhofer of the pixel).
    point = odak.wave.impulse_response_fresnel(field, None, distance, DX, WAVELENGTH)
    envelope = np.sinc(DX * x / (WAVELENGTH * distance))
    np.testing.assert_allclose(np.abs(averaged[32] / point[32]), np.abs(envelope), atol=0.01)


@settings(max_examples=25)
@given(
    rows=st.integers(1, 12),
    columns=st.integers(1, 12),
    batch=st.lists(st.integers(1, 3), max_size=2),
    flags=st.tuples(st.booleans(), st.booleans(), st.booleans()),
    method=st.sampled_from(NAMES),
)
def test_shapes(rows, columns, batch, flags, method):
    field = np.ones((*batch, rows, columns), dtype=np.complex64)
    pad, fine, crop = flags
    if crop and not pad and min(rows, columns) == 1:
        return
    result = propagate(field, method, zero_padding=flags)
    factor = (2 if pad else 1) * (2 if fine and not method.startswith("Fraunhofer") else 1)
    expected = [factor * n // 2 if crop else factor * n for n in (rows, columns)]
    assert result.shape == (*batch, *expected)


def test_auto_follows_the_criteria(field, logged):
    near = propagate(field, "auto")
    assert "chose Linear Angular Spectrum: its error is at most" in logged.text
    assert near.shape == field.shape
    wide = gaussian_beam((256, 256), DX, 3e-4, 0.0, WAVELENGTH)
    # A pitch below half a wavelength samples all propagating waves: the sampled kernel is exact.
    for distance, pitch, name in ((5e-3, DX, "Linear Angular Spectrum"), (1e-4, 0.25e-6, "Rayleigh-Sommerfeld")):
        logged.records.clear()
        result = odak.wave.propagate_beam(wide, None, distance, pitch, WAVELENGTH, "auto")
        assert f"chose {name}" in logged.text
        np.testing.assert_array_equal(result, odak.wave.propagate_beam(wide, None, distance, pitch, WAVELENGTH, name))


def test_a_warning_outside_the_range_names_the_better_method():
    field = np.ones((64, 64), complex)
    with pytest.warns(
        odak.SamplingWarning, match=r"^Angular Spectrum is outside its range.*Use Linear Angular Spectrum"
    ):
        odak.wave.propagate_beam(field, None, 0.5, DX, WAVELENGTH, "Angular Spectrum")
    with pytest.warns(odak.SamplingWarning, match=r"on a 64 x 64 grid \(dx = 8e-06 x 6e-06 m, "):
        odak.wave.propagate_beam(field, None, 0.5, (8e-6, 6e-6), WAVELENGTH, "Angular Spectrum")


def test_advice_on_intensities_is_not_a_method_of_fields():
    with pytest.warns(
        odak.SamplingWarning, match=r"Incoherent Angular Spectrum is outside .* more zeros; the other"
    ) as said:
        odak.wave.propagate_beam(np.ones((64, 64)), None, 0.5, DX, WAVELENGTH, "Incoherent Angular Spectrum")
    assert not any("Use " in str(one.message) for one in said)


def test_custom_without_a_kernel_says_that_it_does_not_propagate():
    field = np.ones((8, 8), complex)
    with pytest.warns(odak.ArgumentWarning, match="'custom' without a kernel ignores the distance"):
        odak.wave.propagate_beam(field, None, 1e-3, DX, WAVELENGTH, "custom")
    np.testing.assert_allclose(odak.wave.custom(field, None, aperture=0.5), 0.5 * field)


def test_warnings_are_shown_once_for_each_line_and_text():
    field = torch.ones(64, 64, dtype=torch.complex64)
    with warnings.catch_warnings(record=True) as caught:
        warnings.resetwarnings()
        for distance in (0.5, 0.5, 0.6):
            torch_wave.propagate_beam(field, None, distance, DX, WAVELENGTH, "Angular Spectrum")
    assert [warning.filename for warning in caught] == [__file__] * 2
    assert ["0.5 m" in str(warning.message) for warning in caught] == [True, False]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"field": [[1.0]]}, TypeError, "field must be an array"),
        ({"field": np.ones(5)}, ValueError, "field must have at least 2 axes"),
        ({"field": np.ones((0, 5))}, ValueError, "none empty"),
        ({"k": 1.0}, ValueError, "k must be 2π/wavelength"),
        ({"zero_padding": (True, False)}, ValueError, "zero_padding must be three booleans"),
        ({"samples": (1, 2)}, ValueError, "samples must be four counts"),
        ({"scale": 0}, ValueError, "scale must be at least 1"),
        ({"propagation_type": "Angular Spectrm"}, ValueError, "Did you mean 'Angular Spectrum'"),
    ],
)
def test_bad_arguments_are_named(change, error, message):
    arguments = {"field": np.ones((4, 4)), "k": None, "distance": 1e-3, "dx": DX, "wavelength": WAVELENGTH} | change
    arguments.setdefault("propagation_type", "AS")
    with pytest.raises(error, match=message):
        odak.wave.propagate_beam(**arguments)


def test_unknown_type_lists_the_known_ones():
    with pytest.raises(ValueError, match="Bandlimited Angular Spectrum") as caught:
        propagate(np.ones((4, 4)), "nonsense")
    for name in NAMES:
        assert repr(name) in str(caught.value)


def test_what_a_method_cannot_do_is_refused(field):
    for method in ("Fraunhofer", "ASAS"):
        with pytest.raises(ValueError, match="aperture needs a method with a transfer function"):
            propagate(field, method, aperture=np.ones((12, 15)))
    with pytest.raises(ValueError, match="scale is for the impulse-response methods only"):
        propagate(field, "RS", scale=2)


@pytest.mark.parametrize("zero", [0.0, np.float32(0), np.zeros(()), torch.zeros(())])
@pytest.mark.filterwarnings("error")
def test_no_distance_gives_the_field_back(field, zero):
    for method in ("RS", "AS", "BLAS", "TR Fresnel"):
        result = torch_wave.propagate_beam(
            torch.from_numpy(field), None, zero, DX, WAVELENGTH, method, zero_padding=[False] * 3
        )
        np.testing.assert_allclose(result.numpy(), field, atol=1e-14)


def test_planes_with_and_without_a_distance(field):
    pair = np.stack([field, field])
    result = odak.wave.propagate_beam(pair, None, [0.0, 4e-3], DX, WAVELENGTH, "RS")
    np.testing.assert_allclose(result[0], field, atol=1e-14)
    np.testing.assert_allclose(result[1], odak.wave.propagate_beam(field, None, 4e-3, DX, WAVELENGTH, "RS"), atol=1e-14)


@pytest.mark.parametrize("method", [name for name in NAMES if name != "auto"])
def test_a_pitch_for_each_field(field, method):
    pitches, options = np.array([8e-6, 5e-6]), {"samples": [3, 2, 4, 3]} if "Impulse" in method else {}
    pair = np.stack([field, field[::-1]])
    together = odak.wave.propagate_beam(pair, None, 0.02, pitches, WAVELENGTH, method, **options)
    for found, one, pitch in zip(together, pair, pitches, strict=True):
        alone = odak.wave.propagate_beam(one, None, 0.02, pitch, WAVELENGTH, method, **options)
        np.testing.assert_allclose(found, alone, atol=1e-12 * np.abs(alone).max())


def elliptical_beam(shape, pitch, waists=(60e-6, 40e-6)):
    y, x = coordinates(shape, 1.0)
    return np.exp(-((y * pitch[0] / waists[0]) ** 2) - (x * pitch[1] / waists[1]) ** 2) * np.exp(2e4j * x * pitch[1])


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("pad", [False, True])
def test_rectangular_pixels(method, pad):
    """Columns of twice the pitch: every second column of the result on square pixels, for a field that both hold."""
    pitch, distance = (4e-6, 8e-6), 0.1 if method.startswith("Fraunhofer") else 0.02
    options = {"zero_padding": (pad, False, pad)}
    coarse = elliptical_beam((256, 128), pitch)
    fine = elliptical_beam((256, 256), (4e-6, 4e-6))
    result = odak.wave.propagate_beam(coarse, None, distance, pitch, WAVELENGTH, method, **options)
    if method == "Fraunhofer Inverse":
        source = odak.wave.fraunhofer(coarse, None, distance, pitch, WAVELENGTH)
        back = odak.wave.fraunhofer_inverse(source, None, distance, pitch, WAVELENGTH)
        np.testing.assert_allclose(back, coarse, atol=1e-12)
    elif method != "Incoherent Angular Spectrum":
        # The band of an incoherent transfer function is that of the grid, so that it is another one on another grid.
        expected = odak.wave.propagate_beam(fine, None, distance, 4e-6, WAVELENGTH, method, **options)
        expected = expected[:, 64:192] if method == "Fraunhofer" else expected[:, ::2]
        # Without padding the tails of a sampled impulse response wrap around.
        wrapped = "Impulse" in method and not pad
        assert relative_error(result, expected) < (0.05 if wrapped else 1e-9)
    swapped = odak.wave.propagate_beam(coarse.T.copy(), None, distance, pitch[::-1], WAVELENGTH, method, **options)
    np.testing.assert_allclose(swapped.T, result, atol=1e-12 * np.abs(result).max())
    pair = torch.tensor(pitch, dtype=torch.float64, requires_grad=True)
    tensor = torch.from_numpy(coarse)
    found = torch_wave.propagate_beam(
        tensor, None, distance, [pair[0], pair[1]], WAVELENGTH, method, samples=(1,) * 4, **options
    )
    np.testing.assert_allclose(found.detach().numpy(), result, atol=1e-10 * np.abs(result).max())
    if method != "custom":
        found.abs().square().sum().backward()
        assert torch.isfinite(pair.grad).all()


TWO_PITCHES = np.array([4e-6, 5e-6])


@pytest.mark.parametrize("pitches", [TWO_PITCHES, torch.from_numpy(TWO_PITCHES), (TWO_PITCHES, 5e-6)])
def test_several_pitches_for_one_field_are_refused(field, pitches):
    with pytest.raises(ValueError, match=r"dx must be one number.*\(2,\).*leading axes \(\)"):
        odak.wave.propagate_beam(field, None, 0.02, pitches, WAVELENGTH, "AS")
    with pytest.raises(ValueError, match="dx must be one number"):
        odak.wave.propagate_to_window(field, WAVELENGTH, 0.02, pitches)


@pytest.mark.parametrize(
    ("k", "wavelength", "complaint"),
    [
        (2 * np.pi / 5e-7, [5e-7, 6e-7], "k must be 2π/wavelength = 10471975.5"),
        (2 * np.pi / np.array([5e-7, 6e-7]), 5e-7, "k must be 2π/wavelength = 12566370.6"),
        (2 * np.pi / np.array([5e-7, 6e-7, 7e-7]), [5e-7, 6e-7], "k must be one number or one for each of 2"),
    ],
)
def test_every_wave_number_is_compared(field, k, wavelength, complaint):
    with pytest.raises(ValueError, match=complaint):
        odak.wave.propagate_beam(np.stack([field] * 2), k, 1e-3, DX, wavelength, "AS")


@pytest.mark.parametrize(
    ("method", "shape", "distance", "reason"),
    [
        ("AS", (64, 64), 0.5, "from where its transfer function aliases"),
        ("BLAS", (64, 64), 0.5, "it keeps only 2% of the band"),
        ("IR Fresnel", (64, 64), 1e-3, "where its impulse response aliases"),
        ("RS", (64, 64), 1e-3, "where its impulse response aliases"),
        ("Fraunhofer", (64, 64), 0.1, "the far field is not reached"),
        ("TR Fresnel", (2048, 2048), 0.2, "the Fresnel approximation is off by up to"),
    ],
)
def test_a_warning_says_which_criterion_fails(method, shape, distance, reason):
    with pytest.warns(odak.SamplingWarning, match=reason):
        odak.wave.propagate_beam(np.ones(shape, np.complex64), None, distance, DX, WAVELENGTH, method)


@pytest.mark.filterwarnings("error")
def test_auto_takes_a_method_that_serves_every_distance():
    beam = gaussian_beam((64, 64), DX, 60e-6, 0.0, WAVELENGTH)
    distances = [1e-3, 0.15]
    together = odak.wave.propagate_beam(
        np.stack([beam, beam]), None, distances, DX, WAVELENGTH, "auto", zero_padding=[True, False, True]
    )
    for found, distance in zip(together, distances, strict=True):
        alone = odak.wave.propagate_beam(beam, None, distance, DX, WAVELENGTH, "auto", zero_padding=[True, False, True])
        assert relative_error(found, alone) < 1e-3


def test_no_field_at_all():
    with pytest.raises(ValueError, match="field must contain at least one field"):
        propagate(np.ones((0, 4, 4)))


@pytest.mark.parametrize("distances", [[2e-3], [-2e-3], [2e-3, 3e-3]])
def test_linear_kernels_of_several_distances_come_in_parts(distances, monkeypatch, random):
    monkeypatch.setattr(odak.wave.linear_kernels, "_SLAB", 200)
    field = torch.from_numpy(random.normal(size=(1, 24, 20)) + 1j * random.normal(size=(1, 24, 20)))
    lengths = (8e-6, 532e-9, "Linear Angular Spectrum")
    stack = torch_wave.propagate_beam(field, None, torch.tensor(distances, dtype=torch.float64), *lengths)
    for plane, distance in zip(stack, distances, strict=True):
        single = torch_wave.propagate_beam(field[0], None, distance, *lengths)
        assert relative_error(plane, single) < 1e-12


@pytest.mark.parametrize("kind", ["numpy", "torch", "gradient"])
def test_transfer_functions_of_large_grids_are_computed_in_parts(kind, monkeypatch, random):
    field = random.normal(size=(2, 13, 10)) + 1j * random.normal(size=(2, 13, 10))
    distance = np.array([2e-3, 3e-3])
    expected = odak.wave.propagate_beam(field, None, distance, 8e-6, 532e-9, "Angular Spectrum")
    monkeypatch.setattr(odak.wave.transfer_functions, "_SLAB", 16)
    odak.wave.clear_kernel_cache()
    if kind == "numpy":
        result = odak.wave.propagate_beam(field, None, distance, 8e-6, 532e-9, "Angular Spectrum")
    else:
        distance = torch.from_numpy(distance).requires_grad_(kind == "gradient")
        result = torch_wave.propagate_beam(
            torch.from_numpy(field), None, distance, 8e-6, 532e-9, "Angular Spectrum", zero_padding=(False,) * 3
        )
        assert result.requires_grad == distance.requires_grad
    odak.wave.clear_kernel_cache()
    result = result.detach() if kind == "gradient" else result
    assert relative_error(result, expected) < 1e-12


def test_without_a_method_both_faces_keep_the_tolerance(random):
    field, geometry = (
        np.exp(2j * np.pi * random.random((24, 31))),
        {"distance": 6e-3, "dx": DX, "wavelength": WAVELENGTH},
    )
    exact = unwrapped_propagation(field, **geometry)
    by_numpy = odak.wave.propagate_beam(field, **geometry)
    by_torch = torch_wave.propagate_beam(torch.from_numpy(field), **geometry).numpy()
    assert relative_error(by_numpy, exact) < 1e-3  # of the reference, whose window is finite
    np.testing.assert_allclose(by_torch, by_numpy, atol=1e-12)
    np.testing.assert_array_equal(by_numpy, odak.wave.propagate_beam(field, None, *geometry.values(), "auto"))


@pytest.mark.parametrize("face", [odak.wave, torch_wave])
def test_lengths_that_are_missing_are_named(face):
    field = torch.ones(4, 4) if face is torch_wave else np.ones((4, 4))
    with pytest.raises(TypeError, match="missing: dx, wavelength"):
        face.propagate_beam(field, distance=1e-3)


@pytest.mark.parametrize("axis", [-2, -1])
@pytest.mark.parametrize("distance", [1e-3, -0.05])
def test_fields_of_one_line_are_cylindrical_waves(axis, distance, random):
    """Against the angular spectrum of one dimension on a grid that nothing leaves; both faces."""
    n, dx, wavelength = 300, 2e-6, 532e-9
    line = np.exp(2j * np.pi * random.random(n)) * np.exp(-(((np.arange(n) - 150) / 60) ** 2))
    frequency = np.fft.fftfreq(1 << 16, dx)
    transfer = np.exp(2j * np.pi * distance * np.sqrt(1 / wavelength**2 - frequency**2))
    expected = np.fft.ifft(np.fft.fft(line, 1 << 16) * transfer)[:n]
    field = np.expand_dims(line, -3 - axis)
    found = odak.wave.propagate_beam(field, distance=distance, dx=dx, wavelength=wavelength, axes=axis)
    assert found.shape == field.shape
    assert np.linalg.norm(found.ravel() - expected) < 1e-4 * np.linalg.norm(expected)
    tensor = odak.learn.wave.propagate_beam(torch.as_tensor(field), None, distance, dx, wavelength, axes=(axis,))
    np.testing.assert_allclose(tensor, found, atol=1e-12)


def test_light_that_leaves_a_line_of_points_is_named():
    column = np.ones((200, 1), complex)
    with pytest.warns(odak.SamplingWarning, match="0.00.* of its power is left on the line; axes=-2"):
        odak.wave.propagate_beam(column, None, 1e-3, 1e-6, 532e-9, "auto", zero_padding=(True, False, True))
    with pytest.raises(ValueError, match="must have one row for axes=-1"):
        odak.wave.propagate_beam(column, None, 1e-3, 1e-6, 532e-9, axes=-1)
    with pytest.raises(ValueError, match="axes must be -2"):
        odak.wave.propagate_beam(column, None, 1e-3, 1e-6, 532e-9, axes=0)


def test_lengths_on_a_gpu_are_not_read(field, monkeypatch):
    expected = torch_wave.propagate_beam(torch.from_numpy(field), None, DISTANCE, DX, WAVELENGTH).numpy()

    def read(value):
        raise AssertionError("a GPU was waited for")

    # As on a GPU: the distance cannot be read without waiting.
    monkeypatch.setattr(odak._array, "is_readable", lambda value: not isinstance(value, torch.Tensor))
    monkeypatch.setattr(odak._array, "numbers_behind", read)
    distance = torch.tensor([DISTANCE, 2 * DISTANCE], dtype=torch.float64)
    both = torch_wave.propagate_beam(torch.from_numpy(np.stack([field] * 2)), None, distance, DX, WAVELENGTH)
    # By one fixed rule instead of one within 1e-4.
    assert relative_error(both[0].numpy(), expected) < 5e-3


@pytest.mark.parametrize(
    ("propagate", "take"), [(odak.wave.propagate_beam, np.asarray), (torch_wave.propagate_beam, torch.from_numpy)]
)
class TestOlderCalls:
    """Call forms of published scripts."""

    PLAIN = (False, False, False)

    def test_a_kernel_of_ones_own_needs_no_lengths(self, propagate, take, field, random):
        kernel = random.normal(size=field.shape) + 1j * random.normal(size=field.shape)
        expected = np.fft.ifft2(np.fft.ifftshift(kernel) * np.fft.fft2(field))
        for lengths in ([None] * 4, [2 * np.pi / WAVELENGTH, None, None, None], [None, DISTANCE, None, WAVELENGTH]):
            found = propagate(
                take(field), *lengths, propagation_type="custom", kernel=take(kernel), zero_padding=self.PLAIN
            )
            np.testing.assert_allclose(np.asarray(found), expected, atol=1e-12)
        with pytest.raises(TypeError, match="missing: distance, dx"):
            propagate(take(field), None, None, None, WAVELENGTH, propagation_type="Angular Spectrum")

    def test_a_list_in_the_place_of_the_kernel_is_answered_with_zero_padding(self, propagate, take, field):
        for kind in ("Bandlimited Angular Spectrum", "custom"):
            with pytest.raises(TypeError, match=r"kernel must be an array.*zero_padding=\[True, False, True\]"):
                propagate(take(field), None, DISTANCE, DX, WAVELENGTH, kind, [True, False, True])

    def test_a_wave_number_with_three_digits_of_pi_is_the_exact_one(self, propagate, take, field, logged):
        lengths = (DISTANCE, DX, WAVELENGTH, "Angular Spectrum")
        found = propagate(take(field), 2 * 3.14 / WAVELENGTH, *lengths)
        assert any("k is 2π/wavelength = 11810498" in record.getMessage() for record in logged.records)
        np.testing.assert_array_equal(np.asarray(found), np.asarray(propagate(take(field), None, *lengths)))
        with pytest.raises(ValueError, match="k must be 2π/wavelength"):
            propagate(take(field), 2 * 3.1 / WAVELENGTH, *lengths)


@pytest.mark.parametrize("length", ["wavelength", "distance"])
def test_lengths_with_axes_of_rows_and_columns_are_named(length, random, recwarn):
    """[C, 1, 1] beside fields [C, m, n] makes C × C fields, as the leading axes alone broadcast."""
    field = random.normal(size=(3, 8, 10)) + 0j
    lengths = {"distance": 1e-3, "wavelength": 532e-9}
    of_each = np.array([1.0, 1.1, 1.2]) * lengths[length]

    def propagated(field, shape):
        return odak.wave.propagate_beam(field, None, dx=8e-6, **lengths | {length: of_each.reshape(shape)})

    right = propagated(field, (3,))
    outer = propagated(field[0], (3, 1, 1))
    assert right.shape == (3, 8, 10) and outer.shape == (3, 1, 1, 8, 10)
    assert propagated(field[:, None, None], (3, 1, 1)).shape == (3, 1, 1, 8, 10)
    assert not recwarn.list
    with pytest.warns(odak.ArgumentWarning, match=rf"{length} broadcasts .* \(3,\) become \(3, 1, 3\); give .* \(3,\)"):
        assert propagated(field, (3, 1, 1)).shape == (3, 1, 3, 8, 10)


def test_an_aperture_of_one_axis_is_centred_along_the_columns():
    rng = np.random.default_rng(2)
    field, mask = rng.normal(size=(6, 9)) + 0j, (np.arange(9) > 5).astype(float)
    found, expected = (
        odak.wave.custom(field, np.ones((6, 9), dtype=complex), aperture=given)
        for given in (mask, np.broadcast_to(mask, (6, 9)))
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(np.fft.fft2(found), np.fft.fft2(field) * np.fft.ifftshift(mask), atol=1e-12)


@pytest.mark.parametrize("kind", [np.float64, np.asarray, torch.tensor, partial(torch.tensor, requires_grad=True)])
def test_an_aperture_of_one_number_leaves_the_choice_of_the_method(kind):
    """An open aperture is no mask, whatever its number is held in: the same method propagates."""
    field = np.random.default_rng(3).normal(size=(16, 16)) + 0j
    lengths = (None, 0.02, 8e-6, 532e-9)
    for number in (1.0, 0.5):
        found = odak.learn.wave.propagate_beam(torch.tensor(field), *lengths, aperture=kind(number)).detach()
        np.testing.assert_allclose(found, odak.wave.propagate_beam(field, *lengths, aperture=number), atol=1e-12)


def test_axes_may_be_an_array():
    field = np.random.default_rng(3).normal(size=(1, 16)) + 0j
    for axes in ((-1,), (-2, -1)):
        found = [odak.wave.propagate_beam(field, None, 1e-3, 8e-6, 532e-9, axes=a) for a in (axes, np.asarray(axes))]
        np.testing.assert_array_equal(*found)
