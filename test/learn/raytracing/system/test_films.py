"""Polarising films in systems against Malus's law, the index ellipsoid, Jones matrices and energy."""

import json
import math

import numpy as np
import pytest
import torch

from odak.catalog import refractive_index
from odak.jones import circular_polarizer, polarizer, retarder
from odak.learn.raytracing import system_elements
from odak.learn.raytracing.system import (
    Coating,
    JonesFilm,
    PolarizerFilm,
    RetarderFilm,
    TableFilm,
    coordinate_break,
    flipped_system,
    ghost_system,
    ghosts,
    launch,
    optical_system,
    polarized_point_spread_function,
    polarized_trace,
    surface,
    system_from_dict,
    system_to_dict,
)
from odak.raytracing.interfaces import IdealLens

F64 = torch.float64
WAVE = 550e-6
HALF = PolarizerFilm.half_mirror()
REFLECTIVE = PolarizerFilm(0.0, (1.0, 0.0), (0.0, 1.0))


def along_z(u=0.0, v=0.0):
    return torch.tensor([[0.0, 0.0, 0.0], [u, v, math.sqrt(1 - u * u - v * v)]], dtype=F64)


def row(*films, mirror=(), **options):
    """Films one behind the other in air, 1 mm apart, those of the places in `mirror` as mirrors."""
    items, way = [], 1.0
    for i, film in enumerate(films):
        way = -way if i in mirror else way
        items.append(surface(thickness=way, coating=film, material="mirror" if i in mirror else "air"))
    return optical_system(items, 1.0, wavelengths=WAVE, **options)


def share(system, state=None, ray=None):
    return float(polarized_trace(system, along_z() if ray is None else ray).throughput(state))


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (40.0, 0.0), (0.0, 55.0), (-20.0, 30.0, 25.0)])
@pytest.mark.parametrize("angle", [0.0, 35.0, 120.0])
def test_malus_at_a_tilted_polariser(tilt, angle):
    """The absorbing axis in space, projected across the ray: |E·a|² is lost (Korger et al. 2013)."""
    film = PolarizerFilm(angle, film_index=1.0)
    tilted = optical_system([surface(coating=film, tilt=tilt, thickness=2.0)], 1.0, wavelengths=WAVE)
    x, y, z = (math.radians(value) for value in (*tilt, 0.0)[:3])
    a = math.radians(angle + 90.0) + z
    # About x, then about the fixed y axis.
    axis = np.array([math.cos(a), math.sin(a) * math.cos(x), math.sin(a) * math.sin(x)])
    axis = np.array([axis[0] * math.cos(y) + axis[2] * math.sin(y), axis[1]])
    axis /= np.linalg.norm(axis)
    for state in ((1.0, 0.0), (0.6, 0.8), (1.0, 1.0j)):
        field = np.array(state) / np.linalg.norm(state)
        assert share(tilted, state) == pytest.approx(1 - abs(axis @ field) ** 2, abs=1e-12)


def test_a_film_bends_the_ray_within_it():
    """A tilt by θ counts as one by asin(sin θ/n)."""
    angle, tilt, index = 30.0, 50.0, 1.5
    inner = math.degrees(math.asin(math.sin(math.radians(tilt)) / index))

    def passed(film, degrees):
        return share(optical_system([surface(coating=film, tilt=(degrees, 0.0))], 1.0, wavelengths=WAVE), (1.0, 0.0))

    bent = passed(PolarizerFilm(angle, film_index=index), tilt)
    assert bent == pytest.approx(passed(PolarizerFilm(angle, film_index=1.0), inner), abs=1e-12)
    assert abs(bent - passed(PolarizerFilm(angle, film_index=1.0), tilt)) > 0.02


