"""Views of meshes and of Gaussian splats from places of a pupil: light fields of scenes that are given as geometry.

Touches a display by the ray matrix from its panel to the pupils, along which each pixel is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from odak import _validate
from odak._torch_private import in_own_precision
from odak.learn._tensors import tensor
from odak.learn.tools.transformation import get_rotation_matrix, quaternion_to_rotation_matrix
from odak.learn.wave.displays.display import Display
from odak.learn.wave.gaussians.sets import Splats, complex_3d_gaussians, shown_opacities, softened, view_colours
from odak.learn.wave.gaussians.splatting import Tiling, composite_gaussians, finer_tiling
from odak.learn.wave.holograms.scenery import LightField
from odak.learn.wave.pictures import light_of

# Points of the boxes around triangles at a time, and pixels along the sides of the tiles that splats are composed in.
_POINTS, _TILE = 2**20, 64
# Splats nearer than this share of the distance of the scene are left out, and slopes beyond so many views are limited.
_NEAREST, _MARGIN = 0.05, 1.3
# From the axes of graphics, y up and z towards the viewer, to those of displays.
_GRAPHICS = (1.0, -1.0, -1.0)


class Surface(Protocol):
    """Triangles over shared vertices, such as :class:`odak.learn.raytracing.triangle_mesh`."""

    vertices: torch.Tensor
    faces: torch.Tensor
    normals: str | torch.Tensor

    def vertex_normals(self) -> torch.Tensor:
        """Return unit normals at the vertices ``[v, 3]``."""


@dataclass(frozen=True)
class Placement:
    """Where a scene stands before eyes: it is rotated, then scaled, then shifted.

    The axes of eyes are x along columns to the right, y along rows downwards, and z the distance from the plane of the
    pupils, all in metres. Those of scenes are of any unit.

    Parameters
    ----------
    scale : float
        Metres of a unit of the scene.
    shift : sequence of float
        Where the origin of the scene is, (x, y, z) in metres.
    rotation : torch.Tensor or sequence of sequence of float
        Rotation from the axes of the scene to those of eyes, ``[3, 3]``; by default none.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Placement
    >>> Placement(1e-3, (0.0, 0.0, 0.1)).of(torch.tensor([1.0, 2.0, 3.0]))
    tensor([0.0010, 0.0020, 0.1030])
    """

    scale: float = 1.0
    shift: Sequence[float] = (0.0, 0.0, 0.0)
    rotation: torch.Tensor | Sequence[Sequence[float]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", float(_validate.real("scale", self.scale, positive=True)))
        shift, turned = (tensor(name, getattr(self, name), torch.float64) for name in ("shift", "rotation"))
        _validate.shaped("shift", _validate.real("shift", shift), "[3]")
        _validate.shaped("rotation", _validate.real("rotation", turned), "[3, 3]")
        if not torch.allclose(turned @ turned.T, torch.eye(3, dtype=turned.dtype), atol=1e-6) or turned.det() < 0:
            raise ValueError(f"rotation must be a rotation matrix, got {turned.tolist()!r:.80}")
        object.__setattr__(self, "shift", tuple(shift.tolist()))
        object.__setattr__(self, "rotation", tuple(map(tuple, turned.tolist())))

    @classmethod
    def fitting(
        cls,
        points: torch.Tensor,
        display: Display,
        distance: float | None = None,
        turned: Sequence[float] = (0.0, 0.0, 0.0),
        share: float = 1.0,
    ) -> "Placement":
        """Return where a scene fills the picture of a display, seen as graphics show it: y up, z towards the viewer.

        Parameters
        ----------
        points : torch.Tensor
            Points of the scene ``[N, 3]``, such as the vertices of a mesh.
        display : Display
            A display for :class:`Eyes`.
        distance : float, optional
            Distance in metres from the pupils to the middle of the scene; by default that of the panel as it is seen.
        turned : sequence of float
            Angles in degrees by which the scene is rotated before about its x, y and z axis, in this order.
        share : float
            Share of the points that are to be seen, those furthest out being left aside, 0 to 1.

        Returns
        -------
        Placement
            The placement.

        Raises
        ------
        ValueError
            If the display has no eyes, or its panel is seen at infinity and no distance is given.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.wave import Display, Eyes, Modulator, Placement
        >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1))
        >>> corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
        >>> place = Placement.fitting(corners, display)
        >>> print(f"{place.scale:.3g} m for each unit, at {place.shift[2]:g} m")
        0.000128 m for each unit, at 0.1 m
        """
        b, d = _seen_along(display)
        away = b / d if distance is None and d else distance
        if away is None:
            raise ValueError("distance must be given for a panel that is seen at infinity")
        away = float(_validate.real("distance", away, positive=True))
        if not 0 < (share := float(_validate.real("share", share))) <= 1:
            raise ValueError(f"share must be above 0 and at most 1, got {share}")
        points = tensor("points", points, torch.float64).detach().cpu()
        _validate.shaped("points", _validate.real("points", points), "[N, 3], not empty")
        angles: Any = tensor("turned", turned, torch.float64).detach().cpu()
        rotation = points.new_tensor(_GRAPHICS)[:, None] * get_rotation_matrix(_validate.real("turned", angles))
        ordered = (points @ rotation.T).sort(0).values
        beside = round((1 - share) / 2 * (len(points) - 1))
        least, most = ordered[beside], ordered[-1 - beside]
        half = ((most - least) / 2).tolist()
        # What is nearest is seen largest: half·scale·B/(away − depth·scale) is half a side of the panel.
        fits = []
        for n, pitch, extent in zip(display.path.sizes, display.path.pitches, half[1::-1], strict=True):
            side = n * pitch / 2
            fits.append(side * away / max(extent * abs(b) + half[2] * side, 1e-300))
        scale = min(fits)
        shift = points.new_tensor([0.0, 0.0, away]) - scale * (least + most) / 2
        return cls(scale, shift.tolist(), rotation.tolist())

    def of(self, points: torch.Tensor) -> torch.Tensor:
        """Return points of the scene ``[..., 3]`` where they stand before the eyes, in metres."""
        points = tensor("points", points)
        points = points if points.is_floating_point() else points.float()
        rotation, shift = (points.new_tensor(part) for part in (self.rotation, self.shift))
        return self.scale * points @ rotation.T + shift


@_validate.takes_units("places", "light")
@in_own_precision
def views_of_mesh(
    mesh: Surface,
    display: Display,
    places: torch.Tensor | Sequence[Sequence[float]],
    placement: Placement | None = None,
    reflectance: float | torch.Tensor = 1.0,
    light: Sequence[float] = (0.0, 0.0),
    samples: int = 2,
) -> LightField:
    """Return the views of a mesh from places of the pupil: a target with the parallax and the occlusion of its surface.

    The surface scatters the light of a lamp in the plane of the pupils by Lambert's law; without a surface it is dark.

    Parameters
    ----------
    mesh : odak.learn.raytracing.triangle_mesh
        The mesh.
    display : Display
        A display for :class:`Eyes`, whose panel and eyepiece say along which rays pixels are seen.
    places : torch.Tensor or sequence of sequence of float
        Where the views are from, (y, x) in the plane of the pupils in metres, ``[V, 2]``.
    placement : Placement, optional
        Where the mesh stands; by default it fills the picture, see :meth:`Placement.fitting`.
    reflectance : float or torch.Tensor
        Share of the light that is reflected, 0 … 1: a number, or of each vertex ``[v]``, or for each colour of the
        display ``[v, C]``, between which triangles are even.
    light : sequence of float
        Place (y, x) of the lamp in the plane of the pupils in metres.
    samples : int
        Points along each side of a pixel, whose mean it shows.

    Returns
    -------
    LightField
        The views; the plane without parallax is the panel.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, naming it.

    Notes
    -----
    A surface seen from behind is lit like one from the front, since files differ in the order of corners. Nothing casts
    a shadow. Intensities are the cosine of the angle between the normal and the direction of the lamp. Triangles that
    reach behind the pupils are left out.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import triangle_mesh
    >>> from odak.learn.wave import Display, Eyes, Modulator, views_of_mesh
    >>> corners = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    >>> square = triangle_mesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]))
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1))
    >>> field = views_of_mesh(square, display, [(0.0, -1e-3), (0.0, 1e-3)])
    >>> field, round(float(field.views[0, 0, 16, 24]), 3)
    (LightField: 2 views of 32 × 48 pixels, 1.0)
    """
    if not all(isinstance(getattr(mesh, name, None), torch.Tensor) for name in ("vertices", "faces")):
        raise TypeError(f"mesh must be an odak.learn.raytracing.triangle_mesh, got {type(mesh).__name__}")
    stands = _placed(placement, mesh.vertices, display)
    samples = _validate.integer("samples", samples, minimum=1)
    places, lamp = _checked_places("places", places), _checked_places("light", [light])[0]
    shares, of_each = tensor("reflectance", reflectance, torch.float64).detach().cpu(), f"[{len(mesh.vertices)}]"
    _validate.shaped("reflectance", shares, f"one number or {of_each} or {of_each[:-1]}, C]")
    if not bool(((shares >= 0) & (shares <= 1)).all()):
        raise ValueError("reflectance must be of 0 … 1")
    shares = (shares[:, None] if shares.ndim == 1 else shares).expand(len(mesh.vertices), -1 if shares.ndim else 1)
    with torch.device("cpu"):
        vertices, faces = stands.of(mesh.vertices.detach().double().cpu()), mesh.faces.cpu()
        corners = vertices[faces]
        normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None]
        if not isinstance(mesh.normals, str) or mesh.normals == "smooth":
            given = mesh.vertex_normals() if isinstance(mesh.normals, str) else mesh.normals
            normals = (given.detach().double().cpu() @ vertices.new_tensor(stands.rotation).T)[faces]
        lamp = torch.stack([lamp[1], lamp[0], lamp[0] * 0])
        views = []
        for place in places.tolist():
            seen = _projected(display, vertices, place)
            seen = torch.cat([(seen + 0.5) * samples - 0.5, vertices[:, 2:].clamp_min(0).reciprocal()], -1)[faces]
            size = [n * samples for n in display.path.sizes]
            pixels, face, weights = _nearest_triangles(seen, size)
            point = (weights[..., None] * corners[face]).sum(1)
            normal = (weights[..., None] * normals[face]).sum(1)
            cosine = torch.nn.functional.cosine_similarity(normal, lamp - point, dim=-1, eps=1e-30).abs()
            light_of_point = (weights[..., None] * shares[faces[face]]).sum(1) * cosine[:, None]
            view = point.new_zeros(shares.shape[1], *size).flatten(1)
            view[:, pixels] = light_of_point.T
            views.append(torch.nn.functional.avg_pool2d(view.unflatten(1, size)[None], samples)[0].float())
    return LightField(torch.stack(views), places)


@_validate.takes_units("places")
@in_own_precision
def views_of_splats(
    splats: Splats,
    display: Display,
    places: torch.Tensor | Sequence[Sequence[float]],
    placement: Placement | None = None,
    *,
    antialiased: bool = False,
) -> LightField:
    """Return the views of Gaussian splats from places of the pupil: a target with the parallax of a captured scene.

    Parameters
    ----------
    splats : Splats
        The Gaussians, such as :func:`load_splats` reads.
    display : Display
        A display for :class:`Eyes`, whose panel and eyepiece say along which rays pixels are seen.
    places : torch.Tensor or sequence of sequence of float
        Where the views are from, (y, x) in the plane of the pupils in metres, ``[V, 2]``.
    placement : Placement, optional
        Where the scene stands; by default 96 % of the centres fill the picture, see :meth:`Placement.fitting`.
    antialiased : bool
        Whether the splats were trained so, see :class:`complex_3d_gaussians`; small ones come out too bright otherwise.

    Returns
    -------
    LightField
        The views, in light of the sources of the display as :func:`light_of` gives it; the plane without parallax is
        the panel.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, naming it.

    Notes
    -----
    Gaussians are projected by the slope of the projection at their centres, and composed from front to back (Kerbl and
    others, ACM Trans. Graph. 42, 139 (2023)). Colours follow the direction from which each is seen.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Eyes, Modulator, Splats, views_of_splats
    >>> means = torch.tensor([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.5]])
    >>> splats = Splats(means, torch.ones(2, 4), torch.full((2, 3), -2.0), torch.ones(2), torch.ones(2, 1, 3))
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1))
    >>> views_of_splats(splats, display, [(0.0, -1e-3), (0.0, 1e-3)])
    LightField: 2 views of 32 × 48 pixels
    """
    _validate.instance("splats", splats, Splats, "odak.learn.wave.Splats")
    antialiased = _validate.flag("antialiased", antialiased)
    stands = _placed(placement, splats.means, display, 0.96)
    b, d = _seen_along(display)
    pitches, sizes = display.path.pitches, display.path.sizes
    means = stands.of(splats.means.double())
    near = means[:, 2] > _NEAREST * stands.shift[2] if stands.shift[2] > 0 else means[:, 2] > 0
    chosen = near.nonzero()[means[near, 2].argsort(stable=True), 0]
    means, turned = means[chosen], means.new_tensor(stands.rotation)
    axes = quaternion_to_rotation_matrix(splats.quats[chosen].double()) * splats.scales[chosen].double().exp()[:, None]
    axes = stands.scale * turned @ axes
    opacities, layers = splats.opacities[chosen].sigmoid(), torch.zeros_like(chosen)
    factors = b / means.new_tensor(pitches[::-1])
    views = []
    for y, x in _checked_places("places", places).tolist():
        eye = means.new_tensor([x, y, 0.0])
        away = means - eye
        depth = away[:, 2:]
        slopes, middles = away[:, :2] / depth, _projected(display, means, (y, x))
        # The slope of the projection at a centre, which is taken as within the view for those far beside it.
        limits = _MARGIN * means.new_tensor(sizes[::-1]) / 2 / factors.abs() + (eye[:2].abs() / abs(b) * abs(d))
        bounded = slopes.clamp(-limits, limits)
        jacobian = torch.diag_embed((factors / depth).expand_as(slopes))
        jacobian = torch.cat([jacobian, -(factors * bounded / depth)[..., None]], -1)
        covariance = softened(jacobian @ axes)
        shown = shown_opacities(opacities, covariance, antialiased)
        conics = complex_3d_gaussians.invert_cov_2D(covariance)[:, [0, 0, 1], [0, 1, 1]]
        directions = torch.nn.functional.normalize(away @ turned, dim=-1)
        colours = view_colours(splats.harmonics[chosen], directions.to(splats.harmonics))
        given = (middles.to(colours), conics.to(colours))
        tiling = Tiling(*sizes, *(min(_TILE, n) for n in sizes))
        tiling = finer_tiling(tiling, *given) if len(chosen) else tiling
        (picture,) = composite_gaussians(*given, shown.to(colours), colours, layers, tiling)
        views.append(light_of(picture.clamp(0, 1), display).targets)
    return LightField(torch.stack(views), places)


def _seen_along(display: Display) -> tuple[float, float]:
    """Return B and D of a display for eyes: pixel D·q + B·t is seen through q with the slope t."""
    _validate.instance("display", display, Display, "an odak.learn.wave.Display")
    if not display.path.on_retinas or display.eyes is None or any(map(any, display.eyes.rotation)):
        raise ValueError(f"display must be one for odak.learn.wave.Eyes that are not rotated, got {display!r:.80}")
    sight: Any = display.path
    _, b, d = sight.sight(0, 0).ray_matrix()
    return float(b), float(d)


def _placed(placement: Placement | None, points: torch.Tensor, display: Display, share: float = 1.0) -> Placement:
    """Return a placement as it is given, or one where the points fill the picture."""
    _seen_along(display)
    if placement is None:
        return Placement.fitting(points, display, share=share)
    _validate.instance("placement", placement, Placement, "an odak.learn.wave.Placement")
    return placement


def _checked_places(name: str, places: Any) -> torch.Tensor:
    found = tensor(name, places, torch.float64).detach().cpu()
    return _validate.shaped(name, _validate.real(name, found), "[V, 2], not empty")


def _projected(display: Display, points: torch.Tensor, place: Sequence[float]) -> torch.Tensor:
    """Return the pixel (x, y) in which each of some points ``[N, 3]`` is seen from a place (y, x), ``[N, 2]``."""
    b, d = _seen_along(display)
    eye, pitches, sizes = (points.new_tensor(one[::-1]) for one in (place, display.path.pitches, display.path.sizes))
    return (d * eye + b * (points[:, :2] - eye) / points[:, 2:]) / pitches + (sizes / 2).floor()


def _nearest_triangles(corners: torch.Tensor, size: Sequence[int]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return which points of a grid see a triangle, which one is nearest there, and the weights of its corners.

    Parameters
    ----------
    corners : torch.Tensor
        Columns, rows and reciprocal distances of the corners ``[t, 3, 3]``.
    size : sequence of int
        Rows and columns of the grid, whose points are at whole coordinates.

    Returns
    -------
    tuple of torch.Tensor
        Numbers of the points ``[P]``, numbers of the triangles ``[P]``, and weights in space ``[P, 3]``.
    """
    rows, columns = size
    last = corners.new_tensor([columns - 1, rows - 1])
    first = corners[..., :2].amin(1).ceil().clamp_min(0)
    extent = (corners[..., :2].amax(1).floor().minimum(last) - first + 1).nan_to_num(0, 0, 0).clamp_min(0)
    used = (corners[..., 2] > 0).all(1) & corners.isfinite().flatten(1).all(1) & (extent.prod(1) > 0)
    (used,) = used.nonzero(as_tuple=True)
    first, extent = first[used].long(), extent[used].long()
    counts = extent.prod(1)
    best = corners.new_zeros(rows * columns)
    nearest = torch.full((rows * columns,), -1, dtype=torch.long)
    # So many triangles at a time that their boxes have not many points.
    parts = ((counts.cumsum(0) - 1) // _POINTS).unique_consecutive(return_counts=True)[1].tolist()
    for some in torch.arange(len(used)).split(parts):
        which = some.repeat_interleave(counts[some])
        within = torch.arange(len(which)) - (counts[some].cumsum(0) - counts[some]).repeat_interleave(counts[some])
        wide = extent[which, 0]
        points = first[which] + torch.stack([within % wide, within // wide], -1)
        weights = _weights(corners[used[which]], points)
        inside = (weights >= 0).all(1)
        which, points, weights = used[which[inside]], points[inside], weights[inside]
        near = (weights * corners[which, :, 2]).sum(1)
        place = points[:, 1] * columns + points[:, 0]
        best.scatter_reduce_(0, place, near, "amax")
        won = near == best[place]
        nearest[place[won]] = which[won]
    (pixels,) = (nearest >= 0).nonzero(as_tuple=True)
    face = nearest[pixels]
    weights = _weights(corners[face], torch.stack([pixels % columns, pixels // columns], -1)) * corners[face, :, 2]
    return pixels, face, weights / weights.sum(1, keepdim=True)


def _weights(corners: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Return the weights of the corners of triangles for points in the picture ``[N, 3]``; NaN without an area."""
    x, y = (corners[..., axis] - points[:, axis, None] for axis in (0, 1))
    areas = torch.stack([x[:, i - 2] * y[:, i - 1] - x[:, i - 1] * y[:, i - 2] for i in range(3)], 1)
    return areas / areas.sum(1, keepdim=True)
