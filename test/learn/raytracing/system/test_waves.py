"""Rays to waves and back: fields behind a lens against closed forms, Fourier images and the rays themselves."""

import math

import numpy as np
import pytest
import torch

from odak import AccuracyWarning
from odak.learn.raytracing import rays_from_field
from odak.learn.raytracing.system import (
    airy_pattern,
    exit_field,
    field_quality,
    first_order,
    launch,
    load_system,
    modulation_at,
    modulation_transfer_function,
    optical_system,
    point_spread_function,
    propagated_point_spread_function,
    pupil_quadrature,
    strehl_ratio,
    surface,
    trace,
    trace_fields,
    wavefront,
    waves,
    zernike_fit,
)
from odak.learn.raytracing.system.analysis import wavefront_with_rays
from odak.learn.wave import propagate_beam

F64 = torch.float64
WAVELENGTH, FOCAL, N = 500e-6, 10.0, 1.5
# For wide pupils on few samples.
LONG = 0.05


def hyperboloid(aperture=0.5, wavelength=WAVELENGTH):
    """Return a lens of 10 mm that images infinity to a point, its exit pupil in the last vertex."""
    rear = surface(-(N - 1) * FOCAL, conic=-(N**2), thickness=FOCAL, stop=True)
    return optical_system([surface(thickness=1.0, material=N), rear], aperture, wavelengths=wavelength)


def singlet(aperture=1.2, wavelength=WAVELENGTH, **options):
    """Return a lens with spherical aberration, coma and astigmatism of a wave or so, its stop in front."""
    faces = [surface(thickness=0.5, stop=True), surface(thickness=0.5, material=N), surface(-5.0, thickness=9.97)]
    return optical_system(faces, aperture, wavelengths=wavelength, **options)