def test_crossed_polarisers_leak_a_maltese_cross():
    """(kx·ky)²/((1 − kx²)(1 − ky²)) of the light that the first lets pass goes through the second."""
    crossed = row(PolarizerFilm(0.0, film_index=1.0), PolarizerFilm(90.0, film_index=1.0))
    for u, v in ((0.3, 0.0), (0.0, 0.6), (0.4, 0.4), (-0.5, 0.6)):
        expected = (u * v) ** 2 / ((1 - u * u) * (1 - v * v)) / 2
        assert share(crossed, ray=along_z(u, v)) == pytest.approx(expected, abs=1e-14)
    # The image of a point by an ideal lens of f/0.6: the transverse field is odd along x and along y, so that it has
    # four lobes; the field along z is odd along x alone.
    films = [surface(coating=PolarizerFilm(a, film_index=1.0), thickness=1.0) for a in (0.0, 90.0)]
    ends = [surface(phase=IdealLens(10.0), thickness=4.0), surface(thickness=4.0)]
    lens = optical_system([ends[0], *films, ends[1]], 16.0)
    found = polarized_point_spread_function(lens, (1.0, 0.0), 64, 128).intensity[0, 0]
    middle, brightest = 64, float(found.max())
    assert float(found[:, middle].max()) < 1e-5 * brightest
    assert 0.1 * brightest < float(found[middle].max()) < 0.5 * brightest
    assert float((found[1:, 1:] - found[1:, 1:].flip(0)).abs().max()) < 1e-3 * brightest
    row_of, column = divmod(int(found.argmax()), 128)
    assert abs(row_of - middle) > 1 and abs(column - middle) > 1
    open_lens = optical_system([surface(phase=IdealLens(10.0), thickness=10.0)], 16.0)
    whole = polarized_point_spread_function(open_lens, (1.0, 0.0), 64, 128).intensity.sum()
    rays = polarized_trace(lens, launch(lens, "grid", 64)).throughput((1.0, 0.0))
    assert float(found.sum() / whole) == pytest.approx(float(rays.mean()), rel=0.03)


def ellipsoid(wavelength, retardance, design, crystal, u, v, azimuth):
    """Jones matrix of a plate by wave vectors of the index ellipsoid; fast axis at 0 about z, ray (u, v)."""
    n_o, n_e = (float(refractive_index(name, wavelength, "mm", medium="air")) for name in crystal)
    d_o, d_e = (float(refractive_index(name, design, "mm", medium="air")) for name in crystal)
    thickness = retardance / 360 * design / abs(d_e - d_o)
    turned = math.radians(azimuth + (90.0 if d_e > d_o else 0.0))
    optic = np.array([math.cos(turned), math.sin(turned), 0.0])
    ordinary = np.array([u, v, math.sqrt(n_o**2 - u * u - v * v)])

    def off(w):
        k = np.array([u, v, w])
        along = k @ optic
        return along**2 / n_o**2 + (k @ k - along**2) / n_e**2 - 1

    low, high = 0.5, 3.0
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if off(middle) < 0 else (low, middle)
    phases = [2 * math.pi * thickness / wavelength * w for w in (low, ordinary[2])]
    k = ordinary / np.linalg.norm(ordinary)
    extra = optic - k * (k @ optic)
    extra /= np.linalg.norm(extra)
    # From the ray within to the ray outside: the axis across both stays.
    across = np.array([-v, u, 0.0]) / math.hypot(u, v)
    outside = np.array([u, v, math.sqrt(1 - u * u - v * v)])
    first = [extra @ across, extra @ np.cross(across, k)]
    axis = first[0] * across + first[1] * np.cross(across, outside)
    other = np.cross(outside, axis)
    return np.exp(1j * phases[0]) * np.outer(axis, axis) + np.exp(1j * phases[1]) * np.outer(other, other)


