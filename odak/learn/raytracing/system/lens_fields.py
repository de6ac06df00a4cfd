"""Fields through a lens system: diffraction between two planes, with phase and amplitude from rays."""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from odak import _show, _validate
from odak._array import is_readable, phasor_of_cycles
from odak._warnings import AccuracyWarning, warn
from odak.catalog.materials import MICROMETRES
from odak.learn._tensors import complex_tensor
from odak.learn.raytracing.system.paraxial import check_image_space, check_media, matrix, signed_indices
from odak.learn.raytracing.system.polarisation import jones_vector, polarized_trace
from odak.learn.raytracing.system.prescriptions import Prescription
from odak.learn.raytracing.system.pupils import solve_pairs
from odak.learn.raytracing.system.surfaces import checked_system, optical_system
from odak.learn.raytracing.system.tracing import Rays, trace
from odak.raytracing.intersections import RayStatus
from odak.wave.bench import between_samples
from odak.wave.transfer_functions import pitches

# Step of direction cosines along which differences are taken, and the error of paths in wavelengths that is warned of.
STEP, LARGE = 1e-4, 0.03
# Share of the tolerance at which the sum ends where derivatives are needed.
_FOR_DERIVATIVES = 0.03
# Samples along an axis of a block of a field, about, whose light is computed together.
_BLOCK = 512
# Times the width of a block over which a period of its transform extends at least, and cycles over the block that the
# system may add.
_FINER, _TURNS = 1.5, 32
# Samples on each side of which values between them are made, and the parameter of Kaiser's window: to about 1e-4.
_TAPS, _KAISER = 8, 8.3
_CROSSING = (
    "system must send exactly one ray from each point of the field to each point of the image plane that its light may "
    "reach, got lost or crossing rays: take a lens of less aberration, a smaller field, or larger pixels"
)


