"""Media of graded refractive index, and rays through them by an adaptive Runge–Kutta method."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

from odak import _validate
from odak._array import Amount, Array, Numbers, broadcast, is_readable, is_torch, namespace
from odak.raytracing import components as vec
from odak.raytracing.batches import needs_gradient
from odak.raytracing.geometry import epsilon
from odak.raytracing.surfaces import Parametric, polynomial_in

# Largest relative error of a step; steps tried before a ray is given up.
TOLERANCE, STEPS = 1e-12, 400


@dataclass(frozen=True)
class Gradient(Parametric):
    """Base class of graded-index media.

    A gradient is a frozen dataclass whose fields are its parameters. It must define :meth:`index`, or :meth:`squared`
    where the derivatives are at hand. Coordinates refer to the vertex behind which the medium lies, z along the axis.
    The class variable ``ranks`` has the meaning of ``ranks`` in :class:`odak.raytracing.Shape`.
    """

    def index(self, x: Array, y: Array, z: Array, base: Any) -> Any:
        """Return the index at points; `base` is the index of the surface's material at the wavelength of the ray."""
        return self.squared(x, y, z, base)[0] ** 0.5

    def squared(self, x: Array, y: Array, z: Array, base: Any) -> tuple[Any, ...]:
        """Return the square of the index and its derivatives by x, y and z; by default from :meth:`index`, in torch."""
        if type(self).index is Gradient.index:
            raise NotImplementedError(f"{type(self).__name__} must define index(x, y, z, base) or squared")
        if not is_torch(x):
            raise TypeError(f"{type(self).__name__} must define squared(x, y, z, base) for arrays other than tensors")
        import torch

        graph = torch.is_grad_enabled() and needs_gradient(x, y, z, base, *self.parameters())
        with torch.enable_grad():
            place = [value.view_as(value) if graph else value.detach() for value in torch.broadcast_tensors(x, y, z)]
            place = [value if value.requires_grad else value.requires_grad_() for value in place]
            value = self.index(place[0], place[1], place[2], base) ** 2
            slopes = torch.autograd.grad(value.sum(), place, create_graph=graph, allow_unused=True)
        slopes = tuple(torch.zeros_like(value) if slope is None else slope for slope in slopes)
        return (value if graph else value.detach()), *slopes

    def expansion(self, z: Array, base: Any) -> tuple[Any, ...]:
        """Return N, A and B of n² = N + A·r² + B·r⁴ + … about the axis at a depth, and the derivative of N.

        Parameters
        ----------
        z : array
            Depth behind the vertex.
        base : array
            Index of the material.
        """
        raise NotImplementedError(f"{type(self).__name__} must define expansion(z, base) for third-order aberrations")

    def paraxial(self, base: Any, thickness: Any) -> tuple[Any, ...]:
        """Return the elements a, b, c, d of the ABCD matrix on (y, n·u) in the y–z plane, and the indices at both ends.

        Parameters
        ----------
        base, thickness : array
            Index of the material, and length along the axis.

        Notes
        -----
        dy/dz = p/n, dp/dz = y·∂²n/∂y² on the axis, in 32 steps of order 8.
        """
        xp = namespace(base, thickness)
        zero = 0 * (base + thickness)

        def field(state):
            near = 1e-4 * thickness + zero
            z = state[4]
            above, below = (self.squared(zero, side * near, z, base) for side in (1, -1))
            index = self.squared(zero, zero, z, base)[0] ** 0.5
            bend = (above[2] - below[2]) / (4 * near * index)
            return xp.stack([state[2] / index, state[3] / index, bend * state[0], bend * state[1], 1 + zero])

        state = xp.stack([1 + zero, zero, zero, 1 + zero, zero])
        for _ in range(32):
            state, _ = step(field, state, thickness / 32)
        ends = [self.squared(zero, zero, z, base)[0] ** 0.5 for z in (zero, thickness + zero)]
        return state[0], state[1], state[2], state[3], ends


@dataclass(frozen=True)
class RadialGradient(Gradient):
    """A medium whose index depends on the distance r from the axis: n² = n0²·(1 + a1·r² + a2·r⁴ + …).

    Parameters
    ----------
    coefficients : sequence or array
        a1, a2, …; a1 = −g² for a rod of pitch 2π/g.

    Notes
    -----
    For a1 alone all rays are harmonic in the parameter t of dr = n·s·dt: Luneburg, Mathematical Theory of Optics
    (1964), section 28.
    """

    coefficients: Numbers = ()

    def squared(self, x: Array, y: Array, z: Array, base: Any) -> tuple[Any, ...]:
        """Return the square of the index and its derivatives."""
        value, slope = polynomial_in(x * x + y * y, self.coefficients)
        scale = base * base
        return scale * (1 + value) + 0 * z, 2 * scale * slope * x, 2 * scale * slope * y, 0 * (x + z)

    def expansion(self, z: Array, base: Any) -> tuple[Any, ...]:
        """Return the coefficients of 1, r² and r⁴ of the square of the index; none changes with the depth."""
        scale = base * base + 0 * z
        first, second = (*vec.terms(self.coefficients)[:2], 0.0, 0.0)[:2]
        return scale, scale * first, scale * second, 0 * scale


