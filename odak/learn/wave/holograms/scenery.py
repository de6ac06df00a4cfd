"""Scenes as targets: what each image of a display is to show of a picture with depth, or of a light field.

Touches a display by its path, which says which rays form an image and how they shift what they show.
"""

import csv
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path as Files
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from scipy import ndimage

from odak import _show, _validate
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import floating, tensor
from odak.learn.tools import load_image, save_image
from odak.learn.wave.displays.display import Display
from odak.learn.wave.displays.paths.base import Path
from odak.learn.wave.training import checked_intensities
from odak.tools.paths import replacing, validate_path

# Rays that an aperture is sampled by, at least and at most.
_RAYS, _MOST = 24, 256
# Table of the views in a folder.
TABLE = "views.csv"
# Pixels by which the picture is continued before it is blurred by diffraction.
_RIM = 16


@runtime_checkable
class Scenery(Protocol):
    """What can be shown on a display: an object that knows the image for each of its planes or pupils."""

    def images(self, display: Display) -> torch.Tensor:
        """Return the intensities ``[D, C, rows, columns]`` that are to be seen, D the planes or pupils."""
        ...


class DepthScene:
    """A picture with the distance of each pixel: a target with parallax, blur and occlusion for any pupil or plane.

    Use it as the target of :func:`odak.learn.wave.optimise`. For :class:`Eyes` each image is what an eye sees of the
    scene with its own place, diameter and focus; for planes it is a focal stack, seen through the iris.

    Parameters
    ----------
    picture : torch.Tensor
        Intensities 0 … 1 as a pupil on the axis sees them, ``[rows, columns]`` or ``[C, rows, columns]``.
    depth : torch.Tensor
        Distances ``[rows, columns]`` in metres: from the pupils for eyes, infinity included, and from the panel towards
        the viewer for planes.
    layers : int
        Layers that the depths are sorted into, evenly in the shift that they cause: in dioptres for eyes.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Layers are seen through points all over an aperture. Through each point they are shifted by its parallax, nearer
    ones hide those behind them, and the mean over the points is the image. Where the picture shows nothing of what is
    further away, that has the colour of the nearest visible pixel further away. The mean is blurred by diffraction at
    the aperture, as if in focus: its transfer is that of a uniform ellipse (Goodman, Introduction to Fourier Optics
    (2005), 6.3). The picture goes on beyond its rim with the colours at its rim.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import DepthScene, Display, Eyes, Modulator
    >>> depth = torch.full((32, 48), 0.2)
    >>> depth[8:24, 16:32] = 0.08
    >>> scene = DepthScene(torch.rand(32, 48), depth)
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1, [(0.0, -1e-3), (0.0, 1e-3)], 2e-3))
    >>> scene.images(display).shape
    torch.Size([2, 1, 32, 48])
    """

    def __init__(self, picture: torch.Tensor, depth: torch.Tensor, layers: int = 12):
        picture = checked_intensities("picture", floating("picture", picture)).detach()
        self.picture: torch.Tensor = picture[None] if picture.ndim == 2 else picture
        self.depth: torch.Tensor = tensor("depth", depth, torch.float64).detach().cpu()
        if self.picture.ndim != 3 or self.picture.shape[1:] != self.depth.shape:
            raise ValueError(
                "depth must be [rows, columns] of a picture [rows, columns] or [C, rows, columns], got "
                f"{list(self.depth.shape)} and {list(picture.shape)}"
            )
        if bool(self.depth.isnan().any()):
            raise ValueError("depth must be distances in metres, got NaN")
        self.layers: int = _validate.integer("layers", layers, minimum=1)

    def __repr__(self) -> str:
        near, far = float(self.depth.min()), float(self.depth.max())
        return f"DepthScene: {_size_of(self.picture)} pixels, {near:.4g} to {far:.4g} m, {self.layers} layers"

    def _repr_html_(self) -> str:
        return _show.page(self, lambda shown: _show.View(repr(shown), _pictures({"picture": shown.picture})))

    def images(self, display: Display) -> torch.Tensor:
        """Return what is to be seen on a display, ``[D, C, rows, columns]``.

        Parameters
        ----------
        display : Display
            The display, whose path says which rays form each image.
        """
        _fits("picture", self.picture, display)
        # Scenes are rendered on the CPU, whatever the default device is.
        with torch.device("cpu"):
            layers = self._sorted(display.path.nearness(self.depth))
            return _each(display.path, lambda colour, image: self._seen(display.path, colour, image, *layers))

    def _seen(self, path: Path, colour: int, image: int, places: torch.Tensor, layers: torch.Tensor) -> torch.Tensor:
        """Return what is to be seen in one image of a colour, of layers at some places."""
        ends = path.displaced(colour, image, places, _rim(path, colour, image))
        # As many rays as make the blur of the layer that is out of focus most smooth.
        rays = _rays(path, colour, image, float((ends[0] - ends[1]).norm(dim=-1).max()))
        # The light of a colour and what covers, in layers from the furthest to the nearest.
        chosen = layers[:, [min(colour, layers.shape[1] - 2), -1]]
        moved = Moved(chosen, path.displaced(colour, image, places, rays))
        seen = torch.stack([_through(moved, ray) for ray in range(len(rays))]).mean(0)
        return _diffracted(seen, path.band(colour, image))

    def _sorted(self, nearness: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return how near each layer is, ``[L]``, and its light, and what it covers, ``[L, C + 1, rows, columns]``."""
        least, most = float(nearness.min()), float(nearness.max())
        which = ((nearness - least) / max(most - least, 1e-300) * self.layers).long().clamp(max=self.layers - 1)
        # Without those that are empty, each at the mean of what it holds.
        which = which.unique(return_inverse=True)[1]
        count = int(which.max()) + 1
        places = which.flatten().bincount(nearness.flatten()) / which.flatten().bincount()
        layers = self.picture.new_zeros(count, len(self.picture) + 1, *which.shape).cpu()
        whole = torch.cat([self.picture.cpu(), torch.ones_like(layers[0, :1])])
        layers.scatter_(0, which[None, None].expand(1, *whole.shape), whole[None])
        for behind in range(count - 1):
            hidden = which > behind
            # Behind what is nearer lies what is visible beside it.
            rows, columns = (torch.from_numpy(part).long()[hidden] for part in _nearest_outside(hidden.numpy()))
            down, across = hidden.nonzero().T
            layers[which[rows, columns], :, down, across] = whole[:, rows, columns].T
        return places, layers


class LightField:
    """Views of a scene from places of the pupil, or in several directions: a target for any pupil among them.

    Use it as the target of :func:`odak.learn.wave.optimise` where a scene is rendered or photographed from many places.
    The image for a pupil is the mean of the views within it, shifted as its focus asks.

    Parameters
    ----------
    views : torch.Tensor
        Intensities 0 … 1, ``[V, rows, columns]`` or ``[V, C, rows, columns]``. A point of the plane of no parallax is
        at the same pixel in all of them.
    rays : torch.Tensor
        Where the views are from, ``[V, 2]``: places (y, x) in the plane of the pupils in metres for eyes, and slopes
        (dy/dz, dx/dz) of rays for planes.
    plane : float, optional
        Distance of the plane of no parallax in metres, counted as the depths of a :class:`DepthScene`; by default the
        panel as it is seen.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    AccuracyWarning
        If a pupil reaches further beyond the views than they are apart.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Eyes, LightField, Modulator
    >>> places = torch.cartesian_prod(torch.linspace(-2e-3, 2e-3, 5), torch.linspace(-2e-3, 2e-3, 5))
    >>> field = LightField(torch.rand(25, 32, 48), places)
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1, [(0.0, 0.0)], 3e-3, focus=0.2))
    >>> field.images(display).shape
    torch.Size([1, 1, 32, 48])
    """

    plane: torch.Tensor | None

    def __init__(self, views: torch.Tensor, rays: torch.Tensor | Sequence[Sequence[float]], plane: float | None = None):
        views = checked_intensities("views", floating("views", views)).detach()
        self.views: torch.Tensor = views[:, None] if views.ndim == 3 else views
        self.rays: torch.Tensor = tensor("rays", rays, torch.float64).detach().cpu()
        if self.views.ndim != 4 or tuple(self.rays.shape) != (len(self.views), 2):
            raise ValueError(
                "rays must be [V, 2] for views [V, rows, columns] or [V, C, rows, columns], got "
                f"{list(self.rays.shape)} and {list(views.shape)}"
            )
        _validate.real("rays", self.rays)
        self.plane = None if plane is None else tensor("plane", plane, torch.float64).detach().cpu()
        if self.plane is not None and (self.plane.ndim or bool(self.plane.isnan())):
            raise ValueError(f"plane must be one distance in metres, got {plane!r:.80}")

    @classmethod
    def load(
        cls,
        folder: str | os.PathLike[str],
        rays: torch.Tensor | Sequence[Sequence[float]] | None = None,
        plane: float | None = None,
    ) -> "LightField":
        """Return a light field of pictures, in the order of their names or as a table lists them.

        Parameters
        ----------
        folder : str or os.PathLike
            A folder, of which all PNG, JPEG, TIFF and EXR files are views; or a table, see `rays`. Values of pictures
            are taken as intensities, see :func:`odak.learn.wave.light_of`.
        rays : torch.Tensor or sequence of sequence of float, optional
            Where the views are from, ``[V, 2]``, in the order of the files. By default as the table says, which is
            ``views.csv`` in a folder: after a line ``file,y,x`` a line for each view, with its file and its ray.
        plane : float, optional
            Distance of the plane of no parallax in metres.

        Returns
        -------
        LightField
            The views.

        Raises
        ------
        ValueError, OSError
            If there are no pictures or no table, or a file cannot be read.
        """
        if rays is None:
            files, rays = listed_views(folder)
        else:
            kinds = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
            files = sorted(file for file in Files(folder).iterdir() if file.suffix.lower() in kinds)
        if not files:
            raise ValueError(f"folder must hold pictures, got none in {os.fspath(folder)!r:.80}")
        views = [load_image(str(file), torch_style=True).float() for file in files]
        return cls(torch.stack([view[:3] if view.ndim == 3 else view[None] for view in views]), rays, plane)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the views as pictures of 16 bits and the table of their rays, as :meth:`load` reads them.

        Parameters
        ----------
        folder : str or os.PathLike
            The folder, which is made if it does not exist. The light of 0 … 1 is stored as it is: with the option
            --linear the command line takes it so. What is brighter becomes 1.
        """
        where = Files(validate_path(folder, name="folder"))
        where.mkdir(parents=True, exist_ok=True)
        lines = ["file,y,x"]
        for number, (view, ray) in enumerate(zip(self.views, self.rays.tolist(), strict=True)):
            name = f"view_{number:0{len(str(len(self.views)))}d}.png"
            light = view.movedim(0, -1) if len(view) in (3, 4) else view[0]
            save_image(str(where / name), light.clamp(0, 1), cmin=0.0, cmax=1.0, color_depth=16)
            lines.append(f"{name},{ray[0]!r},{ray[1]!r}")
        with replacing(str(where / TABLE)) as stream:
            stream.write(("\n".join(lines) + "\n").encode())

    def __repr__(self) -> str:
        return f"LightField: {len(self.views)} views of {_size_of(self.views)} pixels"

    def _repr_html_(self) -> str:
        return _show.page(self, lambda shown: _show.View(repr(shown), _pictures({"first view": shown.views[0]})))

    def images(self, display: Display) -> torch.Tensor:
        """Return what is to be seen on a display, ``[D, C, rows, columns]``.

        Parameters
        ----------
        display : Display
            The display, whose path says which rays form each image.
        """
        _fits("views", self.views, display)
        # Scenes are rendered on the CPU, whatever the default device is.
        with torch.device("cpu"):
            return _each(display.path, lambda colour, image: self._seen(display.path, colour, image))

    def _seen(self, path: Path, colour: int, image: int) -> torch.Tensor:
        nearness = path.nearness(self.plane)
        distances = torch.cdist(_rays(path, colour, image, _MOST), self.rays)
        nearest = distances.min(1)
        apart = torch.cdist(self.rays, self.rays).fill_diagonal_(math.inf).min(1).values.max()
        if (outside := float((nearest.values > apart).double().mean())) > 0:
            warn(
                f"{max(outside, 0.01):.0%} of the rays of image {image} are further from all views than these are "
                "apart: give views from all over the pupils",
                AccuracyWarning,
            )
        shares = torch.bincount(nearest.indices, minlength=len(self.rays)) / len(distances)
        seen = shares.nonzero()[:, 0]
        light = self.views[seen, min(colour, self.views.shape[1] - 1)].cpu()
        moved = Moved(light[:, None], path.displaced(colour, image, nearness[None], self.rays[seen]).movedim(0, 1))
        views = torch.cat([share * moved(0, view) for view, share in enumerate(shares[seen].tolist())])
        return _diffracted(views.sum(0), path.band(colour, image))


