"""Phase-only holograms of a single plane: gradient descent, Gerchberg–Saxton, point-wise and double phase."""

import functools
import inspect
import math
import os
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, ParamSpec, TypeVar

import torch

from odak import _validate
from odak._array import phasor
from odak._bars import tqdm
from odak._warnings import AccuracyWarning, ArgumentWarning, warn
from odak.learn._tensors import (
    checked_device,
    floating,
    get_device,
    takes_constants,
    tensor,
)
from odak.learn.tools.iterations import SOLVERS, Run, minimise
from odak.learn.tools.matrix import blur_gaussian
from odak.learn.wave.camera import captured_by, with_model_gradient
from odak.learn.wave.fields import generate_complex_field, mean_intensity, unit_phasor
from odak.learn.wave.holograms.solvers.double_phase import encode_double_phase
from odak.learn.wave.holograms.starts import STARTS, starting_phase
from odak.learn.wave.propagation import propagate_beam
from odak.learn.wave.slm import checked_fill, iris_cutoff
from odak.learn.wave.training import (
    REGISTER,
    best_scale,
    check_brightness,
    checked_intensities,
    fingerprint,
    generator_from,
    seeded_loss,
    started,
)
from odak.wave import phase_retrieval
from odak.wave.linear_kernels import checked_pixel_fill, pixel_aperture
from odak.wave.methods import check_has_kernel
from odak.wave.propagation import propagate_within_window
from odak.wave.transfer_functions import checked_pitch, convolve, pitches

P = ParamSpec("P")
R = TypeVar("R")


def accepts_older_form(function: Callable[P, R]) -> Callable[P, R]:
    """Let an optimizer be called as ``f(target, wavelength, distance, dx, resolution, propagation_type, count, …)``.

    The older form has a resolution at the fifth place, the keyword `dx` for `pixel_pitch`, `iteration_number` for
    `n_iteration`, and `cuda`.

    Parameters
    ----------
    function : callable
        The optimizer in its present form.

    Returns
    -------
    callable
        The optimizer, accepting both.
    """
    own = list(inspect.signature(function).parameters)

    @functools.wraps(function)
    def adapted(*args, **options):
        args = list(args)
        if not args and own[0] in options:
            args = [options.pop(own[0])]
        resolution = options.pop("resolution", None)
        if len(args) > 4 and hasattr(args[4], "__len__") and not isinstance(args[4], str):
            resolution = args.pop(4)
        for old, new in (("dx", "pixel_pitch"), ("iteration_number", "n_iteration")):
            if old in options and old not in own:
                options[new] = options.pop(old)
        if args and isinstance(args[0], torch.Tensor):
            shape = tuple(args[0].shape[-2:])
            if resolution is not None and _validate.size("resolution", resolution) != shape:
                raise ValueError(f"resolution must be the {own[0]}'s {shape}, got {tuple(resolution)}")
            if "cuda" in options:
                args[0] = args[0].to(get_device("cuda" if options.pop("cuda") else "cpu"))
        return function(*args, **options)

    return adapted


_DESCENT_NAMES = ("field", "wavelength", "distance", "dx")
_DESCENT_OPTIONS = ("propagation_type", "n_iterations", "loss_function", "learning_rate")
_RENAMED = {"pixel_pitch": "dx", "n_iteration": "n_iterations", "iteration_number": "n_iterations"}
_WITHOUT_EFFECT = ("loss_function", "learning_rate", "optimizer", "scale")


def accepts_descent_form(function: Callable[P, R]) -> Callable[P, R]:
    """Let Gerchberg–Saxton be called with the arguments of `stochastic_gradient_descent`, present or older.

    The form is recognised by a wavelength at the second place, or the keyword `target`, which is then an intensity.
    Arguments that alternating projections have no use for are named in an ArgumentWarning.

    Parameters
    ----------
    function : callable
        `gerchberg_saxton` in its own form.

    Returns
    -------
    callable
        The function, accepting both.
    """
    older = accepts_older_form(function)

    @functools.wraps(function)
    def adapted(*args, **options):
        options = {_RENAMED.get(name, name): value for name, value in options.items()}
        if "target" in options or (len(args) > 1 and not _is_count(args[1])):
            names = list(_DESCENT_NAMES)
            if len(args) > 4 and hasattr(args[4], "__len__") and not isinstance(args[4], str):
                names.append("resolution")
            names += _DESCENT_OPTIONS
            if "target" in options:
                options["field"] = options.pop("target")
            given = dict(zip(names, args, strict=False))
            if len(args) > len(names) or given.keys() & options.keys():
                raise TypeError("gerchberg_saxton got more than one value, or too many, for its arguments")
            options = given | options
            options["field"] = torch.sqrt(_validate.image("target", options["field"]).abs())
            args = ()
        ignored = [name for name in _WITHOUT_EFFECT if options.pop(name, None) not in (None, False)]
        if ignored:
            warn(f"gerchberg_saxton has no use for {' and '.join(ignored)}: ignored", ArgumentWarning)
        return older(*args, **options)

    return adapted