@dataclass(frozen=True, repr=False)
class TracedSystem(_show.Shown):
    """A lens system as an element of an optical bench: a field of many points goes through it at once.

    Use it to see a hologram or a display through real lenses, such as an eyepiece: aberrations over the field,
    distortion and losses come from traced rays, diffraction from wave optics. The field enters in the object plane
    of the system, at its `object_distance`, and leaves in its image plane, which belongs where rays from one point are
    spread out: into the pupil of an eye, not into an image.

    Parameters
    ----------
    system : optical_system
        The system, with an object at a finite distance and a plane image.
    output_dx : float or sequence of float, optional
        Pixel pitch of the result in metres; λ·|B|/(N·dx) by default, see :func:`odak.wave.propagate_abcd`.
    output_shape : sequence of int, optional
        Rows and columns of the result; by default the shape of the field.
    grid : sequence of int
        Points of the object plane along rows and columns, odd numbers of at least 3, for which rays are traced; in
        between, paths are interpolated by polynomials.
    points : int
        Rays of each point along each axis, an odd number of at least 3.
    polarization : sequence of complex, optional
        Jones vector (x, y) of the light. If it is given, the coatings, interfaces and glasses take their share of the
        power, as in :func:`polarized_trace`; otherwise nothing is lost.
    tolerance : float
        Relative error of the field at which the sum of transforms ends, see below: the time grows with their number.
        Where a number of the system requires a gradient, it ends at a thirtieth of this, for the derivatives.
    output_center : sequence of float
        Where the middle of the result lies in the image plane, (y, x) in metres: the middle of a pupil beside the axis.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    AccuracyWarning
        If the polynomials deviate from other rays by more than 0.03 wavelengths, which is tried where no number of the
        system requires a gradient, or if an aperture blocks rays: the field is computed as if they passed.

    Notes
    -----
    The field behind is ∬u(x)·|det ∂²V/∂x∂q|^½·exp(2πi·V(x, q)/λ) dx/(iλ), V(x, q) being the optical path of the ray
    from x to q, Hamilton's point characteristic (Born and Wolf, Principles of Optics, 1999, section 4.1), and the
    determinant the amplitude of a tube of rays (Van Vleck, Proc. Natl. Acad. Sci. 14, 178 (1928)), which keeps the
    power. In free space this is the integral of Rayleigh and Sommerfeld, in first-order optics Collins' integral.
    V is a polynomial through the paths of rays between the Chebyshev points of both planes. What it has of x alone and
    of q alone are phases in these planes, −x·q/B is a Fourier transform, and the rest a short sum of products of
    functions of x and of q, with a transform for each.

    Examples
    --------
    A point in the focal plane of a lens becomes a wave of even amplitude, whose light all arrives:

    >>> import torch
    >>> from odak.learn.raytracing.system import Conjugates, TracedSystem, optical_system, surface
    >>> from odak.learn.wave import optical_bench
    >>> front = surface(20.0, thickness=4.0, material="N-BK7")
    >>> rows = [front, surface(-20.0, thickness=18.0)]
    >>> eyepiece = optical_system(rows, 4.0, conjugates=Conjugates(18.0))
    >>> point = torch.zeros(64, 64, dtype=torch.complex128)
    >>> point[32, 32] = 1.0
    >>> pupil, pitch = optical_bench([TracedSystem(eyepiece, 40e-6, grid=(3, 3))], 550e-9).propagate(point, 8e-6)
    >>> round(float((pupil.abs() ** 2).sum() * pitch**2 / 8e-6**2), 1)
    1.0
    """

    system: optical_system
    output_dx: float | Sequence[float] | None = None
    output_shape: Sequence[int] | None = None
    grid: Sequence[int] = (5, 5)
    points: int = 9
    polarization: Sequence[complex] | None = None
    tolerance: float = 1e-3
    output_center: Sequence[float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if checked_system(self.system).at_infinity:
            raise ValueError("system must have an object_distance, got one with its object at infinity")
        if self.system.image is not None:
            raise ValueError("system must have a plane as its image, got one with an image surface")
        grid = _validate.size("grid", self.grid)
        object.__setattr__(self, "grid", tuple(grid))
        for name, value in (("grid", grid[0]), ("grid", grid[1]), ("points", self.points)):
            if _validate.integer(name, value, minimum=3) % 2 == 0:
                raise ValueError(f"{name} must be an odd number, got {value}")
        _validate.number("tolerance", self.tolerance, positive=True)
        (center,) = _validate.constants(output_center=self.output_center)
        center = tuple(float(one) for one in _validate.several("output_center", center, 2))
        object.__setattr__(self, "output_center", center)
        if self.polarization is not None:
            object.__setattr__(self, "polarization", jones_vector(self.polarization))

    @property
    def path_length(self) -> torch.Tensor:
        """Length of the axis from the object plane to the image plane in metres."""
        lengths = torch.stack([item.thickness.double().reshape(()) for item in self.system.surfaces]).abs()
        return (lengths.sum() + self.system.object_distance) * self._metres

    def matrix(self) -> list[Any]:
        """Return the ray matrix between the two planes at the reference wavelength, lengths in metres."""
        numbers = self.system.prescription([self.system.wavelengths[self.system.reference]])
        (a, b), (c, d) = self._paraxial(numbers)
        return [[a, b * self._metres], [c / self._metres, d]]

    @property
    def _metres(self) -> float:
        return MICROMETRES[self.system.unit] * 1e-6

    def _paraxial(self, numbers: Prescription):
        check_media(self.system, numbers)
        check_image_space(self.system, numbers)
        index = signed_indices(self.system, numbers)
        found = matrix(numbers, index, 0, len(self.system.surfaces), gap=True)
        gap = self.system.object_distance / index[..., 0]
        return (found.a, found.b + gap * found.a), (found.c, found.d + gap * found.c)

    def apply(self, field: torch.Tensor, pitch: float | Sequence[float], wavelength: float) -> tuple[torch.Tensor, Any]:
        """Return the field in the image plane of the system and its pixel pitch.

        Parameters
        ----------
        field : torch.Tensor
            Complex field ``[..., rows, columns]`` in the object plane.
        pitch : float or sequence of float
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float
            Wavelength in metres.
        """
        complex_tensor("field", field, "a complex tensor [..., rows, columns]")
        passage = self.passage(_validate.image("field", field).shape[-2:], pitch, wavelength)
        return passage(field), passage.pitch

    def passage(self, shape: Sequence[int], pitch: float | Sequence[float], wavelength: float) -> "Passage":
        """Return what the system does to fields of a shape, whose rays are traced once.

        Parameters
        ----------
        shape : sequence of int
            Rows and columns of the fields.
        pitch : float or sequence of float
            Their pixel pitch in metres, or a pair (rows, columns).
        wavelength : float
            Wavelength in metres.

        Returns
        -------
        Passage
            A linear function of fields, which has the gradients of the system's numbers at the time of this call.
        """
        unit = self._metres
        wave = _validate.constant("wavelength", wavelength, positive=True) / unit
        steps = [_validate.constant("pitch", step, positive=True) / unit for step in pitches(pitch)]
        numbers = self.system.prescription([wave])
        shape = _validate.size("shape", shape)
        lens = self._paraxial(numbers)
        a, b = (float(value.detach()) for value in lens[0])
        if any(abs(b) * wave < abs(a) * n * step**2 for n, step in zip(shape, steps, strict=True)):
            raise ValueError(
                "system must have its image plane where the rays of a point are spread out, got an image of the object "
                "plane; put it into the pupil and propagate from there"
            )
        counts = shape if self.output_shape is None else _validate.size("output_shape", self.output_shape)
        given = (None, None) if self.output_dx is None else pitches(self.output_dx, "output_dx")
        axes = [
            _Axis.of(a, b, wave, *one)
            for one in zip(
                shape,
                steps,
                counts,
                (None if p is None else _validate.constant("output_dx", p, positive=True) / unit for p in given),
                (middle / unit for middle in self.output_center),
                strict=True,
            )
        ]
        return Passage(axes, _Characteristic(self, numbers, axes, wave, lens), counts, unit)


class Passage:
    """What a lens system does to fields of one shape, pitch and wavelength: a linear function of them.

    Made by :meth:`TracedSystem.passage`. For each block of the field it holds the short sum of products of functions of
    both planes, at few points.

    Attributes
    ----------
    pitch : float or tuple of float
        Pixel pitch of the result in metres.
    error : float
        How far paths of other rays lie from the polynomials, in wavelengths; 0 where a number requires a gradient.
    """

    def __init__(self, axes: Sequence["_Axis"], path: "_Characteristic", counts: Sequence[int], unit: float):
        self._axes, self._path, self._counts = axes, path, counts
        out = [one.out * unit for one in axes]
        self.pitch: Any = out[0] if out[0] == out[1] else tuple(out)
        self.error: float = path.error

    @functools.cached_property
    def _blocks(self) -> list["_Block"]:
        return [self._path.block(y, x) for y, x in itertools.product(*(range(one.blocks) for one in self._axes))]

    def __call__(self, field: torch.Tensor) -> torch.Tensor:
        """Return the field behind the system of a field ``[..., rows, columns]`` in front of it."""
        axes = self._axes
        for axis, one in zip((-2, -1), axes, strict=True):
            field = one.finer(field, axis)
        field = _centred(field, [one.block * one.blocks for one in axes])
        down, across = axes
        field = field.unflatten(-1, (-1, across.block)).unflatten(-3, (-1, down.block))
        total: Any = 0.0
        for block, (y, x) in zip(self._blocks, itertools.product(*(range(one.blocks) for one in axes)), strict=True):
            part = field[..., y, :, x, :]
            # Derivatives of all products need much memory; they are computed again instead.
            again: dict[str, Any] = {"use_reentrant": False, "preserve_rng_state": False}
            total = total + (checkpoint(block, part, **again) if block.before.requires_grad else block(part))
        # 1/(iλB) of the integral; the amplitudes are relative to 1/B.
        scale = down.step * across.step / (self._path.wavelength * self._path.lens[0][1]) * -1j
        lit = [torch.from_numpy(abs(one.places()) <= one.reach + one.out).to(total) for one in axes]
        # Beyond what is computed, no light of the field arrives.
        return _centred(total * scale.to(total.dtype) * lit[0][:, None] * lit[1], self._counts)


def _centred(field: torch.Tensor, counts: Sequence[int]) -> torch.Tensor:
    """Return a field of so many rows and columns, by zeros around it, whose middle sample stays its middle."""
    before = [count // 2 - n // 2 for n, count in zip(field.shape[-2:], counts, strict=True)]
    after = [count - n - one for n, count, one in zip(field.shape[-2:], counts, before, strict=True)]
    return torch.nn.functional.pad(field, (before[1], after[1], before[0], after[0]))


@dataclass(frozen=True)
class _Axis:
    """Samples of both planes along one axis, and the transform between them, lengths in the system's unit.

    The samples in front are cut into blocks. The sum over those of one, at n·step from its middle, of
    exp(−2πi·n·step·m·coarse·slope) is a discrete Fourier transform of `size` points, of which every `every`-th is
    taken: `slope`, 1/(λB) but for the rounding of the size, is what makes it one. Behind, light of a block varies
    slowly: `coarse` is `between` steps of the result.
    """

    count: int
    step: float
    double: bool
    counts: int
    out: float
    block: int
    blocks: int
    between: int
    size: int
    every: int
    slope: float
    reach: float
    far: float
    center: float

    @classmethod
    def of(
        cls, a: float, b: float, wave: float, n: int, step: float, count: int, out: float | None, center: float
    ) -> "_Axis":
        """Return the axis of n samples at a step in front and `count` samples behind, about a center."""
        out = wave * abs(b) / (n * step) if out is None else out
        # Where light of the largest frequency arrives from the middle and from the edge of the field.
        middle, edge = wave * abs(b) / (2 * step), abs(a) * n * step / 2
        reach = min(middle + edge, abs(center) + count * out / 2)
        count = min(count, 2 * math.ceil((reach + abs(center)) / out) + 1)
        # The sum repeats itself at λ|B|/step, which light at the edges would reach.
        double = reach > (middle - edge) * (1 + 1e-9)
        n, step = (2 * n, step / 2) if double else (n, step)
        blocks = max(1, round(n / _BLOCK))
        block = 2 * math.ceil(n / (2 * blocks)) if blocks > 1 else n
        period = wave * abs(b) / (step * out)
        between = max(1, math.floor(period / (_FINER * (block + _TURNS))))
        every = max(1, math.ceil(block / period - 1e-9))
        size = _fast_size(block, round(period * every / between))
        slope = math.copysign(every / (size * between * step * out), b)
        far = reach + (_TAPS * between * out if between > 1 else 0.0)
        return cls(n, step, double, count, out, block, blocks, between, size, every, slope, reach, far, center)

    @property
    def near(self) -> float:
        """How far the blocks reach from the axis."""
        return self.block * self.blocks * self.step / 2

    def middle_of(self, block: int) -> float:
        """Return where the middle sample of a block is."""
        return (block * self.block + self.block // 2 - self.block * self.blocks // 2) * self.step

    def places(self) -> np.ndarray:
        """Return where the samples behind are."""
        return (np.arange(self.counts) - self.counts // 2) * self.out + self.center

    def coarse(self) -> np.ndarray:
        """Return where the samples of transforms are, in steps of theirs from the middle of those behind."""
        beyond = _TAPS if self.between > 1 else 0
        first = -math.ceil(self.counts // 2 / self.between) - beyond
        return np.arange(first, math.ceil((self.counts - 1 - self.counts // 2) / self.between) + beyond + 1)

    def interpolation(self) -> np.ndarray | None:
        """Return the matrix from the samples of transforms to those behind, by sinc functions in a Kaiser window."""
        if self.between == 1:
            return None
        away = (np.arange(self.counts) - self.counts // 2)[:, None] / self.between - self.coarse()
        window = np.i0(_KAISER * np.sqrt(np.clip(1 - (away / _TAPS) ** 2, 0, None))) / np.i0(_KAISER)
        return np.sinc(away) * np.where(abs(away) < _TAPS, window, 0.0)

    def finer(self, field: torch.Tensor, axis: int) -> torch.Tensor:
        """Return the band-limited interpolation of a field at half its pitch, if this is what the axis needs."""
        if not self.double:
            return field
        like = torch.zeros(1, 1, dtype=torch.float64, device=field.device)
        return between_samples(field, like, axis).narrow(axis, self.count // 2, self.count)

    def turns(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return cycles in front and behind that make a transform from the first samples one about the middle ones."""
        m, half = self.coarse(), self.block // 2
        x = np.arange(self.block) - half
        # As fractions of a period, which whole numbers are of.
        cycle = math.copysign(self.every / self.size, self.slope)
        before = -cycle * m[0] * (x + half) - self.slope * self.center * self.step * x
        return torch.from_numpy(before), torch.from_numpy(cycle * half * m)

    def transformed(self, field: torch.Tensor, axis: int) -> torch.Tensor:
        """Return the sum at the samples of transforms, but for :meth:`turns`."""
        options, counts = {"n": self.size, "dim": axis}, len(self.coarse())
        found = torch.fft.fft(field, **options) if self.slope > 0 else torch.fft.ifft(field, norm="forward", **options)
        places = torch.arange(counts, device=field.device)
        return found.index_select(axis, (places * self.every) % self.size)


def _fast_size(least: int, wanted: int) -> int:
    """Return the size nearest to the wanted one, but not below the least, whose prime factors are small."""
    wanted = max(least, wanted)
    around = (wanted + sign * step for step in itertools.count() for sign in (1, -1))
    return next(size for size in around if size >= least and _is_fast(size))


def _is_fast(n: int) -> bool:
    for factor in (2, 3, 5, 7, 11, 13):
        while n % factor == 0:
            n //= factor
    return n == 1


def _nodes(n: int) -> np.ndarray:
    """Return the Chebyshev points of −1 … 1, the middle one of which is 0."""
    nodes = np.cos((2 * np.arange(n) + 1) * np.pi / (2 * n))
    nodes[n // 2] = 0.0
    return nodes


def _coefficients(n: int) -> np.ndarray:
    """Return the matrix that makes coefficients of Chebyshev polynomials of values at their points."""
    found = np.polynomial.chebyshev.chebvander(_nodes(n), n - 1).T * (2 / n)
    found[0] /= 2
    return found


def _interpolation(places: np.ndarray, n: int) -> torch.Tensor:
    """Return the matrix ``[places, n]`` of the polynomials through values at the Chebyshev points."""
    held = np.clip(places, -1, 1)
    return torch.from_numpy(np.polynomial.chebyshev.chebvander(held, n - 1) @ _coefficients(n))


@torch.no_grad()
def _enough(cycles: torch.Tensor, axis: int) -> int:
    """Return the odd number of Chebyshev points along an axis that hold phasors of cycles at such points.

    A polynomial of degree m holds exp(iωx) where m exceeds ω by some ten.
    """
    n = cycles.shape[axis]
    steepest = torch.tensordot(_slopes(n).to(cycles), cycles.detach(), dims=([1], [axis])).abs().max()
    return max(2 * n + 3, 2 * math.ceil(math.pi * float(steepest)) + 11)


def _slopes(n: int) -> torch.Tensor:
    """Return the matrix of the derivatives at the Chebyshev points."""
    chebyshev = np.polynomial.chebyshev
    return torch.from_numpy(chebyshev.chebvander(_nodes(n), n - 2) @ chebyshev.chebder(_coefficients(n)))


def _spread(values: torch.Tensor, along: Sequence[torch.Tensor], axes: tuple[int, int] = (-2, -1)) -> torch.Tensor:
    """Return the polynomials through values at the places of a plane, whose axes are the last two or others."""
    return (along[0] @ values.movedim(axes, (-2, -1)) @ along[1].mT).movedim((-2, -1), axes)


def _products(rest: torch.Tensor, amplitude: torch.Tensor, tolerance: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return functions of points of the two planes, ``[K, n, n]``, whose products add up to amplitudes and phases.

    These, at finer Chebyshev points, are a matrix M; its singular vectors U and V are the shortest such sum. It is
    written as M·V·(Uᴴ·M·V)⁻¹·Uᴴ·M, whose derivatives miss only what is in the span of neither.
    """
    sizes = [_enough(rest, axis) for axis in range(4)]
    finer = [_interpolation(_nodes(m), n).to(rest.device) for m, n in zip(sizes, rest.shape, strict=True)]
    rest, amplitude = (_spread(_spread(part, finer[2:], (2, 3)), finer[:2], (0, 1)) for part in (rest, amplitude))
    whole = (phasor_of_cycles(rest, torch.complex128) * amplitude).reshape(sizes[0] * sizes[1], -1)
    # Chebyshev points lie close together at the edges: weights make areas count.
    near, far = (
        torch.from_numpy(np.sqrt(np.outer(*(1 - _nodes(n) ** 2 for n in pair))).reshape(-1)).to(whole).sqrt()
        for pair in (sizes[:2], sizes[2:])
    )
    balanced = near[:, None] * whole * far
    with torch.no_grad():
        power, vectors = torch.linalg.eigh(balanced @ balanced.mH)
        left = power.clamp_min(0).cumsum(0)
        used = vectors[:, left > tolerance**2 * left[-1]]
        others = balanced.mH @ used
        others = others / others.norm(dim=0)
    behind, before = used.mH @ balanced, balanced @ others
    before = torch.linalg.solve(behind @ others, before, left=False)
    return (before / near[:, None]).mT.unflatten(-1, sizes[:2]), (behind / far).unflatten(-1, sizes[2:])


@dataclass(frozen=True)
class _Block:
    """What a system does to the light of one block of samples: phases in either plane, and products of functions.

    Phases are in cycles, at Chebyshev points of the block and of the plane behind.
    """

    axes: Sequence[_Axis]
    which: Sequence[int]
    first: torch.Tensor
    second: torch.Tensor
    before: torch.Tensor
    behind: torch.Tensor

    def __call__(self, field: torch.Tensor) -> torch.Tensor:
        """Return the light behind the system, but for a factor, of the samples of the block."""
        dtype, axes = field.dtype, self.axes

        def lines(places, values):
            return [_interpolation(x, n).to(values) for x, n in zip(places, values.shape[-2:], strict=True)]

        turns = [[turn.to(field.device) for turn in axis.turns()] for axis in axes]
        near = [(np.arange(axis.block) - axis.block // 2) * 2 / axis.block for axis in axes]
        far = [(axis.coarse() * axis.between * axis.out + axis.center) / axis.far for axis in axes]
        (before_y, behind_y), (before_x, behind_x) = turns
        cycles = _spread(self.first, lines(near, self.first)) + before_y[:, None] + before_x
        field = field * phasor_of_cycles(cycles, dtype)
        before, behind = self.before.to(dtype), self.behind.to(dtype)
        before_at, behind_at = lines(near, before), lines(far, behind)
        total: Any = 0.0
        for one, other in zip(before, behind, strict=True):
            arrived = field * _spread(one, before_at)
            for axis, along in zip((-1, -2), axes[::-1], strict=True):
                arrived = along.transformed(arrived, axis)
            total = total + arrived * _spread(other, behind_at)
        total = total * phasor_of_cycles(behind_y[:, None] + behind_x, dtype)
        for dim, axis in zip((-1, -2), axes[::-1], strict=True):
            matrix = axis.interpolation()
            if matrix is not None:
                matrix = torch.from_numpy(matrix).to(total)
                total = total @ matrix.mT if dim == -1 else matrix @ total
        places = [axis.places() for axis in axes]
        down, across = (
            torch.from_numpy(-axis.slope * axis.middle_of(at) * there).to(field.device)
            for axis, at, there in zip(axes, self.which, places, strict=True)
        )
        there = lines([q / axis.far for q, axis in zip(places, axes, strict=True)], self.second)
        return total * phasor_of_cycles(_spread(self.second, there) + down[:, None] + across, dtype)


class _Characteristic:
    """The optical path from points of one plane to points of another, and the amplitude of its tube of rays.

    In wavelengths and relative to the kernel of the transform and to 1/B, at the Chebyshev points of both planes.
    """

    def __init__(self, element: TracedSystem, numbers: Prescription, axes: list[_Axis], wavelength: float, lens: tuple):
        self.element, self.numbers, self.axes = element, numbers, axes
        self.wavelength, self.lens, self.device = wavelength, lens, numbers.thickness.device
        grid, count = element.grid, (element.points,) * 2
        places, targets = self._at(map(_nodes, grid), "near"), self._at(map(_nodes, count), "far")
        self.path, v, u, losses = self._traced(places, targets)
        slope = [_slopes(n).to(self.device) / axis.far for n, axis in zip(count, axes, strict=True)]
        vy, uy = (slope[0] @ part for part in (v, u))
        vx, ux = (part @ slope[1].mT for part in (v, u))
        density = vy * ux - vx * uy
        if is_readable(density) and not bool((density * density.mean() > 0).all()):
            raise ValueError(_CROSSING)
        self.amplitude = density.abs().sqrt() * lens[0][1].abs() * losses
        self.error = self._checked()

    def _at(self, points, side: str) -> list[torch.Tensor]:
        """Return places along both axes of points of −1 … 1."""
        return [
            torch.as_tensor(one, dtype=torch.float64, device=self.device) * getattr(axis, side)
            for one, axis in zip(points, self.axes, strict=True)
        ]

    def block(self, *which: int) -> "_Block":
        """Return what the system does to the light of one block, of those along both axes."""
        lines = [
            _interpolation((axis.middle_of(at) + _nodes(n) * axis.block * axis.step / 2) / axis.near, n).to(self.device)
            for axis, at, n in zip(self.axes, which, self.element.grid, strict=True)
        ]
        path, amplitude = (_spread(values, lines, (0, 1)) for values in (self.path, self.amplitude))
        middle = [n // 2 for n in path.shape]
        first, second = path[:, :, middle[2], middle[3]], path[middle[0], middle[1]]
        first = first - first[middle[0], middle[1]]
        rest = path - first[:, :, None, None] - second
        # Derivatives of what a sum leaves out are several times larger than what it leaves out.
        tolerance = self.element.tolerance * (_FOR_DERIVATIVES if path.requires_grad else 1.0)
        before, behind = _products(rest, amplitude, tolerance)
        return _Block(self.axes, which, first, second, before, behind)

    def _traced(self, places, targets):
        """Return the path less the kernel, optical direction cosines in front, and amplitudes that are left."""
        system, numbers = self.element.system, self.numbers
        (y, x), (q, p) = torch.meshgrid(*places, indexing="ij"), torch.meshgrid(*targets, indexing="ij")
        shape = (*y.shape, *q.shape)
        (y, x), (q, p) = (one.reshape(1, -1, 1) for one in (y, x)), (one.reshape(1, 1, -1) for one in (q, p))
        a, b = self.lens[0]
        front, behind = numbers.index[0, 0], numbers.index[0, -1]

        def rays(u, v, starts):
            depth = -system.object_distance + 0 * u
            return Rays(*(value.expand_as(u) for value in starts.unbind(-1)), depth, u, v, (1 - u * u - v * v).sqrt())

        def missed(u, v, goals, starts):
            met = trace(system, rays(u, v, starts), prescription=numbers, vignetting=False)
            return met.x - goals[..., 0], met.y - goals[..., 1], met.arrived

        with torch.no_grad():
            u, v = ((to - a * at) / (b * front) for at, to in ((x, p), (y, q)))
        goals, starts = (torch.stack([value.expand_as(u) for value in pair], -1) for pair in ((p, q), (x, y)))
        sent = rays(*solve_pairs(missed, u, v, torch.full((), STEP).to(u), goals, starts), starts)
        met = trace(system, sent, prescription=numbers)
        if is_readable(met.status) and bool((met.status == RayStatus.VIGNETTED).any()):
            warn(
                "an aperture of the system blocks rays of the field, which are computed as if they passed: give "
                "surfaces a larger semi_diameter, or the field fewer or larger pixels",
                AccuracyWarning,
            )
            met = trace(system, sent, prescription=numbers, vignetting=False)
        if is_readable(met.status) and not bool(met.arrived.all()):
            raise ValueError(_CROSSING)
        # To the points themselves: by Fermat's principle what is left of the search does not count otherwise.
        path = (met.path + behind * ((p - met.x) * met.u + (q - met.y) * met.v)) / self.wavelength
        path = path + x * p * self.axes[1].slope + y * q * self.axes[0].slope
        losses = torch.ones_like(path)
        if self.element.polarization is not None:
            through = polarized_trace(system, sent, prescription=numbers, vignetting=False)
            losses = through.throughput(self.element.polarization).clamp_min(1e-24).sqrt()
        return (one.reshape(shape) for one in (path, sent.v * front, sent.u * front, losses))

    @torch.no_grad()
    def _checked(self) -> float:
        """Return how much traced paths between the nodes of the polynomials differ from these; warn if that is much."""
        if not is_readable(self.path) or self.path.requires_grad:
            return 0.0
        between = [np.array([(t[0] + t[1]) / 2]) for t in map(_nodes, self.element.grid)]
        inside = [np.array([-0.85, 0.65])] * 2
        wanted, *_ = self._traced(self._at(between, "near"), self._at(inside, "far"))
        near, far = (
            [_interpolation(t, n).to(self.device) for t, n in zip(points, sizes, strict=True)]
            for points, sizes in ((between, self.element.grid), (inside, (self.element.points,) * 2))
        )
        found = _spread(_spread(self.path, far), near, (0, 1))[0, 0]
        error = float((found - wanted[0, 0]).abs().max())
        if error > LARGE:
            warn(
                f"paths between the rays are known to {error:.2g} wavelengths only: give TracedSystem a grid of more "
                f"than {self.element.grid} points, or more than {self.element.points} rays along each axis",
                AccuracyWarning,
            )
        return error
