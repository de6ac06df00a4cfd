"""Polarised rays, coatings and losses against Fresnel's formulas, closed forms of mirrors, and energy."""

import cmath
import math

import numpy as np
import pytest
import torch

from odak.catalog import internal_transmittance
from odak.jones import thin_film_stack
from odak.learn.raytracing import Light, RayScene, system_elements
from odak.learn.raytracing.system import (
    Rays,
    coordinate_break,
    ghost_system,
    ghosts,
    launch,
    load_system,
    optical_system,
    point_spread_function,
    polarized_point_spread_function,
    polarized_trace,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
)
from odak.learn.raytracing.system.surfaces import Coating
from odak.raytracing.gradients import RadialGradient
from odak.raytracing.interfaces import LinearGrating

F64 = torch.float64
GLASS, WAVELENGTH = 1.52, 550e-6


def tilted_plane(angle, material=GLASS, coating=None, **options):
    """A plane met at an angle in degrees, by a ray along z."""
    plane = surface(material=material, coating=coating, tilt=(angle, 0.0), thickness=1.0, **options)
    return optical_system([plane], 1.0, wavelengths=WAVELENGTH)


def along_z():
    return torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], dtype=F64)


def folded(axes, coating, material="air"):
    """Mirrors at 45° one after the other, each about an axis of the frame that it stands in."""
    items, sign = [surface(material=material, thickness=10.0)], 1.0
    for axis in axes:
        tilt = [45.0 * (i == axis) for i in range(3)]
        sign = -sign
        items += [coordinate_break(tilt=tilt), surface(material="mirror", coating=coating)]
        items += [coordinate_break(tilt=tilt, thickness=10.0 * sign)]
    return optical_system(items, 1.0, wavelengths=WAVELENGTH)


@pytest.mark.parametrize("angle", [0.0, 30.0, 56.659])
def test_a_bare_plane_has_fresnels_coefficients(angle):
    """s lies along x here; at Brewster's angle all of p goes through."""
    found = polarized_trace(tilted_plane(angle), along_z())
    sine = math.sin(math.radians(angle))
    first, second = math.cos(math.radians(angle)), math.sqrt(1 - (sine / GLASS) ** 2)
    ts, tp = 2 * first / (first + GLASS * second), 2 * first / (GLASS * first + second)
    scale = math.sqrt(GLASS * second / first)
    jones = found.jones[0, 0, 0]
    assert torch.allclose(jones, torch.diag(torch.tensor([ts, tp], dtype=F64) * scale).to(jones), rtol=0, atol=1e-12)
    power = [(t * scale) ** 2 for t in (ts, tp)]
    assert abs(float(found.transmittance) - sum(power) / 2) < 1e-12
    expected = abs(power[0] - power[1]) / sum(power)
    assert abs(float(found.diattenuation) - expected) < 1e-7
    assert float(found.retardance) < 1e-7
    if angle > 50:
        assert abs(power[1] - 1) < 1e-9
    # The matrix takes the old direction to the new one, and keeps fields across the ray.
    matrix = found.matrix[0, 0, 0]
    assert torch.allclose((matrix @ found.incoming[0, 0, 0].to(matrix)).real, found.outgoing[0, 0, 0], atol=1e-12)
    across = found.outgoing[0, 0, 0].to(matrix) @ matrix @ torch.eye(3, 2, dtype=matrix.dtype)
    assert float(across.abs().max()) < 1e-12


