"""Design of the small filters of a spatial steerable pyramid: least squares on the response, instead of tables of taps.

Every band of K orientations is a mixture of the same K filters, one per product cosⁱθ·sin^(K−1−i)θ. They are even or
odd along each axis and one another's transposes, so that few numbers are unknown and the bank is exactly steerable.
"""

import functools
import json
import math
from importlib import resources
from pathlib import Path

import numpy as np

# Taps of the usual banks, designed once.
KEPT = ("data", "steerable_pyramid_taps.json")
# Points per axis of the grid of frequencies on which the responses are prescribed.
GRID = 24
FOOT = 0.55
# Weight of the distance from the ideal response relative to flatness; see the notes.
PULL, BAND_PULL = 0.05, 0.15
ALIASING, SUMS, FLOOR, SPLIT = 3.0, 100.0, 0.01, 1.0
STEPS, TOLERANCE, DAMPING = 100, 1e-6, 1e-9


def ideal_gains(radius: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the ideal gains of the high-pass residual, the first low-pass, the bands together and the low-pass.

    Parameters
    ----------
    radius : numpy.ndarray
        Length of the frequency vector in radians per pixel.

    Returns
    -------
    tuple of numpy.ndarray
        H₀(r) = H(r/2), L₀(r) = L(r/2)/2, H(r), L(r), for which H₀² + L₀² = 1 and H² + L²/4 = 1.

    Notes
    -----
    Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), eqs. 1 to 4: a raised cosine over
    log₂ r, one octave wide.
    """
    high = [np.sin(_octave_angle(radius / scale)) for scale in (2, 1)]
    low = [np.cos(_octave_angle(radius / scale)) for scale in (2, 1)]
    return high[0], low[0], high[1], 2 * low[1]


def band_amplitude(n_orientations: int) -> float:
    """Return a = 2ᴷ⁻¹(K−1)!/√(K(2K−2)!), for which Σₖ a²·cos²⁽ᴷ⁻¹⁾(θ − πk/K) = 1."""
    order = n_orientations - 1
    return 2**order * math.factorial(order) / math.sqrt(n_orientations * math.factorial(2 * order))


def steering(n_orientations: int, angles: np.ndarray) -> np.ndarray:
    """Return the coefficients of the K products cosⁱθ·sin^(K−1−i)θ in a·cosᴷ⁻¹(θ − angle).

    Parameters
    ----------
    n_orientations : int
        K.
    angles : numpy.ndarray
        ``[A]``, in radians.

    Returns
    -------
    numpy.ndarray
        ``[A, K]``.
    """
    order = n_orientations - 1
    index = np.arange(n_orientations)
    binomial = np.array([math.comb(order, i) for i in index], dtype=float)
    # 0⁰ is 1 here, as it is in NumPy.
    powers = np.cos(angles)[:, None] ** index * np.sin(angles)[:, None] ** (order - index)
    return band_amplitude(n_orientations) * binomial * powers


@functools.lru_cache(maxsize=64)
def design(n_orientations: int, sizes: tuple[int, int, int, int], bilinear: bool = False) -> dict[str, np.ndarray]:
    """Return filters whose pyramid reconstructs a picture nearly perfectly.

    Parameters
    ----------
    n_orientations : int
        Number K ≥ 1 of orientations.
    sizes : tuple of int
        Odd sizes of the low-pass "l", the first low-pass "l0", the high-pass residual "h0" and the bands.
    bilinear : bool
        For a pyramid whose levels are halved by 2 × 2 means and enlarged bilinearly, rather than by "l".

    Returns
    -------
    dict
        "l", "l0", "h0": ``[k, k]``; "b": ``[K, k, k]``, to be applied by correlation; "steerable": the filters
        ``[K, k, k]`` that bands are mixtures of; all float64, read-only.

    Notes
    -----
    Starts from the linear least-squares fit to the ideal responses of Portilla and Simoncelli (2000). Minimised
    together: the deviation from 1 of T = H₀² + L₀²(Σₖ|Bₖ|² + L²/4) and of H₀² + L₀², that of the inner sum as the next
    level is computed from it, the aliasing L(ω)L(ω + π)/4 along one axis and both, the filters' sums, and the distance
    from the ideal responses. A bilinear pyramid has cos⁴(ωₓ/2)·cos⁴(ω_y/2) in place of L²/4, from halving and enlarging
    alone, and its ideal bands are what this leaves; "l" is not used then.
    """
    problem = _Problem(n_orientations, sizes, bilinear)
    kept = _kept().get(_key(n_orientations, sizes, bilinear))
    filters = problem.filters(_descend(problem) if kept is None else np.array(kept))
    for value in filters.values():
        value.setflags(write=False)
    return filters


def keep(banks: list[tuple[int, tuple[int, int, int, int], bool]], path: Path) -> None:
    """Write the taps of designs to a file, from which :func:`design` takes them without designing them again.

    Parameters
    ----------
    banks : list of tuple
        Arguments of :func:`design`.
    path : Path
        The file; that of the library is `KEPT` beside this module.
    """
    taps = {_key(*bank): _descend(_Problem(*bank)).tolist() for bank in banks}
    path.write_text("{\n" + ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in taps.items()) + "\n}\n")


@functools.cache
def _kept():
    return json.loads(resources.files("odak.learn.perception").joinpath(*KEPT).read_text(encoding="utf-8"))


def _key(n_orientations, sizes, bilinear):
    return f"{n_orientations} {' '.join(map(str, sizes))}" + (" bilinear" if bilinear else "")


def _descend(problem) -> np.ndarray:
    """Return the taps of least cost, by Levenberg and Marquardt's damped Gauss–Newton steps."""
    taps, damping = problem.start(), 1e-4
    residual, jacobian = problem.residual(taps)
    cost = residual @ residual + problem.quadratic_cost(taps)
    for _ in range(STEPS):
        normal = problem.normal + jacobian.T @ jacobian
        gradient = problem.normal @ taps - problem.pulled + jacobian.T @ residual
        normal[np.diag_indices_from(normal)] += damping
        trial = taps - np.linalg.solve(normal, gradient)
        residual_there, jacobian_there = problem.residual(trial)
        cost_there = residual_there @ residual_there + problem.quadratic_cost(trial)
        if cost_there >= cost:
            damping *= 4
            continue
        gain = (cost - cost_there) / cost
        taps, residual, jacobian, cost, damping = trial, residual_there, jacobian_there, cost_there, damping / 4
        if gain < TOLERANCE:
            break
    return taps


