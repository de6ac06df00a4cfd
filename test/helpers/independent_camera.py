"""Light of square pixels behind a stop, and what cameras record of it, by quadrature over the stop.

Nothing here is imported from the package, and no transform has a period: the field at any point is the integral of
plane waves over the frequencies that pass the stop, by Gauss's rule along both axes or along radius and angle. Lengths
are in pixels of the panel wherever they are not said to be in metres; pixel k has its middle at k.
"""

import numpy as np


class SquareStop:
    """Frequencies in a square of some diffraction orders, in cycles per pixel: nodes of Gauss's rule along each axis.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the panel.
    reach : float
        Pixels by which light of the highest frequency is displaced on its way.
    orders : int
        Orders along each axis.
    """

    def __init__(self, shape, reach=0.0, orders=1):
        self.nodes = [_gauss(orders / 2, orders * (n + reach) + 8) for n in shape]

    def spectrum(self, light, transfer):
        """Return the amplitudes of the plane waves of light at the pixels, times their weights."""
        (fy, wy), (fx, wx) = self.nodes
        down, across = (
            np.exp(-2j * np.pi * np.outer(f, np.arange(n))) for f, n in zip((fy, fx), light.shape, strict=True)
        )
        return (down @ light @ across.T) * transfer(fy[:, None], fx) * np.outer(wy, wx)

    def on_a_grid(self, waves, y, x):
        """Return the field at all places of rows y and columns x."""
        down, across = (np.exp(2j * np.pi * np.outer(p, f)) for p, (f, _) in zip((y, x), self.nodes, strict=True))
        return down @ waves @ across.T

    def at(self, waves, y, x):
        """Return the field at places one by one."""
        down, across = (np.exp(2j * np.pi * np.outer(p, f)) for p, (f, _) in zip((y, x), self.nodes, strict=True))
        return ((down @ waves) * across).sum(1)


class RoundStop:
    """Frequencies within a circle of some radius, in cycles per pixel: nodes along radius and angle.

    The radius is one number, or a pair along rows and columns where pixels are no squares.
    """

    def __init__(self, shape, radius, reach=0.0):
        radius = np.broadcast_to(radius, 2)
        cycles = 2 * radius.max() * (max(shape) + reach) * 2**0.5 + 8
        r, weight = _gauss(0.5, cycles / 2)
        count = int(np.ceil(np.pi * cycles)) + 16
        angle = 2 * np.pi * np.arange(count) / count
        self.fy, self.fx = (
            (length * np.outer(r + 0.5, turned)).ravel()
            for length, turned in zip(radius, (np.sin(angle), np.cos(angle)), strict=True)
        )
        area = 2 * np.pi / count * radius.prod()
        self.weights = (area * np.outer((r + 0.5) * weight, np.ones(count))).ravel()

    def spectrum(self, light, transfer):
        """Return the amplitudes of the plane waves of light at the pixels, times their weights."""
        down, across = (
            np.exp(-2j * np.pi * np.outer(f, np.arange(n)))
            for f, n in zip((self.fy, self.fx), light.shape, strict=True)
        )
        return ((down @ light) * across).sum(1) * transfer(self.fy, self.fx) * self.weights

    def on_a_grid(self, waves, y, x):
        """Return the field at all places of rows y and columns x."""
        down, across = (np.exp(2j * np.pi * np.outer(p, f)) for p, f in zip((y, x), (self.fy, self.fx), strict=True))
        return (down * waves) @ across.T

    def at(self, waves, y, x):
        """Return the field at places one by one."""
        return np.exp(2j * np.pi * (np.outer(y, self.fy) + np.outer(x, self.fx))) @ waves


class Seen:
    """What is seen of frames of light at the pixels of a panel: intensity at points, and means over squares.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Complex light of each frame at the pixels, ``[rows, columns]``.
    powers : sequence of float
        Share of the power in each frame.
    stop : SquareStop or RoundStop
        What passes.
    transfer : callable
        ``transfer(fy, fx)``, in cycles per pixel: of pixels and of the way.
    """

    def __init__(self, frames, powers, stop, transfer):
        self.stop, self.powers = stop, powers
        self.waves = [stop.spectrum(np.asarray(light, complex), transfer) for light in frames]

    def on_a_grid(self, y, x):
        """Return the intensity at all places of rows y and columns x."""
        lights = (np.abs(self.stop.on_a_grid(waves, y, x)) ** 2 for waves in self.waves)
        return sum(p * light for p, light in zip(self.powers, lights, strict=True))

    def means(self, y, x, side=1.0, points=5):
        """Return the means over squares of some side, about all places of rows y and columns x."""
        down, across = np.broadcast_to(side, 2) if np.ndim(side) else (side, side)
        gy, weights = _rule(down, points)
        gx, more = _rule(across, points)
        finer = self.on_a_grid(np.add.outer(y, gy).ravel(), np.add.outer(x, gx).ravel())
        finer = finer.reshape(len(y), len(gy), len(x), len(gx))
        return np.einsum("aibj,i,j->ab", finer, weights, more)

    def means_at(self, y, x, side=1.0, turned=0.0, points=5):
        """Return the means over squares about places one by one, turned by an angle in degrees."""
        g, weights = _rule(side, points)
        gy, gx = (part.ravel() for part in np.meshgrid(g, g, indexing="ij"))
        cosine, sine = np.cos(np.radians(turned)), np.sin(np.radians(turned))
        down, across = cosine * gy + sine * gx, cosine * gx - sine * gy
        y, x = np.add.outer(y, down).ravel(), np.add.outer(x, across).ravel()
        lights = (np.abs(self.stop.at(waves, y, x)) ** 2 for waves in self.waves)
        finer = sum(p * light for p, light in zip(self.powers, lights, strict=True))
        return finer.reshape(-1, len(gy)) @ np.outer(weights, weights).ravel()


