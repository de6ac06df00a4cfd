"""Closed forms with which the tests compare the library, with their sources."""

import functools

import numpy as np


def coordinates(shape, dx):
    """Return y (column vector) and x (row vector), the optical axis at index n // 2."""
    return tuple(
        (np.arange(n) - n // 2).reshape((-1, 1) if axis == 0 else (1, -1)) * dx for axis, n in enumerate(shape)
    )


def wrapped_phasor(length, wavelength):
    """Return exp(ik·length), whole waves taken off first: the remainder of a division is exact."""
    return np.exp(2j * np.pi * (np.remainder(np.asarray(length, dtype=np.float64), wavelength) / wavelength))


def gaussian_beam(shape, dx, waist, distance, wavelength):
    """Return the paraxial Gaussian beam of Siegman, Lasers (1986), eq. 16.7: amplitude 1 at the waist's centre."""
    y, x = coordinates(shape, dx)
    rayleigh = np.pi * waist**2 / wavelength
    q = distance - 1j * rayleigh
    carrier = wrapped_phasor(distance, wavelength)
    return -1j * rayleigh / q * carrier * np.exp(1j * np.pi / wavelength * (x**2 + y**2) / q)


def circular_aperture_on_axis(radius, distance, wavelength):
    """Return the first Rayleigh–Sommerfeld field behind a circular hole on its axis, exp(ikz) − (z/R)·exp(ikR).

    Osterberg and Smith, J. Opt. Soc. Am. 51, 1050 (1961).
    """
    edge = np.hypot(distance, radius)
    return wrapped_phasor(distance, wavelength) - distance / edge * wrapped_phasor(edge, wavelength)


def disc(shape, dx, radius, oversampling=16):
    """Return a disc whose rim pixels hold the share of their area that is covered."""
    offsets = (np.arange(oversampling) + 0.5) / oversampling - 0.5
    y, x = coordinates(shape, dx)
    covered = np.zeros(shape)
    for dy in offsets:
        for dx_ in offsets:
            covered += (y + dy * dx) ** 2 + (x + dx_ * dx) ** 2 <= radius**2
    return covered / oversampling**2


def relative_error(result, expected):
    """Return the root-mean-square difference over the root-mean-square of what is expected."""
    result, expected = np.asarray(result), np.asarray(expected)
    return float(np.linalg.norm(result - expected) / np.linalg.norm(expected))


def centroid(intensity, dx):
    """Return the centre of mass of an intensity in metres from the optical axis."""
    y, x = coordinates(intensity.shape, dx)
    return float((y * intensity).sum() / intensity.sum()), float((x * intensity).sum() / intensity.sum())


def extrapolated_propagation(field, distance, dx, wavelength, padding=16):
    """Return :func:`unwrapped_propagation` without a stop, less what still wraps around.

    That falls with the square of the padding, so that two paddings give it: 3e-7 of the field's norm is left.
    """
    coarse, fine = (unwrapped_propagation(field, distance, dx, wavelength, padding=p) for p in (padding, 2 * padding))
    return (4 * fine - coarse) / 3


def unwrapped_propagation(field, distance, dx, wavelength, cutoff=np.inf, padding=32):
    """Return a field propagated to its own window by the angular spectrum (Goodman 2005, eq. 3-70) in complex128.

    The window is `padding` times wider, so that what leaves it does not come back. `cutoff` is the radius of a round
    stop in cycles per metre. `dx` is one pitch, or a pair (rows, columns).
    """
    field = np.asarray(field, dtype=np.complex128)
    down, across = map(float, np.broadcast_to(dx, 2))
    return filtered(field, _within(field.shape[-2:], padding, float(distance), down, across, float(wavelength), cutoff))


def behind_mask(field, distance, dx, wavelength, mask, padding=12):
    """Return :func:`unwrapped_propagation` through a mask in the Fourier plane, centred on the grid of twice the field.

    Between its samples the mask is that of the nearest one.
    """
    field = np.asarray(field, dtype=np.complex128)
    wide = tuple(padding * n for n in field.shape[-2:])
    nearest = [
        np.rint(np.fft.fftfreq(count, 1 / size)).astype(int) % size
        for count, size in zip(wide, mask.shape, strict=True)
    ]
    transfer = free_space_transfer(wide, float(distance), tuple(np.broadcast_to(dx, 2)), wavelength)
    return filtered(field, transfer * np.fft.ifftshift(mask)[np.ix_(*nearest)])


# Several fields are propagated over one distance in turn.
@functools.lru_cache(maxsize=64)
def _within(shape, padding, distance, down, across, wavelength, cutoff):
    wide = tuple(padding * n for n in shape)
    return confined(free_space_transfer(wide, distance, (down, across), wavelength, cutoff), shape)


def free_space_transfer(shape, distance, dx, wavelength, cutoff=np.inf):
    """Return exp(2πiz·(1/λ² − f²)^½) within a round stop, in FFT order."""
    pitches = np.broadcast_to(dx, 2)
    # It is even: a quadrant is computed.
    fy, fx = (np.fft.fftfreq(n, step)[: n // 2 + 1] for n, step in zip(shape, pitches, strict=True))
    squared = fy[:, None] ** 2 + fx**2
    axial = np.sqrt((1 / wavelength**2 - squared).astype(np.complex128))
    quadrant = np.exp(2j * np.pi * distance * np.where(distance < 0, axial.conj(), axial)) * (squared <= cutoff**2)
    rows, columns = ((n - 1) // 2 for n in shape)
    half = np.concatenate((quadrant, quadrant[:, columns:0:-1]), axis=1)
    return np.concatenate((half, half[rows:0:-1]))


def confined(transfer, shape):
    """Return a transfer function on twice a window that does to fields within the window what a wider one does.

    It has the part of the impulse response that leads from the window to itself.
    """
    down, across = (np.r_[0:n, -n:0] for n in shape)
    response = np.fft.ifft(np.fft.ifft(transfer, axis=-2)[down], axis=-1)[:, across]
    return np.fft.fft2(response)


def filtered(field, transfer):
    """Return a field, continued by zeros, times a transfer function in FFT order, on its own window.

    Rows that are zero going in or cut off coming out are not transformed.
    """
    rows, columns = field.shape[-2:]
    spectrum = np.fft.fft(np.fft.fft(field, transfer.shape[-1], axis=-1), transfer.shape[-2], axis=-2)
    window = np.fft.ifft(spectrum * transfer, axis=-2)[..., :rows, :]
    return np.fft.ifft(window, axis=-1)[..., :columns]
