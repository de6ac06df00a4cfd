"""Holograms of light fields: retinal images for many positions of the pupil in an eyebox, optimised together."""

import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import takes_constants, tensor
from odak.learn.tools.iterations import SOLVERS, Run, minimise
from odak.learn.wave.eyes import angles_of_each, of_each
from odak.learn.wave.fields import intensity, unit_phasor
from odak.learn.wave.training import best_scale, checked_intensities, fingerprint, generator_from, seeded_loss, started
from odak.wave.transfer_functions import checked_pitch
from odak.wave.viewing import eye_transfer, retinal_field


@takes_constants("wavelength", "distance", "pitch", "pupil_diameter", "focus", "learning_rate")
@torch.inference_mode(False)
@_validate.takes_units("wavelength", "distance", "pitch", "pupil_diameter", "focus", degrees=("rotation",))
def eyebox_hologram(
    targets: torch.Tensor,
    wavelength: float,
    distance: float,
    pitch: float | Sequence[float],
    pupil_positions: torch.Tensor | Sequence[Any],
    pupil_diameter: float | torch.Tensor = 2e-3,
    focus: float | torch.Tensor | None = None,
    iterations: int = 100,
    loss_function: Callable[..., Any] | None = None,
    learning_rate: float = 0.2,
    *,
    rotation: Sequence[float] | torch.Tensor = (0.0, 0.0),
    optimizer: str = "adam",
    initial_phase: torch.Tensor | None = None,
    frames: int = 1,
    slm: Callable[..., Any] | None = None,
    pupils_per_step: int | None = None,
    seed: int | None = None,
    progress: bool = True,
    callback: Callable[..., Any] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: int = 50,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a phase-only hologram that shows an eye its image at each of several places of the pupil.

    The loss compares the images that :func:`odak.learn.wave.eye_image` gives, at one brightness for all of them. A
    hologram that is optimised for its own plane alone shows its image to an eye only where its light happens to go;
    here each place of the pupil gets light, and may get another image (parallax) or another focus.

    Parameters
    ----------
    targets : torch.Tensor
        Intensity ``[rows, columns]`` for all places, or ``[K, rows, columns]``, one for each; 0 … 1. Samples are
        directions from the middle of the pupil, as in :func:`odak.learn.wave.eye_image`.
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from the modulator, or its image by an eyepiece, to the pupil in metres.
    pitch : float or sequence of float
        Pixel pitch of the modulator, or of that image, in metres.
    pupil_positions : torch.Tensor or sequence
        Middles of the pupil (y, x) in metres, ``[K, 2]``.
    pupil_diameter : float or torch.Tensor
        Diameter of the pupil in metres, one or ``[K]``.
    focus : float or torch.Tensor, optional
        Distance in metres on which the eye is focused, one or ``[K]``; by default the distance of the modulator.
    iterations : int
        Number of iterations.
    loss_function : callable, optional
        ``loss_function(images, targets)`` of ``[K, rows, columns]``; mean squared error by default. One that takes a
        `generator` is given one, with which `seed` determines its random numbers too.
    learning_rate : float
        Adam's step size in radians.
    rotation : sequence of float or torch.Tensor
        Angles in degrees (rows, columns) by which the eye is rotated about its centre, ``[2]`` or ``[K, 2]``: the pupil
        moves to the side and back, and appears narrower, as in :func:`odak.learn.wave.eye_image`. Positions are those
        of the pupil before the rotation.
    optimizer : str
        "adam" or "lbfgs".
    initial_phase : torch.Tensor, optional
        Phase ``[rows, columns]``, or ``[frames, rows, columns]`` with several frames, to start from; uniform over a
        cycle by default, which lights the whole eyebox.
    frames : int
        Number of patterns shown one after another, whose intensities the eye averages. One pattern shows several
        images with speckle.
    slm : callable, optional
        ``slm(phase)`` is the field that the modulator sends out, such as
        :class:`odak.learn.wave.spatial_light_modulator`.
    pupils_per_step : int, optional
        Number of places drawn for each iteration, for fewer transforms and less memory; all by default. Not with
        "lbfgs".
    seed : int, optional
        Seed of the random numbers, for reproducible results.
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int
        Iterations between two writings of that file.

    Returns
    -------
    tuple of torch.Tensor
        Hologram, complex ``[rows, columns]``, or ``[frames, rows, columns]`` with several frames, and the intensities
        seen, ``[K, rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, with
        :class:`odak.learn.wave.Eyes` in place of its distances.

    Notes
    -----
    Pupil samples in the loss: Choi et al., Time-multiplexed neural holography, SIGGRAPH (2022), section 4.3.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import eyebox_hologram
    >>> places = [[0.0, -1e-3], [0.0, 1e-3]]
    >>> hologram, seen = eyebox_hologram(
    ...     torch.rand(2, 32, 32), 532e-9, 0.1, 8e-6, places, iterations=2, seed=0, progress=False
    ... )
    >>> hologram.shape, seen.shape
    (torch.Size([32, 32]), torch.Size([2, 32, 32]))
    """
    places = tensor("pupil_positions", pupil_positions, torch.float64)
    _validate.shaped("pupil_positions", places, "[K, 2], not empty")
    targets = checked_intensities("targets", targets)
    _validate.image("targets", targets)
    _validate.shaped(
        "targets", targets, f"[rows, columns] or [1 or {len(places)}, rows, columns], one for each of pupil_positions"
    )
    targets = targets.expand(len(places), *targets.shape[-2:])
    for name, length in (("wavelength", wavelength), ("distance", distance), ("learning_rate", learning_rate)):
        _validate.number(name, length, positive=True)
    checked_pitch("pitch", pitch)
    optimizer = _validate.one_of("optimizer", optimizer, SOLVERS)
    frames = _validate.integer("frames", frames, minimum=1)
    iterations = _validate.integer("iterations", iterations, minimum=1)
    for name, function in (("loss_function", loss_function), ("slm", slm)):
        _validate.function_or_none(name, function)
    at_once = len(places)
    if pupils_per_step is not None:
        at_once = min(_validate.integer("pupils_per_step", pupils_per_step, minimum=1), at_once)
        if optimizer == "lbfgs" and at_once < len(places):
            raise ValueError("pupils_per_step must be left out with 'lbfgs', whose line search needs one loss")
    device, generator = targets.device, generator_from(seed)
    places = places.to(device)
    diameters, foci = (of_each(*pair, places) for pair in (("pupil_diameter", pupil_diameter), ("focus", focus)))
    turns = angles_of_each(rotation, len(places))
    turned = bool(turns.any())
    modulate = unit_phasor if slm is None else slm
    if (samples := getattr(slm, "samples_per_pixel", 1)) != 1:
        raise ValueError(f"slm must have one sample per pixel here, got {samples}")
    loss_of, drawn_from = seeded_loss(loss_function, generator.initial_seed(), device)
    shape = (frames, *targets.shape[-2:])

    def draw(shape, dtype):
        # Uniform over a cycle.
        return 2 * math.pi * torch.rand(shape, generator=generator, dtype=dtype)

    phase = started("initial_phase", initial_phase, (shape, shape[1:]), targets, draw)
    phase = phase.expand(shape).clone().requires_grad_()

    with torch.no_grad():
        like = modulate(phase)[0]
        eyes: Any = [
            eye_transfer(
                like, pitch, wavelength, distance, place, diameters[k], None if foci is None else foci[k], turn
            )
            for k, (place, turn) in enumerate(zip(places, turns.tolist(), strict=True))
        ]
    transfers, lenses = (torch.stack(parts) for parts in zip(*eyes, strict=True))
    # Pupils at one distance share the transform of the field.
    shared = bool((turns == turns[0]).all())

    def images(chosen):
        lens = lenses[0] if shared else lenses[chosen]
        return intensity(retinal_field(modulate(phase), transfers[chosen], lens)).mean(0)

    def loss(iteration):
        chosen = slice(None)
        if at_once < len(places):
            chosen = torch.randperm(len(places), generator=generator)[:at_once].to(device)
        shown, wanted = images(chosen), targets[chosen]
        return loss_of(shown * best_scale(shown.detach(), wanted, None), wanted)

    def about():
        given: dict[str, Any] = {"learning_rate": learning_rate, "optimizer": optimizer, "pupils": at_once}
        lengths = {"wavelength": wavelength, "distance": distance, "pitch": pitch, "pupil_diameter": diameters}
        lengths |= {} if foci is None else {"focus": foci}
        given |= {name: _validate.numbers(length) for name, length in lengths.items()}
        return given | {"targets and places": fingerprint(targets, places, *([turns] if turned else []))}

    minimise(
        {"phase": phase},
        loss,
        learning_rate,
        Run(iterations, progress, callback, checkpoint, checkpoint_every),
        solver=optimizer,
        about=about,
        generators=[generator, *drawn_from],
    )
    with torch.no_grad():
        hologram = modulate(phase)
        return (hologram[0] if frames == 1 and len(hologram) == 1 else hologram), images(slice(None))