def listed_views(table: str | os.PathLike[str]) -> tuple[list[Files], torch.Tensor]:
    """Return the files and the rays ``[V, 2]`` of the views in a table, or in the table of a folder.

    Parameters
    ----------
    table : str or os.PathLike
        The table, see :meth:`LightField.load`, or the folder that it is in.

    Raises
    ------
    ValueError, OSError
        If it is no such table, or cannot be read.
    """
    path = Files(table) / TABLE if Files(table).is_dir() else Files(table)
    if not path.is_file():
        raise ValueError(f"{os.fspath(path)!r:.200} must be a table of views, with lines file,y,x, but is no file")
    with open(path, newline="", encoding="utf-8-sig") as stream:
        rows = list(csv.DictReader(stream))
    try:
        rays = [(float(row["y"]), float(row["x"])) for row in rows]
        found = [path.parent / row["file"] for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)!r:.200} must have a line file,y,x and then these of each view") from error
    if not found:
        raise ValueError(f"{os.fspath(path)!r:.200} must list a view at least, got none")
    return found, torch.tensor(rays, dtype=torch.float64, device="cpu")


class Moved:
    """Pictures of squares that are moved by parts of pixels: means over the pixels, which go on beyond their rims.

    Parameters
    ----------
    pictures : torch.Tensor
        Pictures ``[L, C, rows, columns]``.
    shifts : torch.Tensor
        Shifts along rows and columns in pixels, ``[N, L, 2]``.
    """

    def __init__(self, pictures: torch.Tensor, shifts: torch.Tensor):
        self.size: torch.Size = pictures.shape[-2:]
        # Further away there is nothing but the rim.
        most = torch.tensor(self.size, dtype=torch.float64)
        shifts = shifts.clamp(-most, most)
        reach = math.ceil(float(shifts.abs().max())) + 1
        self.wide: torch.Tensor = torch.nn.functional.pad(pictures, [reach] * 4, mode="replicate")
        first = (reach - shifts).floor()
        self.first: list[list[list[int]]] = first.long().tolist()
        self.share: list[list[list[float]]] = (reach - shifts - first).tolist()

    def __call__(self, ray: int, layer: int) -> torch.Tensor:
        """Return a picture as one of the rays shifts it, ``[C, rows, columns]``."""
        (y, x), (down, across), (rows, columns) = self.first[ray][layer], self.share[ray][layer], self.size
        part = self.wide[layer, :, y : y + rows + 1, x : x + columns + 1]
        part = torch.lerp(part[:, :-1], part[:, 1:], down)
        return torch.lerp(part[..., :-1], part[..., 1:], across)


