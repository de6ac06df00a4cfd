"""Phases from which solvers of holograms start. Touches a display by its path, and targets."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn.wave.displays.display import Display
from odak.learn.wave.fields import unit_phasor
from odak.learn.wave.holograms.solvers.double_phase import encode_double_phase
from odak.learn.wave.holograms.solvers.network import network_for, network_on
from odak.learn.wave.training import generator_from, started
from odak.wave import phase_retrieval
from odak.wave.methods import method_named, warnings_outside_range
from odak.wave.propagation import propagate_within_window
from odak.wave.transfer_functions import Request

# The last three are the names of solvers too; see optimising.SOLVERS.
STARTS = ("quadratic", "flat", "random", "double phase", "gs", "network")
_SPELLINGS = {"gerchberg-saxton": "gs", "gerchberg–saxton": "gs", "double-phase": "double phase"}
# What other programs call a descent along the gradient, with Adam mostly.
_DESCENTS = ("sgd", "stochastic gradient descent", "gradient descent", "gradient_descent", "descent", "gd")
# Of the Nyquist frequency, reached at the edges of the hologram.
_QUADRATIC_SHARE = 0.25
# Iterations of the start "gs"; more would leave the descent less to gain than they take.
_PROJECTIONS = 10


def named(argument: str, name: str, names: Sequence[str]) -> str:
    """Return the name of a start or a solver, which may be spelt in other ways."""
    spelt = _SPELLINGS.get(name.strip().casefold(), name) if isinstance(name, str) else name
    if isinstance(spelt, str) and spelt.strip().casefold() in _DESCENTS and "adam" in names:
        raise ValueError(f"{argument} must be one of {', '.join(map(repr, names))}; got {name!r}. Did you mean 'adam'?")
    return _validate.one_of(argument, spelt, names)


def starting_phase(
    name: str,
    target: torch.Tensor,
    wavelength: float,
    distance: float,
    dx: float | Sequence[float],
    propagation_type: str = "Angular Spectrum",
    seed: int | None = None,
    frames: int = 1,
    callback: Callable[[int, torch.Tensor], object] | None = None,
) -> torch.Tensor:
    """Return a phase from which gradient descent may start.

    Parameters
    ----------
    name : str
        "flat": zero. "random": uniform over a cycle. "quadratic": a weak lens, whose light moves by up to a quarter of
        the Nyquist frequency at the edges. "double phase": the double-phase encoding of the target propagated back with
        a flat phase. "gs", or "gerchberg-saxton": ten accelerated iterations of Gerchberg–Saxton from the quadratic
        phase. "network": the phase of :class:`odak.learn.models.hologram_network` with the weights included in odak,
        for square pixels.
    target : torch.Tensor
        Intensity ``[..., rows, columns]``.
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from hologram to image in metres.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    propagation_type : str
        Propagation type of "double phase" and "gs".
    seed : int, optional
        Makes what is random reproducible.
    frames : int
        Number of frames. Several frames of a deterministic start differ by normal noise of 0.5 rad.
    callback : callable, optional
        ``callback(iteration, phase)`` is called after each iteration of Gerchberg–Saxton.

    Returns
    -------
    torch.Tensor
        Phase in radians, of the target's shape, ``[frames, …]`` with several frames.
    """
    name = named("initial_phase", name, STARTS)
    generator = None if seed is None else generator_from(seed)
    shape = tuple(target.shape) if frames == 1 else (frames, *target.shape)

    def drawn(draw):
        # On the CPU, so that a seed gives the same start on every device.
        return draw(shape, generator=generator, dtype=target.dtype).to(target.device)

    if name == "random":
        return 2 * math.pi * drawn(torch.rand)
    phase = torch.zeros_like(target)
    if name == "double phase":
        field: Any = propagate_within_window(
            target.clamp_min(0).sqrt() + 0j, -distance, dx, wavelength, propagation_type
        )
        phase = encode_double_phase(field)
    elif name == "network":
        with torch.no_grad():
            phase = network_on(target.device)(target, wavelength, dx, distance)
    elif name != "flat":
        for axis, n in ((-2, target.shape[-2]), (-1, target.shape[-1])):
            place = torch.arange(n, dtype=target.dtype, device=target.device) - n // 2
            bend = _QUADRATIC_SHARE * math.pi / n * place**2
            phase = phase + (bend[:, None] if axis == -2 else bend)
        if name == "gs":
            amplitude = target.clamp_min(0).sqrt()
            hologram = phase_retrieval.retrieve(
                *(amplitude, range(_PROJECTIONS), distance, dx, wavelength, 2 * math.pi, propagation_type, phase, seed),
                accelerated=True,
                checked=True,
                callback=callback,
            )[0]
            phase = hologram.angle()
    return phase if frames == 1 else phase + 0.5 * drawn(torch.randn)


def starting_phases(
    display: Display,
    target: torch.Tensor,
    start: str | torch.Tensor | None,
    seed: int | None,
    into: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the phases to start from; a named start is computed for the brightest colour of each frame.

    They are written to `into` after each iteration, so that what is interrupted leaves those of the last one.
    """
    shape = (display.frames, *display.modulator.resolution)
    if not isinstance(start, str):
        shapes = (shape, shape[1:]) if display.frames == 1 else (shape,)
        return started("start", start, shapes, target, torch.zeros, STARTS).reshape(shape)
    name = named("start", start, STARTS)
    path = display.path
    if name not in path.starts:
        accepted = ", ".join(map(repr, path.starts))
        raise ValueError(f"start must be {accepted} or phases {path.where}, got {name!r}")
    if name == "network":
        network_for(display)
    begun = path.begins or name if name == "gs" else name
    method = method_named("Bandlimited Angular Spectrum")
    plane = display.shape[0] // 2
    phases = torch.zeros(shape, dtype=target.dtype, device=target.device) if into is None else into
    brightest = display.powers.argmax(1).tolist()
    for colour in sorted(set(brightest)):
        frames = [frame for frame, lit in enumerate(brightest) if lit == colour]
        wavelength, distance = display.wavelengths[colour] / display.medium, display.distances[plane]
        # Beyond its range this method keeps a small part of the band, and says so; nobody chose it.
        request = Request(display.modulator.pitch, wavelength, distance)
        outside = any(warnings_outside_range(method, display.modulator.resolution, request, padded=True))
        aberration = 0.0 if name in ("flat", "random") else display._flat_light(colour)[1]

        def keep(_, phase, frames=frames, aberration=aberration, colour=colour):
            phases[frames] = display.modulator.asked(phase - aberration, colour)

        found = starting_phase(
            begun,
            target[plane, colour],
            wavelength,
            distance,
            display.modulator.pitch,
            "Linear Angular Spectrum" if outside else method.name,
            seed=seed,
            frames=len(frames),
            callback=None if into is None else keep,
        )
        for frame, phase in zip(frames, found.reshape(len(frames), *shape[1:]), strict=True):
            if begun != name:
                phase = _projected(display, target, colour, phase)
            phases[frame] = display.modulator.asked(phase - aberration, colour)
    return phases


def _projected(display, target, colour, phase, iterations: int = 10):
    """Return a phase after iterations of Gerchberg and Saxton's between the panel and its images."""
    amplitudes, light = target[:, colour].sqrt(), unit_phasor(phase)
    for _ in range(iterations):
        light = unit_phasor(display._replaced(amplitudes, light, colour).angle())
    return light.angle()
