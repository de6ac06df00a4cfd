"""Tilted planes against the direct sum at their points, ordinary propagation, rotated plane waves and energy."""

import numpy as np
import pytest
import torch
from physics import coordinates, gaussian_beam, relative_error, wrapped_phasor

import odak
from odak.wave import propagate_to_tilted_plane, propagate_to_window
from odak.wave.fourier import spectrum_at

WAVELENGTH, DX = 532e-9, 2e-6


def rotation(angles):
    """Return Rz·Ry·Rx, written out from the three elementary rotations."""
    a, b, c = np.deg2rad(angles)
    about_x = [[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]
    about_y = [[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]]
    about_z = [[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]
    return np.array(about_z) @ about_y @ about_x


def points(angles, distance, shape, dx, offset=(0.0, 0.0)):
    y, x = coordinates(shape, dx)
    flat = np.stack(np.broadcast_arrays(x + offset[1], y + offset[0], 0.0), -1)
    return flat @ rotation(angles).T + [0, 0, distance]


def direct_sum(field, wavelength, dx, targets):
    """Return the first Rayleigh–Sommerfeld integral (Goodman 2005, eq. 3-41, near term kept) at points (x, y, z)."""
    y, x = coordinates(field.shape, dx)
    targets = targets[..., None, None, :]
    z = targets[..., 2]
    r = np.sqrt((targets[..., 0] - x) ** 2 + (targets[..., 1] - y) ** 2 + z**2)
    kernel = z / r**2 * (1 / (2 * np.pi * r) - 1j / wavelength) * wrapped_phasor(r, wavelength)
    return (field * kernel).sum((-1, -2)) * dx**2


def patch(shape=(48, 44)):
    y, x = coordinates(shape, DX)
    return np.exp(-(y**2 + x**2) / 1.5e-5**2) * (1 + 0.5 * np.cos(2 * np.pi * x / 1.5e-5 + 1)) * np.exp(2e5j * y)


@pytest.mark.parametrize("angles", [(0, 30, 0), (-35, 0, 0), (0, 0, 25), (40, -20, 70), (0, 70, 0)])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (6e-5, -4e-5)])
def test_direct_sum_at_the_tilted_points(angles, offset):
    distance, window = 3e-3, ((15, 14), 3.4e-6)
    expected = direct_sum(patch(), WAVELENGTH, DX, points(angles, distance, *window, offset))
    result = propagate_to_tilted_plane(patch(), WAVELENGTH, distance, DX, angles, *window, offset)
    assert np.abs(result - expected).max() < 5e-7 * np.abs(patch()).max()
    assert relative_error(result, expected) < 2e-6
    single = propagate_to_tilted_plane(patch().astype(np.complex64), WAVELENGTH, distance, DX, angles, *window, offset)
    assert single.dtype == np.complex64
    assert np.abs(single - expected).max() < 1e-6 * np.abs(patch()).max()


def test_no_tilt_is_ordinary_propagation(random):
    field = random.normal(size=(31, 40)) + 1j * random.normal(size=(31, 40))
    window = (20, 25), 1.1e-6, (1e-5, -2e-5)
    expected = propagate_to_window(field, WAVELENGTH, 1e-3, DX, *window)
    assert relative_error(propagate_to_tilted_plane(field, WAVELENGTH, 1e-3, DX, (0, 0, 0), *window), expected) < 1e-10


def test_a_quarter_turn_about_the_light_turns_the_picture():
    field = patch((49, 49))
    expected = propagate_to_window(field, WAVELENGTH, 1e-3, DX)
    turned = propagate_to_tilted_plane(field, WAVELENGTH, 1e-3, DX, (0, 0, 90.0))
    # Target (x, y) looks at (−y, x).
    assert relative_error(turned, expected.T[::-1]) < 1e-10


@pytest.mark.parametrize("angles", [(0, 40, 0), (25, 0, 0), (20, -30, 10)])
def test_plane_wave_has_its_rotated_frequency(angles):
    shape, dx = (150, 150), 4e-6
    y, x = coordinates(shape, dx)
    wave = np.array([2e4, -3e4, 0.0])
    wave[2] = np.sqrt(1 / WAVELENGTH**2 - (wave**2).sum())
    envelope = np.exp(-(((x**2 + y**2) / 2e-4**2) ** 4))
    field = envelope * np.exp(2j * np.pi * (wave[0] * x + wave[1] * y))
    distance, window = 5e-4, ((20, 21), 1e-7)
    result = propagate_to_tilted_plane(field, WAVELENGTH, distance, dx, angles, *window)
    v, u = coordinates(*window)
    turned = rotation(angles).T @ wave
    expected = np.exp(2j * np.pi * (turned[0] * u + turned[1] * v)) * wrapped_phasor(distance * wave[2], 1.0)
    np.testing.assert_allclose(result, expected, atol=2e-3)