def grid(wave):
    count = wave.field.shape[-1]
    line = (torch.arange(count, dtype=F64) - count // 2) * wave.pitch
    return line, line[:, None] ** 2 + line**2


def test_the_field_of_a_perfect_lens_is_a_spherical_wave():
    """Phase of a sphere about the focus; power of the pupil in each ring by energy alone."""
    lens = hyperboloid(4.0, LONG)
    wave = exit_field(lens, 65, distance=0.0)
    _, squared = grid(wave)
    lit = wave.status == 0
    cycles = -((squared + FOCAL**2).sqrt() - FOCAL) / LONG
    away = torch.angle(wave.field * torch.exp(-2j * math.pi * cycles))[lit]
    assert float(away.abs().max()) < 1e-8
    # From height h in the pupil a ray goes to q = h − (h/f′)z on the vertex plane: Descartes' surface in closed form.
    h = torch.linspace(0, 2.0, 2001, dtype=F64)
    radius = (N - 1) * FOCAL
    z = -(h * h) / radius / (1 + (1 - (1 - N**2) * (h / radius) ** 2).sqrt())
    q = h * FOCAL / (FOCAL - z)
    slope = torch.gradient(q, spacing=(h,))[0]
    cosine = FOCAL / (q * q + FOCAL**2).sqrt()
    expected = (h / (math.pi * 4.0) / (q * slope * cosine)).sqrt()
    whole = lit & (squared.sqrt() < q[-1] - 2 * wave.pitch)
    found = np.interp(squared.sqrt()[whole], q[1:-1], expected[1:-1])
    np.testing.assert_allclose(wave.field.abs()[whole], found, rtol=1e-6)


def test_a_wave_inside_glass_has_the_wavelength_there():
    """An ellipsoid, k = −1/n², with its focus in the glass: n·(√(r² + f²) − f) of optical path."""
    face = surface(FOCAL * (N - 1) / N, conic=-1 / N**2, thickness=FOCAL, material=N)
    wave = exit_field(optical_system([face], 3.0, wavelengths=LONG), 96)
    assert wave.wavelength == pytest.approx(LONG / N)
    _, squared = grid(wave)
    cycles = -N * ((squared + FOCAL**2).sqrt() - FOCAL) / LONG
    away = torch.angle(wave.field * torch.exp(-2j * math.pi * cycles))[wave.status == 0]
    assert float(away.abs().max()) < 1e-9
    found = rays_from_field(wave.field, wave.pitch, wave.wavelength).ray[48, 60]
    assert float((found[0] + found[1] * wave.to_image / found[1, 2])[0].abs()) < 2e-3


@pytest.mark.parametrize("system", [hyperboloid(4.0, LONG), singlet(3.0, LONG)], ids=["perfect", "aberrated"])
def test_power_is_kept(system):
    wave = exit_field(system, 160)
    rays = trace(system, launch(system, "rings", 2))
    assert float(rays.w.min()) < 0.99
    _, squared = grid(wave)
    cosine = wave.to_image / (squared + wave.to_image**2).sqrt()
    power = float((wave.field.abs().square() * cosine).sum()) * wave.pitch**2
    assert power == pytest.approx(1, rel=6e-3)
    half = exit_field(system, 160, apodization=lambda place: 0.5 * torch.ones_like(place[..., 0]))
    torch.testing.assert_close(half.field, 0.5 * wave.field)


def test_light_of_a_perfect_lens_propagates_to_airys_disc():
    found = propagated_point_spread_function(hyperboloid(), 512, 2e-3)
    assert float(found.strehl[0, 0]) == pytest.approx(1, abs=2e-3)
    line = (torch.arange(512, dtype=F64) - 256) * 2e-3
    aperture = math.sin(math.atan(0.25 / FOCAL))
    near = line.abs() < 40e-3
    profile = found.intensity[0, 0, 256]
    assert float((profile - airy_pattern(line, WAVELENGTH, aperture))[near].abs().max()) < 0.01
    spread = point_spread_function(hyperboloid(), samples=128, size=1024)
    place = (torch.arange(1024) - 512) * spread.pitch[0, 0, 1]
    fourier = np.interp(line, place, spread.intensity[0, 0, 512])
    assert np.abs(profile.numpy() - fourier)[near.numpy()].max() < 0.01
    frequency, transfer = (value[0, 0] for value in modulation_transfer_function(found))
    s = (frequency / (2 * aperture / WAVELENGTH)).clamp(max=1)
    perfect = 2 / math.pi * (torch.arccos(s) - s * (1 - s * s).sqrt())
    assert float((transfer - perfect).abs().max()) < 0.01


@pytest.mark.parametrize("field", [pytest.param(0, marks=pytest.mark.slow), 1])
@pytest.mark.slow
def test_light_of_aberrated_lens_propagates_to_its_fourier_image(field):
    system = singlet(1.5, fields=[(0.0, 0.0), (0.0, 2.0)])
    found = propagated_point_spread_function(system, 512, 3.21e-3, field=field)
    spread = point_spread_function(system, samples=128, size=1024)
    strehl = float(spread.strehl[0, field])
    assert 0.1 < strehl < 0.8 and float(found.strehl[0, 0]) == pytest.approx(strehl, rel=0.03)
    line = (torch.arange(512, dtype=F64) - 256) * 3.21e-3
    near = (line.abs() < 20e-3).numpy()
    image, fourier = found.intensity[0, 0], spread.intensity[0, field]
    for axis, profile, expected in ((0, image[:, 256], fourier[:, 512]), (1, image[256], fourier[512])):
        place = (torch.arange(1024) - 512) * spread.pitch[0, field, axis]
        assert np.abs(profile.numpy() - np.interp(line, place, expected))[near].max() < 0.03 * strehl


@pytest.mark.parametrize(
    ("field", "plane", "distance"),
    [(0, "axis", None), (1, "chief", None), pytest.param(1, "axis", 9.0, marks=pytest.mark.slow)],
)
def test_rays_of_the_field_are_the_rays_that_made_it(field, plane, distance):
    """Waves to rays: directions and places again, and all of them to the same image points."""
    system = singlet(wavelength=1e-3, fields=[(0.0, 0.0), (1.0, 3.0)])
    wave = exit_field(system, 257, plane=plane, field=field, distance=distance)
    found = rays_from_field(wave.field, wave.pitch, wave.wavelength)
    start, direction = found.ray.unbind(-2)
    kept = (wave.status == 0) & direction.isfinite().all(-1)
    landed = start + direction * (wave.to_image / direction[..., 2])[..., None]
    landed = landed - landed[128, 128]
    size = landed[kept][:, :2].abs().amax()
    real = trace(system, launch(system, "rings", 12, fields=[system.fields[field]]))
    spot = torch.stack([real.x - real.x[..., :1], real.y - real.y[..., :1]], -1)[0, 0].abs().amax()
    assert float(size / spot) == pytest.approx(1, rel=0.04)
    # Each landed ray lies where the traced one of its pupil point does: the spot's mean square, weighted by power.
    power = torch.where(kept, found.power, 0.0)
    mean = (power * torch.where(kept, landed[..., :2].square().sum(-1), 0.0)).sum() / power.sum()
    many = trace(system, launch(system, "grid", 201, fields=[system.fields[field]]))
    expected = ((many.x - real.x[..., :1]).square() + (many.y - real.y[..., :1]).square()).mean()
    assert float(mean / expected) == pytest.approx(1, rel=0.03)


@pytest.mark.slow
def test_a_real_stop_and_vignetting_cut_the_field():
    system = singlet(wavelength=2e-3, fields=[(0.0, 0.0)])
    free = exit_field(system, 129)
    system.surfaces[2].semi_diameter = 0.5
    cut = exit_field(system, 129)
    blocked = (free.status == 0) & (cut.status == 3)
    assert bool(blocked.any()) and not bool(cut.field[blocked].any())
    kept = cut.status == 0
    torch.testing.assert_close(cut.field[kept], free.field[kept])
    # A stop behind a strong lens: by its real size, the pupil is another one than the paraxial.
    behind = optical_system(
        [surface(6.0, thickness=0.2, material=1.8), surface(thickness=4.0), surface(thickness=3.0, stop=True)],
        aperture=2.4,
        aperture_type="stop",
        wavelengths=0.02,
    )
    for aim in ("paraxial", "real"):
        wave = exit_field(behind, 257, aim=aim, distance=0.0)
        _, squared = grid(wave)
        edge = float(squared[wave.status == 0].max().sqrt())
        assert (abs(edge - 1.2) < wave.pitch) == (aim == "real")


def test_gradients_through_field_and_propagation():
    system = singlet(0.4, 2e-3)
    numbers = system.prescription()

    def values(curvature, thickness):
        wave = exit_field(
            system, 48, 14e-3, prescription=numbers._replace(curvature=curvature, thickness=thickness), distance=-0.3
        )
        image = propagate_beam(wave.field, None, wave.to_image, wave.pitch, wave.wavelength)
        return image.abs().square().sum(0), torch.view_as_real(wave.field[20:28, 20:28])

    inputs = [value.clone().requires_grad_() for value in (numbers.curvature, numbers.thickness)]
    # Phases are known to 2π·path/λ times the rounding error, 1e-10 here: smaller steps differ by this over the step.
    assert torch.autograd.gradcheck(values, inputs, eps=3e-6, rtol=1e-5, atol=1e-5, fast_mode=True)


def test_a_batch_of_systems_and_single_precision():
    system = singlet(0.6, 2e-3)
    numbers = system.prescription()
    scale = torch.tensor([0.98, 1.0], dtype=F64)[:, None]
    both = exit_field(
        system, 64, 11e-3, prescription=numbers._replace(curvature=scale * numbers.curvature), distance=0.0
    )
    assert both.field.shape == (2, 64, 64) and both.to_image.shape == (2,)
    one = exit_field(system, 64, 11e-3, distance=0.0)
    torch.testing.assert_close(both.field[1], one.field, rtol=1e-6, atol=1e-6)
    changed = numbers._replace(curvature=scale * numbers.curvature)
    spread = propagated_point_spread_function(system, 80, 9e-3, prescription=changed)
    assert spread.strehl.shape == (2, 1, 1)
    alone = propagated_point_spread_function(system, 80, 9e-3)
    assert float(spread.strehl[1, 0, 0]) == pytest.approx(float(alone.strehl), rel=1e-9)
    assert abs(float(spread.strehl[0, 0, 0]) - float(alone.strehl)) > 1e-3
    narrow = exit_field(system, 64, 11e-3, distance=0.0, dtype=torch.complex64)
    assert narrow.field.dtype == torch.complex64
    assert float((narrow.field - one.field).abs().max() / one.field.abs().max()) < 1e-6


def test_pieces_change_nothing(monkeypatch):
    from odak.learn.raytracing.system import waves

    system = singlet(0.6, 2e-3)
    numbers = system.prescription()
    scale = torch.tensor([0.98, 1.0], dtype=F64)[:, None]

    def run():
        curvature = (scale * numbers.curvature).requires_grad_()
        wave = exit_field(system, 48, distance=0.0, prescription=numbers._replace(curvature=curvature))
        (found,) = torch.autograd.grad((wave.field.real * torch.arange(48.0)).sum(), curvature)
        return wave.field, wave.status, found

    whole = run()
    monkeypatch.setattr(waves, "PIECE", 700)
    for a, b in zip(run(), whole, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)


def test_a_mirror_leaves_its_field_too():
    mirror = optical_system(
        [surface(-2 * FOCAL, conic=-1.0, thickness=-FOCAL, material="mirror")], 0.5, wavelengths=WAVELENGTH
    )
    wave = exit_field(mirror, 256, 4e-3)
    assert float(wave.to_image) == pytest.approx(FOCAL)
    found = propagated_point_spread_function(mirror, 256, 4e-3)
    assert divmod(int(found.intensity.argmax()), 256) == (128, 128)
    assert float(found.strehl[0, 0]) == pytest.approx(1, abs=2e-3)


def test_what_would_be_wrong_is_refused():
    lens = hyperboloid()
    with pytest.raises(ValueError, match=r"pitch must be at most 0\.01001 for the phase.*a size of 55 or more"):
        exit_field(lens, 64, 2e-2)
    with pytest.raises(ValueError, match="pitch must be at least"):
        exit_field(lens, 64, 1e-3)
    with pytest.raises(ValueError, match=r"pitch must be at most.*perpendicular to the chief ray"):
        exit_field(singlet(fields=[(0.0, 10.0)]), 256)
    with pytest.raises(ValueError, match="plane must be one of 'axis', 'chief'"):
        exit_field(lens, 64, plane="image")
    with pytest.raises(TypeError, match=r"dtype must be torch\.complex64"):
        exit_field(lens, 64, dtype=F64)
    with pytest.raises(ValueError, match="field must be the number of one of the system's 1, got 1"):
        exit_field(lens, 64, field=1)
    strong = singlet(3.0)
    focus = 0.5 * float(first_order(strong).image_distance) + 4.6
    with pytest.raises(ValueError, match="distance must put the plane where rays do not cross"):
        exit_field(strong, 256, distance=focus)
    telecentric = optical_system(
        [surface(thickness=10.0, stop=True), surface(5.0, thickness=1e-12, material=1.5), surface(thickness=10.0)],
        aperture=0.4,
        wavelengths=WAVELENGTH,
    )
    with pytest.raises(ValueError, match="distance must be given: the exit pupil is at infinity"):
        exit_field(telecentric, 64)
    assert bool((exit_field(telecentric, 256, distance=0.0).status == 0).any())


@pytest.mark.parametrize("look", ["rms", "spread", "zernike", "transfer"])
def test_lost_rays_leave_derivatives_finite(look):
    lens = load_system("double_gauss")
    curvature = lens.vary(curvature=[0])[0]

    def value():
        if look == "rms":
            return wavefront(lens).rms.sum()
        if look == "zernike":
            return zernike_fit(wavefront(lens))[0].sum()
        spread = point_spread_function(lens, 224, 224, fields=lens.fields[1:2])
        return (
            spread.intensity[..., 112, 112].sum() if look == "spread" else modulation_transfer_function(spread)[1].sum()
        )

    assert bool((wavefront(lens, fields=lens.fields[1:2]).status != 0).any())
    value().backward()
    found, step = curvature.grad.item(), 1e-9
    with torch.no_grad():
        curvature += step
        above = value()
        curvature -= 2 * step
        below = value()
    assert found == pytest.approx(((above - below) / (2 * step)).item(), rel=1e-3)


def test_blocked_light_leaves_derivatives_of_exit_field_finite():
    pieces = [surface(10.0, semi_diameter=1.0, thickness=30.0, material=1.5, stop=True)]
    lens = optical_system(pieces, aperture=4.0, wavelengths=50e-3)
    curvature = lens.vary(curvature=[0])[0]
    exit_field(lens, 64).field.abs().sum().backward()
    assert curvature.grad.isfinite().all()


def test_waves_are_shorter_in_image_space():
    index = 1.336
    shape = surface(10.0, conic=-1 / index**2, thickness=10 * index / (index - 1), material=index, stop=True)
    eye = optical_system([shape], aperture=1.5, wavelengths=550e-6)
    spread = point_spread_function(eye, 64, 1024)
    profile = spread.intensity[0, 0, 512, 512:]
    ring = int((profile[1:] >= profile[:-1]).nonzero()[0]) * spread.pitch[0, 0, 1].item()
    assert ring == pytest.approx(0.61 * 550e-6 / first_order(eye).numerical_aperture.item(), rel=0.03)


def test_fields_off_both_axes_are_warned_about():
    ball = [surface(20.0, thickness=20.0, material=1.5), surface(thickness=20.0, material=1.5, stop=True)]
    ball.append(surface(-20.0, thickness=9.25))
    image = surface(-29.25)
    point_spread_function(optical_system(ball, aperture=1.0, fields=[0.0, (0, 20.0)], image=image), 32, 64)
    with pytest.warns(AccuracyWarning, match="off both axes"):
        point_spread_function(optical_system(ball, aperture=1.0, fields=[(15.0, 15.0)], image=image), 32, 64)


def test_several_fields_are_each_of_them():
    lens = optical_system([surface(5.0, thickness=0.2, material=1.5), surface(thickness=9.8)], 0.2, fields=[0.0, 1.0])
    several = propagated_point_spread_function(lens, 64, fields=[(0.0, 0.0), (0.0, 1.0), (0.5, 0.5)])
    assert several.intensity.shape == (1, 3, 64, 64) and several.strehl.shape == (1, 3)
    pitch = float(several.pitch[0, 0, 0])
    # Twice the phase's rounding error, 2π·path/λ·eps, for a path of 10 mm.
    rounding = 2 * 2 * torch.pi * 10 / 550e-6 * torch.finfo(F64).eps
    for i in (0, 1):
        one = propagated_point_spread_function(lens, 64, pitch, field=i).intensity
        torch.testing.assert_close(
            several.intensity[:, i : i + 1], one, rtol=rounding, atol=rounding * one.max().item()
        )


def test_the_quality_over_the_field_takes_each_wavefront_once(monkeypatch):
    """Its wavefronts and Strehl ratios are those of separate calls on the same nodes."""
    lens, counts = singlet(fields=[0.0, 2.0]), []

    def counted(system, pupil, count=12, **options):
        counts.append(count)
        return wavefront_with_rays(system, pupil, count, **options)

    monkeypatch.setattr(waves, "wavefront_with_rays", counted)
    found = field_quality(lens)
    assert len(counts) > 1 and counts == sorted(set(counts)) and counts[-1] == found.count
    nodes, numbers = pupil_quadrature(lens, found.count), lens.prescription().at(lens.reference)
    torch.testing.assert_close(found.wavefront_rms, wavefront(lens, nodes).rms[lens.reference], rtol=1e-9, atol=0)
    alone = strehl_ratio(lens, nodes, prescription=numbers)[0]
    torch.testing.assert_close(found.strehl, alone, rtol=1e-9, atol=0)


def test_spots_of_the_quality_take_each_wavelength_in_its_own_pupil():
    """A rim behind a prism-like lens cuts another part of the pupil of each colour; the reference is the second."""
    lens = optical_system(
        [
            surface(radius=30.0, thickness=4.0, material="N-SF11", stop=True),
            surface(radius=-200.0, thickness=20.0),
            surface(thickness=10.0, semi_diameter=3.5),
        ],
        aperture=10.0,
        fields=[8.0],
        wavelengths=[450e-6, 550e-6, 650e-6],
        reference=1,
    )
    found, parts = field_quality(lens), []
    for numbers in map(lens.prescription().at, range(3)):
        points = pupil_quadrature(lens, found.count, prescription=numbers)
        rays = trace_fields(lens, points, prescription=numbers)
        parts.append([rays.x[0, 0], rays.y[0, 0], torch.where(rays.arrived[0, 0], points.weights[0], 0.0)])
    x, y, weights = (torch.cat(values) for values in zip(*parts, strict=True))
    weights = weights / weights.sum()
    spread = sum((weights * value.square()).sum() - (weights * value).sum() ** 2 for value in (x, y))
    assert float(found.passed) < 0.9
    torch.testing.assert_close(found.rms_spot[0], spread.sqrt(), rtol=1e-9, atol=0)


def test_strehl_ratios_take_as_many_rays_as_the_wavefront_needs():
    """The field on the axis is a sum over rings: 16 of them give 0.15 in place of 0.11."""
    lens = load_system("triplet_f28")
    numbers = lens.prescription().at(lens.reference)
    radius = (torch.arange(4000, dtype=torch.float64) + 0.5) / 4000
    found = wavefront(lens, torch.stack([0 * radius, radius], -1), fields=[0.0], prescription=numbers)
    expected = abs((torch.exp(2j * math.pi * found.path[0, 0]) * radius).sum() / radius.sum()) ** 2
    options = {"fields": [0.0], "prescription": numbers}
    assert float(strehl_ratio(lens, **options)) == pytest.approx(float(expected), abs=1e-5)
    with pytest.warns(AccuracyWarning, match="rays do not resolve the wavefront over 3. % of the pupil"):
        few = strehl_ratio(lens, count=16, **options)
    assert float(few) > 1.3 * float(expected)


def test_images_take_as_many_samples_as_the_wavefront_needs():
    """The transfer function on the axis is the autocorrelation of a pupil of rings: 64 samples give 0.07 of 0.13."""
    lens = load_system("double_gauss")
    lens.surfaces[-1].thickness += 0.379046  # to the paraxial focus, in which the wavefront is steep
    numbers = lens.prescription().at(lens.reference)
    radius = torch.linspace(0, 1, 4001, dtype=torch.float64)
    options = {"fields": [0.0], "prescription": numbers}
    found = wavefront(lens, torch.stack([0 * radius, radius], -1), **options)
    path, cosine = found.path[0, 0].numpy(), found.cosines[0, 0, :, 1].abs()
    slope = float((cosine * radius**2).sum() / (radius**3).sum())
    line = (np.arange(900) + 0.5) / 450 - 1
    x, y = np.meshgrid(line, line)
    expected = []
    for frequency in (20.0, 50.0):
        half = frequency * lens.wavelengths[lens.reference] / slope / 2
        ends = [np.hypot(x, y + sign * half) for sign in (1, -1)]
        lags = [np.interp(end, radius.numpy(), path) for end in ends]
        both = (ends[0] <= 1) & (ends[1] <= 1)
        expected.append(abs(np.exp(2j * np.pi * (lags[0] - lags[1]))[both].sum()) * (line[1] - line[0]) ** 2 / np.pi)
    spread = point_spread_function(lens, **options)
    assert spread.intensity.shape[-1] == 1024
    own = [float(modulation_at(spread, frequency)[0, 0]) for frequency in (20.0, 50.0)]
    assert own == pytest.approx(expected, abs=2e-3)
    with pytest.warns(AccuracyWarning, match="64 samples across the pupil do not .* take 17. samples"):
        few = point_spread_function(lens, 64, 256, **options)
    assert float(modulation_at(few, 20.0)[0, 0]) < 0.6 * expected[0]
    enough = point_spread_function(lens, 176, 352, **options)
    assert float(modulation_at(enough, 20.0)[0, 0]) == pytest.approx(expected[0], abs=5e-3)