@pytest.mark.parametrize("material", ["quartz", "calcite"])
@pytest.mark.parametrize("wavelength", [WAVE, 480e-6])
def test_wave_plates_off_axis(material, wavelength):
    """Phases of ordinary and extraordinary waves at any direction; quartz is positive, calcite negative."""
    crystal = [f"{material} (ordinary)", f"{material} (extraordinary)"]
    plate = RetarderFilm(3 * 360 + 90, 25.0, WAVE, crystal)
    system = row(plate)
    for u, v in ((0.2, 0.1), (-0.5, 0.3)):
        found = polarized_trace(system, along_z(u, v), prescription=system.prescription([wavelength]))
        matrix = found.matrix[0, 0, 0].numpy()
        way = np.array([u, v, math.sqrt(1 - u * u - v * v)])
        expected = ellipsoid(wavelength, 3 * 360 + 90, WAVE, crystal, u, v, 25.0)
        ours = matrix - np.outer(way, way)
        phase = np.vdot(expected, ours)
        assert np.abs(ours - expected * phase / abs(phase)).max() < 1e-9
    on_axis = polarized_trace(system, along_z()).jones[0, 0, 0].numpy()
    assert np.abs(on_axis - retarder(3 * 360 + 90, 25.0)).max() < 1e-9


def test_a_weakly_birefringent_film_is_the_limit_of_crystals():
    near, limit = (row(RetarderFilm(90.0, 20.0, None, c)) for c in ((1.5, 1.5 + 1e-7), (1.5, 1.5)))
    both = [polarized_trace(s, along_z(0.5, 0.2)).matrix for s in (near, limit)]
    assert float((both[0] - both[1]).abs().max()) < 1e-6
    # A path 1/cos θ as long across the optic axis, and cos θ as much of the index difference along it.
    inner = math.sqrt(1 - (0.6 / 1.5) ** 2)
    for u, v, factor in ((0.6, 0.0, 1 / inner), (0.0, 0.6, inner)):
        found = polarized_trace(row(RetarderFilm(90.0, 0.0)), along_z(u, v))
        assert float(found.retardance) == pytest.approx(math.pi / 2 * factor, abs=1e-12)


def test_a_plate_passed_twice_by_way_of_a_mirror():
    """A quarter-wave plate in front of a mirror turns x into y; the ideal mirror and the film agree on signs."""
    quarter, polariser = RetarderFilm(90.0, 45.0), PolarizerFilm(0.0)
    for mirror in (None, PolarizerFilm(0.0, (0.0, 0.0), (1.0, 1.0))):
        back = row(polariser, quarter, mirror, quarter, polariser, mirror=(2,))
        assert share(back, (1.0, 0.0)) < 1e-30
        back.surfaces[4].coating = PolarizerFilm(90.0)
        assert share(back, (1.0, 0.0)) == pytest.approx(1.0, abs=1e-12)
    bare, film = (row(mirror, mirror=(0,)) for mirror in (None, PolarizerFilm(0.0, (0.0, 0.0), (1.0, 1.0))))
    rays = [polarized_trace(s, along_z(0.3, 0.2)) for s in (bare, film)]
    assert float((rays[0].matrix - rays[1].matrix).abs().max()) < 1e-14
    assert float((rays[0].rotation - rays[1].rotation).abs().max()) < 1e-14


def test_circular_polarisers_made_of_two_films_and_of_a_matrix():
    """A polariser and a quarter-wave plate; a cholesteric film passes one handedness and reflects the other."""
    made = row(PolarizerFilm(0.0), RetarderFilm(90.0, 45.0))
    right = JonesFilm(circular_polarizer("right"))
    assert share(made, (1.0, 0.0)) == pytest.approx(1.0, abs=1e-12)
    behind = row(PolarizerFilm(0.0), RetarderFilm(90.0, 45.0), right)
    assert share(behind, (1.0, 0.0)) == pytest.approx(1.0, abs=1e-12)
    # Backwards the same film passes the same handedness as its observer sees it.
    reflecting = JonesFilm(circular_polarizer("left"), [[0.5, 0.5j], [0.5j, -0.5]])
    for state, expected in (((1.0, -1.0j), 1.0), ((1.0, 1.0j), 0.0)):
        assert share(row(reflecting), state) == pytest.approx(1 - expected, abs=1e-12)
        assert share(row(reflecting, mirror=(0,)), state) == pytest.approx(expected, abs=1e-12)
        # Its handedness stays, so that the right circular polariser in the way back passes all of it.
        assert share(row(reflecting, right, mirror=(0,)), state) == pytest.approx(expected, abs=1e-12)


