"""Gerchberg–Saxton phase retrieval of holograms, for one image plane or several."""

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak.wave.propagation import propagate
from odak.wave.random_numbers import uniform
from odak.wave.utils import calculate_amplitude, calculate_phase, generate_complex_field

_WINDOW = (True, False, True)
TARGET_TYPES = ("no constraint", "double constraint")


def gerchberg_saxton(
    field: np.ndarray,
    n_iterations: int,
    distance: float,
    dx: float,
    wavelength: float,
    slm_range: float = 6.28,
    propagation_type: str = "IR Fresnel",
    initial_phase: np.ndarray | None = None,
    seed: Any = None,
) -> tuple:
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
    dx : float
        Pixel pitch in metres.
    wavelength : float
        Wavelength in metres.
    slm_range : float
        Phase range of the modulator in radians; phases beyond it take its nearer end.
    propagation_type : str
        Propagation type, see :func:`odak.wave.propagate_beam`.
    initial_phase : numpy.ndarray, optional
        Phase ``[rows, columns]`` to start the hologram from; uniform between 0 and π by default.
    seed : int or generator, optional
        Makes the random start reproducible; a generator is NumPy's, or torch's for a tensor.

    Returns
    -------
    tuple
        Complex phase-only hologram and complex reconstruction, ``[rows, columns]`` each.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    count = _validate.integer("n_iterations", n_iterations, minimum=1)
    return retrieve(field, range(count), distance, dx, wavelength, slm_range, propagation_type, initial_phase, seed)


def retrieve(
    field, turns, distance, dx, wavelength, slm_range, propagation_type, initial_phase, seed, update=None, callback=None
):
    """Return hologram and reconstruction after as many turns as `turns` yields; the algorithm of both faces.

    `update(target, amplitude)` gives the next image amplitude (the target by default), `callback(turn, phase)` is
    told of each turn and stops by returning True.
    """
    field = _validate.image("field", field)
    _validate.real("slm_range", slm_range, positive=True)
    target = calculate_amplitude(field)
    phase = _limit(_starting_phase(target, initial_phase, seed), slm_range)
    light = functools.partial(
        propagate, k=None, dx=dx, wavelength=wavelength, propagation_type=propagation_type, zero_padding=_WINDOW
    )
    for turn in turns:
        hologram = generate_complex_field(1.0, phase)
        change = _correction(light(hologram, distance=distance), target, update)
        phase = _limit(calculate_phase(hologram + light(change, distance=-distance)), slm_range)
        if callback is not None and callback(turn, phase) is True:
            break
    hologram = generate_complex_field(1.0, phase)
    return hologram, light(hologram, distance=distance)


def _correction(image, target, update):
    """Return what has to be added to the image, inside its window, for its amplitude to become the target's.

    The field outside the window is free and stays as it is. Propagated back it is the part of the hologram it came
    from, so only the change needs to make the way back, on the window alone.
    """
    xp = _array.namespace(image)
    amplitude = calculate_amplitude(image)
    wanted = target if update is None else update(target, amplitude)
    gain = wanted / xp.where(amplitude > 0, amplitude, xp.ones_like(amplitude))
    return image * xp.astype(gain - 1, image.dtype)


def _limit(phase, slm_range):
    """Return the phase as a modulator of that range can show it: 0 … range, the nearer end for what lies beyond."""
    xp = _array.namespace(phase)
    phase = phase - xp.floor(phase / (2 * math.pi)) * (2 * math.pi)
    if slm_range >= 2 * math.pi:
        return phase
    top, middle = xp.full_like(phase, slm_range), (slm_range + 2 * math.pi) / 2
    return xp.where(phase > slm_range, xp.where(phase < middle, top, xp.zeros_like(phase)), phase)


def _starting_phase(target, initial_phase, seed):
    shape = tuple(target.shape)
    _validate.seed("seed", seed)
    if initial_phase is None:
        return _array.cast(uniform(shape, seed, target) * math.pi, target)
    if tuple(_validate.image("initial_phase", initial_phase).shape) != shape:
        raise ValueError(
            f"initial_phase must have the field's shape (each of fields), {shape}, got {tuple(initial_phase.shape)}"
        )
    return _array.cast(initial_phase, target)


def gerchberg_saxton_3d(
    fields: np.ndarray,
    n_iterations: int,
    distances: Sequence[float],
    dx: float,
    wavelength: float,
    slm_range: float = 6.28,
    propagation_type: str = "IR Fresnel",
    initial_phase: Array = None,
    target_type: str = "no constraint",
    coefficients: Sequence[float] | None = None,
    seed: Array = None,
) -> np.ndarray:
    """Return a hologram of several image planes: the sum of one phase-only hologram per plane.

    Parameters
    ----------
    fields : numpy.ndarray
        ``[planes, rows, columns]``; amplitudes are the targets.
    n_iterations : int
        Number of iterations per plane.
    distances : sequence of float
        Distance of each plane in metres.
    dx, wavelength, slm_range, propagation_type, initial_phase, seed
        As in :func:`gerchberg_saxton`.
    target_type : str
        "no constraint" replaces the image's amplitude by the target's; "double constraint" by 2α·T − β·|u| (γ·|u|
        where that is zero), after Zhou et al. (2019).
    coefficients : sequence of float, optional
        α, β, γ of "double constraint".

    Returns
    -------
    numpy.ndarray
        Complex hologram ``[rows, columns]``, a sum of phase-only layers.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    fields = _validate.image("fields", fields, axes=3)
    if not len(fields):
        raise ValueError(f"fields must hold at least one plane, got {tuple(fields.shape)}")
    distances = _validate.several("distances", distances)
    if len(distances) != len(fields):
        raise ValueError(f"distances must hold one distance for each of {len(fields)} fields, got {len(distances)}")
    update = None
    if _validate.one_of("target_type", target_type, TARGET_TYPES) == "double constraint":
        update = _double_constraint(coefficients)
    count = _validate.integer("n_iterations", n_iterations, minimum=1)
    layers = [
        retrieve(
            field, range(count), distance, dx, wavelength, slm_range, propagation_type, initial_phase, seed, update
        )[0]
        for field, distance in zip(fields, distances, strict=True)
    ]
    return sum(layers)


def _double_constraint(coefficients):
    if coefficients is None:
        raise ValueError("coefficients must be [alpha, beta, gamma] for 'double constraint', got None")
    alpha, beta, gamma = _validate.several("coefficients", coefficients, 3)

    def update(target, amplitude):
        mixed = 2 * alpha * target - beta * amplitude
        return _array.namespace(mixed).where(mixed == 0, gamma * amplitude, mixed)

    return update