def test_a_quarter_wave_coating_in_a_trace_is_that_of_the_stack():
    """Reflected, transmitted and absorbed power at an angle are those of thin_film_stack, and add up to 1."""
    films, angle = Coating((1.38, 2.1 + 0.05j), [WAVELENGTH / 4 / 1.38, 60e-6]), 35.0
    through = polarized_trace(tilted_plane(angle, coating=films), along_z())
    back = Coating(films.media, films.thicknesses, GLASS)
    mirror = tilted_plane(angle, "mirror", back)
    mirror.surfaces[0].thickness.neg_()
    reflected = polarized_trace(mirror, along_z())
    for i, name in enumerate(("s", "p")):
        indices = (1.0, 1.38, 2.1 + 0.05j, GLASS)
        stack = thin_film_stack(WAVELENGTH, indices, films.thicknesses, angle, name)
        power = [float(ray.jones[0, 0, 0][i, i].abs() ** 2) for ray in (through, reflected)]
        assert abs(power[0] - float(stack.transmittance)) < 1e-12
        assert abs(power[1] - float(stack.reflectance)) < 1e-12
        assert abs(sum(power) + float(stack.absorptance) - 1) < 1e-12
    # Perfect at its wavelength where n = √n_glass.
    perfect = Coating.quarter_waves([math.sqrt(GLASS)], WAVELENGTH)
    assert abs(float(polarized_trace(tilted_plane(0.0, coating=perfect), along_z()).transmittance) - 1) < 1e-14


@pytest.mark.parametrize("as_given", [float, lambda value: torch.tensor(value, dtype=torch.float64)])
def test_a_quarter_wave_mirror_reflects_as_its_admittance(as_given):
    """Macleod, Thin-Film Optical Filters, section 5.2: Y = (H/L)^(2p)·H²/S."""
    high, low, glass, wave = 2.35, 1.46, 1.52, 550e-6
    mirror = Coating.quarter_waves([high, low] * 5 + [high], wave)
    found = mirror.amplitudes(*map(as_given, (1.0, glass, 1.0, 1.0, wave)))
    admittance = (high / low) ** 10 * high**2 / glass
    assert float(abs(found.reflected_s) ** 2) == pytest.approx(((1 - admittance) / (1 + admittance)) ** 2, abs=1e-12)
    assert float(abs(found.transmitted_p) ** 2) == pytest.approx(4 * admittance / (1 + admittance) ** 2, abs=1e-12)


def test_total_reflection_retards_as_fresnel_says():
    """tan(δ/2) = cos θ·√(sin²θ − n⁻²)/sin²θ (Born and Wolf 1999, section 1.5.4), without loss."""
    for angle in (45.0, 51.79):
        items = [surface(material=GLASS, thickness=1.0), coordinate_break(tilt=(angle, 0.0, 0.0))]
        items += [surface(material="mirror", coating=Coating(substrate=1.0))]
        items += [coordinate_break(tilt=(angle, 0.0, 0.0), thickness=-1.0)]
        found = polarized_trace(optical_system(items, 1.0, wavelengths=WAVELENGTH), along_z())
        sine, cosine = math.sin(math.radians(angle)), math.cos(math.radians(angle))
        phase = 2 * math.atan(cosine * math.sqrt(sine**2 - GLASS**-2) / sine**2)
        assert abs(float(found.retardance) - (math.pi - phase)) < 1e-12
        assert float(found.diattenuation) < 1e-7
        assert abs(float(found.transmittance) - 4 * GLASS / (1 + GLASS) ** 2) < 1e-12
    # Fresnel's rhomb: the phases of two reflections add up.
    phase = 2 * math.atan(math.sqrt(0.5) * math.sqrt(0.5 - GLASS**-2) / 0.5)
    twice = polarized_trace(folded((0, 0), Coating(substrate=1.0), GLASS), along_z())
    assert abs(float(twice.retardance) - 2 * phase) < 1e-12


