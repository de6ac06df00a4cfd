"""Rendering of complex-valued Gaussians in space to fields on planes and to a hologram."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import torch

from odak import _torch_private, _validate
from odak._array import is_readable
from odak.learn._tensors import rows_of, shaped, tensor
from odak.learn.tools.transformation import PerspectiveCamera
from odak.learn.wave.fields import disc
from odak.learn.wave.gaussians import sets as shared
from odak.learn.wave.gaussians.sets import complex_3d_gaussians, shown_opacities
from odak.learn.wave.gaussians.splatting import FAINTEST, Tiling, composite_gaussians, finer_tiling
from odak.learn.wave.propagation import propagate_beam

_SETTINGS = ("wavelengths", "pixel_pitch", "distances", "pad_size", "aperture_size")
_TILE = 64


class Scene:
    """Complex Gaussians projected by a camera: a field on each of their planes, and the hologram of all.

    Parameters
    ----------
    gaussians : complex_3d_gaussians
        The Gaussians.
    args_prop : object
        With the attributes `wavelengths` (metres, one for each colour), `pixel_pitch` (metres), `distances` of the
        planes (metres), `pad_size` (rows and columns of the picture) and `aperture_size` (radius of a round aperture
        in samples of the spectrum of the field padded to twice its size; −1 for none).
    rotate_as_points : bool
        Project covariances with the rotation of the camera that moves the points, x·R. False applies R from the left
        instead, which is geometrically right for a symmetric R only; earlier versions did so, and published models were
        trained with it.

    Attributes
    ----------
    wavelengths : torch.Tensor
        In metres.
    mean_2D_for_planeprob : torch.Tensor or None
        Centres of the Gaussians of the last picture [x, y] in pixels ``[N, 2]``, without gradients.

    Raises
    ------
    ValueError
        If an attribute is missing or outside its range.

    Examples
    --------
    >>> import torch
    >>> from argparse import Namespace
    >>> from odak.learn.tools import PerspectiveCamera
    >>> from odak.learn.wave import Scene, complex_3d_gaussians
    >>> settings = Namespace(num_planes=2, wavelengths=[639e-9, 532e-9, 473e-9], pixel_pitch=3.74e-6,
    ...                      distances=[1e-3, 2e-3], pad_size=[32, 32], aperture_size=-1)
    >>> gaussians = complex_3d_gaussians("random", "cpu", num_points=8, args_prop=settings)
    >>> camera = PerspectiveCamera(torch.eye(3), torch.tensor([0.0, 0.0, 40.0]), [30.0, 30.0], [16.0, 16.0])
    >>> hologram, planes = Scene(gaussians, settings).render(camera, (32, 32))
    >>> hologram.shape, planes.shape
    (torch.Size([3, 32, 32]), torch.Size([2, 3, 32, 32]))
    """

    def __init__(self, gaussians: complex_3d_gaussians, args_prop: object, *, rotate_as_points: bool = True):
        _validate.instance("gaussians", gaussians, complex_3d_gaussians, "complex_3d_gaussians")
        wavelengths, pitch, distances, pad_size, aperture = shared.settings(args_prop, _SETTINGS)
        self.gaussians: complex_3d_gaussians = gaussians
        self.args_prop: object = args_prop
        self.rotate_as_points: bool = _validate.flag("rotate_as_points", rotate_as_points)
        self.wavelengths: torch.Tensor = _validate.real("wavelengths", shared.lengths(wavelengths), positive=True)
        self.pixel_pitch: float = _validate.real("pixel_pitch", pitch, positive=True)
        self.distances: torch.Tensor = _validate.real("distances", shared.lengths(distances))
        self.pad_size: tuple[int, int] = _validate.size("pad_size", pad_size)
        if aperture != -1 and not aperture > 0:
            raise ValueError(f"aperture_size must be positive, or -1 for none; got {aperture!r}")
        self.aperture_size = aperture
        self.mean_2D_for_planeprob: torch.Tensor | None = None

    def __repr__(self) -> str:
        return f"<Scene with {len(self.gaussians)} Gaussians>"

    def compute_transmittance(self, alphas: torch.Tensor) -> torch.Tensor:
        """Return the transmittance in front of each layer, the product of 1 − α of those before; zero where below 1e-4.

        Parameters
        ----------
        alphas : torch.Tensor
            Opacities from front to back ``[N, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[N, H, W]``.
        """
        alphas = shaped("alphas", alphas, "[N, H, W]")
        passed = torch.cat([torch.ones_like(alphas[:1]), 1 - alphas[:-1]]).cumprod(0)
        return passed.where(~((passed < FAINTEST) & passed.isfinite()), 0.0)

    def compute_depth_values(self, camera: PerspectiveCamera) -> torch.Tensor:
        """Return the depths z of the Gaussians in the axes of the camera ``[N]``."""
        return checked_camera(camera).transform_world_to_camera_space(self.gaussians.means)[:, 2]

    def calculate_gaussian_directions(self, means_3D: torch.Tensor, camera: PerspectiveCamera) -> torch.Tensor:
        """Return the unit vectors from the camera to the centres of the Gaussians, ``[N, 3]``.

        Parameters
        ----------
        means_3D : torch.Tensor
            Centres of the Gaussians ``[N, 3]``.
        camera : PerspectiveCamera
            Camera that the directions start from.
        """
        means_3D = shaped("means_3D", means_3D, "[N, 3]")
        return torch.nn.functional.normalize(means_3D - checked_camera(camera).get_camera_center(), dim=-1)

    def get_idxs_to_filter_and_sort(self, z_vals: torch.Tensor) -> torch.Tensor:
        """Return the indices of the non-negative depths in ascending order of depth.

        Parameters
        ----------
        z_vals : torch.Tensor
            Depths ``[N]``; NaN is kept and sorted last.
        """
        z_vals = shaped("z_vals", z_vals, "[N]")
        order = z_vals.argsort(stable=True)
        # NaN comes last and is kept, so that it shows in the result.
        return order[~(z_vals[order] < 0)]

    def splat(
        self,
        camera: PerspectiveCamera,
        means_3D: torch.Tensor,
        z_vals: torch.Tensor,
        quats: torch.Tensor,
        scales: torch.Tensor,
        colours: torch.Tensor,
        phase: torch.Tensor,
        opacities: torch.Tensor,
        plane_probs: torch.Tensor,
        wavelengths: torch.Tensor,
        img_size: tuple[int, int] = (256, 256),
        tile_size: tuple[int, int] = (64, 64),
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the hologram of Gaussians, and the fields on their planes.

        On plane p a Gaussian has the opacity α = opacity·probability·exp(−½ dᵀΣ⁻¹d); the field is Σ colour·α·T·exp(iφ)
        from front to back, T being what the Gaussians before it on the same plane let through. The hologram is the
        sum of the fields, each propagated back by the distance of its plane (band-limited angular spectrum, padded to
        twice the size).

        Parameters
        ----------
        camera : PerspectiveCamera
            The camera.
        means_3D : torch.Tensor
            Centres in the world ``[N, 3]``.
        z_vals : torch.Tensor
            Depths ``[N]``, by which Gaussians are sorted.
        quats, scales, phase, opacities, plane_probs : torch.Tensor
            As from :meth:`complex_3d_gaussians.apply_activations`.
        colours : torch.Tensor
            Amplitudes ``[N, C]``.
        wavelengths : torch.Tensor
            Metres ``[C]``.
        img_size : tuple of int
            Width and height of the picture, pixels at whole coordinates.
        tile_size : tuple of int
            Largest width and height of the tiles that the picture is computed by; those not positive become 64. They
            do not change the picture.

        Returns
        -------
        hologram : torch.Tensor
            ``[C, H, W]``; complex64, or complex128 for Gaussians in double precision.
        plane_fields : torch.Tensor
            ``[P, C, H, W]``, before propagation.

        Raises
        ------
        ValueError
            If the size is not `pad_size`, or planes or colours are more or fewer than distances or wavelengths.
        """
        width, height = shared.picture_size("img_size", img_size)
        if (height, width) != self.pad_size:
            raise ValueError(f"img_size must be (width, height) of pad_size {list(self.pad_size)}, got {img_size}")
        tile_size = two_sizes(tile_size)
        across, down = (min(n if n > 0 else _TILE, size) for n, size in zip(tile_size, (width, height), strict=True))
        given = (z_vals, quats, scales, colours, phase, opacities, plane_probs)
        means_3D, z_vals, quats, scales, colours, phase, opacities, plane_probs = gaussians_to_draw(
            "means_3D", means_3D, *given
        )
        wavelengths = self._checked_wavelengths(wavelengths, plane_probs, colours, phase)
        planes = plane_probs.shape[-1]
        rays = camera_rays(checked_camera(camera), means_3D)
        points, fx, fy = rays[:3]
        covariance = self._project(points, fx, fy, quats, scales, (width, height), camera)
        means, conics = self.gaussians.compute_means_2D(*rays), self.gaussians.invert_cov_2D(covariance)
        self.mean_2D_for_planeprob = means.detach()
        opacities = shown_opacities(opacities, covariance, self.gaussians.antialiased)
        shown = (z_vals, means, conics, colours, phase, opacities, plane_probs)
        fields = _plane_fields(*shown, Tiling(height, width, down, across, planes))
        return self._propagate(fields, wavelengths), fields

    def splat_tile(
        self,
        R: torch.Tensor,
        fx: float | torch.Tensor,
        fy: float | torch.Tensor,
        px: float | torch.Tensor,
        py: float | torch.Tensor,
        cam_means_3D: torch.Tensor,
        z_vals: torch.Tensor,
        quats: torch.Tensor,
        scales: torch.Tensor,
        colours: torch.Tensor,
        phase: torch.Tensor,
        opacities: torch.Tensor,
        plane_probs: torch.Tensor,
        tile_x: int,
        tile_y: int,
        tile_size: tuple[int, int],
        gaussian_indices: torch.Tensor,
        img_size: tuple[int, int],
        wavelengths: torch.Tensor,
    ) -> torch.Tensor:
        """Return one tile of the fields that :meth:`splat` gives on the planes.

        Parameters
        ----------
        R : torch.Tensor
            Rotation that acts on covariances, ``[3, 3]``.
        fx, fy, px, py : float or torch.Tensor
            Focal lengths and principal point in pixels.
        cam_means_3D : torch.Tensor
            Centres in the axes of the camera ``[N, 3]``.
        z_vals : torch.Tensor
            Depths ``[N]``, by which Gaussians are sorted.
        quats : torch.Tensor
            Quaternions w, x, y, z ``[N, 4]``.
        scales : torch.Tensor
            Standard deviations along the Gaussians' axes ``[N, 3]``.
        colours : torch.Tensor
            Amplitudes ``[N, C]``.
        phase : torch.Tensor
            Phases of the Gaussians in radians, as from :meth:`complex_3d_gaussians.apply_activations`.
        opacities : torch.Tensor
            Opacities from 0 to 1, as from :meth:`complex_3d_gaussians.apply_activations`.
        plane_probs : torch.Tensor
            Share of each Gaussian on each plane ``[N, P]``.
        tile_x, tile_y : int
            Column and row of the tile, counted in tiles.
        tile_size : tuple of int
            Width and height of a tile.
        gaussian_indices : torch.Tensor
            Numbers of the Gaussians to draw.
        img_size : tuple of int
            Width and height of the picture, at whose rims tiles are cut.
        wavelengths : torch.Tensor
            Without effect here; kept for callers that pass it.

        Returns
        -------
        torch.Tensor
            ``[P, C, h, w]``.

        Raises
        ------
        ValueError
            If the tile is outside the picture.
        """
        tile_size, img_size = two_sizes(tile_size), shared.picture_size("img_size", img_size)
        tile_x, tile_y = _validate.whole("tile_x", tile_x), _validate.whole("tile_y", tile_y)
        for name, number in (("px", px), ("py", py)):
            _validate.real(name, number)
        given = (z_vals, quats, scales, colours, phase, opacities, plane_probs)
        cam_means_3D, z_vals, quats, scales, colours, phase, opacities, plane_probs = gaussians_to_draw(
            "cam_means_3D", cam_means_3D, *given
        )
        _validate.fitting(colours=colours, phase=phase)
        if not plane_probs.shape[1]:
            raise ValueError(f"plane_probs must have a plane at least, got {list(plane_probs.shape)}")
        corner = [place * (n if n > 0 else _TILE) for place, n in zip((tile_x, tile_y), tile_size, strict=True)]
        sizes = [min(n if n > 0 else _TILE, size - at) for n, size, at in zip(tile_size, img_size, corner, strict=True)]
        if min(*corner) < 0 or min(*sizes) < 1:
            raise ValueError(f"tile_x and tile_y must be a tile of a picture of {img_size}, got {(tile_x, tile_y)}")
        some = chosen(gaussian_indices, len(cam_means_3D), cam_means_3D.device)
        cam_means_3D, quats, scales = cam_means_3D[some], quats[some], scales[some]
        covariance = self.gaussians.compute_cov_2D(cam_means_3D, quats, scales, fx, fy, R, img_size)
        opacities = shown_opacities(opacities[some], covariance, self.gaussians.antialiased)
        means = self.gaussians.compute_means_2D(cam_means_3D, fx, fy, px, py)
        tiling = Tiling(sizes[1], sizes[0], sizes[1], sizes[0], plane_probs.shape[-1])
        shown: list[Any] = [
            *(z_vals[some], means - means.new_tensor(corner), self.gaussians.invert_cov_2D(covariance)),
            *(colours[some], phase[some], opacities, plane_probs[some]),
            tiling,
        ]
        return _plane_fields(*shown)

    def render(
        self,
        camera: PerspectiveCamera,
        img_size: tuple[int, int] = (-1, -1),
        bg_colour: tuple[float, float, float] = (0.0, 0.0, 0.0),
        tile_size: tuple[int, int] = (64, 64),
        step: int = -1,
        max_step: int = -1,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the hologram of the Gaussians between NEAR_PLANE and FAR_PLANE, and the fields on their planes.

        Parameters
        ----------
        camera : PerspectiveCamera
            The camera.
        img_size : tuple of int
            Width and height of the picture; by default taken from `pad_size`.
        bg_colour : tuple of float
            Without effect; kept for callers that pass it.
        tile_size : tuple of int
            Largest width and height of the tiles that the picture is computed by; they do not change the picture.
        step, max_step : int
            Handed to :meth:`complex_3d_gaussians.apply_activations`.

        Returns
        -------
        tuple of torch.Tensor
            As from :meth:`splat`.
        """
        (bg_colour,) = _validate.constants(bg_colour=bg_colour)
        width, height = two_sizes(img_size, "img_size")
        if width <= 0 and height <= 0:
            height, width = self.pad_size
        depths = self.compute_depth_values(camera)
        order = self.get_idxs_to_filter_and_sort(depths.detach())
        seen = order[self.gaussians._in_range(depths[order])]
        held = self.gaussians
        activated: Any = held.apply_activations(
            held.pre_act_quats[seen],
            held.pre_act_scales[seen],
            held.pre_act_phase[seen],
            held.pre_act_opacities[seen],
            held.pre_act_plane_assignment[seen],
            step,
            max_step,
        )
        quats, scales, phase, opacities, planes = activated
        shown = (held.means[seen], depths[seen], quats, scales, held.colours[seen], phase, opacities, planes)
        return self.splat(camera, *shown, self.wavelengths, (width, height), tile_size)

    def _project(self, cam_means_3D, fx, fy, quats, scales, img_size, camera):
        rotation = camera.R.reshape(3, 3)
        rotation = rotation.T if self.rotate_as_points else rotation
        return self.gaussians.compute_cov_2D(cam_means_3D, quats, scales, fx, fy, rotation, img_size)

    def _checked_wavelengths(self, wavelengths, plane_probs, colours, phase):
        """Return the wavelengths; raise ValueError unless planes and colours are as many as distances and these."""
        wavelengths = shared.lengths(tensor("wavelengths", wavelengths))
        _validate.real("wavelengths", wavelengths, positive=True)
        _validate.fitting(colours=colours, phase=phase)
        planes, count = plane_probs.shape[1], colours.shape[1]
        if planes != len(self.distances) or count != len(wavelengths):
            raise ValueError(
                "plane_probs must have a column for each distance, and colours one for each "
                f"of the wavelengths; got {planes} planes and {count} colours for "
                f"{len(self.distances)} distances and {len(wavelengths)} wavelengths"
            )
        return wavelengths

    def _propagate(self, fields, wavelengths):
        aperture = 1.0 if self.aperture_size == -1 else _aperture(self.pad_size, self.aperture_size, fields.device)
        back = -self.distances[:, None]
        return propagate_beam(fields, None, back, self.pixel_pitch, wavelengths, aperture=aperture).sum(0)


@lru_cache(maxsize=4)
def _aperture(shape, radius, device):
    with _torch_private.keeping():
        return disc(tuple(2 * n for n in shape), radius).to(device)


def _plane_fields(z_vals, means, conics, colours, phase, opacities, plane_probs, tiling):
    """Return the fields on the planes ``[P, C, H, W]``, the Gaussians sorted by depth.

    Each Gaussian is drawn on each plane that it may be on; a choice of one plane leaves the others out, unless a
    gradient requires the value without it.
    """
    choices = plane_probs.detach()[order := z_vals.detach().argsort(stable=True)]
    on_plane = torch.ones_like(choices, dtype=torch.bool) if plane_probs.requires_grad else choices != 0
    who, layer = on_plane.nonzero(as_tuple=True)
    who = order[who]
    # A Gaussian whose depth is NaN is not left out.
    opacities = opacities.where(~z_vals.isnan(), torch.nan)
    weights = (torch.polar(torch.ones_like(phase), phase) * colours)[who]
    rows = conics[:, [0, 0, 1], [0, 1, 1]][who]
    means, tiling = means[who], finer_tiling(tiling, means[who], rows) if len(who) else tiling
    return composite_gaussians(means, rows, opacities[who] * plane_probs[who, layer], weights, layer, tiling)


def checked_camera(camera: PerspectiveCamera) -> Any:
    """Return a camera; raise TypeError for anything that cannot be one."""
    for name in ("R", "focal_length", "principal_point", "transform_world_to_camera_space"):
        if not hasattr(camera, name):
            raise TypeError(f"camera must be a PerspectiveCamera, got {camera!r:.80}, which has no {name}")
    return camera


def two_sizes(size: Any, name: str = "tile_size") -> tuple[int, int]:
    """Return a width and a height, which need not be positive."""
    if isinstance(size, str) or not isinstance(size, Iterable) or len(size := tuple(size)) != 2:
        raise ValueError(f"{name} must be two integers (width, height), got {size!r:.80}")
    width, height = (_validate.whole(name, n, minimum=-_validate.LONGEST_SIDE) for n in size)
    return width, height


def chosen(gaussian_indices: torch.Tensor, count: Any, device: Any) -> torch.Tensor:
    """Return the numbers, or the choice by truth values, of some of `count` Gaussians."""
    some = tensor("gaussian_indices", gaussian_indices, device=device)
    if some.ndim != 1 or (some.dtype == torch.bool and len(some) != count):
        raise ValueError(f"gaussian_indices must be [n] numbers or {count} truth values, got {list(some.shape)}")
    if some.dtype == torch.bool:
        return some
    some = some.long()
    if is_readable(some) and bool(((some < -count) | (some >= count)).any()):
        raise ValueError(f"gaussian_indices must be below {count}, got {some.min().item()} to {some.max().item()}")
    return some


def gaussians_to_draw(
    name: str,
    means: Any,
    z_vals: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    colours: torch.Tensor,
    phase: torch.Tensor,
    opacities: torch.Tensor,
    plane_probs: torch.Tensor,
) -> list[torch.Tensor]:
    """Return the parameters of Gaussians in one precision, after checking that there is a row for each.

    Parameters
    ----------
    name : str
        What the centres are called.
    means, z_vals, quats, scales, colours, phase, opacities, plane_probs : torch.Tensor
        ``[N, 3]``, ``[N]``, ``[N, 4]``, ``[N, 3]``, ``[N, C]``, ``[N, C]``, ``[N]``, ``[N, P]``.
    """
    return rows_of(
        **{name: (means, "[N, 3]")},
        z_vals=(z_vals, "[N]"),
        quats=(quats, "[N, 4]"),
        scales=(scales, "[N, 3]"),
        colours=(colours, "[N, C]"),
        phase=(phase, "[N, C]"),
        opacities=(opacities, "[N]"),
        plane_probs=(plane_probs, "[N, P]"),
    )


def camera_rays(camera: PerspectiveCamera, means_3D: torch.Tensor) -> Any:
    """Return points in the axes of the camera, its focal lengths fx, fy and its principal point px, py."""
    pairs = []
    for name in ("focal_length", "principal_point"):
        values = getattr(camera, name).reshape(-1)
        if len(values) not in (1, 2):
            raise ValueError(f"camera.{name} must be one number or two, got {tuple(values.shape)}")
        pairs.extend(values.expand(2))
    return camera.transform_world_to_camera_space(means_3D), *pairs
