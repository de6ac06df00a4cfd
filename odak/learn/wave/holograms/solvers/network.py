"""Holograms by a network, in free space. Touches a problem by its lengths, target and start."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from odak._warnings import AccuracyWarning, warn
from odak.learn.wave.displays.display import Display
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.holograms.solvers.projections import frames_alone


@dataclass(frozen=True)
class Network:
    """A network that computes the hologram at once, such as :class:`odak.learn.models.hologram_network`.

    Parameters
    ----------
    model : callable, optional
        ``model(target, wavelength, pitch, distance)`` returns the phase of an image ``[rows, columns]``. By default
        :class:`odak.learn.models.hologram_network` with the weights included in odak, which were trained for pixels
        that are points.

    Warns
    -----
    AccuracyWarning
        If the weights included in odak are asked for a display whose pixels have an area. What a camera at any place
        records of their holograms is then 9 to 19 dB, where ten steps of "lbfgs" from "gs" reach 19 to 32 (ten
        geometries of the range of the training, 128 × 128 pixels, two stops).

    Examples
    --------
    >>> from odak.learn.models import hologram_network
    >>> from odak.learn.wave import Network
    >>> fewer_steps = Network(hologram_network(refinements=4, pretrained=True))
    >>> fewer_steps.model.training
    False
    """

    model: Callable[..., Any] | None = None

    @torch.no_grad()
    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display, phases = problem.display, problem.start.clone()
        model = network_for(display) if self.model is None else self.model
        for frame, plane, colour in frames_alone(display, "a network"):
            wavelength, distance = display.wavelengths[colour] / display.medium, display.distances[plane]
            wanted = model(problem.target[plane, colour], wavelength, display.modulator.pitch, distance)
            phases[frame] = display.modulator.asked(wanted - display._flat_light(colour)[1], colour)
        return phases


# Pixels that fill less of their pitch than this are points.
_POINT = 0.01


def network_for(display: Display) -> torch.nn.Module:
    """Return the network that is named "network", on the device of a display; warns if its pixels are not points."""
    if display.modulator.fill > _POINT:
        warn(
            'the weights of "network" were trained for pixels that are points, and the pixels of this display have a '
            f'fill of {display.modulator.fill:g}: take "lbfgs" from the start "gs", whose images are better',
            AccuracyWarning,
        )
    return network_on(display.powers.device)


@functools.cache
def network_on(device: torch.device) -> torch.nn.Module:
    """Return the network that is named "network", with the weights included in odak."""
    from odak.learn.models import hologram_network

    with torch.inference_mode(False):
        return hologram_network(pretrained=True).to(device)