@dataclass(frozen=True)
class AxialGradient(Gradient):
    """A medium whose index is a polynomial of the depth behind the vertex, n = n0 + a1·z + a2·z² and so on.

    Parameters
    ----------
    coefficients : sequence or array
        a1, a2, …
    """

    coefficients: Numbers = ()

    def squared(self, x: Array, y: Array, z: Array, base: Any) -> tuple[Any, ...]:
        """Return the square of the index and its derivatives."""
        value, slope = polynomial_in(z, self.coefficients)
        index, zero = base + value, 0 * (x + y + z)
        return index * index + zero, zero, zero, 2 * index * slope + zero

    def expansion(self, z: Array, base: Any) -> tuple[Any, ...]:
        """Return the square of the index on the axis, zeros for the coefficients of r² and r⁴, and its derivative."""
        value, slope = polynomial_in(z, self.coefficients)
        index = base + value
        return index * index, 0 * index, 0 * index, 2 * index * slope


@dataclass(frozen=True)
class FunctionGradient(Gradient):
    """A medium whose index is a user-defined function; see :meth:`of`.

    Parameters
    ----------
    parameters_of_function : sequence or array
        Numbers that the function takes, which may be varied.
    """

    parameters_of_function: Numbers = ()
    ranks: ClassVar[Mapping[str, int]] = {"parameters_of_function": 1}
    function: ClassVar[Any] = None

    @classmethod
    def of(cls, function: Callable[..., Any], parameters: Any = ()) -> "FunctionGradient":
        """Return a medium made of a function.

        Parameters
        ----------
        function : callable
            Takes x, y, z and the base index as tensors, then the parameters; returns the index. Its derivatives are
            computed by autograd.
        parameters : sequence or array
            Numbers for the function.

        Returns
        -------
        FunctionGradient
            An instance of a class made for the function; it cannot be written to a file.
        """
        _validate.function("function", function)
        kind: Any = type(cls.__name__, (cls,), {"function": staticmethod(function)})
        return kind(parameters)

    def index(self, x: Array, y: Array, z: Array, base: Any) -> Any:
        """Return the index computed by the function."""
        return type(self).function(x, y, z, base, *vec.terms(self.parameters_of_function))


class Path(NamedTuple):
    """A ray at the end of its path through a graded-index medium.

    Attributes
    ----------
    state : array
        Point, direction times index, and optical path, ``[7, ...]``.
    time : array
        Parameter t, dt = ds/n, from the start to the end, ``[...]``.
    arrived : array
        Whether the end was reached, bool.
    steps : int
        Number of steps that were tried.
    """

    state: Any
    time: Any
    arrived: Any
    steps: int


def ray_equation(gradient: Gradient, base: Amount) -> Callable[..., Any]:
    """Return the derivative of states ``[7, ...]`` by t: dr/dt = T, dT/dt = ½∇n², dL/dt = n².

    Sharma, Kumar and Ghatak, Appl. Opt. 21, 984 (1982).
    """

    def field(state):
        xp = namespace(state)
        value, *slopes = gradient.squared(state[0], state[1], state[2], base)
        return xp.stack(list(broadcast(state[3], state[4], state[5], *(slope / 2 for slope in slopes), value)))

    return field


@cache
def tableau() -> Any:
    """Return the coefficients of Dormand and Prince's method of order 8: A, B, E3 and E5 in the notation of SciPy."""
    from scipy.integrate import DOP853

    return DOP853


def step(field: Callable[..., Any], state: Any, length: Any) -> Any:
    """Return states after a step of Dormand and Prince's method of order 8, the derivatives at its stages ``[12, …]``.

    Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I (1993), section II.5.
    """
    stages = [field(state)]
    for row in range(1, 12):
        stages.append(field(stage(state, length, stages, row)))
    return state + length * _combined(tableau().B, stages), stages


def stage(state: Array, length: Array | float, stages: Sequence[Array], row: int) -> Array:
    """Return states at a stage of a step, from the derivatives at those before."""
    return state + length * _combined(tableau().A[row, :row], stages[:row])


