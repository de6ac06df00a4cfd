"""Light of square pixels behind stops, lenses, pupils and other panels, and what cameras record of it, by quadrature.

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
        self.nodes = [_gauss(orders / 2, (orders * (n + reach) + 16) / 2) for n in shape]

    def spectrum(self, light, transfer, places=None):
        """Return the amplitudes of the plane waves of light at the pixels, or some places, times their weights."""
        (fy, wy), (fx, wx) = self.nodes
        down, across = (
            np.exp(-2j * np.pi * np.outer(f, p)) for f, p in zip((fy, fx), _or_pixels(places, light), strict=True)
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
    """Frequencies within a circle of some radius, in cycles per pixel: lines of nodes of Gauss's rule along its chords.

    The lines are at sines of equally spaced angles, for which the sum over them is exact as that of a periodic function
    is. The radius is one number, or a pair along rows and columns where pixels are no squares.
    """

    def __init__(self, shape, radius, reach=0.0):
        radius = np.broadcast_to(radius, 2)
        down, across = (2 * r * (n + reach) + 8 for r, n in zip(radius, shape, strict=True))
        count = int(np.ceil(np.pi * np.hypot(down, across) / 2)) + 24
        angle = (np.arange(count) + 0.5) / count * np.pi - np.pi / 2
        nodes, weights = _gauss(1.0, across / 2)
        self.fy, self.fx = radius[0] * np.sin(angle), radius[1] * np.outer(np.cos(angle), nodes)
        self.weights = np.pi / count * radius.prod() * np.outer(np.cos(angle) ** 2, weights)

    def spectrum(self, light, transfer, places=None):
        """Return the amplitudes of the plane waves of light at the pixels, or some places, times their weights."""
        y, x = _or_pixels(places, light)
        lines = np.exp(-2j * np.pi * np.outer(self.fy, y)) @ light
        waves = [_sums(f, x, line) for f, line in zip(self.fx, lines, strict=True)]
        return np.stack(waves) * transfer(self.fy[:, None], self.fx) * self.weights

    def on_a_grid(self, waves, y, x):
        """Return the field at all places of rows y and columns x."""
        lines = [wave @ np.exp(2j * np.pi * np.outer(f, x)) for f, wave in zip(self.fx, waves, strict=True)]
        return np.exp(2j * np.pi * np.outer(y, self.fy)) @ np.stack(lines)


class Focus:
    """Points behind a lens, in place of frequencies: Fourier sums over the pixels, times the spectrum of squares.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the panel.
    curvature : float
        Phase in cycles, per square of a pixel, that the lens leaves at a plane beside its focus.
    fill : float
        Share of a pixel that emits.
    """

    def __init__(self, shape, curvature=0.0, fill=0.9):
        self.pixels = [np.arange(n) - n // 2 for n in shape]
        self.curvature, self.width = curvature, fill**0.5

    def spectrum(self, light, _):
        """Return the light that the lens turns into an image."""
        y, x = self.pixels
        return light * np.exp(2j * np.pi * self.curvature * (y[:, None] ** 2 + x**2)) / light.size**0.5

    def on_a_grid(self, light, y, x):
        """Return the field at all places of rows y and columns x."""
        down, across = (
            np.exp(-2j * np.pi * np.outer(f, pixels)) * np.sinc(self.width * f)[:, None]
            for f, pixels in (((p - len(k) // 2) / len(k), k) for p, k in zip((y, x), self.pixels, strict=True))
        )
        return down @ light @ across.T


class Retina:
    """Points of a pupil: Fresnel's integral over the area of each pixel, and the image in polar coordinates.

    Lengths are in metres.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the panel.
    pitch, wavelength : float
        Of the panel and of the light.
    ray_matrix : tuple of float
        A, B and D from the panel to the pupil.
    diameter : float
        Of the pupil.
    middle : tuple of float
        Place of the pupil.
    focus : float, optional
        Distance in front of the pupil that is sharp; the panel, as it is seen, by default.
    one_order : bool
        Whether a stop passes one diffraction order, whose light Fresnel's integral spreads from its edge.
    fill : float
        Share of a pixel that emits.
    """

    def __init__(
        self, shape, pitch, wavelength, ray_matrix, diameter, middle=(0.0, 0.0), focus=None, one_order=False, fill=0.9
    ):
        a, b, d = ray_matrix
        self.shape, self.step, self.width = shape, pitch / (wavelength * b), fill**0.5
        self.middle, self.curvature = middle, a * pitch * self.step / 2
        radius, blur = diameter / 2 * abs(self.step), 0 if focus is None else d / b - 1 / focus
        turns = abs(blur) * diameter**2 / 8 / wavelength / radius
        if one_order:
            # The edges of a stop send light as far aside as their plane waves go on the way to the pupil.
            turns += (0.5 + radius + max(np.abs(middle)) * abs(self.step)) / abs(2 * self.curvature)
        self.disc = disc = RoundStop(shape, radius, turns)
        self.blur = lambda fy, fx: np.exp(1j * np.pi * blur / wavelength / self.step**2 * (fx**2 + fy**2))
        self.ways = None
        if one_order:
            places = np.repeat(disc.fy, disc.fx.shape[1]) / self.step, disc.fx.ravel() / self.step
            pixels = [(np.arange(n) - n // 2) * pitch for n in shape]
            self.ways = [
                self._of_one_order(there + m, x, a, wavelength * b, pitch, self.width)
                for there, m, x in zip(places, middle, pixels, strict=True)
            ]

    def _of_one_order(self, there, x, a, length, pitch, width):
        """Return the sum of the plane waves that pass, of which each is a chirp in the plane of the pupil."""
        # The places along one axis repeat.
        different, of = np.unique(there, return_inverse=True)
        q, curvature = different / length, a / length
        turns = (np.abs(q).max() + 0.5 / pitch) / abs(curvature) / pitch
        f, weights = _gauss(0.5 / pitch, turns + len(x))
        waves = weights * np.sinc(width * pitch * f) * (1j / curvature) ** 0.5
        chirps = np.exp(-1j * np.pi / curvature * np.subtract.outer(q, f) ** 2)
        return (chirps @ (waves[:, None] * np.exp(-2j * np.pi * np.outer(f, x))))[of]

    def spectrum(self, light, _):
        """Return the light at points of the pupil, times their weights and what the eye does not focus."""
        disc = self.disc
        if self.ways is not None:
            down, across = self.ways
            seen = ((down @ light) * across).sum(1).reshape(disc.weights.shape)
            return seen * disc.weights * self.blur(disc.fy[:, None], disc.fx)
        # Points of the squares; fewer of large panels, whose light is less oblique in a pixel.
        nodes, weights = _rule(self.width, 5 if light.size < 1e5 else 3)
        axes = [
            [
                (w, p, np.exp(2j * np.pi * (self.curvature * p**2 - m * self.step * p)))
                for w, p in ((w, node - n // 2 + np.arange(n)) for w, node in zip(weights, nodes, strict=True))
            ]
            for n, m in zip(self.shape, self.middle, strict=True)
        ]
        return sum(
            v * w * disc.spectrum(light * down[:, None] * across, self.blur, (y, x))
            for v, y, down in axes[0]
            for w, x, across in axes[1]
        )

    def on_a_grid(self, waves, y, x):
        """Return the field at all places of rows y and columns x."""
        return self.disc.on_a_grid(waves, *(np.asarray(p) - n // 2 for p, n in zip((y, x), self.shape, strict=True)))


def after_a_panel(amplitudes, light, between, transfer, fill=0.9, points=10):
    """Return the light of a panel that is lit through another one, at points of its pixels, and where these are.

    `between` is the stop that the light of the first panel passes, `transfer` its pixels and its way; the second panel
    multiplies it within the inner squares of its pixels. The results are the light at the pixels' points, times their
    weights, and the places of these along rows and columns.
    """
    nodes, weights = _rule(fill**0.5, points)
    y, x = (np.add.outer(np.arange(n), nodes).ravel() for n in light.shape)
    there = between.on_a_grid(between.spectrum(amplitudes.astype(complex), transfer), y, x)
    return there * np.kron(light, np.outer(weights, weights)), [(y, x)]


class Seen:
    """What is seen of frames of light at the pixels of a panel: intensity at points, and means over squares.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Complex light of each frame at the pixels, ``[rows, columns]``.
    powers : sequence of float
        Share of the power in each frame.
    stop : SquareStop, RoundStop, Focus or Retina
        What passes.
    transfer : callable
        ``transfer(fy, fx)``, in cycles per pixel: of pixels and of the way.
    places : sequence, optional
        Places of the light along rows and columns instead of the pixels, by :func:`after_a_panel`.
    """

    def __init__(self, frames, powers, stop, transfer=None, places=()):
        self.stop, self.powers = stop, powers
        self.waves = [stop.spectrum(np.asarray(light, complex), transfer, *places) for light in frames]

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


def camera(seen, target, step=1.0, fill=1.0, shifts=4, window=None, every=1):
    """Return the ratios in decibels at all shifts of a camera with pixels `step` pixels apart, ``[shifts, shifts]``.

    Shifts are quarters of a pixel of the panel. They are taken over a window of rows and columns of the target, over
    one in `every` rows and columns of the camera's pixels.
    """
    side, quarters = step * fill**0.5, np.arange(shifts) / 4
    ends = [(0, n) for n in target.shape] if window is None else [(s.start, s.stop) for s in window]
    rows, columns = (
        [first + places_inside(end - first, s, step, side)[::every] for s in quarters] for first, end in ends
    )
    places = [(y, x) for y in rows for x in columns]
    found = decibels(
        lambda y, x: seen.means(y, x, side, 5 if side <= 1.5 else 10),
        lambda y, x: picture_means(target, y, x, side),
        places,
    )
    return np.reshape(found, (len(rows), len(columns)))


def _or_pixels(places, light):
    return [np.arange(n) for n in light.shape] if places is None else places


def _sums(frequencies, places, values, block=32):
    """Return the sums of values·exp(−2πi·f·place) for each frequency; of pixels, products of fewer exponentials."""
    first = places[0]
    if len(places) < 4 * block or not np.array_equal(places, first + np.arange(len(places))):
        return np.exp(-2j * np.pi * np.outer(frequencies, places)) @ values
    parts = np.pad(values, (0, -len(values) % block)).reshape(-1, block)
    far = np.exp(-2j * np.pi * np.outer(frequencies, first + block * np.arange(len(parts))))
    return ((far @ parts) * np.exp(-2j * np.pi * np.outer(frequencies, np.arange(block)))).sum(1)


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