def test_metal_fold_mirrors_in_parallel_and_crossed_planes():
    """Two mirrors at 45° in one plane double retardance and diattenuation; crossed ones take both away."""
    metal = Coating(substrate=0.96 + 6.69j)

    stack = [thin_film_stack(WAVELENGTH, (1.0, 0.96 + 6.69j), [], 45.0, name) for name in ("s", "p")]
    apart = abs(cmath.phase(-complex(stack[1].r / stack[0].r)))
    one, two, crossed = (polarized_trace(folded(axes, metal), along_z()) for axes in ((0,), (0, 0), (0, 1)))
    assert abs(float(one.retardance) - apart) < 1e-12 and abs(float(two.retardance) - 2 * apart) < 1e-12
    power = [float(item.reflectance) for item in stack]
    assert abs(float(one.diattenuation) - (power[0] - power[1]) / sum(power)) < 1e-10
    squared = [value**2 for value in power]
    assert abs(float(two.diattenuation) - (squared[0] - squared[1]) / sum(squared)) < 1e-10
    assert float(crossed.retardance) < 1e-7 and float(crossed.diattenuation) < 1e-7
    assert abs(float(crossed.transmittance) - power[0] * power[1]) < 1e-12


def test_a_corner_cube_turns_the_field_by_its_geometry():
    """Three ideal mirrors: Q is the point reflection, and no retardance is found in what is geometry."""
    # Three planes at right angles, met one after the other by a ray along (1, 1, 1)/√3 in their frame.
    turn = coordinate_break
    items = [
        surface(thickness=0.0),
        turn(tilt=(0.0, -45.0, 0.0)),
        turn(tilt=(35.26438968275465, 0.0, 0.0)),
        surface(material="mirror"),
        turn(tilt=(0.0, 90.0, 0.0)),
        surface(material="mirror"),
        turn(tilt=(90.0, 0.0, 0.0)),
        surface(material="mirror"),
    ]
    system = optical_system(items, 1.0, wavelengths=WAVELENGTH)
    start = torch.tensor([[0.01, -0.02, -1.0], [0.0, 0.0, 1.0]], dtype=F64)
    found = polarized_trace(system, start)
    assert bool(found.traced.arrived.all())
    inverse = torch.linalg.inv(found.rotation[0, 0, 0])
    assert abs(float(torch.linalg.det(found.rotation[0, 0, 0])) + 1) < 1e-12
    assert torch.allclose(inverse, found.rotation[0, 0, 0].mT, atol=1e-12)
    assert float(found.retardance) < 1e-7 and abs(float(found.transmittance) - 1) < 1e-12
    frames, _ = system.frames(own=False)
    direction = frames[-1] @ found.outgoing[0, 0, 0]
    assert torch.allclose(direction, torch.tensor([0.0, 0.0, -1.0], dtype=F64), atol=1e-12)
    # In global coordinates the three reflections are the point reflection.
    assert torch.allclose(frames[-1] @ found.rotation[0, 0, 0], -torch.eye(3, dtype=F64), atol=1e-12)


def test_losses_of_a_lens_are_those_of_its_surfaces():
    """On the axis of a doublet: the product of Fresnel's transmittances; coated, of those of the stacks."""
    glasses = ("N-BK7", "N-SF5")
    lens = optical_system(
        [
            surface(60.0, thickness=4.0, material=glasses[0]),
            surface(-45.0, thickness=2.0, material=glasses[1]),
            surface(-130.0, thickness=95.0),
        ],
        10.0,
        wavelengths=[486e-6, 588e-6],
    )
    found = polarized_trace(lens, launch(lens, "rings", 1))
    index = lens.prescription().index
    expected = (4 * index[:, 1:] * index[:, :-1] / (index[:, 1:] + index[:, :-1]) ** 2).prod(-1)
    bare = found.transmittance[:, 0, 0] / found.absorption[:, 0, 0]
    assert torch.allclose(bare, expected, rtol=0, atol=1e-12)
    for i, wavelength in enumerate(lens.wavelengths):
        expected = internal_transmittance("N-BK7", wavelength, 4.0, "mm")
        expected *= internal_transmittance("N-SF5", wavelength, 2.0, "mm")
        assert 0.9 < expected < 1 and abs(float(found.absorption[i, 0, 0]) - expected) < 1e-14
    plain = trace(lens, launch(lens, "rings", 1))
    assert torch.allclose(found.traced.y, plain.y, rtol=0, atol=1e-12)