def _through(moved: Moved, ray: int) -> torch.Tensor:
    """Return the light of layers along a ray, the first of which is the furthest: each covers what lies behind it."""
    seen, _ = moved(ray, 0)
    for layer in range(1, len(moved.wide)):
        light, cover = moved(ray, layer)
        seen = torch.addcmul(light + seen, cover, seen, value=-1)
    return seen


def _nearest_outside(hidden: np.ndarray) -> np.ndarray:
    """Return for each pixel the row and the column of the nearest one that is not hidden."""
    return ndimage.distance_transform_edt(hidden, return_distances=False, return_indices=True)


def _rim(path: Path, colour: int, image: int) -> torch.Tensor:
    """Return two rays at opposite ends of an aperture, ``[2, 2]``."""
    middle, halves, _ = path.aperture(colour, image)
    return torch.stack([middle - halves, middle + halves])


def _rays(path: Path, colour: int, image: int, blur: float) -> torch.Tensor:
    """Return rays all over an aperture ``[N, 2]``, enough for a blur of some pixels."""
    middle, halves, is_round = path.aperture(colour, image)
    count = min(_MOST, max(_RAYS, math.ceil(0.6 * blur**2)))
    if not is_round:
        side = math.isqrt(count)
        even = (torch.arange(side, dtype=torch.float64) + 0.5) / side * 2 - 1
        return middle + halves * torch.cartesian_prod(even, even)
    # Of equal shares of the area, turned on by the golden angle.
    k = torch.arange(count, dtype=torch.float64)
    angle, radius = k * math.pi * (3 - math.sqrt(5)), ((k + 0.5) / count).sqrt()
    return middle + halves * (radius * torch.stack([angle.sin(), angle.cos()])).T


