"""The base of paths of light, which says what a display asks of one. Touches numbers and the light it is given."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, ClassVar

import numpy as np
import torch

from odak import _array, _torch_private, _validate
from odak.learn.wave.displays.panels import AmplitudePanel, Expander, Iris, Modulator, orders_through
from odak.learn.wave.training import fingerprint

Lights = tuple[torch.Tensor, ...]


class Kept:
    """Tensors that a path makes from constants, each made once for a device, and what it has drawn for a call.

    Parameters
    ----------
    device : torch.device
        Where they are.
    """

    generator: torch.Generator | None = None
    errors: tuple[float, ...] | None = None

    def __init__(self, device: torch.device):
        self.device = device
        self.tensors: dict[Any, torch.Tensor] = {}

    def __call__(self, make: Callable[..., torch.Tensor], path: "Path", *given: Any) -> torch.Tensor:
        """Return what ``make(path, device, *given)`` does; `make` is a method of the class of the path."""
        if torch.compiler.is_dynamo_compiling():
            # Versions of torch before 2.13 take no object of a frozen class as an argument here; of a method the object
            # is none, and only its identity makes the graph depend on it.
            return path._constant(id(path), make, self.device, *given)[0]
        # Sources of several wavelengths have a path for each.
        key = make, path.wavelengths, *given
        if key not in self.tensors:
            with torch.no_grad(), _torch_private.keeping():
                self.tensors[key] = make(path, self.device, *given)
        return self.tensors[key]

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies and files of a display are without them.
        return Kept, (self.device,)


@dataclass(frozen=True)
class Path:
    """What light meets from the pixels of a display to its images: numbers, and what they make of the light.

    A kind of path is a subclass in a module of its own, entered in :data:`odak.learn.wave.displays.paths.choice.PATHS`.

    Attributes
    ----------
    sizes, pitches : tuple
        Its rows and columns, and their distances in metres.
    wavelengths : tuple of float
        Wavelengths in metres.
    ends : tuple of float, odak.instruments.Lens or Eyes
        Where the images are.
    iris : Iris or str, optional
        Stop of the display.
    medium : float
        Refractive index.
    expander : Expander, optional
        Mask in contact with the panel.
    distances : tuple of float
        Distance of each image in metres.
    samples : int
        Points along each axis of a pixel at which the intensity is computed.
    """

    sizes: tuple[int, int]
    pitches: tuple[float, float]
    fill: float
    first: AmplitudePanel | None
    wavelengths: tuple[float, ...]
    ends: Any
    iris: Iris | str | None
    medium: float
    expander: Expander | None = None
    distances: tuple[float, ...] = field(init=False)
    samples: int = field(init=False)

    # Starts that are computed for it, and the one that projections begin with; None where a start needs none.
    starts: ClassVar[tuple[str, ...]] = ()
    begins: ClassVar[str | None] = None
    # Where the images are, in messages about starts.
    where: ClassVar[str] = ""
    # What solvers that compute with free space alone ask for in place of it.
    free_space: ClassVar[str] = ""
    # Standard deviation of the errors of distances in metres, which are drawn anew for each call.
    jitter: ClassVar[float] = 0.0
    # Whether images are on retinas, which may all see the same, and see no depth of a picture.
    on_retinas: ClassVar[bool] = False

    @_array.constant_in_graphs
    def _constant(
        self, identity: int, make: Callable[..., torch.Tensor], device: torch.device, *given: Any
    ) -> tuple[torch.Tensor]:
        """Return what the path makes, for a graph of torch.compile to hold, which recognises it by its identity.

        The result is in a tuple because one graph can hold several tuples, but only one tensor from each function.
        """
        with _torch_private.outside_functional_transforms(), torch.no_grad(), _torch_private.keeping():
            return (make(self, device, *given),)

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        raise NotImplementedError

    def renew(self, kept: Kept) -> None:
        """Draw what is random in the path anew, for a call of a display."""

    def points(self, kept: Kept, lights: Lights, colour: int, planes: Sequence[int]) -> torch.Tensor:
        """Return the fields of some images at the points of pixels, ``[..., F, planes·samples², rows, columns]``.

        Among them are :data:`odak.learn.wave.displays.observers.REACH` rows and columns beyond each rim.

        Parameters
        ----------
        kept : Kept
            Tensors that were made from constants.
        lights : tuple of torch.Tensor
            What each panel does to the light, in the order in which it meets them, ``[..., F, rows, columns]`` each.
        colour : int
            Which wavelength.
        planes : sequence of int
            Which images.
        """
        raise NotImplementedError

    def middles(self, kept: Kept, lights: Lights, colour: int) -> torch.Tensor:
        """Return the fields of all images at the middles of pixels, ``[..., F, D, rows, columns]``."""
        raise NotImplementedError

    def replaced(self, kept: Kept, amplitudes: torch.Tensor, light: torch.Tensor, colour: int) -> torch.Tensor:
        """Return the light on the panel, by the adjoint, of its images with their amplitudes ``[D, …]`` replaced."""
        raise NotImplementedError

    def in_words(self) -> str:
        """Return where the images are, in words."""
        raise NotImplementedError

    def place(self, image: int) -> dict[str, Any]:
        """Return where an image is, lengths in metres."""
        return {"distance": self.distances[image]}

    def place_in_words(self, image: int) -> tuple[str, str]:
        """Return of which kind the place of an image is, and the place in words."""
        return "plane", f"{1e3 * self.distances[image]:.6g} mm"

    def image_pitches(self, colour: int) -> tuple[float, float]:
        """Return how far apart pixels of the image of a colour are along rows and columns, in metres."""
        return self.pitches

    def band(self, colour: int, image: int) -> tuple[float, float] | None:
        """Return the half axes of the ellipse that holds the frequencies of an image, in cycles per pixel of it.

        They are those of the intensity, twice the field's. None where all frequencies of a picture of pixels pass.
        """
        return None

    def aperture(self, colour: int, image: int) -> tuple[torch.Tensor, torch.Tensor, bool]:
        """Return which rays form an image: the middle and half widths of their bundle, and whether it is round.

        Rays to planes are told apart by their slopes along rows and columns, those to eyes by where they meet the plane
        of the pupil, in metres.
        """
        slopes = [self.wavelengths[colour] / self.medium / (2 * pitch) for pitch in self.pitches]
        if (cutoff := self.cutoff(colour)) is not None:
            slopes = [self.wavelengths[colour] / self.medium * cutoff] * 2
        return torch.zeros(2, dtype=torch.float64), torch.tensor(slopes, dtype=torch.float64), cutoff is not None

    def nearness(self, depths: torch.Tensor | None) -> torch.Tensor:
        """Return what grows towards the viewer and shifts images in proportion; of the panel without depths.

        Depths in metres are distances from the panel here, towards the viewer.
        """
        if depths is None:
            return torch.zeros((), dtype=torch.float64)
        if not bool(depths.isfinite().all()):
            raise ValueError("depth must be finite distances from the panel, got infinity")
        return depths

    def displaced(self, colour: int, image: int, nearness: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
        """Return by how many pixels, along rows and columns, points of a scene appear beside their place in a picture.

        The picture is that of the scene from the middle of all rays: along the axis, or from a pupil on the axis.

        Parameters
        ----------
        colour, image : int
            Which wavelength, and which image.
        nearness : torch.Tensor
            See :meth:`nearness`, ``[L]``.
        rays : torch.Tensor
            Rays ``[N, 2]`` as :meth:`aperture` tells them apart.

        Returns
        -------
        torch.Tensor
            Pixels ``[N, L, 2]``.
        """
        away = self.distances[image] - nearness
        return rays[:, None] * away[:, None] / torch.tensor(self.pitches, dtype=torch.float64)

    @property
    def cells(self) -> int:
        """Cells of the mask along each axis of a pixel; 1 without a mask."""
        return 1 if self.expander is None else self.expander.cells_of(self.sizes)

    def extents(self, colour: int) -> dict[str, Any]:
        """Return the étendue of the light of a colour, and what it is the product of; see :meth:`Display.extents`."""
        # Of the side n·p and the sine λ/p that a pixel fills along each axis the pitch drops out.
        etendue = math.prod(self.sizes) * (self.cells * self.wavelengths[colour]) ** 2
        if (cutoff := self.cutoff(colour)) is not None:
            etendue *= min(1.0, math.pi * cutoff**2 * math.prod(self.pitches))
        return {"etendue": etendue}

    def cutoff(self, colour: int) -> float | None:
        """Return the highest frequency that a round iris passes, in cycles per metre; None without one."""
        return self.iris.cutoff(self.wavelengths[colour]) if isinstance(self.iris, Iris) else None

    def passing(self, iris: Iris | str | None) -> int:
        """Return how many diffraction orders along each axis a stop passes."""
        return orders_through(iris, self.wavelengths, self.pitches)

    def words(self) -> str:
        """Return its numbers as a text, by which a checkpoint is recognised."""
        first = None if self.first is None else (self.first.distance, self.first.fill, self.first.iris)
        pixels = self.sizes, self.pitches, float(self.fill)
        numbers = pixels, first, self.wavelengths, self.ends, self.iris, float(self.medium)
        return repr(_plain(numbers if self.expander is None else (*numbers, self.expander)))


def _plain(value):
    """Return a part of a path as numbers, texts and tuples of them."""
    if is_dataclass(value) and not isinstance(value, Iris):
        return (type(value).__name__, *(_plain(getattr(value, one.name)) for one in fields(value)))
    if isinstance(value, torch.Tensor):
        return fingerprint(value)
    if isinstance(value, torch.nn.Module):
        return (repr(value), *map(fingerprint, value.state_dict().values()))
    if isinstance(value, Iris):
        return float(value.radius), float(value.focal_length)
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    # Infinity is a focus of eyes, and no number in a text of Python.
    return value if value is None or isinstance(value, str) or math.isfinite(value) else str(value)


def listed(lengths: Sequence[float], scale: float) -> str:
    """Return lengths in words, separated by commas."""
    return ", ".join(f"{length * scale:.4g}" for length in lengths)


def keep(path: object, **values: Any) -> None:
    """Set what follows from the numbers of a path, while it is made."""
    for name, value in values.items():
        object.__setattr__(path, name, value)


def checked_numbers(name: str, values: Any, positive: bool = False) -> tuple[float, ...]:
    """Return one number or several as a tuple of floats after checking them."""
    (values,) = _validate.constants(**{name: values})
    given = [values] if np.ndim(values) == 0 else values
    checked = tuple(float(value) for value in _validate.several(name, given, positive=positive))
    if not checked:
        raise ValueError(f"{name} must contain at least one number, got none")
    return checked
