"""Holograms by alternating projections in free space. Touches a problem by its lengths, target and start."""

from dataclasses import dataclass

import torch

from odak._bars import tqdm
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
    The loss of an iteration is the mean squared error of the amplitudes of the image before it, at points. Frames are
    computed one after another; where the callback ends a run, those that are left get a single iteration.

    Examples
    --------
    >>> from odak.learn.wave import AlternatingProjections
    >>> AlternatingProjections()
    AlternatingProjections()
    """

    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display, run, ended = problem.display, problem.run, False
        phases = problem.start.clone()
        for frame, plane, colour in frames_alone(display, "alternating projections"):
            count, paraxial = 1 if ended else run.iterations, "Fresnel" in getattr(display.path, "method", "")
            turns = tqdm(range(count), desc="hologram", disable=not run.progress)

            def watch(turn, phase, error, before=frame * run.iterations):
                nonlocal ended, latest
                latest = phase
                ended = run.callback is not None and run.callback(before + turn, error) is True
                return ended

            illumination, aberration = display._flat_light(colour)
            scale = 1.0 if display.modulator.phase_scale is None else display.modulator.phase_scale[colour]
            latest = phases[frame] * scale + aberration
            try:
                phase_retrieval.retrieve(
                    problem.target[plane, colour].sqrt() + 0j,
                    turns,
                    display.distances[plane],
                    display.modulator.pitch,
                    display.wavelengths[colour] / display.medium,
                    TURN,
                    # What comes closest to propagation without wrap-around on a padded grid.
                    "Transfer Function Fresnel" if paraxial else "Bandlimited Angular Spectrum",
                    latest,
                    run.seed,
                    fill=display.modulator.fill,
                    cutoff=display.path.cutoff(colour),
                    accelerated=True,
                    illumination=illumination.to(phases),
                    watch=watch,
                )
            except KeyboardInterrupt:
                ended = True
            phases[frame] = display.modulator.asked(latest - aberration, colour)
        return phases