def test_ghosts_are_as_bright_as_two_reflections():
    """On the axis: R_2·R_1 of the two faces times the transmittances on the way."""
    lens = optical_system([surface(50.0, thickness=5.0, material=GLASS), surface(-80.0, thickness=60.0)], 5.0)
    found = polarized_trace(ghost_system(lens, 0, 1), launch(ghost_system(lens, 0, 1), "rings", 1))
    reflectance = ((GLASS - 1) / (GLASS + 1)) ** 2
    expected = reflectance**2 * (1 - reflectance) ** 2
    assert abs(float(found.transmittance[0, 0, 0]) / expected - 1) < 1e-12
    films = Coating((1.38,), [100e-6])
    coated = optical_system(
        [
            surface(50.0, thickness=5.0, material=GLASS, coating=films),
            surface(-80.0, thickness=60.0, coating=films.reversed()),
        ],
        5.0,
        wavelengths=WAVELENGTH,
    )
    ghost = ghost_system(coated, 0, 1)
    found = polarized_trace(ghost, launch(ghost, "rings", 1))
    r = float(thin_film_stack(WAVELENGTH, (1.0, 1.38, GLASS), [100e-6]).reflectance)
    assert abs(float(found.transmittance[0, 0, 0]) / (r**2 * (1 - r) ** 2) - 1) < 1e-10


def test_a_singlet_has_one_ghost_of_known_power_and_focus():
    """Power R²(1 − R)² on the axis; the focus by matrices of first order (Gerrard and Burch, 1975)."""
    n, t, r1, r2, back = 1.6, 5.0, 60.0, -90.0, 40.0
    lens = optical_system([surface(r1, thickness=t, material=n), surface(r2, thickness=back)], 0.02, fields=[0.0, 3.0])
    (ghost,) = ghosts(lens, samples=5).paths
    reflectance = ((n - 1) / (n + 1)) ** 2
    assert float(ghost.power[0]) == pytest.approx(reflectance**2 * (1 - reflectance) ** 2, rel=1e-6)
    # Heights and angles, unfolded: (y, angle) through refraction, two mirrors within the glass, and refraction.
    move = np.array([[1, t], [0, 1]])
    enter = np.array([[1, 0], [(1 - n) / (r1 * n), 1 / n]])
    far, near = (np.array([[1, 0], [2 / r, 1]]) for r in (r2, -r1))
    leave = np.array([[1, 0], [(n - 1) / r2, n]])
    y, angle = leave @ move @ near @ move @ far @ move @ enter @ np.array([1.0, 0.0])
    assert float(ghost.focus) == pytest.approx(-y / angle - back, rel=1e-9)
    # A spot of a disc of uniform light, far from focus: RMS radius over the edge's is 1/√2.
    edge = 0.01 * abs(y + angle * back)
    assert float(ghost.radius[0]) == pytest.approx(edge / 2**0.5, rel=0.2)


def test_ghosts_agree_with_light_that_finds_its_own_way():
    """The same lens as a scene: what arrives beside the image is the ghost, and of four reflections R² times that."""
    lens = optical_system([surface(60.0, thickness=5.0, material=1.6), surface(-90.0, thickness=55.0)], 8.0)
    found = ghosts(lens, samples=21)
    rays = launch(lens, "grid", 21).to_tensor().reshape(-1, 2, 3)
    rays = torch.stack((rays[:, 0] - rays[:, 1], rays[:, 1]), 1)
    light = Light(rays, torch.full((len(rays),), 1 / len(rays), dtype=torch.float64))
    held = (
        RayScene(system_elements(lens)).trace(light, lens.wavelengths[0], split=True, threshold=1e-9).received["image"]
    )
    order = (held.power * len(rays)).log10()
    assert float(held.power[order > -1].sum()) == pytest.approx(float(found.direct[0]), rel=1e-6)
    weak = (order < -1) & (order > -4)
    assert float(held.power[weak].sum()) == pytest.approx(float(found.paths[0].power[0]), rel=1e-4)
    scene_map = held._replace(power=torch.where(weak, held.power, 0.0)).irradiance((30.0, 30.0), (9, 9))
    assert torch.allclose(scene_map, found.irradiance((30.0, 30.0), (9, 9)), rtol=1e-3, atol=1e-12)


