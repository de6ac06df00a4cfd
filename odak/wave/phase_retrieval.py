"""Phase-only holograms by Gerchberg–Saxton: of images in one plane or several, of spots, and of far fields."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Amount, Array, Seed
from odak.wave.fields import (
    calculate_amplitude,
    calculate_intensity,
    calculate_phase,
    generate_complex_field,
    uniform,
    within_range,
)
from odak.wave.linear_kernels import checked_pixel_fill, pixel_aperture
from odak.wave.methods import check_has_kernel
from odak.wave.propagation import propagate_beam, propagate_within_window
from odak.wave.sampling import warn_of_factor
from odak.wave.transfer_functions import pitches

_WINDOW = (True, False, True)
_AMPLITUDES = "give amplitudes of 0 … 1 (8-bit values divided by 255)"
TARGET_TYPES = ("no constraint", "double constraint")


@_validate.takes_units("distance", "dx", "wavelength")
def gerchberg_saxton(
    field: np.ndarray,
    n_iterations: int,
    distance: float,
    dx: float | Sequence[float],
    wavelength: float,
    slm_range: float = 6.28,
    propagation_type: str = "auto",
    initial_phase: np.ndarray | None = None,
    seed: Seed = None,
    *,
    pixel_fill: float | None = None,
    accelerated: bool = False,
) -> tuple[Any, ...]:
    """Return a phase-only hologram of an image, by alternating projections (Gerchberg and Saxton, Optik 35, 1972).

    The planes are twice the image's size: the amplitude is constrained inside the image's window and free around it.

    Parameters
    ----------
    field : numpy.ndarray
        ``[rows, columns]``; its amplitude is the target amplitude.
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
        Propagation type, see :func:`odak.wave.propagate_beam`. During the iterations fields are
        padded to twice their size, on which the light of the named transfer functions wraps around beyond the critical
        distance N·dx²/λ. The image returned is computed without this wrap-around.
    initial_phase : numpy.ndarray, optional
        Phase ``[rows, columns]`` to start the hologram from; uniform between 0 and π by default.
    seed : int or generator, optional
        Makes the random start reproducible; a generator is NumPy's, or torch's for a tensor.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1. The image is then formed by the light of pixels of
        that size up to 1/(2·dx), for methods with a transfer function; by default pixels are points.
    accelerated : bool
        Start each iteration ahead of the hologram found, along its last change (Nesterov's extrapolation). It takes no
        further propagation, and reaches in 20 to 30 iterations what takes 60 without. False by default.

    Returns
    -------
    tuple
        Complex phase-only hologram and complex reconstruction, ``[rows, columns]`` each.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    The hologram is of phase alone:

    >>> import numpy as np
    >>> from odak.wave import gerchberg_saxton
    >>> image = np.zeros((16, 16))
    >>> image[6:10, 6:10] = 1
    >>> hologram, reconstruction = gerchberg_saxton(image, 5, 5e-3, 8e-6, 532e-9, 2 * np.pi, "Angular Spectrum", seed=0)
    >>> bool(np.allclose(abs(hologram), 1))
    True
    """
    count = _validate.integer("n_iterations", n_iterations, minimum=1)
    return retrieve(
        *(field, range(count), distance, dx, wavelength, slm_range, propagation_type, initial_phase, seed),
        fill=pixel_fill,
        accelerated=_validate.flag("accelerated", accelerated),
    )


def retrieve(
    field: Array,
    turns: Any,
    distance: Amount,
    dx: Any,
    wavelength: Amount,
    slm_range: Any,
    propagation_type: Any,
    initial_phase: Any,
    seed: Seed,
    *,
    fill: Any = None,
    cutoff: Any = None,
    checked: Any = False,
    **options: Any,
) -> Any:
    """Return hologram and reconstruction after one iteration for each item of `turns`, for NumPy and PyTorch.

    `options` are `callback`, `watch`, `accelerated` and `illumination`: `callback(turn, phase)` is called after each
    iteration, and ends them by returning True, as does `watch(turn, phase, error)`, whose error is the mean squared one
    of the amplitudes before it; the illumination is the amplitude of the light on the hologram, one by default.
    `cutoff` is the radius of a round stop in cycles per metre, which `fill` goes with. A field that is `checked` is not
    looked at again.
    """
    field = _validate.planes("field", field)
    if not checked:
        _validate.check_values("field", field, _AMPLITUDES)
    options |= {"initial_phase": initial_phase, "seed": seed, "fill": fill, "cutoff": cutoff}
    hologram = _alternate([(field, distance)], turns, dx, wavelength, slm_range, propagation_type, **options)
    # On the padded grid of the iterations light may wrap around; the image that is returned is free of it.
    return hologram, propagate_within_window(hologram, distance, dx, wavelength, propagation_type, cutoff, fill)


def _alternate(
    planes,
    turns,
    dx,
    wavelength,
    slm_range,
    propagation_type,
    initial_phase,
    seed,
    update=None,
    callback=None,
    fill=None,
    cutoff=None,
    accelerated=False,
    illumination=1.0,
    watch=None,
):
    """Return the hologram of pairs of a field and its distance.

    The corrections of all planes are propagated back to the one hologram and averaged. `update(target, amplitude)`
    gives the next image amplitude, the target by default. `fill` is the share of a pixel's area that emits, `cutoff`
    the radius of a round stop that goes with it, in cycles per metre. `accelerated` extrapolates with the weights of
    Nesterov's method, k/(k + 3).
    """
    check_has_kernel(propagation_type)
    limit = min(_validate.constant("slm_range", slm_range, positive=True), 2 * math.pi)
    planes = [(calculate_amplitude(field), distance) for field, distance in planes]
    phase = within_range(_starting_phase(planes[0][0], initial_phase, seed), limit)
    light = functools.partial(
        propagate_beam, k=None, dx=dx, wavelength=wavelength, propagation_type=propagation_type, zero_padding=_WINDOW
    )
    back = light
    if fill is not None:
        pixels = pixel_aperture(planes[0][0], checked_pixel_fill(fill))
        stop = None if cutoff is None else _round_stop(pixels, dx, cutoff)
        # The way back ends at the modulator's field without its pixels' transfer function, which has zeros.
        back = functools.partial(light, aperture=1 / pixels if cutoff is None else stop / pixels)
        light = functools.partial(light, aperture=pixels if cutoff is None else stop * pixels)
    before = found = generate_complex_field(illumination, phase)
    for count, turn in enumerate(turns):
        hologram = found
        if accelerated:
            # The extrapolated field gets its amplitude again, as only a phase-only hologram is propagated.
            hologram = generate_complex_field(
                illumination, calculate_phase(found + (found - before) * (count / (count + 3)))
            )
        corrected, error = hologram, 0.0
        for target, distance in planes:
            change = _correction(light(hologram, distance=distance), target, update)
            # What is added to a field along its own phase is the error of its amplitude.
            error = error if watch is None else error + calculate_intensity(change).mean() / len(planes)
            corrected = corrected + back(change, distance=-distance) / len(planes)
        phase = within_range(calculate_phase(corrected), limit)
        before, found = found, generate_complex_field(illumination, phase)
        if callback is not None and callback(turn, phase) is True:
            break
        if watch is not None and watch(turn, phase, error) is True:
            break
    return found


def _round_stop(spectrum, dx, cutoff):
    """Return ones up to a cut-off in cycles per metre, zeros beyond, centred, of the shape of a spectrum."""
    xp = _array.namespace(spectrum)
    down, across = (
        (xp.arange(n, dtype=spectrum.dtype, device=_array.device_of(spectrum)) - n // 2) / (n * step)
        for n, step in zip(spectrum.shape, pitches(dx), strict=True)
    )
    return xp.astype(down[:, None] ** 2 + across**2 <= cutoff**2, spectrum.dtype)


def _correction(image, target, update):
    """Return the change of the image, inside its window, that gives it the amplitude of the target.

    The field outside the window is free and stays as it is. Propagated back, this part gives the hologram it came from
    again, so that only the change is propagated back, on the window alone.
    """
    xp = _array.namespace(image)
    amplitude = calculate_amplitude(image)
    wanted = target if update is None else update(target, amplitude)
    gain = wanted / xp.where(amplitude > 0, amplitude, xp.ones_like(amplitude))
    return image * xp.astype(gain - 1, image.dtype)


def _starting_phase(target, initial_phase, seed, half_turns=1):
    """Return phases to start from: those given, or random ones from 0 to some half turns."""
    shape = tuple(target.shape)
    _validate.seed("seed", seed)
    if initial_phase is None:
        return _array.cast(uniform(shape, seed, target) * half_turns * math.pi, target)
    _validate.shaped(
        "initial_phase", _validate.image("initial_phase", initial_phase), f"{list(shape)} as field, or each of fields"
    )
    _validate.check_values("initial_phase", initial_phase)
    return _array.cast(_validate.real("initial_phase", initial_phase), target)


@_validate.takes_units("distances", "dx", "wavelength")
def gerchberg_saxton_3d(
    fields: np.ndarray,
    n_iterations: int,
    distances: Sequence[float],
    dx: float | Sequence[float],
    wavelength: float,
    slm_range: float = 6.28,
    propagation_type: str = "auto",
    initial_phase: Array | None = None,
    target_type: str = "no constraint",
    coefficients: Sequence[float] | None = None,
    seed: Array | None = None,
    *,
    pixel_fill: float | None = None,
) -> np.ndarray:
    """Return a phase-only hologram of several image planes, by alternating projections that couple them.

    In each iteration the hologram is propagated to every plane, the amplitude corrected there, and the corrections are
    propagated back and averaged, so that the light of one plane is known to all others.

    Parameters
    ----------
    fields : numpy.ndarray
        ``[planes, rows, columns]``; amplitudes are the targets.
    n_iterations : int
        Number of iterations, each of which visits all planes.
    distances : sequence of float
        Distance of each plane in metres.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    slm_range : float, default: 6.28
        Phase range of the modulator in radians; phases beyond it take its nearer end.
    propagation_type : str, default: "auto"
        Propagation type, see :func:`odak.wave.propagate_beam`.
    initial_phase : numpy.ndarray, optional
        Phase ``[rows, columns]`` in radians to start the hologram from; uniform between 0 and π by default.
    target_type : str, default: "no constraint"
        "no constraint" replaces the image's amplitude by the target's; "double constraint" by 2α·T − β·|u| (γ·|u|
        where that is zero), after Zhou et al. (2019).
    coefficients : sequence of float, optional
        α, β, γ of "double constraint".
    seed : int or generator, optional
        Makes the random start reproducible.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1. The images are then formed by the light of pixels
        of that size up to 1/(2·dx), for methods with a transfer function; by default pixels are points.

    Returns
    -------
    numpy.ndarray
        Complex phase-only hologram ``[rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import gerchberg_saxton_3d
    >>> planes = np.zeros((2, 16, 16))
    >>> planes[0, :, 4:8] = planes[1, :, 8:12] = 1
    >>> hologram = gerchberg_saxton_3d(
    ...     planes, 5, [5e-3, 6e-3], 8e-6, 532e-9, 2 * np.pi, "Angular Spectrum", seed=0
    ... )
    >>> hologram.shape, bool(np.allclose(abs(hologram), 1))
    ((16, 16), True)
    """
    fields = _validate.image("fields", fields, axes=3)
    if not len(fields):
        raise ValueError(f"fields must contain at least one plane, got {tuple(fields.shape)}")
    distances = _validate.several("distances", distances)
    if len(distances) != len(fields):
        raise ValueError(f"distances must contain one distance for each of {len(fields)} fields, got {len(distances)}")
    update = None
    if _validate.one_of("target_type", target_type, TARGET_TYPES) == "double constraint":
        update = _double_constraint(coefficients)
    count = _validate.integer("n_iterations", n_iterations, minimum=1)
    _validate.check_values("fields", fields, _AMPLITUDES)
    planes = [(fields[index, ...], distance) for index, distance in enumerate(distances)]
    options = {"initial_phase": initial_phase, "seed": seed, "update": update, "fill": pixel_fill}
    return _alternate(planes, range(count), dx, wavelength, slm_range, propagation_type, **options)


def _double_constraint(coefficients):
    if coefficients is None:
        raise ValueError("coefficients must be [alpha, beta, gamma] for 'double constraint', got None")
    alpha, beta, gamma = _validate.several("coefficients", coefficients, 3)

    def update(target, amplitude):
        mixed = 2 * alpha * target - beta * amplitude
        return _array.namespace(mixed).where(mixed == 0, gamma * amplitude, mixed)

    return update


@_validate.takes_units("wavelength", "dx")
def spot_hologram(
    points: Array,
    resolution: Sequence[int],
    wavelength: float,
    dx: float | Sequence[float],
    n_iterations: int = 30,
    focal: float | None = None,
    *,
    intensities: Array | None = None,
    phases: Array | None = None,
    illumination: Array | None = None,
    fixed_phase_after: int | None = None,
    seed: Seed = None,
) -> tuple[Any, ...]:
    """Return a phase-only hologram that focuses light into points of space, of equal or given intensities.

    The field of each spot is a lens and a prism, which is a column times a row, so that sums over all spots and
    pixels are matrix products. Each iteration raises the weights of the spots that are too weak.

    Parameters
    ----------
    points : array
        Spots ``[..., N, 3]`` as (x, y, z) in metres: x along columns, y along rows, from the optical axis; z from the
        hologram, or, with `focal`, from the focal plane of the lens. The result has the same precision.
    resolution : sequence of int
        Rows m and columns n of the hologram.
    wavelength : float
        Wavelength in metres.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    n_iterations : int
        Number of iterations.
    focal : float, optional
        Focal length of a lens with the hologram in its front focal plane; by default there is no lens.
    intensities : array, optional
        Share of light wanted in each spot, ``[..., N]``, up to a common factor; equal by default.
    phases : array, optional
        Phases in radians that the fields of the spots should have, ``[..., N]``; free by default, which leaves more
        light in the spots. Regular arrays with given phases take more iterations than scattered spots: about 0.1 rad
        is missed after 30, 0.01 after 100.
    illumination : array, optional
        Amplitude of the light on the hologram ``[..., m, n]``; one by default.
    fixed_phase_after : int, optional
        Iterations after which the phases of the spots stay as they are; two thirds of them by default. The weights
        then settle fast: 100 spots after 30 iterations are even to 0.996 instead of 0.95 (Kim et al., Opt. Lett. 44,
        3178 (2019)).
    seed : int or generator, optional
        Makes the random start reproducible; nothing is random where `phases` are given.

    Returns
    -------
    tuple of array
        Hologram, complex of amplitude one ``[..., m, n]``, and fields of the spots ``[..., N]``: |·|² is the share of
        the light that is in each spot. For spots that do not overlap their sum is the efficiency. Behind a lens their
        phases are relative to exp(2ik·focal)/i; in free space, to exp(ikz)·exp(iπ(x² + y²)/(λz))/i, so that spots in
        one plane have equal phases on a sphere about the middle of the hologram.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If the lens or the prism of a spot is undersampled at the edge of the hologram.

    Notes
    -----
    Di Leonardo, Ianni and Ruocco, Opt. Express 15, 1913 (2007), eqs. 1 and 15–19. Paraxial: phases follow
    Fresnel's approximation. Twin orders and the pixels' envelope are not part of it.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import spot_hologram, uniformity
    >>> points = np.asarray([[-2e-4, 0.0, 0.05], [1e-4, 2e-4, 0.05], [2e-4, -1e-4, 0.06]])
    >>> hologram, spots = spot_hologram(points, (64, 64), 532e-9, 8e-6, seed=0)
    >>> bool(uniformity(abs(spots) ** 2) > 0.99)
    True
    """
    n_iterations = _validate.integer("n_iterations", n_iterations, minimum=1)
    columns, rows = _lens_factors(points, resolution, wavelength, dx, focal)
    xp, shape = _array.namespace(columns), (columns.shape[-1], rows.shape[-1])
    count, free = tuple(rows.shape[:-1]), _iterations_of_free_phase(fixed_phase_after, n_iterations)
    wanted = xp.ones(count, dtype=_array.real_dtype(rows), device=_array.device_of(rows))
    if intensities is not None:
        wanted = wanted * xp.sqrt(_checked_intensities(intensities, wanted))
    lit = None if illumination is None else _checked_illumination(illumination, wanted, shape)
    total = math.prod(shape) if lit is None else xp.sum(lit**2, axis=(-2, -1), keepdims=True)[..., 0]
    norm = (math.prod(shape) * total) ** 0.5

    def fields_of(hologram):
        return _spots(hologram if lit is None else hologram * lit, columns, rows) / norm

    if phases is not None:
        cycles = _array.cast(_validate.real("phases", phases), wanted) / (2 * math.pi)
        _validate.fitting(points=wanted, phases=cycles)
        aim = wanted * _array.phasor_of_cycles(cycles, _array.complex_dtype(rows))
        hologram = _with_phases(aim, fields_of, columns, rows, lit, n_iterations)
        return hologram, fields_of(hologram)

    def superposed(light):
        return _superpose(light, columns, rows)

    begun = _array.phasor_of_cycles(uniform(count, seed, rows), _array.complex_dtype(rows))
    hologram = _weighted(fields_of, superposed, begun, wanted, n_iterations, free)
    return hologram, fields_of(hologram)


def _weighted(forth: Callable, back: Callable, direction, wanted, n_iterations: int, free: int, axes=-1):
    """Return the hologram that sends light of amplitudes in fixed ratios where `forth` leads.

    Each iteration weights the light that `back` takes to a hologram by what it lacks; the phases of the light, at first
    `direction`, stay as they are after some free iterations.
    """
    weights, hologram, share = wanted, back(direction * wanted), None
    for turn in range(n_iterations):
        light = forth(hologram)
        ratio = _amplitude_ratio(_array.namespace(light).abs(light), wanted, axes)
        if turn >= free:
            ratio, share = _damped(ratio, share, axes)
        weights = weights * ratio
        direction = _unit(light) if turn < free else direction
        hologram = back(direction * weights)
    return hologram


def _with_phases(aim, fields_of: Callable[..., Any], columns, rows, lit, n_iterations: int):
    """Return the hologram whose spots have the fields `aim`, up to a common factor that is positive.

    What misses in each spot is added to the field of the hologram, whose amplitude is then set to one again. The light
    that the phases leave over goes where no spot is, so that regular arrays have an answer too; changes of the spots'
    weights and directions alone end about 1 rad away from the phases of most arrays of 10 x 10.
    """
    xp = _array.namespace(columns)
    step = 2.0 if lit is None else 2 * lit / xp.sqrt(xp.mean(lit**2, axis=(-2, -1), keepdims=True))
    hologram = _superpose(aim, columns, rows)
    for _ in range(n_iterations):
        spots = fields_of(hologram)
        share = xp.sum(xp.real(spots * xp.conj(aim)), axis=-1, keepdims=True)
        missing = aim * (share / xp.sum(xp.abs(aim) ** 2, axis=-1, keepdims=True)) - spots
        hologram = _unit(hologram + step * _sum_of_spots(missing, columns, rows))
    return hologram


def weighted_gerchberg_saxton(
    field: Array,
    n_iterations: int = 30,
    *,
    illumination: Array | None = None,
    initial_phase: Array | None = None,
    fixed_phase_after: int | None = None,
    seed: Seed = None,
) -> tuple[Any, ...]:
    """Return a phase-only hologram whose far field, as in the focal plane of a lens, has the target's amplitude.

    Each iteration adapts the weights of the target's amplitude where it is not zero, until the far field is
    proportional to the target, for arrays of spots and for images. Where the target is zero the far field should be
    dark. Neighbouring samples of an image are met at the samples alone: between them the far field is speckle. An image
    of 128 × 128 samples, with as many dark ones around it, is met to 46 dB at the samples after 30 iterations, and to
    20 dB over the areas of samples, from which a camera collects light. For images that are to be seen take
    :func:`odak.learn.wave.optimise` with a display behind a lens, which is judged over areas.

    Parameters
    ----------
    field : array
        ``[..., rows, columns]``; its amplitude is the target amplitude. Sample n // 2 is the optical axis, a sample is
        λf/(n·dx) wide.
    n_iterations : int
        Number of iterations.
    illumination : array, optional
        Amplitude of the light on the hologram ``[..., rows, columns]``; one by default.
    initial_phase : array, optional
        Phase of the far field to start from in radians; uniform between 0 and 2π by default.
    fixed_phase_after : int, optional
        Iterations after which the phase of the far field stays as it is, see :func:`spot_hologram`.
    seed : int or generator, optional
        Makes the random start reproducible.

    Returns
    -------
    tuple of array
        Hologram of amplitude one, and its far field, complex ``[..., rows, columns]``; Σ|far field|² = 1.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Di Leonardo, Ianni and Ruocco, Opt. Express 15, 1913 (2007), on the grid of the Fourier transform.

    Examples
    --------
    Three spots are made even:

    >>> import numpy as np
    >>> from odak.wave import uniformity, weighted_gerchberg_saxton
    >>> target = np.zeros((32, 32))
    >>> target[[8, 16, 20], [10, 24, 9]] = 1
    >>> hologram, spots = weighted_gerchberg_saxton(target, seed=0)
    >>> bool(uniformity(abs(spots[target > 0]) ** 2) > 0.99)
    True
    """
    target = calculate_amplitude(_validate.image("field", field))
    target = _array.namespace(target).astype(target, _array.real_dtype(target))
    if _array.is_readable(target) and not 0 < float(_array.namespace(target).max(target)) < math.inf:
        raise ValueError("field must be finite and not zero everywhere, got NaN, infinite or only zeros")
    n_iterations = _validate.integer("n_iterations", n_iterations, minimum=1)
    free = _iterations_of_free_phase(fixed_phase_after, n_iterations)
    xp, axes, shape = _array.namespace(target), (-2, -1), tuple(target.shape)
    # In the order of the transform, so that nothing is shifted in the loop.
    wanted = xp.fft.ifftshift(target, axes=axes)
    lit = (
        None
        if illumination is None
        else xp.fft.ifftshift(_checked_illumination(illumination, wanted, shape), axes=axes)
    )
    begun = _array.phasor(_starting_phase(target, initial_phase, seed, 2), _array.complex_dtype(target))
    total = math.prod(shape[-2:]) if lit is None else xp.sum(lit**2, axis=axes, keepdims=True)
    norm = (math.prod(shape[-2:]) * total) ** 0.5

    def far_field(hologram):
        return xp.fft.fftn(hologram if lit is None else hologram * lit, axes=axes)

    def back(light):
        return _unit(xp.fft.ifftn(light, axes=axes))

    hologram = _weighted(far_field, back, xp.fft.ifftshift(begun, axes=axes), wanted, n_iterations, free, axes)
    return xp.fft.fftshift(hologram, axes=axes), xp.fft.fftshift(far_field(hologram) / norm, axes=axes)


def uniformity(intensities: Array, axis: int = -1) -> Array:
    """Return 1 − (max − min)/(max + min) of the intensities of spots: 1 for equal ones (Di Leonardo 2007, eq. 5).

    Parameters
    ----------
    intensities : array
        Real, not negative, ``[..., N]``; where spots are to differ, over what is wanted.
    axis : int
        Axis of the spots.

    Returns
    -------
    array
        `intensities` without that axis.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import uniformity
    >>> float(uniformity(np.asarray([3.0, 2.0, 1.0])))
    0.5
    """
    if not _array.is_array(intensities):
        raise TypeError(f"intensities must be an array or a tensor, got {type(intensities).__name__}")
    shape = tuple(_validate.array("intensities", intensities).shape)
    axis = _validate.integer("axis", axis, minimum=-math.inf)
    if not -len(shape) <= axis < len(shape) or 0 in shape:
        raise ValueError(f"intensities must contain spots along the axis {axis}, got {shape}")
    xp = _array.namespace(intensities)
    # Sums of the levels of a camera leave the range of their type.
    intensities = xp.astype(intensities, _array.real_dtype(intensities))
    most, least = xp.max(intensities, axis=axis), xp.min(intensities, axis=axis)
    return 1 - (most - least) / (most + least)


def _lens_factors(points, resolution, wavelength, dx, focal):
    """Return the fields of the spots' lenses along columns ``[..., N, m]`` and along rows ``[..., N, n]``."""
    shape = _validate.size("resolution", resolution)
    _validate.number("wavelength", wavelength, positive=True)
    steps = [_validate.number("dx", step, positive=True) for step in pitches(dx)]
    if not _array.is_array(points):
        raise TypeError(f"points must be an array or a tensor, got {type(points).__name__}")
    _validate.real("points", points)
    _validate.shaped("points", points, "[..., N, 3], not empty")
    xp, dtype = _array.namespace(points), _array.complex_dtype(points)
    points = xp.astype(points, xp.float64)
    z = points[..., 2, None]
    if focal is None:
        if _array.is_readable(z) and 0 in _validate.numbers(z):
            raise ValueError("points must have z other than 0 where there is no focal")
        slope, bend = 1 / (wavelength * z), -0.5 / (wavelength * z)
    else:
        focal = _validate.constant("focal", focal, nonzero=True)
        slope, bend = 1 / (wavelength * focal), 0.5 * z / (wavelength * focal**2)
    factors = []
    readable = all(_array.is_readable(value) for value in (points, wavelength, *steps))
    for n, step, along in zip(shape, steps, (points[..., 1, None], points[..., 0, None]), strict=True):
        if readable and n > 1 and not getattr(points, "requires_grad", False):
            steepest = xp.max(abs(slope * along) + abs(bend) * (n - 2) * step)
            factor = 2 * float(step * steepest)
            spots = "spots nearer to the axis" if focal is not None else "spots further away or nearer to the axis"
            warn_of_factor("spot_hologram", factor, (f"a pitch of at most {0.995 * step / factor:.3g} m", spots))
        place = (xp.arange(n, dtype=xp.float64, device=_array.device_of(points)) - n // 2) * step
        factors.append(_array.phasor_of_cycles(place * (slope * along + bend * place), dtype))
    return factors


def _iterations_of_free_phase(fixed_phase_after, n_iterations):
    if fixed_phase_after is None:
        return n_iterations - n_iterations // 3
    return _validate.integer("fixed_phase_after", fixed_phase_after)


def _superpose(light, columns, rows):
    """Return the phase-only part of the sum of the spots' lenses, each times its light ``[..., N]``."""
    return _unit(_sum_of_spots(light, columns, rows))


def _sum_of_spots(light, columns, rows):
    """Return the sum of the spots' lenses, each times its light ``[..., N]``."""
    xp = _array.namespace(light)
    return xp.matmul(xp.matrix_transpose(columns * light[..., None]), rows)


def _spots(field, columns, rows):
    """Return the field that a hologram sends into each spot, ``[..., N]``, of a light of one per pixel."""
    xp = _array.namespace(field)
    return xp.sum(xp.matmul(xp.conj(columns), field) * xp.conj(rows), axis=-1)


def _amplitude_ratio(amplitude, wanted, axes=-1):
    """Return the ratio of the wanted amplitudes to those reached, both normalised to the same mean."""
    xp = _array.namespace(amplitude)
    came, whole = (xp.sum(part * wanted, axis=axes, keepdims=True) for part in (amplitude, wanted))
    return wanted * (came / whole) / _one_where_zero(amplitude)


def _damped(ratio, share, axes=-1):
    """Return the change of the weights, ratio^gain, and its state: the gain and the worst ratio before.

    The gain is halved where the worst ratio falls by less than a tenth. Two spots of equal intensity need this: the
    light moves from one to the other with infinite slope at equal weights, about which undamped weights oscillate.
    """
    xp, used = _array.namespace(ratio), ratio > 0
    change = xp.log(xp.where(used, ratio, xp.ones_like(ratio)))
    worst = xp.max(xp.abs(change), axis=axes, keepdims=True)
    gain = xp.ones_like(worst)
    if share is not None:
        gain, before = share
        gain = xp.where(worst > 0.9 * before, gain / 2, gain)
    return xp.where(used, xp.exp(gain * change), ratio), (gain, worst)


def _one_where_zero(amplitude):
    """Return the amplitude, 1 where it is zero."""
    xp = _array.namespace(amplitude)
    return xp.where(amplitude > 0, amplitude, xp.ones((), dtype=amplitude.dtype, device=_array.device_of(amplitude)))


def _unit(field):
    """Return the field of the same phase and amplitude one; 1 where the field is zero."""
    xp = _array.namespace(field)
    amplitude = xp.abs(field)
    one = xp.ones((), dtype=field.dtype, device=_array.device_of(field))
    return xp.where(amplitude > 0, field / _one_where_zero(amplitude), one)


def _checked_intensities(intensities, wanted):
    shares = _array.cast(_validate.real("intensities", intensities), wanted)
    if shares.ndim == 0 or shares.shape[-1] not in (1, wanted.shape[-1]):
        raise ValueError(f"intensities must be one for each of {wanted.shape[-1]} spots, got {tuple(shares.shape)}")
    if _array.is_readable(shares) and min(_validate.numbers(shares)) <= 0:
        raise ValueError("intensities must be positive")
    return shares


def _checked_illumination(illumination, like, shape):
    light = _array.cast(_validate.real("illumination", illumination), like)
    _validate.shaped(
        "illumination", light, f"[..., {shape[-2]}, {shape[-1]}], of the shape of the hologram (the field)"
    )
    return light