def _diffracted(light: torch.Tensor, band: tuple[float, float] | None) -> torch.Tensor:
    """Return an image as far as a uniform elliptical aperture passes its frequencies, up to some half axes."""
    if band is None:
        return light
    wide = torch.nn.functional.pad(light[None, None], [_RIM] * 4, mode="replicate")[0, 0]
    axes = (torch.fft.fftfreq(n, dtype=torch.float64) / b for n, b in zip(wide.shape, band, strict=True))
    rho = torch.hypot(*torch.meshgrid(*axes, indexing="ij")).clamp(max=1)
    passed = 2 / math.pi * (rho.acos() - rho * (1 - rho**2).sqrt())
    found = torch.fft.ifft2(torch.fft.fft2(wide) * passed.to(light)).real
    return found[_RIM:-_RIM, _RIM:-_RIM].clamp(min=0)


def _fits(name: str, picture: torch.Tensor, display: Display) -> None:
    _validate.instance("display", display, Display, "an odak.learn.wave.Display")
    _, colours, *size = display.shape
    if picture.shape[-3] not in (1, colours) or list(picture.shape[-2:]) != size:
        got = list(picture.shape[-3:])
        raise ValueError(f"{name} must be of {[colours, *size]} colours, rows and columns, got {got}")


def _each(path: Path, seen: Callable[[int, int], torch.Tensor]) -> torch.Tensor:
    """Return what is seen in each colour of each image, ``[D, C, rows, columns]``."""
    colours = range(len(path.wavelengths))
    return torch.stack([torch.stack([seen(c, d) for c in colours]) for d in range(len(path.distances))])


def _size_of(pictures: torch.Tensor) -> str:
    return " × ".join(map(str, pictures.shape[-2:]))


def _pictures(shown: dict[str, torch.Tensor]) -> list[tuple[str, bytes | str]]:
    return [
        (name, _show.png((light if len(light) == 3 else light[:1].expand(3, -1, -1)).cpu().movedim(0, -1)))
        for name, light in shown.items()
    ]
