"""Gerchberg–Saxton holograms in PyTorch."""

from collections.abc import Callable

import torch
from tqdm import tqdm

from odak import _validate
from odak.learn.wave.compat import accepts_older_form
from odak.wave import phase_retrieval


@accepts_older_form
@torch.no_grad()
def gerchberg_saxton(
    field: torch.Tensor,
    n_iterations: int,
    distance: float,
    dx: float,
    wavelength: float,
    slm_range: float = 6.28,
    propagation_type: str = "Transfer Function Fresnel",
    initial_phase: torch.Tensor | None = None,
    seed: int | torch.Generator | None = None,
    progress: bool = False,
    callback: Callable | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a phase-only hologram of an image by alternating projections (Gerchberg and Saxton, Optik 35, 1972).

    Each turn keeps the phase alone on the hologram and sets the target's amplitude on the image; around the image, on
    planes of twice its size, light may fall as it likes.

    Parameters
    ----------
    field : torch.Tensor
        ``[..., rows, columns]``; its amplitude is the target amplitude.
    n_iterations : int
        Number of iterations.
    distance : float
        Distance from hologram to image in metres.
    dx : float
        Pixel pitch in metres.
    wavelength : float
        Wavelength in metres.
    slm_range : float
        Phase range of the modulator in radians; phases beyond it take its nearer end.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`.
    initial_phase : torch.Tensor, optional
        Phase to start the hologram from; uniform between 0 and π by default.
    seed : int or torch.Generator, optional
        Makes the random start reproducible; by default torch's generator draws it.
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, hologram_phase)`` after each iteration; returning True stops.

    Returns
    -------
    tuple of torch.Tensor
        Phase-only hologram and reconstruction, complex ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    count = _validate.integer("n_iterations", n_iterations, minimum=1)
    progress, callback = _validate.flag("progress", progress), _validate.function_or_none("callback", callback)
    turns = tqdm(range(count), desc="hologram", disable=not progress, leave=False)
    return phase_retrieval.retrieve(
        field, turns, distance, dx, wavelength, slm_range, propagation_type, initial_phase, seed, callback=callback
    )
