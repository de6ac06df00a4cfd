"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch

import odak.raytracing.interfaces
import odak.raytracing.intersections
import odak.raytracing.surfaces

def airy_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    scale: float | torch.Tensor | collections.abc.Sequence[float | torch.Tensor],
    decay: float | torch.Tensor = 0.05,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a finite-energy Airy beam, whose peak follows a parabola."""
    ...

def aspheric_lens_phase(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    radius: float | torch.Tensor,
    index: float | torch.Tensor = 1.5,
    conic: float | torch.Tensor = 0.0,
    coefficients: collections.abc.Sequence[typing.Any] = (),
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin plano-aspheric lens, −k(n − 1)·sag(r)."""
    ...

def axicon_phase(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angle: float | torch.Tensor,
    index: float | torch.Tensor = 1.5,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin axicon, −k(n − 1)·tan(angle)·r."""
    ...

def beam_quality(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
) -> torch.Tensor:
    """Return the beam quality factor M² along rows and columns."""
    ...

def beam_width(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    method: str = 'D4sigma',
) -> torch.Tensor:
    """Return the widths of a beam along rows and columns."""
    ...

def bessel_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angle: float | torch.Tensor,
    order: int = 0,
    waist: float | torch.Tensor | None = None,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Bessel beam: plane waves on a cone, which keep their transverse profile."""
    ...

def blazed_grating(
    nx: int,
    ny: int,
    levels: int = 2,
    axis: str = 'x',
) -> torch.Tensor:
    """Return a blazed grating of a period of `levels` samples."""
    ...

def box_volume_sample(
    no: collections.abc.Sequence[int] = (10, 10, 10),
    size: collections.abc.Sequence[float] | torch.Tensor = (100.0, 100.0, 100.0),
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the centres of the cells that a box is cut into."""
    ...

def bring_plane_to_origin(
    point: torch.Tensor,
    plane: torch.Tensor | None = None,
    shape: collections.abc.Sequence[float] = (10.0, 10.0),
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    mode: str = 'XYZ',
) -> torch.Tensor:
    """Return points in the frame of a plane that was rotated by `angles` and moved to `center`."""
    ...

def calculate_intersection_of_two_rays(
    ray0: torch.Tensor,
    ray1: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the intersection of two lines, and its distance along each of the rays."""
    ...

def center_of_triangle(
    triangle: torch.Tensor,
) -> torch.Tensor:
    """Return the mean of the corners of triangles."""
    ...

def circular_aperture(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    radius: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    inner_radius: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transmission of a disc or a ring, with the pixels of its edges weighted by the area inside."""
    ...

def circular_polarizer(
    handedness: str = 'right',
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of an ideal (homogeneous) circular polariser."""
    ...

def circular_sample(
    no: collections.abc.Sequence[int] = (10, 10),
    radius: float | torch.Tensor = 10.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return points of a disc on a polar grid, equally spaced in radius and angle, without the centre."""
    ...

def circular_uniform_random_sample(
    no: collections.abc.Sequence[int] = (10, 50),
    radius: float | torch.Tensor = 10.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    seed: int | numpy.random.Generator | None = None,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return independent random points of uniform density on a disc."""
    ...

def circular_uniform_sample(
    no: collections.abc.Sequence[int] = (10, 50),
    radius: float | torch.Tensor = 10.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return points of a disc on rings whose number of points grows with their radius."""
    ...

def create_ray_from_all_pairs(
    x0y0z0: torch.Tensor,
    x1y1z1: torch.Tensor,
) -> torch.Tensor:
    """Return a ray from each of the first points to each of the second ones."""
    ...

def create_ray_from_angles(
    point: torch.Tensor,
    angles: collections.abc.Sequence[float] | torch.Tensor,
    mode: str = 'XYZ',
) -> torch.Tensor:
    """Return the ray from a point along the rotated z axis."""
    ...

def create_ray_from_two_points(
    x0y0z0: torch.Tensor,
    x1y1z1: torch.Tensor,
) -> torch.Tensor:
    """Return rays from the first points towards the second ones."""
    ...

def crop_center(
    field: torch.Tensor,
    size: collections.abc.Sequence[int] | None = None,
) -> torch.Tensor:
    """Crop the centre of a field; sample ``n // 2`` of each axis stays the centre."""
    ...

def cross_product(
    vector1: torch.Tensor,
    vector2: torch.Tensor,
) -> torch.Tensor:
    """Return the vector product of two rays' directions as a ray that starts where the first does."""
    ...

def cylinder_function(
    point: torch.Tensor,
    cylinder: torch.Tensor,
) -> torch.Tensor:
    """Return the squared distance to the axis of a cylinder minus the squared radius."""
    ...

def cylindrical_lens_phase(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angle: float | torch.Tensor = 0.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin cylindrical lens, −π·s²/(λf), s being the distance from its axis line."""
    ...

def dammann_grating(
    shape: collections.abc.Sequence[int],
    period: float | collections.abc.Sequence[float],
    dx: float | collections.abc.Sequence[float],
    orders: int | collections.abc.Sequence[int] = 5,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the binary phase of a Dammann grating, which splits a beam into equal ones."""
    ...

def define_circle(
    center: torch.Tensor,
    radius: float,
    angles: collections.abc.Sequence[float] | torch.Tensor,
) -> list[torch.Tensor]:
    """Return a circle as [plane ``[3, 3]``, centre ``[3]``, radius ``[1]``]."""
    ...

def define_cylinder(
    center: collections.abc.Sequence[float] | torch.Tensor,
    radius: float | torch.Tensor,
    rotation: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
) -> torch.Tensor:
    """Return infinite cylinders as ``[c, r, q]``, q a point of the axis one unit from c."""
    ...

def define_plane(
    point: collections.abc.Sequence[float] | torch.Tensor,
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
) -> torch.Tensor:
    """Return three points of a plane through `point`, tilted."""
    ...

def define_sphere(
    center: collections.abc.Sequence[float] | torch.Tensor = ...,
    radius: float | torch.Tensor = ...,
) -> torch.Tensor:
    """Return spheres as ``[c_x, c_y, c_z, r]``."""
    ...

def depolarizer(
    kept: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Mueller matrix of an ideal depolariser, which no Jones matrix describes."""
    ...

def diattenuator(
    first: complex | torch.Tensor = 1.0,
    second: complex | torch.Tensor = 0.0,
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a partial polariser."""
    ...

def disk_source(
    radius: float,
    rings: int = 4,
    spokes: int = 12,
    center: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return directions and weights of a quadrature over a uniformly bright disk."""
    ...

def distance_between_two_points(
    point1: torch.Tensor,
    point2: torch.Tensor,
) -> torch.Tensor:
    """Return the distance between points."""
    ...

def double_convergence(
    nx: int,
    ny: int,
    k: float,
    r: float,
    dx: float | collections.abc.Sequence[float],
) -> torch.Tensor:
    """Return the phase factor exp(ik·r²/R) of a doubly converging beam (Engström et al., Opt. Express 15, 2007)."""
    ...

def electricfield(
    px: complex | torch.Tensor,
    py: complex | torch.Tensor,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones vector of the amplitudes `px` and `py`."""
    ...

def fibre_coupling(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    radius: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
) -> torch.Tensor:
    """Return the share of the power of a field that couples into a single-mode fibre."""
    ...

def find_nearest_points(
    ray0: torch.Tensor,
    ray1: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return, on each of two lines, the point nearest to the other line."""
    ...

def flat_top_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    waist: float | torch.Tensor,
    order: float | torch.Tensor = 10.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the amplitude of a flat-top beam, a super-Gaussian."""
    ...

def fresnel_coefficients(
    ray: torch.Tensor,
    normal: torch.Tensor,
    n1: float | torch.Tensor,
    n2: complex | torch.Tensor,
) -> odak.raytracing.interfaces.Fresnel:
    """Return the Fresnel coefficients of rays at surfaces, for the amplitude and for the power."""
    ...

def fresnel_zone_plate(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    kind: str = 'amplitude',
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transmission of a binary Fresnel zone plate."""
    ...

def gaussian_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    waist: float | torch.Tensor | collections.abc.Sequence[float],
    distance: float | torch.Tensor = 0.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Gaussian beam at a distance from its waist."""
    ...

def gaussian_spectrum(
    wavelength: float,
    width: float,
    count: int = 9,
    *,
    device: torch.device | str | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return wavelengths and weights of a quadrature over a Gaussian spectral line."""
    ...

def generate_complex_field(
    amplitude: float | torch.Tensor,
    phase: float | torch.Tensor,
) -> torch.Tensor:
    """Return amplitude·exp(i·phase)."""
    ...

def get_cylinder_normal(
    point: torch.Tensor,
    cylinder: torch.Tensor,
) -> torch.Tensor:
    """Return the outward normals of a cylinder at points of it, as rays from its axis."""
    ...

def get_points_along_a_ray_segment(
    ray: torch.Tensor,
    distances: torch.Tensor,
) -> torch.Tensor:
    """Return the points of rays at given distances from their starts."""
    ...

def get_sphere_normal_torch(
    point: torch.Tensor,
    sphere: torch.Tensor,
) -> torch.Tensor:
    """Return the rays from points of a sphere towards its centre."""
    ...

def get_triangle_normal(
    triangle: torch.Tensor,
    triangle_center: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the unit normals of triangles by the right-hand rule, as rays from their centres."""
    ...

def half_wave_plate(
    angle: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a half-wave plate: :func:`retarder` of 180°."""
    ...

def hermite_gaussian_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    waist: float | torch.Tensor | collections.abc.Sequence[float],
    order: collections.abc.Sequence[int] = (0, 0),
    distance: float | torch.Tensor = 0.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Hermite–Gauss mode at a distance from its waist."""
    ...

def impulse_response_fresnel(
    field: torch.Tensor,
    k: float | torch.Tensor | None,
    distance: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] | torch.Tensor,
    wavelength: float | torch.Tensor,
    zero_padding: bool = False,
    aperture: float | torch.Tensor = 1.0,
    scale: int = 1,
    samples: collections.abc.Sequence[int] = (20, 20, 5, 5),
) -> torch.Tensor:
    """Propagate by the sampled Fresnel impulse response (Voelz 2011, eq. 4.21)."""
    ...

def intersect_parametric(
    ray: torch.Tensor,
    parametric_surface: torch.Tensor,
    surface_function: collections.abc.Callable[..., typing.Any],
    surface_normal_function: collections.abc.Callable[..., typing.Any] = ...,
    target_error: float = 1e-08,
    iter_no_limit: int = 100000,
) -> tuple[torch.Tensor, ...]:
    """Intersect rays with a surface given as a function, at the nearest point ahead."""
    ...

def intersect_w_circle(
    ray: torch.Tensor,
    circle: collections.abc.Sequence[typing.Any],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect rays with the plane of a circle; the distance is 0 where the intersection lies outside the circle."""
    ...

def intersect_w_cylinder(
    ray: torch.Tensor,
    cylinder: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Intersect rays with an infinite cylinder, at the nearest point ahead, or the exit when the ray starts inside."""
    ...

def intersect_w_sag(
    ray: torch.Tensor,
    surface: odak.raytracing.surfaces.Shape,
    center: collections.abc.Sequence[float] | None = None,
    angles: collections.abc.Sequence[float] | None = None,
    aperture: float | None = None,
    ahead: bool = True,
) -> odak.raytracing.intersections.Hit:
    """Intersect rays with a surface z = sag(x, y), differentiable in rays, placement and parameters of the surface."""
    ...

def intersect_w_surface(
    ray: torch.Tensor,
    points: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect rays with the plane through three points."""
    ...

def intersect_w_triangle(
    ray: torch.Tensor,
    triangle: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Intersect rays with one triangle, ahead of the starts or behind them."""
    ...

def laguerre_gaussian_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    waist: float | torch.Tensor,
    radial: int = 0,
    azimuthal: int = 0,
    distance: float | torch.Tensor = 0.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Laguerre–Gauss mode, which carries an optical vortex, at a distance from its waist."""
    ...

def lens_phase(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin lens, −π·r²/(λf), on the field's own grid (optical axis at index n // 2)."""
    ...

def linear_grating(
    nx: int,
    ny: int,
    every: int = 2,
    add: float | None = None,
    axis: str = 'x',
) -> torch.Tensor:
    """Return a binary grating, of lines or as a checkerboard."""
    ...

def metalens_phase(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase that focuses a plane wave without spherical aberration, −k(√(r² + f²) − |f|), f > 0."""
    ...

def mirror(
    rx: complex | torch.Tensor = 1.0,
    ry: complex | torch.Tensor = 1.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a mirror: diag(rx, −ry), which swaps right and left."""
    ...

def mode_overlap(
    field: torch.Tensor,
    mode: torch.Tensor,
) -> torch.Tensor:
    """Return the share of the power of a field that is in a mode, |∑ mode*·field|²/(∑|mode|²·∑|field|²)."""
    ...

def normalize_phase(
    phase: torch.Tensor,
    range_min: float = 0.0,
    range_max: float = 6.283185307179586,
) -> torch.Tensor:
    """Return `phase` mapped linearly so that its extremes are `range_min` and `range_max`."""
    ...

def polarizer(
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of an ideal linear polariser."""
    ...

def power_in_bucket(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    radius: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
) -> torch.Tensor:
    """Return the share of the power of a field that lies within a circle."""
    ...

def prism_grating(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float | collections.abc.Sequence[float] = 0.001,
    axis: str = 'x',
    phase_offset: float = 0.0,
) -> torch.Tensor:
    """Return a blazed prism exp(−i(k·sin(angle)·x + offset)), counted from the first sample."""
    ...

def prism_phase_function(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float | collections.abc.Sequence[float] = 0.001,
    axis: str = 'x',
) -> torch.Tensor:
    """Return the transmission of a thin prism, exp(−ik·sin(angle)·x)."""
    ...

def propagate_a_ray(
    ray: torch.Tensor,
    distance: float | torch.Tensor,
) -> torch.Tensor:
    """Return rays whose starts are moved along their directions; the directions are unchanged."""
    ...

def propagate_beam(
    field: torch.Tensor,
    k: float | torch.Tensor | None = None,
    distance: float | torch.Tensor = ...,
    dx: float | collections.abc.Sequence[float] | torch.Tensor = ...,
    wavelength: float | torch.Tensor = ...,
    propagation_type: str = 'auto',
    kernel: torch.Tensor | None = None,
    zero_padding: bool | collections.abc.Sequence[bool] = (True, False, True),
    aperture: float | torch.Tensor = 1.0,
    scale: int = 1,
    samples: collections.abc.Sequence[int] = (20, 20, 5, 5),
    tolerance: float = 0.0001,
    axes: int | collections.abc.Sequence[int] = (-2, -1),
) -> torch.Tensor:
    """Propagate a field, by the method named or by the one whose error is at most 1e-4."""
    ...

def propagate_partially_coherent(
    field: torch.Tensor,
    spectrum: torch.Tensor,
    source: torch.Tensor,
    distance: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] | torch.Tensor,
    window_shape: collections.abc.Sequence[int] | None = None,
    window_dx: float | collections.abc.Sequence[float] | None = None,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    guard: float = 4.0,
    memory: int = 67108864,
) -> torch.Tensor:
    """Return the intensity on a window under partially coherent light: several wavelengths and directions."""
    ...

def propagate_ray(
    ray: torch.Tensor,
    distance: float | torch.Tensor,
) -> torch.Tensor:
    """Return rays whose starts are moved along their directions; the directions are unchanged."""
    ...

def pupil_function(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float,
    numerical_aperture: float | torch.Tensor,
    aberrations: collections.abc.Mapping[typing.Any, typing.Any] | None = None,
    obscuration: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the pupil of a lens, on the frequencies of the image that it forms."""
    ...

def q_plate(
    shape: collections.abc.Sequence[int],
    charge: float,
    retardance: float | torch.Tensor = 180.0,
    angle: float = 0.0,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the Jones matrices of a q-plate: a retarder whose fast axis rotates with the azimuth."""
    ...

def quarter_wave_plate(
    angle: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a quarter-wave plate: :func:`retarder` of 90°."""
    ...

def rectangular_aperture(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    size: collections.abc.Sequence[typing.Any],
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transmission of a rectangle, with the pixels of its edges weighted by the area inside."""
    ...

def reference_wave(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0),
    amplitude: float | torch.Tensor = 1.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return a plane wave on a camera, the reference of a recorded hologram."""
    ...

def reflect(
    input_ray: torch.Tensor,
    normal: torch.Tensor,
) -> torch.Tensor:
    """Reflect rays at surfaces: d' = d − 2(d·n)/(n·n)·n."""
    ...

def refract(
    vector: torch.Tensor,
    normvector: torch.Tensor,
    n1: float | torch.Tensor,
    n2: float | torch.Tensor,
    error: float = 0.01,
) -> torch.Tensor:
    """Refract rays at surfaces by Snell's law."""
    ...

def retarder(
    retardance: complex | torch.Tensor,
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a wave plate of any retardance."""
    ...

def rotationspeed(
    wavelength: torch.Tensor,
    c: float | torch.Tensor = 300000000000,
) -> torch.Tensor:
    """Return the angular frequency ω = 2πc/λ."""
    ...

def rotator(
    angle: complex | torch.Tensor,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a rotation of the polarisation, as an optically active crystal or a Faraday cell does."""
    ...

def rotmatx(
    angle: float | torch.Tensor,
) -> torch.Tensor:
    """Return the rotation about the x axis."""
    ...

def rotmaty(
    angle: float | torch.Tensor,
) -> torch.Tensor:
    """Return the rotation about the y axis."""
    ...

def rotmatz(
    angle: float | torch.Tensor,
) -> torch.Tensor:
    """Return the rotation about the z axis."""
    ...

def same_side(
    p1: torch.Tensor,
    p2: torch.Tensor,
    a: torch.Tensor,
    b: torch.Tensor,
) -> torch.Tensor:
    """Return whether p1 and p2 lie on the same side of the line through a and b."""
    ...

def seperable_impulse_response_fresnel(
    field: torch.Tensor,
    k: float | torch.Tensor | None,
    distance: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] | torch.Tensor,
    wavelength: float | torch.Tensor,
    zero_padding: bool = False,
    aperture: float | torch.Tensor = 1.0,
    scale: int = 1,
    samples: collections.abc.Sequence[int] = (20, 20, 5, 5),
) -> torch.Tensor:
    """Propagate by the sampled Fresnel impulse response (Voelz 2011, eq. 4.21)."""
    ...

def smooth_pad(
    field: torch.Tensor,
    size: collections.abc.Sequence[int] | None = None,
    method: str = 'center',
    smooth_factor: collections.abc.Sequence[float] | None = None,
) -> torch.Tensor:
    """Pad a field with its border samples, tapered to zero at the edge."""
    ...

def sphere_function(
    point: torch.Tensor,
    sphere: torch.Tensor,
) -> torch.Tensor:
    """Return |p − c|² − r², which is zero on a sphere and negative inside."""
    ...

def sphere_sample(
    no: collections.abc.Sequence[int] = (10, 10),
    radius: float | torch.Tensor = 1.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    k: collections.abc.Sequence[float] | torch.Tensor = (1, 2),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return points of a sphere on a grid of polar and azimuthal angles."""
    ...

def sphere_sample_uniform(
    no: collections.abc.Sequence[int] = (10, 10),
    radius: float | torch.Tensor = 1.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    k: collections.abc.Sequence[float] | torch.Tensor = (1, 2),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the points of :func:`sphere_sample` in a sheared order of the two angles; they are not uniform in area."""
    ...

def spiral_phase(
    shape: collections.abc.Sequence[int],
    charge: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a spiral plate, charge times the azimuth."""
    ...

def thin_film_transfer(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float,
    indices: collections.abc.Sequence[typing.Any],
    thicknesses: collections.abc.Sequence[typing.Any],
    *,
    reflect: bool = False,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transfer function of a stack of thin films for the transverse components of a polarised field."""
    ...

def wavenumber(
    wavelength: float | torch.Tensor,
) -> float | torch.Tensor:
    """Return the wave number 2π/λ."""
    ...

def zernike_basis(
    nx: int,
    ny: int,
    modes: collections.abc.Iterable[typing.Any],
    radius: float | torch.Tensor | None = None,
    dx: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return Zernike polynomials of root mean square 1, for sums that are taken again and again."""
    ...

def zernike_phase(
    nx: int,
    ny: int,
    coefficients: collections.abc.Mapping[typing.Any, typing.Any],
    radius: float | torch.Tensor | None = None,
    dx: float | collections.abc.Sequence[float] | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the aberration Σ c·Z as a phase, each Z a Zernike polynomial of root mean square 1 over the disc."""
    ...

def zero_pad(
    field: torch.Tensor,
    size: collections.abc.Sequence[int] | None = None,
    method: str = 'center',
) -> torch.Tensor:
    """Pad a field with zeros."""
    ...
