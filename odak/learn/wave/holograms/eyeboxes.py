"""Quality of a hologram over an eyebox: what pupils at many places, and eyes of many focuses, see of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from odak import _show, _validate
from odak._torch_private import in_own_precision
from odak.instruments import Lens
from odak.learn.wave.displays.display import Display
from odak.learn.wave.displays.judge import Comparison, judged
from odak.learn.wave.displays.observers import brightest, decibels, squared_errors
from odak.learn.wave.eyes import Eyes
from odak.learn.wave.holograms.result import DisplayedHologram
from odak.learn.wave.holograms.scenery import Scenery
from odak.learn.wave.holograms.targets import checked_target
from odak.learn.wave.pictures import shown_on_a_screen


@dataclass(frozen=True)
class EyeboxMap:
    """What is seen of a hologram over an eyebox; see :func:`eyebox_map`.

    Attributes
    ----------
    display : Display
        The display with the pupils of the map, from row to row.
    rows : torch.Tensor
        Places of the pupils' middles along the rows of the display in metres, ``[R]``.
    columns : torch.Tensor
        The same along columns, ``[Q]``.
    psnr : torch.Tensor
        Peak signal-to-noise ratio at each pupil in decibels, of the colour where it is least, ``[R, Q]``. The
        brightness of each colour is one for all pupils, the best one.
    brightness : torch.Tensor
        Light of the image at each pupil over that of the image wanted there, at that brightness, ``[R, Q]``.
    images : torch.Tensor
        What is seen, ``[R, Q, C, rows, columns]``, at that brightness.
    wanted : torch.Tensor
        What is to be seen, of the same shape.
    foci : torch.Tensor
        Distances in metres on which the eye in the middle is focused, ``[K]``; none if none were given.
    psnr_of_focus : torch.Tensor
        Ratio in decibels for each of these, ``[K]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Eyes, Modulator, Run, eyebox_map, optimise
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes(0.1, diameter=2e-3))
    >>> hologram = optimise(display, torch.ones(32, 48), run=Run(2, progress=False, seed=0))
    >>> seen = eyebox_map(hologram, torch.ones(32, 48), (0.0, 2e-3), (1, 3), 2e-3)
    >>> seen.images.shape
    torch.Size([1, 3, 1, 32, 48])
    """

    display: Display = field(repr=False)
    rows: torch.Tensor
    columns: torch.Tensor
    psnr: torch.Tensor
    brightness: torch.Tensor
    images: torch.Tensor
    wanted: torch.Tensor
    foci: torch.Tensor
    psnr_of_focus: torch.Tensor

    def __repr__(self) -> str:
        sides = " × ".join(f"{1e3 * float(axis[-1] - axis[0]):.3g}" for axis in (self.rows, self.columns))
        least, most = float(self.psnr.min()), float(self.psnr.max())
        light = f"{float(self.brightness.min()):.2f} to {float(self.brightness.max()):.2f}"
        return (
            f"EyeboxMap: {least:.1f} to {most:.1f} dB and {light} of the light at {self.psnr.numel()} pupils of "
            f"{1e3 * self.display.path.ends.diameter[0]:.3g} mm in {sides} mm"
        )

    def _repr_html_(self) -> str:
        return _show.page(self, EyeboxMap._view)

    def _view(self) -> _show.View:
        """Return what notebooks show: the maps, the curve over focus, and what the corners and the middle see."""
        corners = {(r, q) for r in (0, len(self.rows) - 1) for q in (0, len(self.columns) - 1)}
        pictures: list[tuple[str, bytes | str]] = [("quality, light and focus", self.drawing())]
        for r, q in sorted(corners | {(len(self.rows) // 2, len(self.columns) // 2)}):
            screen = shown_on_a_screen(self.images[r, q][None], self.display)[0]
            place = f"{1e3 * float(self.rows[r]):.3g}, {1e3 * float(self.columns[q]):.3g} mm"
            pictures.append((f"pupil at {place}", _show.png(screen.cpu().movedim(0, -1))))
        rows = [
            (f"{focus:.4g} m", f"{ratio:.1f} dB")
            for focus, ratio in zip(self.foci.tolist(), self.psnr_of_focus.tolist(), strict=True)
        ]
        return _show.View(repr(self), pictures, [("focus", "PSNR"), *rows] if rows else [])

    def drawing(self) -> str:
        """Return the map of quality, the map of light, and the quality over focus, as the text of an SVG file."""
        from odak._drawn import subplots, svg

        columns = 2 + bool(len(self.foci))
        figure, (axes,) = subplots(1, columns, (columns * (1.2 + 0.6 * len(self.columns)), 1.4 + 0.5 * len(self.rows)))
        draw_over_pupils(axes[0], self, "PSNR (dB)", self.psnr, ".0f")
        draw_over_pupils(axes[1], self, "light", self.brightness, ".2f")
        if len(self.foci):
            draw_over_focus(axes[2], self)
        return svg(figure)


def draw_over_pupils(axis: Any, found: EyeboxMap, title: str, values: torch.Tensor, form: str) -> None:
    """Draw numbers ``[R, Q]`` at the places of the pupils of a map on an axis of Matplotlib."""
    ticks = [[f"{1e3 * place:.3g}" for place in places.tolist()] for places in (found.columns, found.rows)]
    written_map(axis, title, values.numpy(), form)
    axis.set_xticks(range(len(found.columns)), ticks[0])
    axis.set_yticks(range(len(found.rows)), ticks[1])
    axis.set(xlabel="x of the pupil (mm)", ylabel="y of the pupil (mm)")


def draw_over_focus(axis: Any, found: EyeboxMap) -> None:
    """Draw the quality over the focus of the eye in the middle of a map on an axis of Matplotlib."""
    from odak._drawn import color_of

    order = found.foci.argsort()
    axis.plot((1 / found.foci[order]).numpy(), found.psnr_of_focus[order].numpy(), "o-", color=color_of(0))
    axis.set(title="PSNR over focus (dB)", xlabel="focus (dioptres)")


def written_map(axis: Any, title: str, values: np.ndarray, form: str) -> None:
    """Draw a map of numbers ``[rows, columns]`` with each of them written on its place."""
    axis.imshow(values, cmap="Blues_r")
    for (r, q), value in np.ndenumerate(values):
        colour = "white" if 2 * value < values.min() + values.max() else "black"
        axis.text(q, r, format(value, form), color=colour, ha="center", va="center", fontsize=9)
    axis.set_title(title)


@_validate.takes_units("box", "diameter", "focus", "foci", "distance")
@in_own_precision
def eyebox_map(
    hologram: DisplayedHologram,
    target: torch.Tensor | Scenery,
    box: float | Sequence[float],
    steps: int | Sequence[int] = 5,
    diameter: float = 3e-3,
    focus: float | None = None,
    foci: Sequence[float] = (),
    distance: float | Lens | None = None,
) -> EyeboxMap:
    """Return what pupils all over an eyebox see of a hologram, whatever it was optimised for.

    Use it to judge a near-eye hologram where it was not optimised. What is seen is computed by :meth:`Display.judge`,
    which shares no transfer functions with what an optimisation descends along.

    Parameters
    ----------
    hologram : DisplayedHologram
        The hologram, of a display with planes or with eyes.
    target : DepthScene, LightField, object with a method images, or torch.Tensor
        What is to be seen; a tensor ``[C, rows, columns]`` is the same for all pupils.
    box : float or sequence of float
        Height and width in metres of the area of the pupils' middles, about the axis.
    steps : int or sequence of int
        Number of pupils along rows and columns.
    diameter : float
        Their diameter in metres.
    focus : float, optional
        Distance in metres on which the eyes are focused; by default the panel.
    foci : sequence of float
        Distances on which the eye in the middle is focused for the quality over focus, infinity included.
    distance : float or odak.instruments.Lens, optional
        Distance from the panel to the pupils, or the eyepiece; by default that of the hologram's own eyes.

    Returns
    -------
    EyeboxMap
        Quality, brightness and images at each pupil; it draws itself in a notebook.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import DepthScene, Display, Eyes, Modulator, Run, eyebox_map, optimise
    >>> scene = DepthScene(torch.ones(32, 48), torch.full((32, 48), 0.2))
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Eyes.within(0.1, 2e-3, 3, 2e-3))
    >>> hologram = optimise(display, scene, run=Run(2, progress=False, seed=0))
    >>> eyebox_map(hologram, scene, 2e-3, 3, 2e-3).psnr.shape
    torch.Size([3, 3])
    """
    _validate.instance("hologram", hologram, DisplayedHologram, "an odak.learn.wave.DisplayedHologram")
    own = hologram.display.eyes
    if distance is None and own is None:
        raise ValueError("distance must be given for a hologram on planes: that from the panel to the pupils")
    away = own.distance if distance is None and own is not None else distance
    counts = [_validate.integer("steps", n, minimum=1) for n in _validate.pair("steps", steps)]
    box, foci = _validate.constants(box=box, foci=foci)
    foci = [float(one) for one in _validate.listed("foci", foci, "distances in metres")]
    if not all(one > 0 for one in foci):
        raise ValueError(f"foci must be positive distances, infinity included; got {foci!r:.80}")
    down, across = (
        torch.linspace(-side / 2, side / 2, n, dtype=torch.float64) if n > 1 else torch.zeros(1, dtype=torch.float64)
        for side, n in zip(_validate.pair("box", box), counts, strict=True)
    )
    places = torch.cartesian_prod(down, across).tolist()
    display = hologram.display.looked_at(Eyes(away, places, diameter, focus))  # type: ignore[arg-type]
    wanted, images, compared = _judged(hologram, display, target)
    lights = brightest(compared)
    images = images * lights[:, None, None].to(images)
    ratio = decibels(squared_errors(compared, lights)).amin(1)
    light = (images.mean((-2, -1)) / wanted.mean((-2, -1)).clamp_min(1e-12)).mean(1)
    curve = torch.zeros(0, dtype=torch.float64)
    if len(foci):
        middle = Eyes(away, [(0.0, 0.0)] * len(foci), diameter, foci)  # type: ignore[arg-type]
        found = _judged(hologram, hologram.display.looked_at(middle), target)[2]
        curve = decibels(squared_errors(found, lights)).amin(1).cpu()
    ratio, light, images, wanted = (x.unflatten(0, (len(down), -1)).cpu() for x in (ratio, light, images, wanted))
    looked = torch.tensor(foci, dtype=torch.float64)
    return EyeboxMap(display, down, across, ratio, light, images, wanted, looked, curve)


def _judged(
    hologram: DisplayedHologram, display: Display, target: torch.Tensor | Scenery
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return what is wanted, what is seen of a hologram by the eyes of a display, and how the two compare."""
    wanted = checked_target(display, target)
    found = judged(display, hologram.phases, hologram.amplitudes, Comparison(hologram.observer, wanted))
    return wanted, found.areas, found.compared