@pytest.mark.parametrize("angle", [-45.0, 30.0, 60.0])
def test_gaussian_beam_keeps_its_power(angle):
    dx, waist = 4e-6, 6e-5
    start = gaussian_beam((101, 101), dx, waist, 0.0, WAVELENGTH)
    result = propagate_to_tilted_plane(start, WAVELENGTH, 2e-3, dx, (0, angle, 0), (150, 250), 4e-6)
    # A tilted plane sees the beam stretched by 1/cos: its area times its cosine is what conserves power.
    power = (np.abs(result) ** 2).sum() * np.cos(np.deg2rad(angle))
    # Waves of the beam meet the plane at angles that differ by λ/(π·waist).
    assert power == pytest.approx((np.abs(start) ** 2).sum(), rel=1e-4)


def test_flux_of_every_plane_wave_is_conserved():
    field, dx, angle = patch(), DX, 35.0
    fine = 2.5e-7
    # Beyond λ/2 the samples of the tilted plane tell every frequency.
    result = propagate_to_tilted_plane(field, WAVELENGTH, 1e-4, dx, (0, angle, 0), (200, 1000), fine)

    def flux(u, pitch):
        fy, fx = (np.fft.fftfreq(n, pitch) for n in u.shape)
        axial = np.sqrt(np.maximum(1 / WAVELENGTH**2 - fy[:, None] ** 2 - fx**2, 0)) * WAVELENGTH
        return (np.abs(np.fft.fft2(u)) ** 2 * axial).sum() / u.size * pitch**2

    assert flux(result, fine) == pytest.approx(flux(field, dx), rel=1e-6)


def test_batches_and_libraries(as_array, random):
    field = np.stack([patch(), patch()[::-1]])[:, None] * (1 + 1j * random.normal())
    wavelengths, distances = [450e-9, 532e-9, 638e-9], [[1e-3], [2e-3]]
    arguments = DX, (10.0, 20.0, 0.0), (8, 7)
    result = propagate_to_tilted_plane(as_array(field), np.array(wavelengths), np.array(distances), *arguments)
    assert tuple(result.shape) == (2, 3, 8, 7)
    for i in range(2):
        for j in range(3):
            one = propagate_to_tilted_plane(field[i, 0], wavelengths[j], distances[i][0], *arguments)
            # What depends on the frequencies that a batch shares is the guard's error.
            assert np.abs(np.asarray(result)[i, j] - one).max() < 1e-6 * np.abs(field).max()


def test_spectrum_at_any_frequency_is_the_direct_sum(random):
    field = random.normal(size=(3, 21, 30)) + 1j * random.normal(size=(3, 21, 30))
    cy, cx = random.uniform(-2, 2, (2, 7, 5))
    wave_y = np.exp(-2j * np.pi * cy[..., None] * (np.arange(21) - 10))
    wave_x = np.exp(-2j * np.pi * cx[..., None] * (np.arange(30) - 15))
    expected = np.einsum("bnm,pqn,pqm->bpq", field, wave_y, wave_x)
    assert relative_error(spectrum_at(field, cy, cx), expected) < 1e-12
    assert relative_error(spectrum_at(field.astype(np.complex64), cy, cx), expected) < 1e-6


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"angles": (0, 0)}, ValueError, "angles"),
        ({"angles": (0, float("nan"), 0)}, ValueError, "angles"),
        ({"angles": (0, 90, 0)}, ValueError, "angles"),
        ({"angles": (180, 0, 0)}, ValueError, "angles"),
        ({"distance": float("inf")}, ValueError, "distance"),
    ],
)
def test_bad_arguments(change, error, message):
    arguments = {"field": patch(), "wavelength": WAVELENGTH, "distance": 1e-3, "dx": DX, **change}
    with pytest.raises(error, match=message):
        propagate_to_tilted_plane(**arguments)