def test_a_system_and_its_elements_agree():
    """A coated triplet and a fold with a lens behind its mirror: places, directions, paths and power of rays."""
    triplet = load_system("cooke_triplet")
    for i, item in enumerate(triplet.surfaces):
        item.coating = Coating((1.38,), [100e-6]) if i % 2 == 0 else Coating((1.38,), [100e-6]).reversed()
    turn = {"tilt": (45.0, 0.0, 0.0)}
    fold = [
        surface(80.0, thickness=3.0, material=1.5),
        surface(thickness=10.0),
        coordinate_break(**turn),
        surface(material="mirror", coating=Coating(substrate=0.96 + 6.69j)),
        coordinate_break(**turn, thickness=-20.0),
        surface(-70.0, thickness=-4.0, material=1.6, coating=Coating((1.38,), [100e-6]), semi_diameter=9.0),
        surface(thickness=-30.0),
    ]
    for lens in (triplet, optical_system(fold, 6.0, fields=[0.0, 2.0])):
        wave = lens.wavelengths[lens.reference]
        rays = launch(lens, "rings", 2, prescription=lens.prescription([wave]))
        traced = polarized_trace(lens, rays, prescription=lens.prescription([wave]))
        given = rays.to_tensor().reshape(-1, 2, 3)
        given = torch.stack((given[:, 0] - 9 * given[:, 1], given[:, 1]), 1)
        light = Light(given, torch.ones(len(given), dtype=F64)).polarized()
        held = RayScene(system_elements(lens)).trace(light, wave, split=True, threshold=0.2).received["image"]
        half = held.ray < len(given)
        assert torch.equal(held.ray[half], torch.arange(len(given)))
        for axis, place in enumerate((traced.traced.x, traced.traced.y)):
            assert (held.point[half, axis] - place.flatten()).abs().max() < 1e-10
        assert (held.path[half] - 9 - traced.traced.path.flatten()).abs().max() < 1e-10
        power = held.power[half] + held.power[~half]
        assert (power - traced.transmittance.flatten()).abs().max() < 1e-6
    with pytest.raises(ValueError, match=r"phases and gradients, got one at surfaces\[0\]"):
        system_elements(optical_system([surface(phase=LinearGrating(1.0))], 1.0))


def test_polarised_images_of_points():
    """Unpolarised light is the mean of two states; without losses and at low aperture the scalar image remains."""
    lens = load_system("cooke_triplet")
    one = polarized_point_spread_function(lens, (1.0, 0.0), 48, 48)
    two = polarized_point_spread_function(lens, (0.0, 1.0j), 48, 48)
    both = polarized_point_spread_function(lens, None, 48, 48)
    assert torch.allclose((one.intensity + two.intensity) / 2, both.intensity, rtol=1e-12, atol=1e-15)
    mirror = optical_system(
        [surface(-400.0, conic=-1.0, material="mirror", thickness=-200.0)], 4.0, wavelengths=WAVELENGTH
    )
    scalar, vector = point_spread_function(mirror, 16, 32), polarized_point_spread_function(mirror, (1, 1j), 16, 32)
    assert torch.allclose(scalar.intensity, vector.intensity, rtol=0, atol=1e-4)
    # The power of the longitudinal field of a high aperture follows from the sines of the angles.
    fast = optical_system(
        [surface(-20.0, conic=-1.0, material="mirror", thickness=-10.0)], 16.0, wavelengths=WAVELENGTH
    )
    along = polarized_point_spread_function(fast, (1.0, 0.0), 32, 64).intensity[0, 0]
    widths = [(along.sum(i) * torch.arange(-32, 32) ** 2).sum() / along.sum() for i in (0, 1)]
    assert float(widths[0] / widths[1]) > 1.02
    found = polarized_trace(fast, launch(fast, "rings", 3))
    field = (found.matrix @ torch.tensor([1.0, 0, 0], dtype=found.matrix.dtype))[0, 0]
    assert torch.allclose(field.abs().square().sum(-1), torch.ones(37, dtype=F64), atol=1e-12)
    assert torch.allclose(field[:, 2].real.abs(), found.outgoing[0, 0, :, 0].abs(), atol=1e-12)