def freely(pitch, wavelength, distance, fill=0.9):
    """Return the transfer of square pixels and of free space, and the pixels by which it displaces a full order.

    Lengths in metres; the pitch is one number or a pair.
    """
    down, across = np.broadcast_to(pitch, 2)
    width = fill**0.5

    def transfer(fy, fx):
        along = np.sqrt(wavelength**-2.0 - (fy / down) ** 2 - (fx / across) ** 2 + 0j)
        return np.sinc(width * fy) * np.sinc(width * fx) * np.exp(2j * np.pi * distance * along)

    return transfer, wavelength * abs(distance) / min(down, across) ** 2 / 2


def picture_means(target, y, x, side=1.0):
    """Return the means of a picture of squares over squares about places of rows y and columns x, inside of it."""

    def shares(places, count, width):
        ends = np.add.outer(places, np.array([-width / 2, width / 2]))[..., None]
        pixels = np.arange(count)
        return np.clip(np.minimum(ends[:, 1], pixels + 0.5) - np.maximum(ends[:, 0], pixels - 0.5), 0, None) / width

    down, across = np.broadcast_to(side, 2) if np.ndim(side) else (side, side)
    return shares(np.asarray(y), target.shape[0], down) @ target @ shares(np.asarray(x), target.shape[1], across).T


def picture_means_at(target, y, x, side=1.0, turned=0.0, points=24):
    """Return the means of a picture of squares over turned squares about places one by one, by many points."""
    g = ((np.arange(points) + 0.5) / points - 0.5) * side
    gy, gx = (part.ravel() for part in np.meshgrid(g, g, indexing="ij"))
    cosine, sine = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    rows = np.rint(np.add.outer(y, cosine * gy + sine * gx)).astype(int)
    columns = np.rint(np.add.outer(x, cosine * gx - sine * gy)).astype(int)
    return target[rows, columns].mean(1)


def places_inside(count, shift, step, side, ring=1):
    """Return the middles of a camera's pixels whose squares lie inside a picture without its outermost pixels."""
    places = np.arange(-2, count / step + 2) * step + shift
    low, high = ring - 0.5, count - ring - 0.5
    return places[(places - side / 2 > low - 1e-9) & (places + side / 2 < high + 1e-9)]


def decibels(seen, target, places):
    """Return the peak signal-to-noise ratio at several places of a camera, at one brightness for all of them.

    `seen` and `target` are functions of rows and columns; `places` is a list of pairs of them.
    """
    pairs = [(seen(y, x), target(y, x)) for y, x in places]
    brightness = sum((s * t).sum() for s, t in pairs) / sum((s * s).sum() for s, _ in pairs)
    return [-10 * np.log10(np.mean((brightness * s - t) ** 2)) for s, t in pairs]


def camera(seen, target, step=1.0, fill=1.0, shifts=4):
    """Return the ratios in decibels at all shifts of a camera with pixels `step` pixels apart, ``[shifts, shifts]``.

    Shifts are quarters of a pixel of the panel.
    """
    side, quarters = step * fill**0.5, np.arange(shifts) / 4
    rows, columns = ([places_inside(n, s, step, side) for s in quarters] for n in target.shape)
    places = [(y, x) for y in rows for x in columns]
    found = decibels(
        lambda y, x: seen.means(y, x, side, 5 if side <= 1.5 else 10),
        lambda y, x: picture_means(target, y, x, side),
        places,
    )
    return np.reshape(found, (len(rows), len(columns)))


def _gauss(half, cycles):
    """Return nodes and weights of Gauss's rule over ±half for an integrand that turns so many times."""
    nodes, weights = np.polynomial.legendre.leggauss(int(np.ceil(np.pi * cycles)) + 24)
    return half * nodes, half * weights


def _rule(side, points):
    """Return places and weights of a mean over a side; a point for none."""
    if side == 0:
        return np.zeros(1), np.ones(1)
    nodes, weights = np.polynomial.legendre.leggauss(points)
    return side / 2 * nodes, weights / 2