def test_energy_is_conserved_by_films_that_do_not_absorb():
    for film in (HALF, REFLECTIVE, JonesFilm(circular_polarizer("left"), [[0.5, 0.5j], [0.5j, -0.5]])):
        for state in ((1.0, 0.0), (0.3, 0.8j), None):
            for ray in (along_z(), along_z(0.4, -0.3)):
                both = share(row(film), state, ray) + share(row(film, mirror=(0,)), state, ray)
                assert both == pytest.approx(1.0, abs=1e-12)
    for bad in (
        lambda: PolarizerFilm(0.0, (1.0, 0.0), (0.1, 1.0)),
        lambda: JonesFilm(1.01 * np.eye(2)),
        lambda: PolarizerFilm.half_mirror(1.1),
    ):
        with pytest.raises(ValueError, match=r"at most 1|not gain"):
            bad()


def test_films_on_tilted_frames_and_curved_faces():
    """A film on a sphere counts as the tangent plane where the ray meets it; a break as the tilt of its surface."""
    film = PolarizerFilm(30.0, film_index=1.0)
    tilted = optical_system([surface(coating=film, tilt=(25.0, 0.0), thickness=2.0)], 1.0, wavelengths=WAVE)
    broken = [coordinate_break(tilt=(25.0, 0.0, 0.0)), surface(coating=film), coordinate_break(tilt=(-25.0, 0.0, 0.0))]
    ball = optical_system([surface(10.0, coating=film, thickness=2.0)], 1.0, wavelengths=WAVE)
    height = 10 * math.sin(math.radians(25.0))
    ray = torch.tensor([[0.0, height, -1.0], [0.0, 0.0, 1.0]], dtype=F64)
    expected = share(tilted, (1.0, 0.0))
    assert share(optical_system([*broken, surface(thickness=1.0)], 1.0, wavelengths=WAVE), (1.0, 0.0)) == (
        pytest.approx(expected, abs=1e-12)
    )
    assert share(ball, (1.0, 0.0), ray) == pytest.approx(expected, abs=1e-12)


def test_a_table_of_matrices_is_interpolated():
    """Tables with the matrices of a plate come near it, and refuse rays outside."""
    waves, angles = [500e-6, 550e-6, 600e-6], np.linspace(0, 40, 9)
    plate = RetarderFilm(90.0, 45.0, WAVE)
    sines = np.sin(np.radians(angles))
    table = np.array([plate.matrices(sines, 0 * sines, wave).transmission for wave in waves])
    film = JonesFilm(table, None, waves, angles)
    system = row(film)
    for angle, wave, within in ((20.0, 550e-6, 1e-12), (12.0, 550e-6, 1e-3), (20.0, 570e-6, 5e-3)):
        ray, numbers = along_z(math.sin(math.radians(angle))), [wave]
        found, exact = (
            polarized_trace(s, ray, prescription=s.prescription(numbers)).jones for s in (system, row(plate))
        )
        assert float((found - exact).abs().max()) < within
    with pytest.raises(ValueError, match="angles of a table"):
        share(system, ray=along_z(0.8))
    with pytest.raises(ValueError, match="wavelengths of a table"):
        polarized_trace(system, along_z(), prescription=system.prescription([700e-6]))
    only = JonesFilm(table[:, :1], None, waves)
    assert np.abs(share(row(PolarizerFilm(0.0), only), (1.0, 0.0)) - 1) < 1e-12


def pancake(retardance=90.0, angle=45.0, curved=False):
    """From the eye: reflective polariser, quarter-wave plate, half mirror, and the display's circular polariser."""
    quarter = RetarderFilm(retardance, angle)
    return optical_system(
        [
            surface(coating=REFLECTIVE, thickness=0.5, stop=True),
            surface(coating=quarter, thickness=5.0),
            surface(-120.0 if curved else math.inf, coating=HALF, thickness=5.0),
            surface(coating=RetarderFilm(90.0, 45.0), thickness=0.5),
            surface(coating=PolarizerFilm(0.0), thickness=5.0),
        ],
        1.0,
        wavelengths=WAVE,
    )