def orientations(n_orientations: int) -> np.ndarray:
    """Return the K angles πk/K in radians, counter-clockwise with y upwards."""
    return np.arange(n_orientations) * math.pi / n_orientations


def quadrature(bands: np.ndarray, size: int) -> np.ndarray:
    """Return the filters that are a quarter of a cycle behind the bands of a bank.

    Parameters
    ----------
    bands : numpy.ndarray
        ``[K, k, k]`` as :func:`design` returns them, to be applied by correlation.
    size : int
        Odd size of the filters.

    Returns
    -------
    numpy.ndarray
        ``[K, size, size]``, each of sum 0: where a band gives cos φ for a grating that runs along its orientation, its
        filter gives sin φ.

    Notes
    -----
    Least squares on Q(ω) = −i·sign(ω·u)·B(ω) over a grid of the whole plane, each frequency weighted by the amplitude
    1/|ω| that pictures have, with the response at zero held by a large weight.
    """
    frequencies = 2 * math.pi * (np.arange(2 * GRID) + 0.5) / (2 * GRID) - math.pi
    x, down = np.meshgrid(frequencies, frequencies)
    x, down = np.append(x.ravel(), 0.0), np.append(down.ravel(), 0.0)

    def waves(side):
        offset = np.arange(side) - side // 2
        return np.exp(1j * (down[:, None] * np.repeat(offset, side) + x[:, None] * np.tile(offset, side)))

    weight = 1 / np.maximum(np.hypot(x, down), FOOT)
    weight[-1] = SUMS
    equations = waves(size) * weight[:, None]
    toward = np.cos(orientations(len(bands)))[:, None] * x - np.sin(orientations(len(bands)))[:, None] * down
    wanted = -1j * np.sign(toward) * (waves(bands.shape[-1]) @ bands.reshape(len(bands), -1).T).T * weight
    stacked = np.concatenate([equations.real, equations.imag])
    taps = np.linalg.lstsq(stacked, np.concatenate([wanted.real, wanted.imag], 1).T, rcond=1e-10)[0]
    taps -= taps.mean(0)
    return taps.T.reshape(len(bands), size, size)


