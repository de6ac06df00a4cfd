"""Holograms that were computed for a display, with their quality. Touches a display by its places and levels."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from odak import _show, _validate
from odak.learn.wave.displays.display import Display
from odak.learn.wave.displays.judge import Comparison, judged
from odak.learn.wave.displays.observers import ANYWHERE, Observer, brightest, decibels, squared_errors
from odak.learn.wave.pictures import shown_on_a_screen
from odak.learn.wave.slm import TURN
from odak.tools.file import save_dictionary, save_image, save_levels
from odak.tools.paths import validate_path


@dataclass(frozen=True)
class DisplayedHologram:
    """Patterns for a display, what is seen of them, and how good it is.

    Attributes
    ----------
    display : Display
        The display they are for. If powers of the sources were found, they are its own, relative to the brightest.
    target : torch.Tensor
        What was to be seen, ``[D, C, rows, columns]``.
    phases : torch.Tensor
        Phases in radians as the panel shows them, by its levels, ``[F, rows, columns]``.
    images : torch.Tensor
        Means over the areas of pixels, at the brightness closest to the target, ``[D, C, rows, columns]``, by
        :meth:`Display.judge`: what a camera records whose pixels are those of the image.
    brightness : torch.Tensor
        Factor of each colour by which images are brighter than what :meth:`Display.forward` returns, ``[C]``.
    psnr : torch.Tensor
        Peak signal-to-noise ratio of what the observer sees in decibels, ``[D, C]``: for a camera at any place the
        least over its places by quarters of a pixel, without the outermost pixels.
    psnr_at_points : torch.Tensor
        Peak signal-to-noise ratio of the intensities at the middles of pixels, which no sensor sees, ``[D, C]``.
    losses : tuple of float
        Loss after each iteration.
    psnr_in_focus : torch.Tensor, optional
        Of a target with depth: the ratio of what the observer sees of each colour, put together of the parts of the
        planes that are in focus, ``[C]``.
    amplitudes : torch.Tensor, optional
        Amplitudes of the panel that the modulator is lit through, by its levels, ``[F, rows, columns]``.
    observer : Observer
        Who looks.
    gain_over_rounding : torch.Tensor, optional
        Of a search over levels: the decibels by which its loss is below that of the phases without levels that it began
        with, rounded.
    error : torch.Tensor, optional
        By how much the images may be off, as a share of them, ``[D, C]``; see :meth:`Display.judge`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Run, optimise
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> hologram = optimise(display, torch.ones(48, 64), run=Run(iterations=2, progress=False))
    >>> hologram.levels().shape, sorted(hologram.table()[0])[:2]
    (torch.Size([1, 48, 64]), ['brightness', 'distance'])
    """

    display: Display
    target: torch.Tensor
    phases: torch.Tensor
    images: torch.Tensor
    brightness: torch.Tensor
    psnr: torch.Tensor
    psnr_at_points: torch.Tensor
    losses: tuple[float, ...] = field(default=(), repr=False)
    psnr_in_focus: torch.Tensor | None = None
    amplitudes: torch.Tensor | None = None
    observer: Observer = ANYWHERE
    gain_over_rounding: torch.Tensor | None = None
    error: torch.Tensor | None = None

    @property
    def psnr_registered(self) -> torch.Tensor:
        """Peak signal-to-noise ratio of the images in decibels, ``[D, C]``: of a camera whose pixels are theirs."""
        return decibels((self.images - self.target).square().mean((-2, -1)))

    def psnr_of(self, observer: Observer | Sequence[Observer]) -> torch.Tensor:
        """Return what :attr:`psnr` is for another observer, each colour at the brightness that is best for it.

        Parameters
        ----------
        observer : Observer or sequence of Observer
            Who looks; of several, such as :meth:`Observer.cameras`, the least is returned.

        Returns
        -------
        torch.Tensor
            Decibels ``[D, C]``.
        """
        if not isinstance(observer, Observer):
            return torch.stack([self.psnr_of(one) for one in observer]).amin(0)
        held = Comparison(observer, self.target)
        compared = judged(self.display, self.phases, self.amplitudes, held).compared
        return decibels(squared_errors(compared, brightest(compared))).to(self.psnr)

    def levels(self) -> torch.Tensor:
        """Return the levels to send to the panel, int32 ``[F, rows, columns]``."""
        return self.display.modulator.levels(self.phases)

    def pictures(self, plane: int | None = None) -> torch.Tensor:
        """Return the images as they look on a screen, where they can be compared with the picture they are of.

        Parameters
        ----------
        plane : int, optional
            Of this plane or eye alone; of all by default.

        Returns
        -------
        torch.Tensor
            sRGB values of 0 … 1 ``[D, 3, rows, columns]``, or ``[3, rows, columns]``, by
            :func:`odak.learn.wave.picture_of`; grey where the colours of the sources cannot be mixed to white.
        """
        if plane is None:
            return shown_on_a_screen(self.images, self.display)
        return shown_on_a_screen(self.images[_validate.place_in("plane", plane, len(self.images))], self.display)

    def save(self, folder: str | os.PathLike[str]) -> list[str]:
        """Write the patterns, the images and a report to a folder, which is made if there is none.

        Parameters
        ----------
        folder : str or os.PathLike
            The folder. Files of the same names are replaced.

        Returns
        -------
        list of str
            Paths of the files: ``pattern_1.png`` … of each frame, grey levels in the upper bits as `odak hologram`
            writes them; of two panels also ``amplitude_1.png`` …; ``image_1.png`` … as each plane or eye looks on a
            screen; and ``report.json``, the :meth:`table` with the display in words.

        Raises
        ------
        ValueError, OSError
            If the folder cannot be made or written to.

        Examples
        --------
        >>> import os, tempfile
        >>> import torch
        >>> from odak.learn.wave import Display, Modulator, Run, optimise
        >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
        >>> hologram = optimise(display, torch.ones(48, 64), run=Run(iterations=2, progress=False))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     [os.path.basename(path) for path in hologram.save(folder)]
        ['pattern_1.png', 'image_1.png', 'report.json']
        """
        folder = validate_path(folder)
        os.makedirs(folder, exist_ok=True)
        panel, first = self.display.modulator, self.display.modulator.lit_through
        stacks = {"pattern": (self.levels(), panel.bits)}
        if self.amplitudes is not None and first is not None:
            stacks["amplitude"] = (first.levels(self.amplitudes), first.bits)
        files = []
        for kind, (levels, bits) in stacks.items():
            for number, one in enumerate(levels.cpu().numpy(), 1):
                files.append(os.path.join(folder, f"{kind}_{number}.png"))
                save_levels(files[-1], one, 8 if bits is None else bits)
        for number, image in enumerate(self.pictures().detach().cpu(), 1):
            files.append(os.path.join(folder, f"image_{number}.png"))
            save_image(files[-1], image.movedim(0, -1).numpy(), cmin=0, cmax=1)
        report = {
            "display": self.display.extra_repr(),
            "observer": self.observer.in_words(),
            "files": [os.path.basename(file) for file in files],
            "patterns": {kind: {"bits": 8 if bits is None else bits} for kind, (_, bits) in stacks.items()},
            "powers": self.display.powers.tolist(),
            **({} if self.gain_over_rounding is None else {"gain_over_rounding_db": float(self.gain_over_rounding)}),
            # A number without end is none in JSON.
            "table": [
                {k: None if v != v or v in (math.inf, -math.inf) else v for k, v in row.items()} for row in self.table()
            ],
        }
        files.append(os.path.join(folder, "report.json"))
        save_dictionary(report, files[-1])
        return files

    def table(self) -> list[dict[Any, Any]]:
        """Return one row of numbers for each plane or eye and colour: lengths in metres, ratios in decibels."""
        return [
            {
                **self.display.path.place(d),
                "wavelength": wavelength,
                "psnr_db": float(self.psnr[d, c]),
                "psnr_registered_db": float(self.psnr_registered[d, c]),
                "psnr_at_points_db": float(self.psnr_at_points[d, c]),
                "brightness": float(self.brightness[c]),
                **({} if self.error is None else {"error": float(self.error[d, c])}),
            }
            for d in range(self.display.shape[0])
            for c, wavelength in enumerate(self.display.wavelengths)
        ]

    def __repr__(self) -> str:
        worst, best = (f"{float(v):.1f}" for v in (self.psnr.min(), self.psnr.max()))
        span = worst if worst == best else f"{worst} to {best}"
        gain = "" if self.gain_over_rounding is None else f", {float(self.gain_over_rounding):.1f} dB above rounding"
        return f"DisplayedHologram: {span} dB for {self.observer.in_words()}{gain}, {self.display.extra_repr()}"

    def _repr_html_(self) -> str:
        return _show.page(self, DisplayedHologram._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: targets, images and a pattern, the quality of each plane and colour."""
        places = [self.display.path.place_in_words(d) for d in range(self.display.shape[0])]
        shown = {}
        for d, (_, place) in enumerate(places):
            at = f", {place}" if len(places) > 1 else ""
            shown[f"target{at}"] = shown_on_a_screen(self.target[d], self.display)
            shown[f"image{at}"] = self.pictures(d)
        pictures = [(name, _show.png(one.detach().cpu().movedim(0, -1))) for name, one in shown.items()]
        pictures.append(("pattern", _show.png((self.phases[0] / TURN).detach().cpu())))
        head = places[0][0], "wavelength", "PSNR", "registered", "at points", "brightness", "error"
        rows = [
            (
                *(places[i // self.display.shape[1]][1], f"{1e9 * r['wavelength']:.4g} nm"),
                *(f"{r[name]:.1f} dB" for name in ("psnr_db", "psnr_registered_db", "psnr_at_points_db")),
                *(f"{r['brightness']:.4g}", f"{r.get('error', math.nan):.1g}"),
            )
            for i, r in enumerate(self.table())
        ]
        return _show.View(repr(self), pictures, [head, *rows])