@pytest.mark.parametrize("retardance, angle", [(90.0, 45.0), (80.0, 45.0), (97.0, 38.0)])
def test_a_pancake_and_its_ghosts_by_jones_matrices(retardance, angle):
    """Direct light, the image of two reflections and the ghosts of four and six, each as a product of matrices."""
    system = pancake(retardance, angle)
    found = ghosts(system, 3, reflections=6)
    plate, passes, turns = retarder(retardance, angle), np.diag([1.0, 0.0]), np.diag([0.0, 1.0])
    behind = passes @ retarder(90.0, 45.0) * math.sqrt(0.5)
    state = plate @ passes
    powers = {}
    for order in range(4):
        powers[2 * order] = np.linalg.norm(behind @ state) ** 2 / 2
        state = math.sqrt(0.5) * plate @ turns @ plate @ state
    assert float(found.direct) == pytest.approx(powers[0], abs=1e-12)
    if (retardance, angle) == (90.0, 45.0):
        # A quarter of the light that the polariser passes, and nothing else.
        assert [powers[n] for n in (0, 2, 4)] == pytest.approx([0.0, 0.125, 0.0], abs=1e-12)
        assert share(ghost_system(system, 0, 2), (1.0, 0.0)) == pytest.approx(0.25, abs=1e-12)
    by_order = {2 + len(ghost.further): float(ghost.power) for ghost in found.paths}
    for order in (2, 4, 6):
        assert by_order.get(order, 0.0) == pytest.approx(powers[order], abs=2e-9)
    assert {(ghost.first, ghost.second) for ghost in found.paths} == {(0, 2)}
    # Of what the first polariser blocks nothing arrives; of the rest twice as much as of unpolarised light.
    for state, factor in (((0.0, 1.0), 0.0), ((1.0, 0.0), 2.0)):
        of_state = ghosts(system, 3, polarization=state)
        assert float(of_state.direct) == pytest.approx(factor * powers[0], abs=1e-12)
        assert sum(float(g.power) for g in of_state.paths) == pytest.approx(factor * powers[2], abs=2e-9)


def test_ghosts_of_four_reflections_of_bare_faces():
    """R⁴(1 − R)² of a slab; R is small, but the sequence is that of a slab that is passed five times."""
    slab = optical_system([surface(thickness=2.0, material=1.8), surface(thickness=3.0)], 1.0, wavelengths=WAVE)
    reflectance = (0.8 / 2.8) ** 2
    for n, places in ((2, (0, 1)), (4, (0, 1, 1, 0))):
        system = ghost_system(slab, *places)
        assert len(system.surfaces) == 2 + n
        assert share(system) == pytest.approx(reflectance**n * (1 - reflectance) ** 2, rel=1e-12)
        last = polarized_trace(system, along_z()).traced.path
        assert float(last) == pytest.approx(1.8 * 2.0 * (n + 1) + 3.0, abs=1e-12)
    assert len(ghosts(slab, 3, reflections=4).paths) == 2
    with pytest.raises(ValueError, match="even"):
        ghosts(slab, 3, reflections=3)
    for wrong in ((0, 1, 1), (0, 1, 0, 1)):
        with pytest.raises(ValueError, match="pairs"):
            ghost_system(slab, *wrong)


