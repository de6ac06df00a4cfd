"""Lenses, detectors and diffusers of the catalogue against geometry and the numbers of the specification."""

import numpy as np
import pytest

from odak import catalog
from odak.catalog.optics import plane_detector, plano_convex_lens, thin_diffuser
from odak.raytracing import create_ray_from_two_points
from odak.tools.transformation import rotation_matrix


class Figure:
    def __init__(self):
        self.calls = []

    def add_surface(self, **values):
        self.calls.append(values)


def grid(count, size, z, shift=0.0):
    x = np.linspace(-size / 2, size / 2, count)
    points = np.stack(np.meshgrid(x, x + shift, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack((points, np.full(len(points), z)))


def parallel_rays(points):
    return create_ray_from_two_points(points, np.add(points, [0.0, 0.0, 1.0]))


# Detector


def test_detector_counts_each_ray_where_it_lands():
    detector = plane_detector(resolution=[8, 6], shape=[8.0, 12.0], center=[1, 2, 10], angles=[20, -30, 40])
    random = np.random.default_rng(5)
    local = random.uniform(-7, 7, size=(400, 2))
    points = np.column_stack((local, np.zeros(400))) @ rotation_matrix(np.asarray([20.0, -30, 40])).T + [1, 2, 10]
    rays = create_ray_from_two_points([0, 0, -30], points)
    _, distance = detector.raytrace(rays)
    np.testing.assert_allclose(distance, np.linalg.norm(points - [0, 0, -30], axis=1), rtol=1e-12)
    expected = np.histogram2d(*local.T, bins=(8, 6), range=((-4, 4), (-6, 6)), weights=1000 / distance**2)[0]
    np.testing.assert_allclose(detector.get_amplitude()[..., 0], expected, rtol=1e-5)
    np.testing.assert_allclose(detector.get_intensity()[..., 0], expected**2, rtol=1e-5)
    assert not detector.get_phase().any()
    detector.clear_detector()
    assert not detector.get_field().any() and detector.get_field().dtype == np.complex64


@pytest.mark.parametrize("count", [1, 2, 3])
def test_detector_takes_any_number_of_rays(count):
    detector = plane_detector(resolution=[4, 6], shape=[8, 12], center=[0, 0, 10])
    rays = create_ray_from_two_points([0, 0, 0], [[0.5, 0.5, 10]] * count)
    detector.raytrace(rays)
    assert detector.get_field()[2, 3, 0] == pytest.approx(count * 1000 / 100.5, rel=1e-6)
    detector.raytrace(rays)
    assert detector.get_field()[2, 3, 0] == pytest.approx(2 * count * 1000 / 100.5, rel=1e-6)


def test_detector_of_the_older_test():
    rays = create_ray_from_two_points(grid(4, 100, 0.0), grid(4, 100, 100.0))
    detector = catalog.plane_detector(
        resolution=[5, 5], shape=[50, 50], center=[0.0, 0.0, 200.0], angles=[0.0, 10.0, 0.0]
    )
    detector.raytrace(rays)
    assert np.count_nonzero(detector.get_field()) <= 16


def test_detector_channels_and_amplitudes():
    detector = plane_detector(np.zeros((2, 2, 3)), [2, 2], [2, 2], [0, 0, 2])
    rays = create_ray_from_two_points([0, 0, 0], [[0.5, 0.5, 2], [-0.5, -0.5, 2]])
    _, distance = detector.raytrace(rays, field=np.asarray([1j, 2]), channel=[0, 2])
    weight = 1 / distance**2
    np.testing.assert_allclose(detector.get_field()[1, 1], [1j * weight[0], 0, 1j * weight[0]], rtol=1e-6)
    np.testing.assert_allclose(detector.get_field()[0, 0], [2 * weight[1], 0, 2 * weight[1]], rtol=1e-6)
    assert detector.get_phase()[1, 1, 0] == pytest.approx(np.pi / 2)
    start = np.full((2, 2), 1 + 1j)
    assert plane_detector(start, [2, 2]).get_field().shape == (2, 2, 1)


def test_detector_rims_and_rays_that_miss():
    detector = plane_detector(resolution=[2, 2], shape=[2.0, 2.0], center=[0, 0, 1])
    points = np.asarray([[-1.0, 0.5, 0], [1.0, 0.5, 0], [0.5, 3, 0], [0.5, 0.5, 2], [0.5, 0.5, 1], [np.nan] * 3])
    detector.raytrace(parallel_rays(points))  # lower rim, upper rim, outside, behind, on the detector, NaN
    np.testing.assert_array_equal(detector.get_amplitude()[..., 0], [[0, 1000], [0, 0]])


def test_detector_errors():
    with pytest.raises(ValueError, match=r"field must be \[2, 2\]"):
        plane_detector(np.zeros((3, 2)), [2, 2])
    with pytest.raises(ValueError, match="shape must be positive"):
        plane_detector(shape=[0, 1])
    detector = plane_detector(resolution=[2, 2])
    ray = create_ray_from_two_points([0, 0, -1], [0, 0, 1])
    with pytest.raises(ValueError, match="channel must be within"):
        detector.raytrace(ray, field=1.0, channel=1)
    with pytest.raises(ValueError, match=r"field must be a number, \[1\]"):
        detector.raytrace(ray, field=[1, 2, 3, 4])
    with pytest.raises(ValueError, match="plot_type must be one of"):
        detector.plot_detector(Figure(), plot_type="colour")


def test_detector_drawn():
    detector, figure = plane_detector(resolution=[3, 4], shape=[2, 6], center=[0, 0, 5]), Figure()
    detector.plot_detector(figure, plot_type="phase")
    (call,) = figure.calls
    assert call["surface_color"].shape == call["data_x"].shape == (3, 4)
    assert call["data_x"][-1, 0] == 1 and call["data_y"][0, -1] == 3 and (call["data_z"] == 5).all()


# Diffuser


def test_diffuser_points():
    points = thin_diffuser().diffusion_points
    np.testing.assert_allclose(points, [[0.01455, 0, 1], [0.02911, 0, 1], [-0.02911, 0, 1]], atol=5e-6)
    assert thin_diffuser().k == pytest.approx(125.66371)
    assert thin_diffuser().surface_points.shape == (10000, 3)
    assert not hasattr(thin_diffuser(phase=1), "surface_points")


@pytest.mark.parametrize("towards", [(0, 0, 1), (0.3, -0.5, 0.9), (0, 0, -1), (1, 2, -0.5)])
def test_diffuser_scatters_onward_within_its_cone(towards):
    diffuser = thin_diffuser(shape=[4, 4], angles=[10, 0, 0], diffusion_angle=30, diffusion_no=[3, 6])
    towards = np.asarray(towards) / np.linalg.norm(towards)
    new, _, distance = diffuser.raytrace(create_ray_from_two_points(-3 * towards, [0.0, 0, 0]))
    assert distance == pytest.approx(3)
    np.testing.assert_allclose(new[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(new[:, 1], axis=1), 1, atol=1e-12)
    tangent = np.tan(np.radians(15)) * np.asarray([1 / 3] * 2 + [2 / 3] * 4)
    np.testing.assert_allclose(new[:, 1] @ towards, 1 / np.sqrt(1 + tangent**2), atol=1e-12)


def test_directions_of_rays_may_be_of_any_length():
    ray = create_ray_from_two_points([0.2, 0.1, -3], [0.3, 0.4, 2])
    longer = ray * [[1.0], [2.5]]
    found, given = (thin_diffuser(diffusion_angle=30).raytrace(one)[0] for one in (longer, ray))
    np.testing.assert_allclose(found, given * [[1.0], [2.5]], atol=1e-12)
    fields = []
    for one in (longer, ray):
        detector = plane_detector(resolution=[4, 4], center=[0, 0, 2])
        detector.raytrace(one)
        fields.append(detector.get_field())
    np.testing.assert_allclose(*fields, rtol=1e-6)


def test_diffuser_rays_come_ray_by_ray_and_misses_are_flagged():
    diffuser = thin_diffuser(shape=[2, 2], diffusion_no=[3, 3])
    rays = parallel_rays(np.asarray([[0.0, 0, -1], [0, 5, -1], [0.5, 0, -1], [0, 0, 1]]))
    new, normal, distance = diffuser.raytrace(rays)
    assert new.shape == (12, 2, 3) and normal.shape == (4, 2, 3) and distance.shape == (4,)
    assert np.isfinite(new[[0, 1, 2, 6, 7, 8]]).all() and np.isnan(new[[3, 4, 5, 9, 10, 11]]).all()
    np.testing.assert_allclose(new[6:9, 0], [[0.5, 0, 0]] * 3, atol=1e-15)


def test_diffuser_then_detector():
    diffuser = catalog.thin_diffuser(
        shape=[50, 50], center=[0.0, 0.0, 100.0], diffusion_no=[5, 2], diffusion_angle=10.0
    )
    new, _, _ = diffuser.raytrace(create_ray_from_two_points(grid(2, 10, 0.0), grid(2, 10, 100.0, shift=5)))
    detector = catalog.plane_detector(resolution=[10, 10], shape=[100, 100], center=[0, 0, 200.0])
    detector.raytrace(new)
    assert new.shape == (8, 2, 3) and np.count_nonzero(detector.get_field()) > 0


def test_diffuser_drawn_and_checked():
    figure = Figure()
    thin_diffuser(center=[0, 0, 3]).plot_diffuser(figure)
    assert figure.calls[0]["data_z"].shape == (10, 10) and not figure.calls[0]["surface_color"].any()
    with pytest.raises(ValueError, match="diffusion_angle must be at least 0 and below 180"):
        thin_diffuser(diffusion_angle=180)


# Lens


def test_lens_geometry():
    lens = plano_convex_lens()
    np.testing.assert_allclose(lens.convex_surface, [0, 0, 1.1, 2.1])
    np.testing.assert_allclose(lens.convex_point, [0, 0, -1])
    assert lens.plane_surface[2] == 1.0 and (lens.diameter, lens.units) == (2.0, "mm")
    turned = plano_convex_lens("LA1036", [1, 2, 3], [0, 90, 0])
    np.testing.assert_allclose(turned.center, [2.6, 2, 3], atol=1e-12)
    np.testing.assert_allclose(turned.convex_point, [-0.5, 2, 3], atol=1e-12)
    for item in ("LA1024", "LA1026", "LA1036", "LA1039"):
        lens = plano_convex_lens(item)
        sag = lens.radius - np.sqrt(lens.radius**2 - lens.diameter**2 / 4)
        assert lens.thickness - sag == pytest.approx(
            lens.settings["edge thickness"], abs=0.12
        )  # edge thicknesses are rounded


def test_lens_of_the_older_test():
    points = grid(5, 2, 0.0)
    normal, distance = plano_convex_lens().intersect(create_ray_from_two_points([0, 0, -5], points))
    on_cap = np.hypot(*points[:, :2].T) <= 1
    assert np.isfinite(distance[on_cap]).all()
    hits = normal[np.isfinite(distance), 0]
    np.testing.assert_allclose(np.linalg.norm(hits - [0, 0, 1.1], axis=1), 2.1, atol=1e-12)
    axial, distance = plano_convex_lens().intersect([[0, 0, -5], [0, 0, 1]])
    np.testing.assert_allclose(axial, [[[0, 0, -1], [0, 0, 1]]], atol=1e-12)
    assert distance == pytest.approx(4)


def test_lens_faces_from_both_sides_and_apertures():
    lens = plano_convex_lens()
    back = create_ray_from_two_points([[0.2, 0, 5], [1.2, 0, 3], [0, 0, 5]], [[0.2, 0, 0], [1.2, 0, 0], [0, 0, 9]])
    normal, distance = lens.intersect(back)
    # The flat face and not the far side of the sphere; past the rim; away from the lens.
    np.testing.assert_allclose(normal[0], [[0.2, 0, 0], [0, 0, 1]], atol=1e-12)
    assert distance[0] == pytest.approx(5) and np.isnan(distance[1:]).all() and np.isnan(normal[1:]).all()
    inside, distance = lens.intersect([[0, 0, -0.5], [0, 0, -1]])
    np.testing.assert_allclose(inside[0, 0], [0, 0, -1], atol=1e-12)
    assert distance == pytest.approx(0.5)


def test_lens_focuses_at_its_focal_length():
    lens = plano_convex_lens("LA1039", wavelength=0.0005876)
    height = 1e-3
    (out,) = lens.raytrace(parallel_rays(np.asarray([[height, 0, -5.0]])))
    crossing = out[0, 2] - out[0, 0] * out[1, 2] / out[1, 0]
    focal = lens.radius / (1.5168 - 1)
    # f = R/(n − 1), from the principal plane at the convex vertex; thickness t shortens the way behind by t/n.
    assert crossing == pytest.approx(focal - lens.thickness / 1.5168, rel=1e-5)
    assert height / -(out[1, 0] / out[1, 2]) == pytest.approx(focal, rel=1e-5)
    (other,) = lens.raytrace(create_ray_from_two_points([height, 0, 5.0], [height, 0, 0.0]))
    assert other[0, 2] - other[0, 0] * other[1, 2] / other[1, 0] == pytest.approx(-lens.thickness - focal, rel=1e-5)


def test_lens_turned_and_moved_does_the_same():
    angles, location = [15.0, -40.0, 70.0], [3.0, -2.0, 1.0]
    matrix = rotation_matrix(np.asarray(angles))
    rays = create_ray_from_two_points(grid(3, 1.2, -4.0), grid(3, 1.0, 0.0))
    moved = np.stack((rays[:, 0] @ matrix.T + location, rays[:, 1] @ matrix.T), axis=1)
    expected = plano_convex_lens().raytrace(rays)
    found = plano_convex_lens(location=location, rotation=angles).raytrace(moved)
    np.testing.assert_allclose(found[:, 0], expected[:, 0] @ matrix.T + location, atol=1e-10)
    np.testing.assert_allclose(found[:, 1], expected[:, 1] @ matrix.T, atol=1e-10)


def test_lens_medium_and_index():
    assert plano_convex_lens().index() == pytest.approx(catalog.refractive_index("N-BK7", 532e-9))
    in_water = plano_convex_lens(medium="water").index()
    assert in_water == pytest.approx(1.5195 / 1.3352, abs=1e-3)
    rays = parallel_rays(grid(3, 1, -5.0))
    np.testing.assert_allclose(plano_convex_lens().raytrace(rays, n=1.0)[:, 1], rays[:, 1], atol=1e-12)
    assert plano_convex_lens().raytrace() is None
    assert np.isnan(plano_convex_lens().raytrace([[5, 0, -5], [0, 0, 1]])).all()


def test_unknown_lens_lists_the_known_ones():
    with pytest.raises(ValueError, match="LA1024, LA1026, LA1036, LA1039; got 'LA1025'"):
        plano_convex_lens("LA1025")