@pytest.mark.parametrize("angle", [3.0, 45.0])
def test_a_plane_through_the_middle_of_the_field(angle):
    n, pitch, waist = 96, 8e-6, 60e-6
    line = (np.arange(n) - n // 2) * pitch
    field = np.exp(-(line[:, None] ** 2 + line**2) / waist**2).astype(complex)
    found = propagate_to_tilted_plane(field, 532e-9, 0.0, pitch, (angle, 0.0, 0.0), (64, 48), 3e-6)
    rows, columns = ((np.arange(size) - size // 2) * 3e-6 for size in (64, 48))
    tilt, k = np.radians(angle), 2 * np.pi / 532e-9
    y, z = rows[:, None] * np.cos(tilt), rows[:, None] * np.sin(tilt)
    q = 1 / (1 + 1j * z * 532e-9 / (np.pi * waist**2))
    beam = q * np.exp(1j * k * z - (columns**2 + y**2) / waist**2 * q)
    assert np.abs(found - beam).max() < 1e-7


def test_grazing_planes_are_reported():
    with pytest.warns(odak.AccuracyWarning, match="more than 88 degrees"):
        propagate_to_tilted_plane(np.ones((8, 8), complex), 532e-9, 0.01, 8e-6, (88.5, 0.0, 0.0), (4, 4))


@pytest.mark.parametrize("angles", [(0, 30, 0), (-35, 0, 0), (20, -30, 40)])
@pytest.mark.parametrize("source", [(0, 4, 0), (2, -3, 30)])
def test_direct_sum_from_a_tilted_field(angles, source):
    distance, window, offset = 3e-3, ((15, 14), 3.4e-6), (6e-5, -4e-5)
    targets = points(angles, distance, *window, offset) @ rotation(source)
    # In the coordinates of the field's own plane.
    expected = direct_sum(patch(), WAVELENGTH, DX, targets)
    result = propagate_to_tilted_plane(patch(), WAVELENGTH, distance, DX, angles, *window, offset, source_angles=source)
    assert np.abs(result - expected).max() < 5e-7 * np.abs(patch()).max()
    matrices = [rotation(turn) for turn in (angles, source)]
    same = propagate_to_tilted_plane(
        patch(), WAVELENGTH, distance, DX, matrices[0], *window, offset, source_angles=matrices[1]
    )
    np.testing.assert_allclose(same, result, atol=1e-9 * np.abs(result).max())


def test_planes_tilted_alike_are_parallel_planes_aside():
    angle, distance, window = 5.0, 3e-3, ((30, 27), 1.7e-6)
    result = propagate_to_tilted_plane(
        patch(), WAVELENGTH, distance, DX, (0, angle, 0), *window, source_angles=(0, angle, 0)
    )
    aside = distance * np.sin(np.deg2rad(angle))
    expected = propagate_to_window(
        patch(), WAVELENGTH, distance * np.cos(np.deg2rad(angle)), DX, *window, (0.0, -aside)
    )
    assert np.abs(result - expected).max() < 5e-7 * np.abs(patch()).max()


@pytest.mark.parametrize("angles", [(0.0, 33.0, 0.0), (-20.0, 0.0, 0.0)])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_one_axis_at_a_time_is_the_general_transform(angles, dtype):
    field = np.stack([patch(), patch()[::-1]]).astype(dtype)
    quick = propagate_to_tilted_plane(field, WAVELENGTH, 2e-3, (DX, DX), angles, (30, 27), 1.7e-6)
    general = propagate_to_tilted_plane(field, WAVELENGTH, 2e-3, DX, rotation(angles), (30, 27), 1.7e-6)
    assert relative_error(quick, general) < (1e-5 if dtype == np.complex64 else 1e-10)


@pytest.mark.parametrize("angles", [(-35, 5, 0), (10, 20, 30), (20, -30, 95), (5, 25, 60), (30, 10, -140)])
@pytest.mark.parametrize("window_dx", [None, (1.3e-6, 2.1e-6)])
def test_both_steps_with_oblong_pixels_and_exchanged_axes(angles, window_dx):
    dx, distance, window, offset = (2e-6, 3e-6), 3e-3, (16, 13), (1e-5, -3e-5)
    y, x = (
        axis.reshape(shape) * pitch
        for axis, shape, pitch in zip((np.arange(48) - 24, np.arange(44) - 22), ((-1, 1), (1, -1)), dx, strict=True)
    )
    field = np.exp(-(y**2 + x**2) / 1.5e-5**2 + 1e5j * (3 * x - 2 * y))
    rows, columns = (
        (np.arange(n) - n // 2) * pitch + start for n, pitch, start in zip(window, window_dx or dx, offset, strict=True)
    )
    places = np.stack(np.broadcast_arrays(columns, rows[:, None], 0.0), -1) @ rotation(angles).T + [0, 0, distance]
    r = np.sqrt(
        ((places[..., None, None, :2] - np.stack(np.broadcast_arrays(x, y), -1)) ** 2).sum(-1)
        + places[..., None, None, 2] ** 2
    )
    kernel = places[..., None, None, 2] / r**2 * (1 / (2 * np.pi * r) - 1j / WAVELENGTH) * wrapped_phasor(r, WAVELENGTH)
    expected = (field * kernel).sum((-1, -2)) * dx[0] * dx[1]
    found = propagate_to_tilted_plane(field, WAVELENGTH, distance, dx, angles, window, window_dx, offset)
    assert np.abs(found - expected).max() < 1e-7


@pytest.mark.parametrize("angles", [(10, 20, 0), (10, 20, 45)])
def test_frequencies_a_period_apart_add_up_in_equal_pitch(angles, random):
    field = random.normal(size=(40, 36)) + 1j * random.normal(size=(40, 36))
    found = propagate_to_tilted_plane(field, WAVELENGTH, 1e-3, 8e-6, angles)
    # The same places, which are summed one by one.
    expected = propagate_to_tilted_plane(field, WAVELENGTH, 1e-3, 8e-6, angles, window_dx=8e-6 * (1 + 1e-14))
    assert relative_error(found, expected) < 1e-9


def test_gradients_of_both_rotations():
    field = torch.from_numpy(patch((6, 7)))
    angles = torch.tensor([3.0, 20.0, 2.0, 10.0], dtype=torch.float64, requires_grad=True)

    def tilted(a):
        turned = (a[0], a[1], 0.0)
        return propagate_to_tilted_plane(field, WAVELENGTH, 1e-4, DX, turned, (4, 4), source_angles=(a[2], a[3], 0.0))

    assert torch.autograd.gradcheck(tilted, (angles,), eps=1e-5, fast_mode=True)
    single = torch.tensor(20.0, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda a: propagate_to_tilted_plane(field, WAVELENGTH, 1e-4, DX, (0.0, a, 0.0), (4, 4)),
        (single,),
        eps=1e-5,
        fast_mode=True,
    )


def test_what_is_no_rotation_is_refused():
    with pytest.raises(ValueError, match="angles must be a rotation matrix"):
        propagate_to_tilted_plane(patch(), WAVELENGTH, 1e-3, DX, 2 * np.eye(3))
    with pytest.raises(ValueError, match="less than 90 degrees"):
        propagate_to_tilted_plane(patch(), WAVELENGTH, 1e-3, DX, (0, 50, 0), source_angles=(0, -50, 0))


@pytest.mark.parametrize("angles", [(0.0, 30.0, 0.0), (-20.0, 0.0, 0.0), (10.0, 20.0, 30.0)])
def test_kept_paths_are_those_that_are_not_kept(angles, random):
    field = random.normal(size=(2, 9, 12)) + 1j * random.normal(size=(2, 9, 12))
    traced = torch.tensor(1e-3, dtype=torch.float64, requires_grad=True)
    tensor = torch.from_numpy(field)
    # A distance that requires a gradient has no stored path.
    expected = propagate_to_tilted_plane(tensor, WAVELENGTH, traced, DX, angles).detach().numpy()
    for _ in range(2):
        found = propagate_to_tilted_plane(field, WAVELENGTH, 1e-3, DX, angles)
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
        same = propagate_to_tilted_plane(tensor, WAVELENGTH, 1e-3, DX, angles)
        np.testing.assert_allclose(same.numpy(), expected, atol=1e-10 * np.abs(expected).max())
        matrix = torch.from_numpy(rotation(angles))
        same = propagate_to_tilted_plane(tensor, WAVELENGTH, 1e-3, DX, matrix)
        np.testing.assert_allclose(same.numpy(), expected, atol=1e-10 * np.abs(expected).max())
    single = propagate_to_tilted_plane(tensor.to(torch.complex64), WAVELENGTH, 1e-3, DX, angles)
    assert relative_error(single.numpy(), expected) < 1e-5
    held = tensor.clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda u: propagate_to_tilted_plane(u, WAVELENGTH, 1e-3, DX, angles), held, fast_mode=True
    )