def test_gradients_reach_the_films():
    """The transmittance by the thickness of a film, the index and the angle, against finite differences."""
    lens = tilted_plane(30.0, coating=Coating((1.38, 2.0), [80e-6, 50e-6]))
    item = lens.surfaces[0]
    given = [item.vary("thicknesses"), item.vary("tilt"), item.vary("index")]
    names = ["own_coating.thicknesses", "tilt", "index"]

    def power(thick, tilt, index):
        from torch.func import functional_call

        class Whole(torch.nn.Module):
            def __init__(self):
                super().__init__()
                self.lens = lens

            def forward(self):
                found = polarized_trace(self.lens, along_z())
                return found.transmittance, found.diattenuation

        values = dict(zip([f"lens.surfaces.0.{name}" for name in names], (thick, tilt, index), strict=True))
        return functional_call(Whole(), values, ())

    scaled = [given[0].detach() * 1.0, given[1].detach(), given[2].detach()]
    for value in scaled:
        value.requires_grad_()
    thick = (scaled[0].detach() * 1e6).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda a, b, c: power(a * 1e-6, b, c), (thick, *scaled[1:]), fast_mode=True, eps=1e-6, atol=1e-6
    )


def test_films_in_files_gratings_and_what_is_refused():
    films = Coating(("N-BK7", 1.4 + 0.2j), [1e-4, 2e-4])
    metal = Coating(substrate=0.9 + 6.0j)
    lens = optical_system(
        [
            surface(40.0, thickness=3.0, material=1.5, coating=films),
            surface(material="mirror", coating=metal, thickness=-9.0),
        ],
        2.0,
        wavelengths=WAVELENGTH,
    )
    again = system_from_dict(system_to_dict(lens))
    rays = launch(lens, "rings", 1)
    assert torch.equal(polarized_trace(again, rays).matrix, polarized_trace(lens, rays).matrix)
    grating = optical_system([surface(phase=LinearGrating(0.0, 300.0), thickness=9.0)], 1.0, wavelengths=WAVELENGTH)
    found = polarized_trace(grating, Rays.from_tensor(along_z()))
    assert torch.allclose(found.transmittance, torch.ones_like(found.transmittance), atol=1e-12)
    assert torch.allclose((found.rotation @ found.incoming[..., None])[..., 0], found.outgoing, atol=1e-12)
    with pytest.raises(ValueError, match="substrate of a coating belongs to mirrors"):
        surface(coating=metal)
    with pytest.raises(ValueError, match="thicknesses must have one entry for each of 1 media, got 2"):
        Coating((1.4,), [1.0, 2.0])
    with pytest.raises(ValueError, match=r"media\[0\] must be an index"):
        Coating((-1.4,), [1.0])
    with pytest.raises(ValueError, match="substrate is the end"):
        metal.reversed()


def rod(length):
    return optical_system(
        [surface(thickness=length, material=1.6, gradient=RadialGradient([-0.09])), surface(thickness=1.0)], 1.0
    )


