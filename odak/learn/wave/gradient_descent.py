"""Phase-only holograms by gradient descent."""

import functools
from collections.abc import Callable

import torch
from tqdm import tqdm

from odak import _validate
from odak.learn.wave.compat import accepts_older_form
from odak.learn.wave.fields import intensity, unit_phasor
from odak.learn.wave.propagation import propagate_beam

OPTIMIZERS = ("adam", "lbfgs")


@accepts_older_form
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
    progress: bool = True,
    callback: Callable | None = None,
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
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.

    Returns
    -------
    tuple of torch.Tensor
        Hologram (amplitude one) and reconstruction, complex ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Chen et al., Math. Program. 176, 5 (2019); Peng et al., ACM Trans. Graph. 39, 185 (2020).

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
    _validate.real("learning_rate", learning_rate, positive=True)
    optimizer = _validate.one_of("optimizer", optimizer, OPTIMIZERS)
    phase = _starting_phase(target, initial_phase, seed).requires_grad_()
    reconstruct = functools.partial(
        propagate_beam,
        k=None,
        distance=distance,
        dx=pixel_pitch,
        wavelength=wavelength,
        propagation_type=propagation_type,
    )
    loss_function = torch.nn.functional.mse_loss if loss_function is None else loss_function

    def evaluate():
        image = intensity(reconstruct(unit_phasor(phase)))
        if scale:
            image = image * best_scale(image.detach(), target)
        return loss_function(image, target)

    _minimise(phase, evaluate, optimizer, learning_rate, n_iteration, progress, callback)
    with torch.no_grad():
        hologram = unit_phasor(phase)
        return hologram, reconstruct(hologram)


def best_scale(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return s = ⟨I, T⟩/⟨I, I⟩, the brightness at which an image is closest to its target, ``[..., 1, 1]``."""
    axes = (-2, -1)
    norm = (image * image).sum(axes, keepdim=True).clamp_min(torch.finfo(image.dtype).tiny)
    return (image * target).sum(axes, keepdim=True) / norm


def _checked_target(target) -> torch.Tensor:
    if not isinstance(target, torch.Tensor):
        raise TypeError(f"target must be a torch.Tensor of intensities, got {type(target).__name__}")
    _validate.image("target", target)
    if target.is_complex():
        raise TypeError(f"target must be real intensities, got {target.dtype}")
    target = target.detach() if target.dtype in (torch.float32, torch.float64) else target.detach().float()
    if not torch.isfinite(target).all() or (target < 0).any():
        raise ValueError("target must be finite intensities of at least 0, got NaN, infinite or negative values")
    return target


def _starting_phase(target, initial_phase, seed) -> torch.Tensor:
    if initial_phase is not None:
        if tuple(initial_phase.shape) != tuple(target.shape):
            raise ValueError(
                f"initial_phase must have the target's shape {tuple(target.shape)}, got {tuple(initial_phase.shape)}"
            )
        return initial_phase.detach().to(target, copy=True)
    generator = None if seed is None else torch.Generator().manual_seed(seed)
    # Drawn on the CPU, so that a seed gives the same start on every device.
    return torch.randn(target.shape, generator=generator, dtype=target.dtype).to(target.device)


def _minimise(phase, evaluate, optimizer, learning_rate, n_iteration, progress, callback) -> None:
    """Run the optimizer; the loss is read from the device for the progress bar only, twenty times in all."""
    step = _make_step(phase, evaluate, optimizer, learning_rate)
    bar = tqdm(range(n_iteration), desc="hologram", disable=not progress, leave=False)
    for iteration in bar:
        loss = step()
        if progress and iteration % max(1, n_iteration // 20) == 0:
            bar.set_postfix(loss=f"{float(loss):.3g}", refresh=False)
        if callback is not None and callback(iteration, loss) is True:
            bar.close()
            break


def _make_step(phase, evaluate, optimizer, learning_rate) -> Callable:
    def gradient():
        phase.grad = None
        with torch.enable_grad():
            loss = evaluate()
        loss.backward()
        return loss

    if optimizer == "adam":
        return _Adam(phase, gradient, learning_rate).step
    # torch's L-BFGS forgets a step whose y·s is below 1e-10. The mean over a million pixels makes it that small, so the
    # solver is given the sum, and the caller the mean again.
    pixels = phase.numel()
    solver = torch.optim.LBFGS(
        [phase], lr=1, max_iter=1, tolerance_grad=0, tolerance_change=0, line_search_fn="strong_wolfe"
    )

    def summed():
        loss = gradient()
        phase.grad.mul_(pixels)
        return pixels * loss

    return lambda: solver.step(summed).detach() / pixels


class _Adam:
    """Adam (Kingma and Ba, 2015, algorithm 1) on one tensor.

    ``torch.optim.Adam`` does the same, but its constructor loads the compiler: two seconds and 80 MB, as much as
    twenty iterations at full size and more memory than the hologram's padded field.
    """

    def __init__(self, phase: torch.Tensor, gradient: Callable, learning_rate: float, betas=(0.9, 0.999), epsilon=1e-8):
        self.phase, self.gradient = phase, gradient
        self.learning_rate, self.betas, self.epsilon = learning_rate, betas, epsilon
        self.mean = torch.zeros_like(phase, requires_grad=False)
        self.square = torch.zeros_like(self.mean)
        self.count = 0

    def step(self) -> torch.Tensor:
        """Take one step and return the loss before it."""
        loss = self.gradient()
        slope = self.phase.grad
        with torch.no_grad():
            self.count += 1
            mean_bias, square_bias = (1 - beta**self.count for beta in self.betas)
            self.mean.lerp_(slope, 1 - self.betas[0])
            self.square.mul_(self.betas[1]).addcmul_(slope, slope, value=1 - self.betas[1])
            # The gradient's memory is done with, so the denominator takes its place.
            denominator = torch.sqrt(self.square, out=slope).div_(square_bias**0.5).add_(self.epsilon)
            self.phase.addcdiv_(self.mean, denominator, value=-self.learning_rate / mean_bias)
        return loss.detach()
