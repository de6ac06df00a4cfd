"""Phase-only holograms by gradient descent."""

import functools
import os
from collections.abc import Callable

import torch

from odak import _validate
from odak.learn._tensors import floating, trainable
from odak.learn.wave.camera_in_the_loop import captured_by, seen
from odak.learn.wave.compat import accepts_older_form
from odak.learn.wave.fields import intensity, unit_phasor
from odak.learn.wave.propagation import propagate_beam
from odak.learn.wave.solvers import SOLVERS
from odak.learn.wave.training import Options, constant, fingerprint, minimise


@accepts_older_form
@torch.inference_mode(False)
def stochastic_gradient_descent(
    target: torch.Tensor,
    wavelength: float,
    distance: float,
    pixel_pitch: float,
    propagation_type: str = "Bandlimited Angular Spectrum",
    n_iteration: int = 100,
    loss_function: Callable | None = None,
    learning_rate: float = 0.1,
    *,
    optimizer: str = "adam",
    initial_phase: torch.Tensor | None = None,
    seed: int | None = None,
    scale: bool = False,
    slm: Callable | None = None,
    camera: Callable | None = None,
    progress: bool = True,
    callback: Callable | None = None,
    checkpoint: str | os.PathLike | None = None,
    checkpoint_every: int = 50,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a phase-only hologram whose intensity at a distance is the target.

    Parameters
    ----------
    target : torch.Tensor
        Intensity ``[..., rows, columns]``, 0 … 1. Its device is where the work is done.
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from hologram to image in metres.
    pixel_pitch : float
        Pixel pitch in metres.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`; fields are padded to twice their size.
    n_iteration : int
        Number of iterations.
    loss_function : callable, optional
        ``loss_function(intensity, target)``; mean squared error by default.
    learning_rate : float
        Adam's step size in radians. L-BFGS takes its steps from a line search instead.
    optimizer : str
        "adam" or "lbfgs".
    initial_phase : torch.Tensor, optional
        Phase to start from, in radians; normal noise of standard deviation 1 by default. Without `scale` a flat
        phase (``torch.zeros_like(target)``) ends about 2 dB higher on photographs; with it the start hardly matters.
    seed : int, optional
        Makes the random start reproducible.
    scale : bool
        Compare s·intensity with the target, s = ⟨I, T⟩/⟨I, I⟩ being the best brightness of each iteration. Without it
        the light that the target does not need has to be thrown outside the image, which costs 10 dB on photographs.
    slm : callable, optional
        Model of the modulator: ``slm(phase)`` is the field it sends out, such as
        :class:`odak.learn.wave.spatial_light_modulator`. The hologram returned is that field.
    camera : callable, optional
        ``camera(phase)`` shows a phase on the real display and returns the intensity it captures, in the target's
        shape. The loss is then that of the captured image, and the model gives its slope alone (camera in the loop).
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int
        Iterations between two writings of that file; it is written at the end and on an interruption too.

    Returns
    -------
    tuple of torch.Tensor
        Hologram (amplitude one) and reconstruction, complex ``[..., rows, columns]``. After a KeyboardInterrupt they
        are the best so far.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Chen et al., Math. Program. 176, 5 (2019); Peng et al., ACM Trans. Graph. 39, 185 (2020), whose section 4 is the
    camera in the loop.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import stochastic_gradient_descent
    >>> target = torch.zeros(32, 32)
    >>> target[12:20, 12:20] = 1.0
    >>> hologram, image = stochastic_gradient_descent(
    ...     target, 532e-9, 1e-3, 8e-6, n_iteration=5, seed=0, progress=False
    ... )
    >>> bool((hologram.abs() - 1).abs().max() < 1e-6)
    True
    """
    target = _checked_target(target)
    n_iteration = _validate.integer("n_iteration", n_iteration, minimum=1)
    _validate.real("wavelength", wavelength, positive=True)
    _validate.real("distance", distance)
    _validate.real("pixel_pitch", pixel_pitch, positive=True)
    _validate.real("learning_rate", learning_rate, positive=True)
    scale = _validate.flag("scale", scale)
    for name, function in (("loss_function", loss_function), ("slm", slm), ("camera", camera)):
        _validate.function_or_none(name, function)
    options = Options(progress, callback, checkpoint, checkpoint_every, seed)
    optimizer = _validate.one_of("optimizer", optimizer, SOLVERS)
    phase = _starting_phase(target, initial_phase, seed).requires_grad_()
    modulate = unit_phasor if slm is None else slm
    if (samples := getattr(slm, "samples_per_pixel", 1)) != 1:
        raise ValueError(f"slm must have one sample per pixel here, got {samples}; a propagator takes more")
    reconstruct = functools.partial(
        propagate_beam,
        k=None,
        distance=distance,
        dx=pixel_pitch,
        wavelength=wavelength,
        propagation_type=propagation_type,
    )
    loss_function = torch.nn.functional.mse_loss if loss_function is None else loss_function

    def gradient(iteration):
        image = intensity(reconstruct(modulate(phase)))
        if camera is not None:
            image = seen(image, captured_by(camera, phase, tuple(image.shape)))
        if scale:
            image = image * best_scale(image.detach(), target)
        loss = loss_function(image, target)
        loss.backward()
        return loss.detach()

    about = {"learning_rate": learning_rate, "optimizer": optimizer, "scale": scale}
    if checkpoint is not None:
        about |= _problem(target, wavelength, distance, pixel_pitch) | {"propagation_type": propagation_type}
    minimise({"phase": phase}, gradient, n_iteration, constant(learning_rate), options, solver=optimizer, about=about)
    with torch.no_grad():
        hologram = modulate(phase)
        return hologram, reconstruct(hologram)


def best_scale(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return s = ⟨I, T⟩/⟨I, I⟩, the brightness at which an image is closest to its target, ``[..., 1, 1]``."""
    axes = (-2, -1)
    norm = (image * image).sum(axes, keepdim=True).clamp_min(torch.finfo(image.dtype).tiny)
    return (image * target).sum(axes, keepdim=True) / norm


def _problem(target, wavelength, distance, pixel_pitch) -> dict:
    """Return what a checkpoint must be of."""
    lengths = {"wavelength": wavelength, "distance": distance, "pixel_pitch": pixel_pitch}
    return {"target": fingerprint(target), **{name: _validate.numbers(length) for name, length in lengths.items()}}


def _checked_target(target) -> torch.Tensor:
    if not isinstance(target, torch.Tensor):
        raise TypeError(f"target must be a torch.Tensor of intensities, got {type(target).__name__}")
    _validate.image("target", target)
    if target.is_complex():
        raise TypeError(f"target must be real intensities, got {target.dtype}")
    target = target.detach() if target.dtype in (torch.float32, torch.float64) else target.detach().float()
    if not torch.isfinite(target).all() or (target < 0).any():
        raise ValueError("target must be finite intensities of at least 0, got NaN, infinite or negative values")
    return trainable(target)


def _starting_phase(target, initial_phase, seed) -> torch.Tensor:
    if initial_phase is not None:
        _validate.real("initial_phase", floating("initial_phase", initial_phase).detach().cpu())
        if tuple(initial_phase.shape) != tuple(target.shape):
            raise ValueError(
                f"initial_phase must have the target's shape {tuple(target.shape)}, got {tuple(initial_phase.shape)}"
            )
        return initial_phase.detach().to(target, copy=True)
    generator = None if seed is None else torch.Generator().manual_seed(seed)
    # Drawn on the CPU, so that a seed gives the same start on every device.
    return torch.randn(target.shape, generator=generator, dtype=target.dtype).to(target.device)