def test_the_field_of_a_helical_ray_turns_by_rytovs_law():
    """n² = n0²(1 − g²r²): after one period of the helix the field is rotated by the solid angle 2π(1 − cos θ)."""
    n0, g, radius = 1.6, 0.3, 0.9
    pitch = 2 * math.pi / g * math.sqrt(1 - 2 * (g * radius) ** 2)
    index = n0 * math.sqrt(1 - (g * radius) ** 2)
    within = n0 * g * radius / index
    # In front of the plane face the direction that is refracted into the helix.
    sine = index * within
    ray = torch.tensor([[[radius, 0.0, 0.0], [0.0, sine, math.sqrt(1 - sine * sine)]]], dtype=F64)
    lens = rod(pitch)
    found = polarized_trace(lens, ray)
    assert torch.allclose(found.traced.x, ray[0, 0, 0], rtol=0, atol=1e-9)
    assert torch.allclose(found.outgoing, found.incoming, rtol=0, atol=1e-9)
    cosine = math.sqrt(1 - within * within)
    k = torch.tensor([0.0, within, cosine], dtype=F64)
    across = torch.tensor([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]], dtype=F64)
    angle = 2 * math.pi * (1 - cosine)
    expected = torch.eye(3, dtype=F64) + math.sin(angle) * across + (1 - math.cos(angle)) * across @ across
    # Within the rod: the refractions at its faces turn about x, the normal of the plane of incidence.
    tilt = math.asin(within) - math.asin(sine)
    turn = torch.tensor(
        [[1.0, 0, 0], [0, math.cos(tilt), math.sin(tilt)], [0, -math.sin(tilt), math.cos(tilt)]], dtype=F64
    )
    assert torch.allclose(turn @ found.incoming.reshape(3), k, atol=1e-9)
    assert torch.allclose(found.rotation.reshape(3, 3), turn.mT @ expected @ turn, rtol=0, atol=1e-9)


def test_graded_media_without_gradient_are_glass_everywhere():
    """A medium of constant index, and losses of its material over the way."""

    def system_of(**options):
        turn = {"tilt": (40.0, 10.0, 5.0)}
        return optical_system(
            [
                surface(30.0, thickness=5.0, material="SF6", **options),
                coordinate_break(**turn),
                surface(material="mirror"),
                coordinate_break(**turn, thickness=-6.0),
                surface(25.0, thickness=-20.0),
            ],
            2.0,
            wavelengths=[400e-6, 550e-6],
        )

    plain, curved = (
        polarized_trace(lens, launch(lens, "rings", 1))
        for lens in (system_of(), system_of(gradient=RadialGradient([0.0])))
    )
    for name in ("matrix", "rotation", "absorption", "transmittance"):
        assert torch.allclose(getattr(plain, name), getattr(curved, name), rtol=0, atol=1e-11), name
    assert float(plain.absorption.min()) < 0.99


def test_polarised_gradients_through_graded_media():
    lens = rod(4.0)
    values = [lens.surfaces[0].vary(name) for name in ("thickness", "coefficients")]
    ray = torch.tensor([[[0.5, 0.2, 0.0], [0.1, 0.3, math.sqrt(0.9)]]], dtype=F64)
    names = [name for name, _ in lens.named_parameters()]

    def matrix(ray, *given):
        held = dict(zip(names, given, strict=True))

        class Whole(torch.nn.Module):
            def __init__(self):
                super().__init__()
                self.lens = lens

            def forward(self, ray):
                return torch.view_as_real(polarized_trace(self.lens, ray).matrix)

        return torch.func.functional_call(Whole(), {f"lens.{name}": value for name, value in held.items()}, (ray,))

    order = {id(value): name for name, value in lens.named_parameters()}
    given = sorted(values, key=lambda value: names.index(order[id(value)]))
    assert torch.autograd.gradcheck(matrix, (ray.requires_grad_(), *given), fast_mode=True)
