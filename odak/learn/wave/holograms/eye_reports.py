"""Reports of what an eye has of a display: quality, light and speckle over an eyebox, focus, and resolution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch

from odak import _show, _validate
from odak._torch_private import in_own_precision
from odak.learn.tools.iterations import Run
from odak.learn.wave.displays.display import Display
from odak.learn.wave.eyes import Sight
from odak.learn.wave.holograms.eyeboxes import EyeboxMap, draw_over_focus, draw_over_pupils, eyebox_map, written_map
from odak.learn.wave.holograms.optimising import optimise
from odak.learn.wave.holograms.scenery import DepthScene, Scenery

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Share of what is seen at a frequency that belongs to the picture, and contrast over that of the picture, which are
# resolved at least: as much picture as error, and the tenth that lenses are commonly judged by.
_PICTURE, _CONTRAST = 0.5, 0.1
# Pixels along each side of a part of the field that has a resolution, at least.
_LEAST = 16
# Share of the rows and columns at each rim in which the light of a flat picture is not judged: it falls off there.
_RIM = 8


@dataclass(frozen=True)
class EyeReport:
    """What an eye has of a display; see :func:`eye_report`.

    Attributes
    ----------
    scene : EyeboxMap
        Quality of the picture over the eyebox and over focus.
    flat : EyeboxMap
        What is seen of a flat picture. Its `brightness` is the light at each pupil over that at the best brightness.
    speckle : torch.Tensor
        Contrast of the flat picture at each pupil, standard deviation over mean without the rim, of the colour where it
        is largest, ``[R, Q]``.
    resolution : torch.Tensor
        Resolution in each part of the field in cycles per degree, of the colour where it is least, ``[rows, columns]``.
    pixel_limit : float
        Cycles per degree of a stripe of two pixels in the middle of the field.
    pupil_limit : float
        Cycles per degree up to which the pupil passes light of the longest wavelength, diameter/λ.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Eyes, Modulator, Run, eye_report
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1, diameter=2e-3))
    >>> found = eye_report(display, torch.ones(32, 48), 1e-3, (1, 2), 2e-3, parts=2, run=Run(2, progress=False, seed=0))
    >>> found.speckle.shape, found.resolution.shape
    (torch.Size([1, 2]), torch.Size([2, 2]))
    """

    scene: EyeboxMap
    flat: EyeboxMap = field(repr=False)
    speckle: torch.Tensor
    resolution: torch.Tensor
    pixel_limit: float
    pupil_limit: float

    def __repr__(self) -> str:
        speckle, finest = (f"{float(v.min()):.3g} to {float(v.max()):.3g}" for v in (self.speckle, self.resolution))
        quality = repr(self.scene).removeprefix("EyeboxMap: ")
        return f"EyeReport: {quality}; speckle of {speckle}; {finest} cycles per degree"

    def _repr_html_(self) -> str:
        from odak._drawn import svg

        return _show.page(self, lambda shown: _show.View(repr(shown), [("what an eye has", svg(shown.figure()))]))

    def figure(self) -> "Figure":
        """Return a figure of Matplotlib: maps over pupils and over the field, and the quality over focus."""
        from odak._drawn import subplots

        parts, curve = self.resolution.numpy(), bool(len(self.scene.foci))
        wide, high = (max(len(self.scene.columns), parts.shape[1]), max(len(self.scene.rows), len(parts)))
        figure, (axes,) = subplots(1, 4 + curve, ((4 + curve) * (1.4 + 0.5 * wide), 1.4 + 0.5 * high))
        draw_over_pupils(axes[0], self.scene, "PSNR (dB)", self.scene.psnr, ".0f")
        draw_over_pupils(axes[1], self.flat, "light", self.flat.brightness, ".2f")
        draw_over_pupils(axes[2], self.flat, "speckle contrast", self.speckle, ".2f")
        written_map(axes[3], "resolution (cycles/degree)", parts, ".0f")
        axes[3].set_xticks([])
        axes[3].set_yticks([])
        down, across = self.scene.display.extents()[0]["field_of_view"]
        limits = f"limits: pixels {self.pixel_limit:.0f}, pupil {self.pupil_limit:.0f}"
        axes[3].set(ylabel="y of the field", xlabel=f"x of the field of {down:.3g}° × {across:.3g}°\n{limits}")
        if curve:
            draw_over_focus(axes[4], self.scene)
        return figure


@_validate.takes_units("box", "diameter", "foci")
@in_own_precision
def eye_report(
    display: Display,
    target: torch.Tensor | Scenery,
    box: float | Sequence[float],
    steps: int | Sequence[int] = 5,
    diameter: float = 3e-3,
    foci: Sequence[float] = (),
    parts: int | Sequence[int] = 3,
    run: Run | None = None,
) -> EyeReport:
    """Return what an eye has of a display: quality, light, speckle, depth of field and resolution.

    Use it to compare displays. Three holograms are optimised for the eyes of the display: of a picture, of a flat one,
    and of a chart of random pixels, both at the distance of the panel. Pupils all over the eyebox judge them, by
    :meth:`Display.judge`, which shares no arithmetic with what was optimised.

    Parameters
    ----------
    display : Display
        The display, with the :class:`Eyes` that holograms are optimised for.
    target : DepthScene, LightField, object with a method images, or torch.Tensor
        The picture; a tensor ``[C, rows, columns]`` is the same for all pupils.
    box : float or sequence of float
        Height and width in metres of the area of the pupils' middles, about the axis.
    steps : int or sequence of int
        Number of pupils along rows and columns.
    diameter : float
        Their diameter in metres.
    foci : sequence of float
        Distances on which the eye in the middle is focused for the quality over focus, infinity included.
    parts : int or sequence of int
        Number of parts of the field along rows and columns, each of 16 × 16 pixels or more.
    run : Run, optional
        Iterations, progress and seed of each of the three optimisations; no checkpoint.

    Returns
    -------
    EyeReport
        The numbers; :meth:`EyeReport.figure` draws them.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    The resolution is that of an eye in the middle of the eyebox, focused on the panel: the least spatial frequency at
    which half of the power that is seen is not that of the chart (the squared correlation of both is ½: a ratio of
    signal to noise of one, as of a Fourier ring correlation; van Heel and Schatz, J. Struct. Biol. 151, 250 (2005)),
    or at which a tenth of the chart's contrast is left. Speckle of random phases has the contrast 1/√F after F frames
    (Goodman, Speckle Phenomena in Optics (2007), 3.1). Its mean over the area of each pixel is judged.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Eyes, Modulator, Run, eye_report
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1, diameter=2e-3))
    >>> found = eye_report(display, torch.ones(32, 48), 1e-3, (1, 2), 2e-3, parts=2, run=Run(2, progress=False, seed=0))
    >>> bool((found.resolution <= found.pupil_limit).all())
    True
    """
    _validate.instance("display", display, Display, "an odak.learn.wave.Display")
    if display.eyes is None:
        raise ValueError(f"display must be one that odak.learn.wave.Eyes look at, got {display!r:.80}")
    counts = [_validate.integer("parts", n, minimum=1) for n in _validate.pair("parts", parts)]
    size = display.modulator.resolution
    if any(n // count < _LEAST for n, count in zip(size, counts, strict=True)):
        raise ValueError(f"parts must be of {_LEAST} × {_LEAST} pixels or more, got {parts!r:.80} of {list(size)}")
    run = Run() if run is None else _validate.instance("run", run, Run, "an odak.learn.wave.Run")
    if run.checkpoint is not None:
        raise ValueError("run must be without a checkpoint, which is one for each of three holograms")
    nearness = float(display.path.nearness(None))
    at = torch.full(size, 1 / nearness if nearness > 0 else math.inf, dtype=torch.float64)
    # Of all frequencies alike.
    chart = torch.rand(size, generator=torch.Generator().manual_seed(0))
    scene = eyebox_map(optimise(display, target, run=run), target, box, steps, diameter, foci=foci)
    flat = DepthScene(torch.ones(size), at)
    seen = eyebox_map(optimise(display, flat, run=run), flat, box, steps, diameter)
    sharp = DepthScene(chart, at)
    middle = eyebox_map(optimise(display, sharp, run=run), sharp, 0.0, 1, diameter)
    path: Any = middle.display.path
    sights = [path.sight(c, 0) for c in range(display.shape[1])]
    finest = [
        _resolutions(light, chart, sight, counts) for light, sight in zip(middle.images[0, 0], sights, strict=True)
    ]
    return EyeReport(
        scene,
        seen,
        contrast_without_rim(seen.images).amax(-1),
        torch.stack(finest).amin(0),
        0.5 / max(_degrees(sights[0], axis, (0.0, 0.0)) for axis in (0, 1)),
        math.radians(diameter / max(display.wavelengths)),
    )


def contrast_without_rim(images: torch.Tensor) -> torch.Tensor:
    """Return the standard deviation over the mean of flat images ``[..., rows, columns]`` without their rims."""
    rows, columns = (slice(n // _RIM, n - n // _RIM) for n in images.shape[-2:])
    inner = images[..., rows, columns].double()
    return inner.std((-2, -1), correction=0) / inner.mean((-2, -1))


def _degrees(sight: Sight, axis: int, place: Sequence[float]) -> float:
    """Return the angle between neighbouring pixels along an axis, at a place on the panel in metres, for an eye."""
    _, b, d = sight.ray_matrix()
    # Tangents of the direction in which the place is seen from the middle of the pupil.
    along = [(d * p - x) / b for p, x in zip(sight.pupil()[0], place, strict=True)]
    other = along[1 - axis]
    share = math.sqrt(1 + other**2) / (1 + along[0] ** 2 + along[1] ** 2)
    return math.degrees(share * sight.pitches[axis] / abs(b))


def _resolutions(image: torch.Tensor, chart: torch.Tensor, sight: Sight, counts: Sequence[int]) -> torch.Tensor:
    """Return the cycles per degree that are resolved in each part of the field, ``[rows, columns]``."""
    found = torch.zeros(*counts, dtype=torch.float64)
    sides = [n // count for n, count in zip(image.shape, counts, strict=True)]
    for part in torch.cartesian_prod(*(torch.arange(count) for count in counts)).tolist():
        rows, columns = (slice(k * side, (k + 1) * side) for k, side in zip(part, sides, strict=True))
        middle = [
            ((k + 0.5) * side - 0.5 - n // 2) * p
            for k, side, n, p in zip(part, sides, image.shape, sight.pitches, strict=True)
        ]
        degrees = [_degrees(sight, axis, middle) for axis in (0, 1)]
        found[tuple(part)] = resolved_frequency(image[rows, columns], chart[rows, columns], degrees)
    return found


def resolved_frequency(image: torch.Tensor, chart: torch.Tensor, degrees: Sequence[float]) -> float:
    """Return the frequency up to which an image ``[rows, columns]`` shows a chart, in cycles per degree.

    `degrees` are the angles between neighbouring pixels along rows and columns. Beyond the frequency of a stripe of two
    pixels, along the axis where it is less, nothing is told.
    """
    window = torch.outer(*(torch.hann_window(n, dtype=torch.float64) for n in image.shape))
    level = float(image.mean() / chart.mean())
    one, other = (torch.fft.fft2((x.double() - x.double().mean()) * window) for x in (image / level, chart))
    axes = [torch.fft.fftfreq(n, angle, dtype=torch.float64) for n, angle in zip(image.shape, degrees, strict=True)]
    frequency = torch.hypot(axes[0][:, None], axes[1])
    # Rings twice as wide as frequencies are apart, between which the window makes no difference.
    step = 2 / min(n * angle for n, angle in zip(image.shape, degrees, strict=True))
    most = 0.5 / max(degrees)
    which = (frequency / step).long()

    def summed(values: torch.Tensor) -> torch.Tensor:
        rings = torch.zeros(int(which.max()) + 1, dtype=torch.float64)
        return rings.index_add(0, which.flatten(), values.flatten())[: math.ceil(most / step)]

    both, seen, wanted = (summed(x) for x in ((one * other.conj()).real, one.abs().square(), other.abs().square()))
    both = both.clamp_min(0)
    share, contrast = both**2 / (seen * wanted).clamp_min(1e-300), both / wanted.clamp_min(1e-300)
    enough = torch.minimum(share / _PICTURE, contrast / _CONTRAST).tolist()
    for ring in range(1, len(enough)):
        if enough[ring] < 1:
            # The first ring holds what the window makes of the mean; nothing is below it.
            before = enough[ring - 1] if ring > 1 else 1 / _PICTURE
            return step * (ring - 0.5 + (before - 1) / (before - enough[ring]))
    return most