class _Problem:
    """Unknown taps of a bank, the responses they give and the residuals of its flatness."""

    def __init__(self, n_orientations: int, sizes: tuple[int, int, int, int], bilinear: bool) -> None:
        self.count, self.bilinear = n_orientations, bilinear
        axis = np.linspace(0, math.pi, GRID)
        self.x, self.y = np.meshgrid(axis, axis, indexing="xy")
        self.parts = self._parts(sizes)
        self.slices, start = [], 0
        for taps, *_ in self.parts:
            self.slices.append(slice(start, start + len(taps)))
            start += len(taps)
        self.length = start
        self.halved = self._response(self.parts[0][0], 0, 0, 0.5)
        # C with Σₖ|Bₖ|² = Σᵢⱼ Cᵢⱼ·Mᵢ·Mⱼ for the products Mᵢ.
        shares = steering(n_orientations, orientations(n_orientations))
        self.power = shares.T @ shares
        self.normal, self.pulled, self.constant = self._quadratic()

    def _parts(self, sizes):
        """Return taps ``[n, k, k]``, gains ``[points, n]`` and ideal gains of l, l0, h0 and half of the products."""
        radius, angle = np.hypot(self.x, self.y), np.arctan2(self.y, self.x)
        high0, low0, band, _ = ideal_gains(radius)
        # A tail below the octave, so that small filters keep their sign down to low frequencies.
        band = np.maximum(band, np.minimum(FOOT * radius * 4 / math.pi, FOOT))
        if self.bilinear:
            band = np.sqrt(1 - self._bilinear_gain(1.0))
        low = 2 * np.sqrt(1 - band**2)
        parts = [self._part(size, 0, 0, True, ideal) for size, ideal in zip(sizes, (low, low0, high0), strict=False)]
        order = self.count - 1
        for i in range((order + 2) // 2):
            product = band * np.cos(angle) ** i * np.sin(angle) ** (order - i)
            parts.append(self._part(sizes[3], i % 2, (order - i) % 2, 2 * i == order, product))
        return parts

    def _part(self, size, odd_x, odd_y, symmetric, ideal):
        taps = _symmetric_taps(size, odd_x, odd_y, symmetric)
        return taps, self._response(taps, odd_x, odd_y), ideal.ravel()

    def _response(self, taps, odd_x, odd_y, scale=1.0):
        """Return the gains ``[points, n]`` of filters at the grid's frequencies times a scale."""
        size = taps.shape[-1]
        offset = np.arange(size) - size // 2
        # Rows grow downwards and y upwards; odd products stand for −j times a real gain.
        along_x = [np.cos, np.sin][odd_x](scale * self.x.ravel()[:, None] * offset)
        along_y = [np.cos, np.sin][odd_y](scale * self.y.ravel()[:, None] * -offset)
        sign = -1.0 if odd_x or odd_y else 1.0
        outer = along_y[:, :, None] * along_x[:, None, :]
        return sign * outer.reshape(-1, size * size) @ taps.reshape(len(taps), -1).T

    def products(self, taps):
        """Return the gains of the K products ``[K, points]``, and the taps and responses that each comes from."""
        gains, sources = [], []
        for i in range(self.count):
            mirrored = i > (self.count - 1) // 2 and 2 * i != self.count - 1
            part = 3 + (self.count - 1 - i if mirrored else i)
            response = self.parts[part][1]
            if mirrored:
                response = response.reshape(GRID, GRID, -1).transpose(1, 0, 2).reshape(GRID * GRID, -1)
            gains.append(response @ taps[self.slices[part]])
            sources.append((self.slices[part], response))
        return np.array(gains), sources

    def relevance(self, part):
        """Return weights of the frequencies: the bands and the low-pass follow the first low-pass."""
        ideal_low0 = self.parts[1][2]
        return np.ones_like(ideal_low0) if part in (1, 2) else np.maximum(ideal_low0**2, FLOOR)

    def start(self):
        taps = np.zeros(self.length)
        for part, (_, response, ideal) in enumerate(self.parts):
            weight = np.sqrt(self.relevance(part))
            taps[self.slices[part]] = np.linalg.lstsq(response * weight[:, None], ideal * weight, rcond=1e-10)[0]
        return taps

    def residual(self, taps):
        """Return every residual ``[m]`` that is not quadratic, and its Jacobian ``[m, n]``."""
        low0, high0 = (part[1] @ taps[where] for part, where in zip(self.parts[1:3], self.slices[1:3], strict=True))
        inner, inner_jacobian = self._inner(taps)
        flat = high0**2 + low0**2 * inner - 1
        jacobian = low0[:, None] ** 2 * inner_jacobian
        for gain, index in ((2 * low0 * inner, 1), (2 * high0, 2)):
            jacobian[:, self.slices[index]] += gain[:, None] * self.parts[index][1]
        # A coarser level gets what the low-pass transmits at half the frequency.
        passed, passed_jacobian = self._passed(taps, self.halved, 0.5)
        deep = passed * (inner - 1)
        deep_jacobian = passed[:, None] * inner_jacobian
        deep_jacobian[:, self.slices[0]] += (inner - 1)[:, None] * passed_jacobian
        # Small bands do not respond to one-pixel stripes: there the first low-pass would be undetermined.
        split = high0**2 + low0**2 - 1
        split_jacobian = np.zeros_like(jacobian)
        for gain, index in ((2 * low0, 1), (2 * high0, 2)):
            split_jacobian[:, self.slices[index]] = gain[:, None] * self.parts[index][1]
        scale = SPLIT / GRID
        rows = [
            (flat / GRID, jacobian / GRID),
            (deep / GRID, deep_jacobian / GRID),
            (scale * split, scale * split_jacobian),
        ]
        if not self.bilinear:
            rows.append(self._aliasing(taps))
        return np.concatenate([r for r, _ in rows]), np.concatenate([j for _, j in rows])

    def _inner(self, taps):
        """Return Σₖ|Bₖ|² + L²/4 and its Jacobian: the power of the bands and the low-pass of one level together."""
        products, sources = self.products(taps)
        mixed = self.power @ products
        passed, passed_jacobian = self._passed(taps, self.parts[0][1], 1.0)
        jacobian = np.zeros((passed.size, self.length))
        jacobian[:, self.slices[0]] = passed_jacobian
        for row, (where, response) in zip(mixed, sources, strict=True):
            jacobian[:, where] += 2 * row[:, None] * response
        return (products * mixed).sum(0) + passed, jacobian

    def _passed(self, taps, response, scale):
        """Return the gain of halving and enlarging at scaled frequencies, and its Jacobian in the taps of L."""
        if self.bilinear:
            return self._bilinear_gain(scale).ravel(), np.zeros_like(response)
        low = response @ taps[self.slices[0]]
        return low**2 / 4, (low / 2)[:, None] * response

    def _bilinear_gain(self, scale):
        # The mean of two pixels has the gain cos(ω/2), taking every second pixel 1/2, bilinear enlargement 2·cos³(ω/2).
        return np.cos(scale * self.x / 2) ** 4 * np.cos(scale * self.y / 2) ** 4

    def _aliasing(self, taps):
        """Return the aliases of a frequency from half the sampling rate away, along one axis or both."""
        grid, where = self.parts[0][1].reshape(GRID, GRID, -1), self.slices[0]
        residuals, jacobians = [], []
        # π − ω is on the grid too, and L is even.
        for folded in (grid[:, ::-1], grid[::-1, ::-1]):
            one, two = grid @ taps[where], folded @ taps[where]
            product = one[..., None] * folded + two[..., None] * grid
            jacobian = np.zeros((GRID * GRID, self.length))
            jacobian[:, where] = product.reshape(GRID * GRID, -1)
            residuals.append((one * two).ravel())
            jacobians.append(jacobian)
        scale = ALIASING / (4 * GRID)
        return scale * np.concatenate(residuals), scale * np.concatenate(jacobians)

    def quadratic_cost(self, taps):
        """Return the cost of the filters' sums and of the distance from the ideal responses, up to a constant."""
        return taps @ self.normal @ taps - 2 * taps @ self.pulled + self.constant

    def _quadratic(self):
        normal, pulled, constant = DAMPING * np.eye(self.length), np.zeros(self.length), 0.0
        sums = [2.0, 1.0, *[0.0] * (len(self.parts) - 2)]
        pulls = [PULL, PULL, PULL, *[BAND_PULL] * (len(self.parts) - 3)]
        for part, (basis, response, ideal) in enumerate(self.parts):
            where, row = self.slices[part], SUMS * basis.sum((1, 2))
            weighted = (pulls[part] / GRID) ** 2 * (response * self.relevance(part)[:, None]).T
            normal[where, where] += weighted @ response + np.outer(row, row)
            pulled[where] += weighted @ ideal + SUMS * sums[part] * row
            constant += (pulls[part] / GRID) ** 2 * self.relevance(part) @ ideal**2 + (SUMS * sums[part]) ** 2
        return normal, pulled, constant

    def filters(self, taps):
        maps = [np.tensordot(taps[where], part[0], 1) for where, part in zip(self.slices, self.parts, strict=True)]
        products = []
        for i in range(self.count):
            mirrored = i > (self.count - 1) // 2 and 2 * i != self.count - 1
            product = maps[3 + (self.count - 1 - i if mirrored else i)]
            # x and y are exchanged; both axes are flipped because rows grow downwards.
            products.append(np.ascontiguousarray(product.T[::-1, ::-1]) if mirrored else product)
        products = np.array(products)
        bands = np.tensordot(steering(self.count, orientations(self.count)), products, 1)
        return {"l": maps[0], "l0": maps[1], "h0": maps[2], "b": bands, "steerable": products}


def _octave_angle(radius):
    """Return an angle that rises from 0 at π/4 to π/2 at π/2 over one octave of the radius."""
    position = np.log2(np.maximum(radius, 1e-12) * 4 / math.pi)
    return np.clip(position, 0, 1) * math.pi / 2


def _symmetric_taps(size, odd_x, odd_y, symmetric):
    """Return an orthogonal basis ``[n, k, k]`` of the filters that are even or odd along each axis."""
    half = size // 2
    columns, rows = ([_line(size, offset, odd) for offset in range(int(odd), half + 1)] for odd in (odd_x, odd_y))
    basis = [np.outer(row, column) for row in rows for column in columns]
    if symmetric:
        basis = [
            np.outer(rows[i], columns[j]) + (np.outer(rows[j], columns[i]) if i != j else 0)
            for i in range(len(rows))
            for j in range(i + 1)
        ]
    return np.array(basis)


def _line(size, offset, odd):
    line = np.zeros(size)
    line[size // 2 + offset] = 1.0
    line[size // 2 - offset] = -1.0 if odd else 1.0
    return line