def _combined(weights, stages):
    """Return the weighted sum of derivatives, weights that are zero left out."""
    total: Any = 0.0
    for weight, stage in zip(weights, stages, strict=True):
        if weight:
            total = total + float(weight) * stage
    return total


def _error(stages, length, scale):
    """Return the error of a step in units of the tolerance."""
    fifth, third = _combined(tableau().E5, stages) / scale, _combined(tableau().E3, stages) / scale
    fifth, third = (fifth * fifth).sum(0), (third * third).sum(0)
    xp, count = namespace(fifth), stages[0].shape[0]
    whole = (fifth + 0.01 * third) * count
    return abs(length) * xp.where(whole > 0, fifth / xp.where(whole > 0, whole, 1.0) ** 0.5, 0.0)


def integrate(field: Callable, state: Any, scale: Any, remaining: Callable) -> Path:
    """Integrate states to the end of their paths, with steps of adaptive length for each ray.

    Parameters
    ----------
    field : callable
        Derivative of states.
    state : array
        ``[k, ...]``.
    scale : array
        Magnitude of the components, ``[k, ...]``, relative to which errors are measured.
    remaining : callable
        Takes states and t; returns an estimate of the interval of t that remains, and whether the end is reached.
        An estimate of NaN stops the ray.

    Returns
    -------
    Path
        States and t at the end of the path.
    """
    xp = namespace(state)
    time = 0 * state[0]
    rest, done = remaining(state, time)
    largest, scale = abs(rest), scale * TOLERANCE
    largest = xp.where(xp.isfinite(largest), largest, 1.0)
    hidden = is_torch(state) and not is_readable(done) and not state.is_cuda
    count = 0
    for count in range(1, (STEPS if not hidden else 96) + 1):
        length = xp.where(abs(rest) <= largest, rest, xp.copysign(largest, rest))
        length = xp.where(done | ~xp.isfinite(length), 0.0, length)
        found, stages = step(field, state, length)
        error = _error([*stages, field(found)], length, scale)
        good = ~done & (error <= 1)
        state = xp.where(good, found, state)
        time = xp.where(good, time + length, time)
        usable = xp.isfinite(error)
        power = xp.where(usable, xp.clip(xp.where(usable, error, 1.0), 1e-12, 1e12), 1e12) ** -0.125
        factor = xp.clip(0.9 * power, 0.2, 5.0)
        # A step shortened by the end of the path must not reduce the length of later ones.
        grown = abs(length) * factor
        largest = xp.where(good & (grown < largest) & (factor >= 1), largest, xp.where(done, largest, grown))
        rest, done = remaining(state, time)
        if not hidden and (count % 4 == 0 or is_readable(done)) and bool(xp.all(done | xp.isnan(rest))):
            break
    return Path(state, time, done, count)


def to_surface(gradient: Gradient, base: Amount, state: Array, level: Callable[..., Any], sign: int) -> Path:
    """Integrate rays until they intersect a surface.

    Parameters
    ----------
    gradient : Gradient
        The medium.
    base : array or float
        Index of its material.
    state : array
        Points, directions times index, optical paths, ``[7, ...]``.
    level : callable
        Takes points and directions as tuples of components; returns the distance z − sag from the surface along its
        axis, its derivative along the direction, and a length relative to which its rounding error is measured.
    sign : int
        Sign of that derivative where rays arrive.

    Returns
    -------
    Path
        Rays on the surface; anywhere else those that do not arrive.
    """
    xp = namespace(state)

    def remaining(state, time):
        error, slope, size = level(tuple(state[:3]), tuple(state[3:6]))
        forward = slope * sign > 0
        # Rays that run along the surface or away from it are followed until their direction reverses.
        rest = xp.where(forward, -error / xp.where(forward, slope, 1.0), xp.inf)
        away = vec.dot(tuple(state[:3]), tuple(state[:3])) > limit
        rest = xp.where(away, xp.nan, rest)
        return rest, ~away & forward & (abs(error) <= 16 * epsilon(error) * size)

    limit, n = xp.inf, vec.dot(tuple(state[3:6]), tuple(state[3:6])) ** 0.5
    far = abs(remaining(state, 0 * state[0])[0]) * n
    far = xp.where(xp.isfinite(far), far, 1.0) + vec.dot(tuple(state[:3]), tuple(state[:3])) ** 0.5
    # A ray this far away has reversed its direction, and does not return.
    limit = (100 * far) ** 2
    scale = xp.stack([far, far, far, n, n, n, n * far])
    return integrate(ray_equation(gradient, base), state, scale + 1e-300, remaining)