def test_gradients_reach_axis_retardance_and_amplitudes():
    """By finite differences, in rays that meet tilted films, and through the ghost that a pancake makes."""
    names = ("retardance", "angle", "transmitted", "tilt")

    def power(retardance, angle, transmitted, tilt):
        items = [
            surface(coating=PolarizerFilm(20.0), thickness=1.0),
            surface(coating=RetarderFilm(100.0, 30.0, WAVE, (1.55, 1.6)), thickness=1.0, tilt=(10.0, 5.0)),
            surface(coating=PolarizerFilm(70.0, (0.9, 0.1)), thickness=1.0),
        ]
        system = optical_system(items, 1.0, wavelengths=WAVE)
        rays = torch.stack([along_z(0.3, 0.2), along_z(-0.1, 0.4), along_z()])
        values = {
            "surfaces.1.own_coating.retardance": retardance,
            "surfaces.1.own_coating.angle": angle,
            "surfaces.2.own_coating.transmitted": transmitted,
            "surfaces.1.tilt": tilt,
        }
        return torch.func.functional_call(_Power(system), {f"system.{k}": v for k, v in values.items()}, (rays,))

    start = [torch.tensor(v, dtype=F64, requires_grad=True) for v in (100.0, 30.0, [0.9, 0.1], [10.0, 5.0])]
    assert len(names) == len(start) and torch.autograd.gradcheck(power, start, eps=1e-5, atol=1e-9, rtol=1e-5)


class _Power(torch.nn.Module):
    def __init__(self, system):
        super().__init__()
        self.system = system

    def forward(self, rays):
        return polarized_trace(self.system, rays).throughput((1.0, 0.5j))


def test_gradients_of_jones_matrices():
    matrix = torch.nn.Parameter(torch.as_tensor(0.9 * polarizer(20.0), dtype=torch.complex128))
    system = row(JonesFilm(matrix))
    polarized_trace(system, along_z(0.2, 0.1)).throughput((1.0, 1.0j)).sum().backward()
    step, given = 1e-6, matrix.detach().clone()
    for part in (1.0, 1.0j):
        change = torch.zeros(2, 2, dtype=torch.complex128)
        change[0, 1] = part * step
        up, down = (share(row(JonesFilm(given + s * change)), (1.0, 1.0j), along_z(0.2, 0.1)) for s in (1, -1))
        slope = (up - down) / (2 * step)
        assert float((matrix.grad[0, 1] * np.conj(part)).real) == pytest.approx(slope, abs=1e-8)


def test_the_contrast_of_a_pancake_improves_by_gradients():
    """A plate of 78° at 40° becomes the quarter-wave plate at 45° that is known to send nothing straight on."""
    system = pancake(78.0, 40.0)
    plate = system.surfaces[1]
    parameters = [plate.vary(name) for name in ("retardance", "angle")]
    wanted = ghost_system(system, 0, 2)
    optimizer = torch.optim.LBFGS(parameters, max_iter=60, line_search_fn="strong_wolfe", tolerance_change=1e-14)

    def loss():
        optimizer.zero_grad()
        direct, image = (polarized_trace(s, along_z()).transmittance.sum() for s in (system, wanted))
        value = direct / image
        value.backward()
        return value

    first = float(loss().detach())
    optimizer.step(loss)
    assert first > 0.02 and float(loss().detach()) < 1e-9
    assert [float(p.detach()) for p in parameters] == pytest.approx([90.0, 45.0], abs=0.01)


def test_systems_with_films_are_written_and_read():
    table = JonesFilm(np.stack([[polarizer(0.0), retarder(20.0, 30.0)]] * 2), None, (4e-4, 8e-4), (0.0, 60.0))
    crystal = ("quartz (ordinary)", "quartz (extraordinary)")
    films = [HALF, REFLECTIVE, RetarderFilm(450.0, 30.0, WAVE, crystal), JonesFilm(polarizer(20.0)), table]
    system = row(*films)
    entry = system_to_dict(system)
    again = system_from_dict(json.loads(json.dumps(entry)))
    ray = along_z(0.2, 0.3)
    assert share(again, (1.0, 0.5j), ray) == pytest.approx(share(system, (1.0, 0.5j), ray), abs=1e-14)
    assert system_to_dict(again) == entry
    with pytest.raises(ValueError, match="polarising films"):
        system_elements(system)
    turned = flipped_system(row(JonesFilm([[0.0, 1.0], [0.0, 0.0]])), 0, 0)
    assert share(turned, (1.0, 0.0)) == pytest.approx(1.0) and share(turned, (0.0, 1.0)) < 1e-30


