"""Problems of holograms, and the objects that solve them. Touches a display by what it shows of patterns."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from odak.learn.tools.iterations import Run
from odak.learn.wave.displays.display import Display
from odak.learn.wave.displays.observers import ANYWHERE, Observer
from odak.learn.wave.displays.paths.base import Lights
from odak.learn.wave.training import brightness_of


@dataclass(frozen=True)
class Problem:
    """What a solver is given: a display, the images to show, how they are compared, and the phases to begin with.

    Attributes
    ----------
    display : Display
        The display.
    target : torch.Tensor
        Intensities ``[D, C, rows, columns]``.
    loss : callable
        ``loss(image, target)``.
    start : torch.Tensor
        Phases ``[F, rows, columns]`` in radians.
    run : Run
        How long, with what progress and seed.
    free : bool
        Whether the brightness of the images is free.
    observer : Observer
        Who looks: what is recorded on its grids is compared with the means of the target's squares there.

    Examples
    --------
    A solver of your own: the phases of the light that would travel back from the target.

    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Problem, optimise, propagate_beam
    >>> class Backwards:
    ...     def solve(self, problem: Problem) -> torch.Tensor:
    ...         display = problem.display
    ...         field = problem.target[0, 0].sqrt() * torch.exp(1j * problem.start[0])
    ...         back = propagate_beam(
    ...             field, dx=8e-6, wavelength=display.wavelengths[0], distance=-display.distances[0]
    ...         )
    ...         return back.angle()[None]
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> hologram = optimise(display, torch.ones(48, 64), solver=Backwards(), start="flat")
    >>> bool(hologram.psnr > 10)
    True
    """

    display: Display
    target: torch.Tensor
    loss: Callable[..., Any]
    start: torch.Tensor
    run: Run
    free: bool = True
    observer: Observer = ANYWHERE

    def loss_of(
        self, phases: torch.Tensor, powers: torch.Tensor | None = None, amplitudes: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Return the loss of patterns.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` in radians.
        powers : torch.Tensor, optional
            Powers ``[F, C]`` of the sources; by default the display's own.
        amplitudes : torch.Tensor, optional
            Amplitudes ``[F, rows, columns]`` of the panel that the modulator is lit through; one by default.

        Returns
        -------
        torch.Tensor
            The loss.
        """
        return self.loss_of_lights(self.display._lights(phases, amplitudes), powers)

    def loss_of_lights(self, lights: Lights, powers: torch.Tensor | None = None) -> torch.Tensor:
        """Return the loss of `lights`: what each panel does to the light, in the order in which it meets them.

        `powers` are those of :meth:`loss_of`.
        """
        return self.loss_of_recorded(self.display._recorded_of(self.observer, lights, powers))

    def loss_of_recorded(self, images: torch.Tensor) -> torch.Tensor:
        """Return the loss of what the observer records.

        Parameters
        ----------
        images : torch.Tensor
            Recorded intensities of the shape of :attr:`wanted`.

        Returns
        -------
        torch.Tensor
            The loss.
        """
        images = self.scaled(images)
        each = [self.loss(*pair) for pair in zip(images, self.wanted, strict=True)]
        return torch.stack(each).mean(0) if len(each) > 1 else each[0]

    def loss_of_images(self, images: torch.Tensor) -> torch.Tensor:
        """Return the loss of `images` on the pixels of the target, ``[D, C, rows, columns]``, whoever looks."""
        return self.loss(images * brightness_of(images.detach(), self.target) if self.free else images, self.target)

    @functools.cached_property
    def wanted(self) -> torch.Tensor:
        """What the observer is to record, ``[grids, D, C, rows, columns]``."""
        colours = range(self.display.shape[1])
        pitches = [self.display.path.image_pitches(c) for c in colours]
        return torch.stack([self.observer.wanted(self.target[:, c], pitches[c]) for c in colours], -3)

    def scaled(self, images: torch.Tensor) -> torch.Tensor:
        """Return recorded `images` at the brightness of each colour that is closest to what is wanted.

        Sources can be dimmed. The shape is that of :attr:`wanted`.
        """
        return images * brightness_of(images.detach(), self.wanted) if self.free else images


class Solver(Protocol):
    """What finds the phases of a problem: an object of one method."""

    def solve(self, problem: Problem) -> torch.Tensor | tuple[torch.Tensor | None, ...]:
        """Return the phases ``[frames, rows, columns]`` in radians, or them and what else was found.

        These are the powers of the sources or None, third the amplitudes of the panel in front of the modulator, and
        fourth the decibels by which the loss of levels is below that of rounded phases.
        """
        ...
