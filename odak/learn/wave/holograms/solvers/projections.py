"""Holograms by alternating projections in free space. Touches a problem by its lengths, target and start."""

from dataclasses import dataclass

import torch

from odak.learn.wave.displays.display import Display
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.slm import TURN
from odak.wave import phase_retrieval


def frames_alone(display: Display, solver: str) -> list[tuple[int, int, int]]:
    """Return frame, plane and colour for each frame, for solvers whose frames show one colour on one plane each."""
    if display.path.free_space:
        raise ValueError(f"{solver} needs {display.path.free_space}: use the solver 'lbfgs'")
    lit = [[c for c, frames in enumerate(display.lit_frames) if f in frames] for f in range(display.frames)]
    if len(display.distances) > 1 or any(len(colours) != 1 for colours in lit):
        raise ValueError(
            f"{solver} shows one colour on one plane in each frame; this display has {len(display.distances)} planes "
            f"and up to {max(map(len, lit))} colours in a frame: use the solver 'lbfgs'"
        )
    return [(frame, 0, colours[0]) for frame, colours in enumerate(lit)]


@dataclass(frozen=True)
class AlternatingProjections:
    """Gerchberg–Saxton, accelerated: an image on one plane in few iterations, without a gradient.

    Use it where a hologram has to be there within seconds; :class:`Descent` comes closer to the target. Uneven light on
    the panel and its aberration are made up for, and the image is one of the frequencies that an :class:`Iris` passes.

    Examples
    --------
    >>> from odak.learn.wave import AlternatingProjections
    >>> AlternatingProjections()
    AlternatingProjections()
    """

    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display = problem.display
        phases = problem.start.clone()
        for frame, plane, colour in frames_alone(display, "alternating projections"):
            illumination, aberration = display._flat_light(colour)
            scale = 1.0 if display.modulator.phase_scale is None else display.modulator.phase_scale[colour]
            hologram = phase_retrieval.retrieve(
                problem.target[plane, colour].sqrt() + 0j,
                range(problem.run.iterations),
                display.distances[plane],
                display.modulator.pitch,
                display.wavelengths[colour] / display.medium,
                TURN,
                "Bandlimited Angular Spectrum",
                phases[frame] * scale + aberration,
                problem.run.seed,
                fill=display.modulator.fill,
                cutoff=display.path.cutoff(colour),
                accelerated=True,
                illumination=illumination.to(phases),
            )[0]
            phases[frame] = display.modulator.asked(hologram.angle() - aberration, colour)
        return phases