def test_what_is_refused():
    with pytest.raises(ValueError, match="mirror must reflect"):
        surface(material="mirror", coating=RetarderFilm())
    with pytest.raises(TypeError, match="a Coating or a PolarizingFilm"):
        surface(coating="polariser")
    with pytest.raises(ValueError, match="crystal"):
        RetarderFilm(90.0, 0.0, WAVE, (1.5,))
    with pytest.raises(ValueError, match="transmission must be complex"):
        JonesFilm(np.eye(3))
    with pytest.raises(ValueError, match="must rise"):
        JonesFilm(np.zeros((2, 1, 2, 2)), None, (2.0, 1.0))


def test_a_pellicle_between_equal_media_counts():
    """A film of glass in air reflects, though the medium is the same on both sides."""
    pellicle = row(Coating((1.5,), [WAVE / 4 / 1.5]))
    assert share(pellicle) == pytest.approx(1 - ((1 - 1.5**2) / (1 + 1.5**2)) ** 2, abs=1e-12)


def fresnel_table(index, angles):
    """Transmittances [A, 2] of s and p at a bare face, by Fresnel's formulas."""
    theta = np.radians(angles)
    inside = np.arcsin(np.sin(theta) / index)
    with np.errstate(invalid="ignore"):
        s = (np.sin(theta - inside) / np.sin(theta + inside)) ** 2
        p = (np.tan(theta - inside) / np.tan(theta + inside)) ** 2
    s[theta == 0] = p[theta == 0] = ((index - 1) / (index + 1)) ** 2
    return 1 - np.stack([s, p], -1)


@pytest.mark.parametrize("ray", [(0.0, 0.0), (0.0, 0.5), (0.4, 0.0), (-0.45, 0.5)])
def test_a_table_of_a_bare_face_acts_as_the_face(ray):
    """Fresnel's powers of s and p as a table: throughputs of all linear states, the rest reflected."""
    angles = np.linspace(0, 89, 8901)
    passed = fresnel_table(1.5, angles)[None]
    film = TableFilm(passed, 1 - passed, angles=angles.tolist())
    bare = optical_system([surface(material=1.5, thickness=1.0)], 1.0, wavelengths=WAVE)
    for azimuth in (0.0, 35.0, 90.0):
        state = (math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth)))
        expected = share(bare, state, along_z(*ray))
        assert share(row(film), state, along_z(*ray)) == pytest.approx(expected, abs=2e-7), azimuth
        back = share(row(film, mirror=(0,)), state, along_z(*ray))
        assert back == pytest.approx(1 - expected, abs=2e-7)


def test_tables_of_films_are_interpolated_checked_and_written():
    film = TableFilm([[0.2, 0.4], [0.6, 1.0]], wavelengths=[500e-6, 600e-6], angles=[0.0, 60.0])
    system = row(film)
    assert share(system) == pytest.approx(0.4, abs=1e-12) and not film.reflects
    assert share(system, ray=along_z(0.5)) == pytest.approx((0.4 + 0.7) / 2, abs=1e-12)
    again = system_from_dict(json.loads(json.dumps(system_to_dict(system))))
    assert share(again, ray=along_z(0.5)) == share(system, ray=along_z(0.5))
    numbers = torch.tensor([[[0.2, 0.4]]], dtype=F64, requires_grad=True)
    x = torch.tensor([0.3], dtype=F64)
    powers = TableFilm(numbers).matrices(x, 0 * x, WAVE).transmission.abs().square().sum()
    assert torch.autograd.grad(powers, numbers)[0].flatten().tolist() == pytest.approx([1.0, 1.0])
    for table, words in (
        ([[0.7]], "must not gain power, got 1.3"),
        ([[-0.1]], "must be at least 0"),
        ([[0.5, 0.5]], r"transmittance must be \[1, 1\] or"),
    ):
        with pytest.raises(ValueError, match=words):
            TableFilm(table, [[0.6]])
    with pytest.raises(ValueError, match="angles of a table of a film reach from 0 to 60"):
        share(system, ray=along_z(0.9))