def _is_count(value) -> bool:
    """Return whether a second argument is a number of iterations: no wavelength in metres is above 1, or 0 or less."""
    return isinstance(value, Real) and not 0 < float(value) < 1


@accepts_older_form
@takes_constants("wavelength", "distance", "pixel_pitch", "learning_rate")
@torch.inference_mode(False)
@_validate.takes_units("wavelength", "distance", "pixel_pitch", "iris_radius", "iris_focal_length")
def stochastic_gradient_descent(
    target: torch.Tensor,
    wavelength: float,
    distance: float,
    pixel_pitch: float | Sequence[float],
    propagation_type: str = "Bandlimited Angular Spectrum",
    n_iteration: int = 100,
    loss_function: Callable[..., Any] | None = None,
    learning_rate: float = 0.1,
    *,
    optimizer: str = "adam",
    initial_phase: torch.Tensor | str | None = None,
    seed: int | None = None,
    scale: bool = False,
    frames: int = 1,
    slm: Callable[..., Any] | None = None,
    iris_radius: float | None = None,
    iris_focal_length: float | None = None,
    camera: Callable[..., Any] | None = None,
    progress: bool = True,
    callback: Callable[..., Any] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: int = 50,
    pixel_fill: float | None = None,
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
    pixel_pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`. Light is propagated without wrap-around, where all
        exact methods are the same, equal to "auto", and so are those after Fresnel. "Fraunhofer" and its inverse remain
        as they are.
    n_iteration : int
        Number of iterations.
    loss_function : callable, optional
        ``loss_function(intensity, target)``; mean squared error by default. One that draws random numbers should take a
        `generator`: it is then given one on the device of the targets, with which `seed` determines its random numbers
        and a checkpoint keeps their state. What it draws from torch's own generator does not depend on `seed`.
    learning_rate : float
        Adam's step size in radians. L-BFGS takes its steps from a line search instead.
    optimizer : str
        "adam" or "lbfgs". L-BFGS is the faster one where the loss is the same function in each iteration; it keeps
        twenty arrays of the phase's size.
    initial_phase : torch.Tensor or str, optional
        Phase to start from, in radians, of the target's shape, ``[frames, …]`` with several frames; or one of
        :data:`STARTS` by name, see :func:`starting_phase`. Normal noise of standard deviation 1 by default. "gs" is
        recommended, together with ``scale=True`` and L-BFGS: they were the fastest in all measurements from 512 × 512
        pixels on.
    seed : int, optional
        Makes the random start reproducible, and the random numbers of a loss that takes a `generator`; by default
        torch's own generator draws them.
    scale : bool
        Compare s·intensity with the target, s = ⟨I, T⟩/⟨I, I⟩ being the best brightness of each iteration. Without it
        the light that the target does not need has to be thrown outside the image, which costs 10 dB on photographs.
    frames : int
        Number of patterns shown one after another, faster than an eye or a camera tells apart. The image is the mean of
        their intensities. With frames of few bits (``slm=spatial_light_modulator(bits=1)``), as fast modulators show
        them, this averages the quantisation too. A modulator that is still settling while it is lit is
        ``slm=temporal_modulator(…)``.
    slm : callable, optional
        Model of the modulator: ``slm(phase)`` is the field it sends out, such as
        :class:`odak.learn.wave.spatial_light_modulator`. The hologram returned is that field. With a fill factor below
        one, the field is propagated with the spectrum of pixels of that size.
    iris_radius : float, optional
        Radius in metres of a round iris in the focal plane of a lens; open by default. Frequencies up to
        iris_radius/(wavelength·iris_focal_length) pass.
    iris_focal_length : float, optional
        Focal length in metres of that lens.
    camera : callable, optional
        ``camera(phase)`` shows a phase on the real display and returns the intensity it captures, in the target's
        shape. The loss is then computed from the captured image, its gradient by the model (camera in the loop).
        The best state is returned, with a ConvergenceWarning if the loss has risen since.
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int
        Iterations between two writings of that file; it is written at the end and on an interruption too.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1. The field is then propagated with the spectrum of
        pixels of that size, up to 1/(2·pixel_pitch); an iris has to keep the orders beyond it away. By default pixels
        are points, unless `slm` has a fill factor.

    Returns
    -------
    tuple of torch.Tensor
        Hologram (amplitude one) and reconstruction, complex ``[..., rows, columns]``; with several frames
        ``[frames, ..., rows, columns]``. After a KeyboardInterrupt they are the best so far.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, by solver
        "adam" or "lbfgs".

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
    checked_pitch("pixel_pitch", pixel_pitch)
    _validate.real("learning_rate", learning_rate, positive=True)
    scale = _validate.flag("scale", scale)
    for name, function in (("loss_function", loss_function), ("slm", slm), ("camera", camera)):
        _validate.function_or_none(name, function)
    if seed is not None:
        _validate.integer("seed", seed)
    conserved = not scale and loss_function is None and slm is None
    check_brightness("target", target, 1 if conserved else math.inf, "scale=True")
    run = Run(n_iteration, progress, callback, checkpoint, checkpoint_every)
    check_has_kernel(propagation_type)
    optimizer = _validate.one_of("optimizer", optimizer, SOLVERS)
    frames = _validate.integer("frames", frames, minimum=1)
    cutoff = iris_cutoff(wavelength, iris_radius, iris_focal_length)
    shape = tuple(target.shape) if frames == 1 else (frames, *target.shape)
    lengths: dict[str, Any] = {
        "distance": distance,
        "dx": pixel_pitch,
        "wavelength": wavelength,
        "propagation_type": propagation_type,
    }
    if isinstance(initial_phase, str):
        initial_phase = starting_phase(initial_phase, target, seed=seed, frames=frames, **lengths)
    draw = functools.partial(torch.randn, generator=None if seed is None else generator_from(seed))
    phase = started("initial_phase", initial_phase, [shape], target, draw, STARTS).requires_grad_()
    modulate = unit_phasor if slm is None else slm
    if (samples := getattr(slm, "samples_per_pixel", 1)) != 1:
        raise ValueError(f"slm must have one sample per pixel here, got {samples}; a propagator takes more")
    fill = checked_fill(pixel_fill, slm, cutoff is not None)
    reconstruct = functools.partial(propagate_within_window, cutoff=cutoff, pixel_fill=fill, **lengths)
    loss_of, drawn_from = seeded_loss(loss_function, seed, target.device)

    def loss(iteration):
        image = mean_intensity(reconstruct(modulate(phase)), frames)
        if camera is not None:
            image = with_model_gradient(image, captured_by(camera, phase, tuple(image.shape)))
        if scale:
            image = image * best_scale(image.detach(), target)
        return loss_of(image, target)

    def about():
        given = {"learning_rate": learning_rate, "optimizer": optimizer, "scale": scale, "target": fingerprint(target)}
        given |= {} if cutoff is None else {"cutoff": cutoff}
        given |= {} if fill is None else {"pixel_fill": fill}
        lengths = {"wavelength": wavelength, "distance": distance, "pixel_pitch": pixel_pitch}
        given |= {name: _validate.numbers(length) for name, length in lengths.items()}
        return given | {"propagation_type": propagation_type}

    minimise(
        {"phase": phase},
        loss,
        learning_rate,
        run,
        solver=optimizer,
        about=about,
        generators=drawn_from,
        rising=None if camera is None else REGISTER,
    )
    with torch.no_grad():
        hologram = modulate(phase)
        shown: Any = reconstruct(hologram)  # type: ignore[call-arg]
        return hologram, shown


def _checked_target(target) -> torch.Tensor:
    if isinstance(target, torch.Tensor):
        _validate.planes("target", target)
    return checked_intensities("target", target)


@accepts_descent_form
@takes_constants("distance", "dx", "wavelength", "slm_range")
@torch.no_grad()
@_validate.takes_units("distance", "dx", "wavelength")
def gerchberg_saxton(
    field: torch.Tensor,
    n_iterations: int,
    distance: float,
    dx: float | Sequence[float],
    wavelength: float,
    slm_range: float = 6.28,
    propagation_type: str = "auto",
    initial_phase: torch.Tensor | None = None,
    seed: int | torch.Generator | None = None,
    progress: bool = False,
    callback: Callable[..., Any] | None = None,
    pixel_fill: float | None = None,
    *,
    accelerated: bool = False,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a phase-only hologram of an image by alternating projections (Gerchberg and Saxton, Optik 35, 1972).

    Each iteration keeps only the phase on the hologram and sets the target's amplitude on the image; around the image,
    on planes of twice its size, the field is free.

    Parameters
    ----------
    field : torch.Tensor
        ``[..., rows, columns]``; its amplitude is the target amplitude.
    n_iterations : int
        Number of iterations.
    distance : float
        Distance from hologram to image in metres.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    slm_range : float
        Phase range of the modulator in radians; phases beyond it take its nearer end.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`. During the iterations fields are
        padded to twice their size, on which the light of the named transfer functions wraps around beyond the critical
        distance N·dx²/λ. The image returned is computed without this wrap-around.
    initial_phase : torch.Tensor, optional
        Phase to start the hologram from; uniform between 0 and π by default.
    seed : int or torch.Generator, optional
        Makes the random start reproducible; by default torch's generator draws it.
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, hologram_phase)`` after each iteration; returning True stops.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1. The image is then formed by the light of pixels of
        that size up to 1/(2·dx), for methods with a transfer function; by default pixels are points.
    accelerated : bool
        Start each iteration ahead of the hologram found, along its last change (Nesterov's extrapolation). It takes no
        further propagation, and reaches in 20 to 30 iterations what takes 60 without. False by default.

    Returns
    -------
    tuple of torch.Tensor
        Phase-only hologram and reconstruction, complex ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, by solver "gs".

    Notes
    -----
    The arguments of :func:`odak.learn.wave.stochastic_gradient_descent` are accepted too, its older ones included; the
    target is then an intensity, and an ArgumentWarning names those without effect, such as `learning_rate`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import gerchberg_saxton
    >>> image = torch.zeros(16, 16)
    >>> image[6:10, 6:10] = 1
    >>> hologram, reconstruction = gerchberg_saxton(image, 5, 5e-3, 8e-6, 532e-9, 6.2832, "Angular Spectrum", seed=0)
    >>> bool((hologram.abs() - 1).abs().max() < 1e-5)
    True
    """
    count = _validate.integer("n_iterations", n_iterations, minimum=1)
    progress, callback = _validate.flag("progress", progress), _validate.function_or_none("callback", callback)
    turns = tqdm(range(count), desc="hologram", disable=not progress, leave=False)
    options = {"callback": callback, "fill": pixel_fill, "accelerated": _validate.flag("accelerated", accelerated)}
    return phase_retrieval.retrieve(
        field, turns, distance, dx, wavelength, slm_range, propagation_type, initial_phase, seed, **options
    )


@takes_constants("wavelength", "distance", "dx")
@torch.no_grad()
@_validate.takes_units("wavelength", "distance", "dx")
def point_wise(
    target: torch.Tensor,
    wavelength: float,
    distance: float,
    dx: float | Sequence[float],
    device: torch.device,
    lens_size: int = 401,
) -> torch.Tensor:
    """Return the hologram that focuses a lens on each lit pixel (Maimone, Georgiou and Kollin, ACM TOG 36, 85 (2017)).

    Parameters
    ----------
    target : torch.Tensor
        Intensity ``[..., rows, columns]``.
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from hologram to image in metres; each lens has this focal length.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    device : torch.device
        Where to compute.
    lens_size : int
        Radius of each lens in pixels, along both axes.

    Returns
    -------
    torch.Tensor
        Complex hologram ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, of any picture.

    Examples
    --------
    The hologram of one pixel is brought to a focus on that pixel:

    >>> import torch
    >>> from odak.learn.wave import point_wise, propagate_beam
    >>> image = torch.zeros(32, 32)
    >>> image[20, 12] = 1
    >>> hologram = point_wise(image, 532e-9, 2e-3, 8e-6, torch.device("cpu"), lens_size=15)
    >>> focus = propagate_beam(hologram, None, 2e-3, 8e-6, 532e-9, "Angular Spectrum").abs()
    >>> divmod(int(focus.argmax()), 32)
    (20, 12)
    """
    target = _validate.image("target", tensor("target", target)).to(checked_device("device", device))
    device = target.device
    _validate.real("wavelength", wavelength, positive=True)
    _validate.real("distance", distance, nonzero=True)
    steps = [_validate.number("dx", pitch, positive=True) for pitch in pitches(dx)]
    radius = _validate.side("lens_size", lens_size)
    dtype = torch.complex128 if target.dtype == torch.float64 else torch.complex64
    y, x = (torch.fft.fftfreq(2 * n, 1 / (2 * n), dtype=torch.float64, device=device) for n in target.shape[-2:])
    squared = (steps[0] * y[:, None]) ** 2 + (steps[1] * x) ** 2
    lens = phasor(-math.pi / (wavelength * distance) * squared, dtype) * (y[:, None] ** 2 + x**2 <= radius**2)
    return convolve(target.sqrt().to(dtype), torch.fft.fft2(lens))


@_validate.takes_units("depth_shift", "pixel_pitch", "wavelength")
def shift_w_double_phase(
    phase: torch.Tensor,
    depth_shift: float,
    pixel_pitch: float | Sequence[float],
    wavelength: float,
    propagation_type: str = "Transfer Function Fresnel",
    kernel_length: int = 4,
    sigma: float = 0.5,
    amplitude: torch.Tensor | None = None,
    *,
    pixel_fill: float | None = None,
) -> torch.Tensor:
    """Return a phase-only hologram shifted in depth, its amplitude encoded by double phase.

    Parameters
    ----------
    phase : torch.Tensor
        Phase ``[rows, columns]`` in radians.
    depth_shift : float
        Distance to move by, in metres.
    pixel_pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`.
    kernel_length : int
        Length in pixels of the Gaussian that smooths the field before encoding, taken to the next odd number; 0 for
        none.
    sigma : float
        Its standard deviation in pixels.
    amplitude : torch.Tensor, optional
        Amplitude of the field; ones by default.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1. The field is then divided by the spectrum of such
        pixels, which multiplies what the hologram shows; by default pixels are points.

    Returns
    -------
    torch.Tensor
        Phase ``[rows, columns]``: φ − arccos(a) where row and column are both even or both odd, φ + arccos(a)
        elsewhere.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, by solver
        "double phase".

    Notes
    -----
    Shi, Li, Kim, Kellnhofer and Matusik, Nature 591, 234 (2021); Hsueh and Sawchuk, Appl. Opt. 17, 3874 (1978).

    Neighbouring pixels add up to the field only behind an iris in the Fourier plane that stops the checkerboard's own
    orders, half of the band of the pixels at most; without one the image is lost in them. The displays and
    :func:`stochastic_gradient_descent` take one as `iris_radius` and `iris_focal_length`;
    :func:`double_phase_hologram` simulates one by default.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import shift_w_double_phase
    >>> tuple(shift_w_double_phase(torch.zeros(16, 16), 1e-3, 8e-6, 532e-9).shape)
    (16, 16)
    """
    phase = _validate.image("phase", floating("phase", phase))
    check_has_kernel(propagation_type)
    _validate.real("depth_shift", depth_shift)
    checked_pitch("pixel_pitch", pixel_pitch)
    kernel_length, sigma = _validate.whole("kernel_length", kernel_length), _validate.real("sigma", sigma)
    field = generate_complex_field(torch.ones_like(phase) if amplitude is None else amplitude, phase)
    undo = {} if pixel_fill is None else {"aperture": 1 / pixel_aperture(field, checked_pixel_fill(pixel_fill))}
    field = propagate_beam(field, None, depth_shift, pixel_pitch, wavelength, propagation_type, **undo)
    carrier = torch.tensor(-2 * math.pi * (depth_shift / wavelength % 1), dtype=torch.float64, device=phase.device)
    field = field * phasor(carrier, field.dtype)
    if kernel_length > 0 and sigma > 0:
        side = 2 * (kernel_length // 2) + 1
        # Samples of that Gaussian are side / (side - 1) apart.
        widths = (sigma * side / max(side - 1, 1),) * 2
        parts = torch.view_as_real(field).movedim(-1, 0).contiguous()
        smooth = blur_gaussian(parts, (side, side), widths, keep_sum=True).reshape(parts.shape)
        field = torch.view_as_complex(smooth.movedim(0, -1).contiguous())
    return encode_double_phase(field)


@takes_constants("wavelength", "distance", "pitch")
@torch.no_grad()
@_validate.takes_units("wavelength", "distance", "pitch", "iris_radius", "iris_focal_length")
def double_phase_hologram(
    target: torch.Tensor,
    wavelength: float,
    distance: float,
    pitch: float | Sequence[float],
    propagation_type: str = "Bandlimited Angular Spectrum",
    *,
    image_phase: torch.Tensor | None = None,
    iris: bool = True,
    iris_radius: float | None = None,
    iris_focal_length: float | None = None,
    pixel_fill: float | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the double-phase hologram of an image, and what it shows behind the iris that it needs.

    The field of the image is propagated back to the modulator and encoded by two phases in a checkerboard, without
    iterations. Neighbouring pixels add up to the field where an iris stops the orders of the checkerboard.

    Parameters
    ----------
    target : torch.Tensor
        Intensity ``[..., rows, columns]``, 0 … 1.
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from hologram to image in metres.
    pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    propagation_type : str
        Propagation type with a transfer function, see :func:`odak.learn.wave.propagate_beam`, or "auto".
    image_phase : torch.Tensor, optional
        Phase of the image in radians, which broadcasts against the target; zero by default.
    iris : bool
        Simulate an iris, which also limits the field that is encoded. False shows the image on a display without one,
        where most of it is lost, and issues an AccuracyWarning.
    iris_radius : float, optional
        Radius in metres of a round iris in the focal plane of a lens. By default the iris passes frequencies up to
        1/(4·pitch), half of the band of the pixels; with two pitches the larger one counts.
    iris_focal_length : float, optional
        Focal length in metres of that lens.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1. The field that is encoded is divided by the spectrum
        of such pixels, and the reconstruction is what they show; by default pixels are points.

    Returns
    -------
    tuple of torch.Tensor
        Hologram (amplitude one) and reconstruction, complex ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    AccuracyWarning
        If there is no iris, or one that passes the orders of the checkerboard.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, by solver
        "double phase".

    Notes
    -----
    Hsueh and Sawchuk, Appl. Opt. 17, 3874 (1978); Maimone, Georgiou and Kollin, ACM Trans. Graph. 36, 85 (2017).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import double_phase_hologram
    >>> target = torch.zeros(32, 32)
    >>> target[8:24, 8:24] = 1.0
    >>> hologram, image = double_phase_hologram(target, 532e-9, 5e-3, 8e-6)
    >>> bool((hologram.abs() - 1).abs().max() < 1e-6)
    True
    """
    target = _checked_target(target)
    _validate.real("wavelength", wavelength, positive=True)
    _validate.real("distance", distance)
    checked_pitch("pitch", pitch)
    check_has_kernel(propagation_type)
    cutoff = iris_cutoff(wavelength, iris_radius, iris_focal_length)
    if not _validate.flag("iris", iris):
        if cutoff is not None:
            raise ValueError("iris_radius excludes iris=False")
        passes = "there is no iris"
    else:
        quarters = [0.25 / _validate.numbers(length)[0] for length in pitches(pitch)]
        cutoff = min(quarters) if cutoff is None else cutoff
        # The orders of the checkerboard lie at (±1, ±1)/(2·pitch), and the image about them is as wide as the iris.
        passes = "the iris passes more than that" if cutoff > math.hypot(*quarters) else ""
    if passes:
        warn(
            "double phase needs an iris that passes frequencies up to about 1/(4·pitch), or the orders of its "
            f"checkerboard lie over the image; {passes}",
            AccuracyWarning,
        )
    lengths: dict[str, Any] = {"dx": pitch, "wavelength": wavelength, "cutoff": cutoff}
    lengths["propagation_type"] = propagation_type
    phase = torch.zeros_like(target)
    if image_phase is not None:
        phase = _validate.image("image_phase", floating("image_phase", image_phase)).to(target)
        _validate.real("image_phase", phase)
        if _validate.fitting(target=target, image_phase=phase) != tuple(target.shape):
            raise ValueError(f"image_phase must fit the target {list(target.shape)}, got {list(phase.shape)}")
    there: Any = propagate_within_window(target.sqrt() * unit_phasor(phase), distance=-distance, **lengths)
    fill = None if pixel_fill is None else checked_pixel_fill(pixel_fill)
    if fill is not None:
        there = convolve(there, torch.fft.ifftshift(1 / pixel_aperture(there, fill)))
    hologram = unit_phasor(encode_double_phase(there))
    shown: Any = propagate_within_window(hologram, distance=distance, pixel_fill=fill, **lengths)
    return hologram, shown
