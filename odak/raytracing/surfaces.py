"""Shapes of surfaces z = sag(x, y) with their vertex at the origin, and intersections of rays with them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from odak import _validate
from odak._array import Amount, Array, ArrayT, Numbers, cast, device_of, is_array, is_readable, is_torch, namespace
from odak.raytracing import arguments, intersections
from odak.raytracing import components as vec
from odak.raytracing.batches import CHUNK, in_pieces
from odak.raytracing.components import terms
from odak.raytracing.geometry import epsilon
from odak.raytracing.intersections import Hit, RayStatus, as_hit, conic_status, status_array
from odak.tools.transformation import apply_matrix, rotation_matrix
from odak.tools.zernike import jacobi, noll_to_nm, zernike_norm

# Rays at which it no longer pays to set the ones aside that are done.
FEW = 256


class Sag(NamedTuple):
    """Height of a surface and its first derivatives.

    Attributes
    ----------
    height : array
        z, ``[...]``; 0 where not defined.
    slope_x, slope_y : array
        ∂z/∂x and ∂z/∂y.
    defined : array
        Where the surface exists, bool.
    """

    height: Any
    slope_x: Any
    slope_y: Any
    defined: Any


@dataclass(frozen=True)
class Parametric:
    """Base class of shapes, phases and media: frozen dataclasses whose fields are their parameters.

    Attributes
    ----------
    ranks : mapping
        Number of axes of a parameter that belong to one surface, 0 unless given.
    fixed : tuple of str
        Fields that are no numbers to vary.
    """

    ranks: ClassVar[Mapping[str, int]] = {"coefficients": 1}
    fixed: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def ranks_of_parameters(cls) -> tuple[int, ...]:
        """Return how many axes of each parameter do not belong to a batch."""
        return tuple(cls.ranks.get(field.name, 0) for field in fields(cls))

    def parameters(self) -> tuple[Any, ...]:
        """Return the parameters in the order of the constructor."""
        return tuple(getattr(self, field.name) for field in fields(self))


@dataclass(frozen=True)
class Shape(Parametric):
    """Base class of the shapes of surfaces.

    A shape is a frozen dataclass whose fields are its parameters: numbers, or arrays that broadcast against x and y. It
    must define :meth:`sag`. Intersections, apertures, placement, optical systems, files, drawings and gradients are
    derived from it. A method ``scaled(factor)``, if it has one, returns it with all its lengths multiplied, by which it
    expands with temperature.

    Notes
    -----
    Two class variables may be set: ``closed_form``, True if the surface is the conic of :meth:`base` itself, and
    ``ranks``, the number of trailing axes of each parameter that belong to one surface (0 by default). The axes in
    front of them are batch axes.

    Examples
    --------
    A paraboloid z = r²/(2R) as a user-defined shape:

    >>> from dataclasses import dataclass
    >>> from odak.raytracing import Shape, intersect_w_sag
    >>> from odak.raytracing.surfaces import Sag
    >>> @dataclass(frozen=True)
    ... class Paraboloid(Shape):
    ...     radius: float = 1.0
    ...
    ...     def sag(self, x, y):
    ...         height = (x * x + y * y) / (2 * self.radius)
    ...         return Sag(height, x / self.radius, y / self.radius, height >= 0)
    >>> float(intersect_w_sag([[0, 2, -10], [0, 0, 1]], Paraboloid(4.0)).distance)
    10.5
    """

    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        raise NotImplementedError(f"{type(self).__name__} must define sag(x, y)")

    def base(self) -> tuple[Any, ...]:
        """Return curvature and conic constant of an approximating conic, the initial guess of iterations."""
        return 0.0, 0.0

    def curvatures(self) -> tuple[Any, ...]:
        """Return the curvatures at the vertex along x and along y, for first-order properties."""
        curvature, _ = self.base()
        return curvature, curvature

    def covers(self, x: Array, y: Array) -> bool | Array:
        """Return where the surface is defined, as a bool array; True if that is everywhere.

        Parameters
        ----------
        x : array
            Horizontal position on the surface, in the unit of the surface.
        y : array
            Vertical position, of a shape that broadcasts with `x`.
        """
        return True


@dataclass(frozen=True)
class Plane(Shape):
    """The plane z = 0.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.raytracing import Plane
    >>> sag = Plane().sag(np.asarray([1.0]), np.asarray([2.0]))
    >>> round(float(sag.height[0]), 6)
    0.0
    """

    closed_form: ClassVar[bool] = True

    def sag(self, x: Array, y: Array) -> Sag:
        """Return the height and the derivatives of a plane, all zero.

        Parameters
        ----------
        x : array
            Horizontal position on the surface, in the unit of the surface.
        y : array
            Vertical position, of a shape that broadcasts with `x`.
        """
        zero = 0 * (x + y)
        return Sag(zero, zero, zero, zero == 0)


@dataclass(frozen=True)
class Conic(Shape):
    """A conic of revolution.

    Parameters
    ----------
    curvature : float or array
        1/radius at the vertex; positive when the centre lies at +z, 0 for a plane.
    conic : float or array
        Conic constant: 0 sphere, −1 paraboloid, below −1 hyperboloid.

    Examples
    --------
    A sphere of radius 5 has the height 5 − √(25 − 9) at a distance 3 from the axis:

    >>> import numpy as np
    >>> from odak.raytracing import Conic
    >>> sag = Conic(curvature=1 / 5).sag(np.asarray([3.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    1.0
    """

    curvature: float | Array = 0.0
    conic: float | Array = 0.0
    closed_form: ClassVar[bool] = True

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y; see :func:`conic_sag`."""
        return conic_sag(x, y, self.curvature, self.conic)

    def base(self) -> tuple[Any, ...]:
        """Return curvature and conic constant."""
        return self.curvature, self.conic


@dataclass(frozen=True)
class EvenAsphere(Conic):
    """A conic plus even powers of the distance r from the axis, a1·r² + a2·r⁴ and so on.

    Parameters
    ----------
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.
    coefficients : sequence or array
        a1, a2, … along the last axis.

    Examples
    --------
    A plane plus 0.1·r² + 0.01·r⁴, at r = 2:

    >>> import numpy as np
    >>> from odak.raytracing import EvenAsphere
    >>> sag = EvenAsphere(coefficients=[0.1, 0.01]).sag(np.asarray([2.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    0.56
    """

    coefficients: Numbers = ()
    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y; see :func:`even_asphere_sag`."""
        return even_asphere_sag(x, y, self.curvature, self.conic, self.coefficients)

    def curvatures(self) -> tuple[Any, ...]:
        """Return c + 2·a1 twice."""
        given = terms(self.coefficients)
        curvature = self.curvature + 2 * given[0] if given else self.curvature
        return curvature, curvature


@dataclass(frozen=True)
class ZernikeFreeform(Conic):
    """A conic plus Zernike polynomials.

    Parameters
    ----------
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.
    coefficients : sequence or array
        Amplitudes in Noll's order from j = 1, each the polynomial's RMS over the disc.
    radius : float or array
        Radius of the disc.

    Examples
    --------
    Defocus, Noll's fourth polynomial, is √3·(2ρ² − 1): its value at the rim is √3.

    >>> import numpy as np
    >>> from odak.raytracing import ZernikeFreeform
    >>> sag = ZernikeFreeform(coefficients=[0, 0, 0, 1.0], radius=10.0).sag(np.asarray([10.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    1.732051
    """

    coefficients: Numbers = ()
    radius: float | Array = 1.0
    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y; see :func:`zernike_sag`."""
        return zernike_sag(x, y, self.curvature, self.conic, self.coefficients, self.radius)

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives at the vertex."""
        return _curvatures_by_differences(self, self.radius)


@dataclass(frozen=True)
class Toroid(Shape):
    """A profile in y rotated about an axis parallel to y.

    Parameters
    ----------
    curvature_x : float or array
        Curvature at the vertex along x, given by the rotation; 0 for a cylinder.
    curvature_y : float or array
        Curvature at the vertex along y, given by the profile.
    conic : float or array
        Conic constant of the profile.
    coefficients : sequence or array
        a1, a2, … of a1·y² + a2·y⁴ + …, added to the profile.

    Examples
    --------
    A cylinder of radius 5 along x has the height 5 − √(25 − 9) at x = 3, for any y:

    >>> import numpy as np
    >>> from odak.raytracing import Toroid
    >>> sag = Toroid(curvature_x=1 / 5).sag(np.asarray([3.0]), np.asarray([7.0]))
    >>> round(float(sag.height[0]), 6)
    1.0
    """

    curvature_x: float | Array = 0.0
    curvature_y: float | Array = 0.0
    conic: float | Array = 0.0
    coefficients: Numbers = ()

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        xp, bend = namespace(x, y), self.curvature_x
        profile = even_asphere_sag(0 * x, y, self.curvature_y, self.conic, self.coefficients)
        arm = 1 - bend * profile.height
        inside = arm * arm - (bend * x) ** 2
        defined = profile.defined & (inside > 0) & (arm > 0)
        root = xp.where(defined, inside, 1.0) ** 0.5
        # (1 − root)/c_x in a form that holds for c_x = 0.
        rise = 2 * profile.height - bend * (profile.height * profile.height - x * x)
        height = xp.where(defined, rise / (1 + root), 0.0)
        slope_y = arm * profile.slope_y / root
        return Sag(height, xp.where(defined, bend * x / root, 0.0), xp.where(defined, slope_y, 0.0), defined)

    def base(self) -> tuple[Any, ...]:
        """Return the mean curvature and the constant of a sphere."""
        return (self.curvature_x + self.curvature_y) / 2, 0.0

    def curvatures(self) -> tuple[Any, ...]:
        """Return both curvatures, that along y with 2·a1 added."""
        given = terms(self.coefficients)
        return self.curvature_x, self.curvature_y + 2 * given[0] if given else self.curvature_y


@dataclass(frozen=True)
class SplineFreeform(Shape):
    """A conic plus a uniform cubic B-spline.

    Parameters
    ----------
    heights : array
        Control points ``[n0, n1]``, at least 2 along each axis; the first axis is x. See :meth:`through`.
    size : sequence or array
        Extents along x and y, outside which the surface is undefined.
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.

    Notes
    -----
    The control points of the boundary are repeated outside it. de Boor, A Practical Guide to Splines (1978), chapter
    IX.

    Examples
    --------
    The spline through the heights of a plane z = x/10 is that plane:

    >>> import numpy as np
    >>> from odak.raytracing import SplineFreeform
    >>> x = np.linspace(-2, 2, 9)
    >>> spline = SplineFreeform.through(0.1 * x[:, None] * np.ones((9, 9)), [4.0, 4.0])
    >>> sag = spline.sag(np.asarray([0.5]), np.asarray([0.25]))
    >>> round(float(sag.height[0]), 4)
    0.05
    """

    heights: Sequence[Numbers] | Array
    size: Numbers
    curvature: float | Array = 0.0
    conic: float | Array = 0.0
    ranks: ClassVar[Mapping[str, int]] = {"heights": 2, "size": 1}

    @classmethod
    def through(
        cls, heights: Array, size: Sequence[float], curvature: float = 0.0, conic: float = 0.0
    ) -> "SplineFreeform":
        """Return the spline that passes through measured heights: a grid sag.

        Parameters
        ----------
        heights : array
            ``[n0, n1]``, at x and y from −size/2 to size/2, first axis x.
        size : sequence of float
            Extents along x and y.
        curvature, conic : float
            Of a conic that is added.

        Returns
        -------
        SplineFreeform
            The control points are the solution of two tridiagonal systems, computed with NumPy.
        """
        values = _validate.image("heights", np.asarray(*_validate.reals(heights=heights)))
        for axis in (0, 1):
            n = values.shape[axis]
            matrix = (4 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)) / 6
            # The control points of the boundary are repeated outside it.
            matrix[0, 0] += 1 / 6
            matrix[-1, -1] += 1 / 6
            values = np.moveaxis(np.linalg.solve(matrix, np.moveaxis(values, axis, 0)), 0, axis)
        return cls(values, [float(v) for v in _validate.several("size", size, 2)], curvature, conic)

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        xp: Any = namespace(x, y)
        heights: Any = self.heights
        base = conic_sag(x, y, self.curvature, self.conic)
        n0, n1 = heights.shape[-2:]
        (i, weight_x, slope_x), (j, weight_y, slope_y) = (
            _spline_weights(value, extent, n)
            for value, extent, n in zip((x, y), terms(self.size), (n0, n1), strict=True)
        )
        take = grid_reader(heights, x)
        value = along_x = along_y = 0.0 * x
        for a in range(4):
            for b in range(4):
                index = xp.clip(i + (a - 1), 0, n0 - 1) * n1 + xp.clip(j + (b - 1), 0, n1 - 1)
                control = take(index)
                value = value + control * weight_x[a] * weight_y[b]
                along_x = along_x + control * slope_x[a] * weight_y[b]
                along_y = along_y + control * weight_x[a] * slope_y[b]
        return Sag(base.height + value, base.slope_x + along_x, base.slope_y + along_y, base.defined)

    def base(self) -> tuple[Any, ...]:
        """Return curvature and conic constant."""
        return self.curvature, self.conic

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives at the vertex."""
        return _curvatures_by_differences(self, terms(self.size)[0])

    def covers(self, x: Array, y: Array) -> bool | Array:
        """Return whether x, y lie within the extents."""
        width, height = terms(self.size)
        return (abs(x) <= width / 2) & (abs(y) <= height / 2)


@dataclass(frozen=True)
class OddAsphere(Conic):
    """A conic plus all powers of the distance r from the axis, a1·r + a2·r² + a3·r³ and so on.

    Parameters
    ----------
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.
    coefficients : sequence or array
        a1, a2, … along the last axis. A nonzero a1 gives a conical apex, where the normal is undefined.

    Examples
    --------
    A plane plus 0.1·r + 0.01·r², at r = 2:

    >>> import numpy as np
    >>> from odak.raytracing import OddAsphere
    >>> sag = OddAsphere(coefficients=[0.1, 0.01]).sag(np.asarray([2.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    0.24
    """

    coefficients: Numbers = ()
    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        base = conic_sag(x, y, self.curvature, self.conic)
        xp, squared = namespace(x, y), x * x + y * y
        radius = xp.where(squared > 0, xp.where(squared > 0, squared, 1.0) ** 0.5, 0.0)
        value, derivative = polynomial_in(radius, self.coefficients)
        slope = derivative / xp.where(squared > 0, radius, 1.0)
        return Sag(base.height + value, base.slope_x + slope * x, base.slope_y + slope * y, base.defined)

    def curvatures(self) -> tuple[Any, ...]:
        """Return c + 2·a2 twice."""
        given = terms(self.coefficients)
        curvature = self.curvature + 2 * given[1] if len(given) > 1 else self.curvature
        return curvature, curvature

    def scaled(self, factor: float) -> "OddAsphere":
        """Return the surface with all its lengths multiplied by a positive factor.

        Parameters
        ----------
        factor : float or array
            Of r^n, the coefficient is multiplied by factor^(1 − n).
        """
        grown = [value / factor**n for n, value in enumerate(terms(self.coefficients))]
        xp = namespace(*grown, self.curvature)
        made = xp.stack(grown, -1) if grown and is_array(grown[0]) else tuple(grown)
        return type(self)(self.curvature / factor, self.conic, made)


@dataclass(frozen=True)
class Biconic(Shape):
    """A surface whose sections along x and y are two different conics.

    Parameters
    ----------
    curvature_x : float or array
        Curvature at the vertex along x.
    curvature_y : float or array
        Curvature at the vertex along y.
    conic_x : float or array
        Conic constant of the section along x.
    conic_y : float or array
        Conic constant of the section along y.

    Notes
    -----
    z = (c_x x² + c_y y²)/(1 + √(1 − (1 + k_x)c_x²x² − (1 + k_y)c_y²y²)).

    Examples
    --------
    A cylinder of radius 5 along x has the height 5 − √(25 − 9) at x = 3, for any y:

    >>> import numpy as np
    >>> from odak.raytracing import Biconic
    >>> sag = Biconic(curvature_x=1 / 5).sag(np.asarray([3.0]), np.asarray([7.0]))
    >>> round(float(sag.height[0]), 6)
    1.0
    """

    curvature_x: float | Array = 0.0
    curvature_y: float | Array = 0.0
    conic_x: float | Array = 0.0
    conic_y: float | Array = 0.0

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        xp = namespace(x, y)
        cx, cy = self.curvature_x, self.curvature_y
        bend_x, bend_y = (1 + self.conic_x) * cx * cx, (1 + self.conic_y) * cy * cy
        inside = 1 - bend_x * x * x - bend_y * y * y
        defined = inside > 0
        root = xp.where(defined, inside, 1.0) ** 0.5
        top, bottom = cx * x * x + cy * y * y, 1 + root
        rise = top / (bottom * bottom * root)
        slopes = (2 * cx * x / bottom + rise * bend_x * x, 2 * cy * y / bottom + rise * bend_y * y)
        height, by_x, by_y = (xp.where(defined, value, 0.0) for value in (top / bottom, *slopes))
        return Sag(height, by_x, by_y, defined)

    def base(self) -> tuple[Any, ...]:
        """Return the mean curvature and the constant of a sphere."""
        return (self.curvature_x + self.curvature_y) / 2, 0.0

    def curvatures(self) -> tuple[Any, ...]:
        """Return both curvatures."""
        return self.curvature_x, self.curvature_y


@dataclass(frozen=True)
class PolynomialFreeform(Conic):
    """A conic plus a polynomial in x and y, Σ a_j·(x/R)^p·(y/R)^q.

    Parameters
    ----------
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.
    coefficients : sequence or array
        In units of length, in the order x, y, x², xy, y², x³, …
    radius : float or array
        R.

    Examples
    --------
    A plane plus 0.3·(x/R)·(y/R), at x = R and y = 2R:

    >>> import numpy as np
    >>> from odak.raytracing import PolynomialFreeform
    >>> sag = PolynomialFreeform(coefficients=[0, 0, 0, 0.3], radius=10.0).sag(np.asarray([10.0]), np.asarray([20.0]))
    >>> round(float(sag.height[0]), 6)
    0.6
    """

    coefficients: Numbers = ()
    radius: float | Array = 1.0
    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        base = conic_sag(x, y, self.curvature, self.conic)
        value, along_x, along_y = xy_polynomial(x / self.radius, y / self.radius, self.coefficients)
        slopes = base.slope_x + along_x / self.radius, base.slope_y + along_y / self.radius
        return Sag(base.height + value, *slopes, base.defined)

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives at the vertex."""
        found = terms(self.coefficients)
        scale = 2 / (self.radius * self.radius)
        along_x = self.curvature + (scale * found[2] if len(found) > 2 else 0.0)
        return along_x, self.curvature + (scale * found[4] if len(found) > 4 else 0.0)


@dataclass(frozen=True)
class ChebyshevFreeform(Conic):
    """A conic plus products of Chebyshev polynomials, Σ a_ij·T_i(x/A)·T_j(y/B).

    Parameters
    ----------
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.
    coefficients : array
        ``[n0, n1]``, the first axis i.
    size : sequence or array
        A and B, half the extents along x and y, outside which the surface is undefined.

    Examples
    --------
    T_2(u) = 2u² − 1 is −1 in the middle and 1 at the rim:

    >>> import numpy as np
    >>> from odak.raytracing import ChebyshevFreeform
    >>> surface = ChebyshevFreeform(coefficients=[[0.0], [0.0], [0.5]], size=[4.0, 4.0])
    >>> sag = surface.sag(np.asarray([4.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    0.5
    """

    coefficients: Sequence[Numbers] | Array = ((0.0,),)
    size: Numbers = (1.0, 1.0)
    closed_form: ClassVar[bool] = False
    ranks: ClassVar[Mapping[str, int]] = {"coefficients": 2, "size": 1}

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        base = conic_sag(x, y, self.curvature, self.conic)
        width, height = terms(self.size)
        rows = [terms(row) for row in self._rows()]
        tx, dx = _chebyshev(x / width, len(rows))
        ty, dy = _chebyshev(y / height, len(rows[0]))
        value = along_x = along_y = 0.0 * (x + y)
        for i, row in enumerate(rows):
            for j, coefficient in enumerate(row):
                value = value + coefficient * tx[i] * ty[j]
                along_x = along_x + coefficient * dx[i] * ty[j] / width
                along_y = along_y + coefficient * tx[i] * dy[j] / height
        return Sag(base.height + value, base.slope_x + along_x, base.slope_y + along_y, base.defined)

    def _rows(self) -> tuple[Any, ...]:
        given = self.coefficients
        return tuple(namespace(given).unstack(given, axis=-2)) if is_array(given) else tuple(given)

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives at the vertex."""
        return _curvatures_by_differences(self, terms(self.size)[0])

    def covers(self, x: Array, y: Array) -> bool | Array:
        """Return whether x, y lie within the extents."""
        width, height = terms(self.size)
        return (abs(x) <= width) & (abs(y) <= height)


def _chebyshev(u, count: int) -> tuple[list[Any], list[Any]]:
    """Return T_0 … T_(count − 1) and their derivatives."""
    values, slopes = [1 + 0 * u, u], [0 * u, 1 + 0 * u]
    for _ in range(2, count):
        slopes.append(2 * values[-1] + 2 * u * slopes[-1] - slopes[-2])
        values.append(2 * u * values[-1] - values[-2])
    return values[:count], slopes[:count]


@dataclass(frozen=True)
class QbfsAsphere(Shape):
    """A mild asphere by Forbes' polynomials of the departure from the best-fit sphere.

    Parameters
    ----------
    curvature : float or array
        Curvature of the sphere through the vertex and the rim.
    coefficients : sequence or array
        a_0, a_1, … in units of length; the mean square of the departure's slope along the normal is the sum of their
        squares over R².
    radius : float or array
        R, the semi-diameter at which the departure vanishes.

    Notes
    -----
    z = cr²/(1 + φ) + u²(1 − u²)/φ·Σ a_m·Q_m(u²), u = r/R, φ = √(1 − c²r²). Forbes, Opt. Express 15, 5218 (2007); the
    recurrence is from Opt. Express 18, 19700 (2010).

    Examples
    --------
    The departure from the best-fit sphere vanishes at the semi-diameter:

    >>> import numpy as np
    >>> from odak.raytracing import QbfsAsphere
    >>> sag = QbfsAsphere(curvature=1 / 5, coefficients=[0.1], radius=3.0).sag(np.asarray([3.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    1.0
    """

    curvature: float | Array = 0.0
    coefficients: Numbers = ()
    radius: float | Array = 1.0

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        base = conic_sag(x, y, self.curvature, 0.0)
        xp, scale = namespace(x, y), self.radius * self.radius
        v = (x * x + y * y) / scale
        inside = xp.where(base.defined, 1 - self.curvature * self.curvature * scale * v, 1.0)
        total, derivative = _qbfs(v, terms(self.coefficients))
        # Derivatives by v = u²: of v(1 − v), of 1/φ, and of the polynomial.
        window, inverse = v * (1 - v), inside**-0.5
        bent = self.curvature * self.curvature * scale / 2 * inverse / inside
        height = window * inverse * total
        slope = (1 - 2 * v) * inverse * total + window * (bent * total + inverse * derivative)
        slope = xp.where(base.defined, 2 * slope / scale, 0.0)
        height = base.height + xp.where(base.defined, height, 0.0)
        return Sag(height, base.slope_x + slope * x, base.slope_y + slope * y, base.defined)

    def base(self) -> tuple[Any, ...]:
        """Return the best-fit sphere."""
        return self.curvature, 0.0

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives at the vertex."""
        first = _qbfs(0.0 * self.radius, terms(self.coefficients))[0] if len(terms(self.coefficients)) else 0.0
        value = self.curvature + 2 * first / (self.radius * self.radius)
        return value, value


def _qbfs(v, coefficients) -> tuple[Any, ...]:
    """Return Σ a_m·Q_m(v) of Forbes' slope-orthogonal polynomials, and the derivative by v."""
    total = derivative = 0 * v
    p = [(2 + 0 * v, 0 * v), (6 - 8 * v, -8 + 0 * v)]
    f: list[float] = [2.0, 19**0.5 / 2]
    g: list[float] = [-0.5]
    h: list[float] = []
    q: list[Any] = []
    for m, coefficient in enumerate(coefficients):
        if m >= len(p):
            (a, da), (b, db) = p[-1], p[-2]
            p.append(((2 - 4 * v) * a - b, (2 - 4 * v) * da - 4 * a - db))
        if m >= 2:
            h.append(-m * (m - 1) / (2 * f[m - 2]))
            g.append(-(1 + g[m - 2] * h[m - 2]) / f[m - 1])
            f.append((m * (m + 1) + 3 - g[m - 1] ** 2 - h[m - 2] ** 2) ** 0.5)
        value, slope = p[m]
        if m == 0:
            found = (value / f[0], slope / f[0])
        else:
            a, da = q[m - 1]
            value, slope = value - g[m - 1] * a, slope - g[m - 1] * da
            if m > 1:
                b, db = q[m - 2]
                value, slope = value - h[m - 2] * b, slope - h[m - 2] * db
            found = (value / f[m], slope / f[m])
        q.append(found)
        total, derivative = total + coefficient * found[0], derivative + coefficient * found[1]
    return total, derivative


@dataclass(frozen=True)
class QconAsphere(Conic):
    """A strong asphere by Forbes' polynomials of the departure from a conic.

    Parameters
    ----------
    curvature : float or array
        Vertex curvature of the conic.
    conic : float or array
        Conic constant of the conic.
    coefficients : sequence or array
        a_0, a_1, … in units of length.
    radius : float or array
        R, the semi-diameter.

    Notes
    -----
    z = conic + u⁴·Σ a_m·Q_m(u²), u = r/R, Q_m(v) = P_m^(0, 4)(2v − 1), Jacobi's polynomials. Forbes, Opt. Express 15,
    5218 (2007).

    Examples
    --------
    At the semi-diameter every polynomial is 1, so that the departure is the sum of the coefficients:

    >>> import numpy as np
    >>> from odak.raytracing import QconAsphere
    >>> surface = QconAsphere(curvature=1 / 5, coefficients=[0.1, 0.02], radius=3.0)
    >>> sag = surface.sag(np.asarray([3.0]), np.asarray([0.0]))
    >>> round(float(sag.height[0]), 6)
    1.12
    """

    coefficients: Numbers = ()
    radius: float | Array = 1.0
    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> Sag:
        """Return height and derivatives at x, y."""
        base = conic_sag(x, y, self.curvature, self.conic)
        scale = self.radius * self.radius
        v = (x * x + y * y) / scale
        total = derivative = 0 * v
        for m, coefficient in enumerate(terms(self.coefficients)):
            total = total + coefficient * jacobi(m, 4, 2 * v - 1)
            derivative = derivative + coefficient * _jacobi_derivative(m, 4, 2 * v - 1)
        height = v * v * total
        slope = 2 * (2 * v * total + 2 * v * v * derivative) / scale
        return Sag(base.height + height, base.slope_x + slope * x, base.slope_y + slope * y, base.defined)


def _jacobi_derivative(degree: int, m: int, s):
    """Return the derivative of Jacobi's P_k^(0, m), ½·Σ_l (2l + m + 2)·P_l^(0, m + 1), l < k."""
    return sum(((k + m / 2 + 1) * jacobi(k, m + 1, s) for k in range(degree)), start=0 * s)


def _curvatures_by_differences(shape: Shape, length) -> tuple[Any, ...]:
    """Return the second derivatives at the vertex by central differences of the first ones."""
    step = 1e-5 * length + 0 * sum(shape.base())
    zero = 0 * step
    right, left = shape.sag(step, zero), shape.sag(-step, zero)
    above, below = shape.sag(zero, step), shape.sag(zero, -step)
    return (right.slope_x - left.slope_x) / (2 * step), (above.slope_y - below.slope_y) / (2 * step)


def radial_sag(
    squared: ArrayT, curvature: Amount, conic: Amount, coefficients: Sequence[Amount] = ()
) -> tuple[ArrayT, ArrayT, ArrayT]:
    """Return height, derivative by r² and domain of an even asphere at squared distances r² from the axis."""
    xp = namespace(squared)
    inside = 1 - (1 + conic) * (curvature * curvature) * squared
    defined = inside > 0
    root = xp.where(defined, inside, 1.0) ** 0.5
    height, slope = curvature * squared / (1 + root), curvature / (2 * root)
    value, derivative = polynomial_in(squared, coefficients) if coefficients else (0.0, 0.0)
    return height + value, slope + derivative, defined


def conic_sag(x: Array, y: Array, curvature: Amount = 0.0, conic: Amount = 0.0) -> Sag:
    """Return z = cr²/(1 + √(1 − (1 + k)c²r²)): a plane for c = 0, a sphere for k = 0, a paraboloid for k = −1."""
    return even_asphere_sag(x, y, curvature, conic)


def even_asphere_sag(
    x: Array, y: Array, curvature: Amount = 0.0, conic: Amount = 0.0, coefficients: Numbers = ()
) -> Sag:
    """Return the conic's height plus a1·r² + a2·r⁴ + a3·r⁶ + …, ``coefficients[..., i]`` belonging to r^(2i + 2)."""
    height, slope, defined = radial_sag(x * x + y * y, curvature, conic, terms(coefficients))
    xp = namespace(height)
    height, slope = xp.where(defined, height, 0.0), xp.where(defined, slope, 0.0)
    return Sag(height, 2 * x * slope, 2 * y * slope, defined)


def zernike_sag(
    x: Array, y: Array, curvature: Amount = 0.0, conic: Amount = 0.0, coefficients: Numbers = (), radius: Amount = 1.0
) -> Sag:
    """Return the conic's height plus Σ a_j·Z_j(x/R, y/R), Noll's order from j = 1, each of RMS 1 over the disc.

    The polynomials are evaluated outside the disc of radius R as well.
    Noll, J. Opt. Soc. Am. 66, 207 (1976).
    """
    base = conic_sag(x, y, curvature, conic)
    height, slope_x, slope_y = base.height, base.slope_x, base.slope_y
    u, v = x / radius, y / radius
    for j, coefficient in enumerate(terms(coefficients), start=1):
        value, along_u, along_v = _zernike(j, u, v)
        height = height + coefficient * value
        slope_x = slope_x + coefficient * along_u / radius
        slope_y = slope_y + coefficient * along_v / radius
    return Sag(height, slope_x, slope_y, base.defined)


def grid_reader(grid: Array, places: Array) -> Callable[..., Any]:
    """Return a function that takes samples of a grid ``[..., n0, n1]`` by flat indices of the shape of `places`.

    The grid is one for all places, or a batch of them whose axes stand before the last of the places.
    """
    xp = namespace(places)
    flat = xp.reshape(grid, (*grid.shape[:-2], -1))
    if all(n == 1 for n in flat.shape[:-1]):
        flat = xp.reshape(flat, (-1,))
        return lambda index: xp.reshape(xp.take(flat, xp.reshape(index, (-1,)), axis=0), index.shape)
    flat = xp.broadcast_to(flat, (*places.shape[:-1], flat.shape[-1]))
    return lambda index: xp.take_along_axis(flat, index, axis=-1)


def polynomial_in(s: Any, coefficients: Any) -> Any:
    """Return Σ a_i·s^(i + 1) and its derivative, by Horner's rule."""
    value = slope = 0 * s
    for coefficient in reversed(terms(coefficients)):
        value = value + coefficient
        slope = slope * s + value
        value = value * s
    return value, slope


def xy_polynomial(x: Array, y: Array, coefficients: Numbers) -> tuple[Any, ...]:
    """Return Σ a_j·x^p·y^q in the order x, y, x², xy, y², x³, …, and its derivatives by x and by y."""
    given = terms(coefficients)
    value = along_x = along_y = 0.0 * (x + y)
    powers_x, powers_y, j, degree = [1 + 0 * x], [1 + 0 * y], 0, 0
    while j < len(given):
        degree += 1
        powers_x.append(powers_x[-1] * x)
        powers_y.append(powers_y[-1] * y)
        for q in range(degree + 1):
            p = degree - q
            if j < len(given):
                value = value + given[j] * powers_x[p] * powers_y[q]
                along_x = along_x + (given[j] * p * powers_x[p - 1] * powers_y[q] if p else 0.0)
                along_y = along_y + (given[j] * q * powers_x[p] * powers_y[q - 1] if q else 0.0)
            j += 1
    return value, along_x, along_y


def _zernike(j: int, u, v):
    """Return the normalised Zernike polynomial of Noll's index j in Cartesian form, and its two derivatives.

    Re or Im of (u + iv)^m times Jacobi's P_k^(0, m)(2ρ² − 1), whose derivative is ½·Σ_l (2l + m + 2)·P_l^(0, m + 1),
    l < k (Christoffel and Darboux). The Cartesian form contains no angle and is regular at the centre.
    """
    n, signed = noll_to_nm(j)
    m = abs(signed)
    degree, s = (n - m) // 2, 2 * (u * u + v * v) - 1
    radial = jacobi(degree, m, s)
    slope = _jacobi_derivative(degree, m, s)
    real, imaginary = u * 0 + 1, v * 0
    lower = (real, imaginary)
    for _ in range(m):
        lower = (real, imaginary)
        real, imaginary = real * u - imaginary * v, real * v + imaginary * u
    wave, along_u, along_v = (
        (real, m * lower[0], -m * lower[1]) if signed >= 0 else (imaginary, m * lower[1], m * lower[0])
    )
    norm = zernike_norm(n, signed)
    return (
        norm * wave * radial,
        norm * (along_u * radial + 4 * u * wave * slope),
        norm * (along_v * radial + 4 * v * wave * slope),
    )


def _spline_weights(value, extent, count: int):
    """Return the cell of each position and the four cubic weights with their derivatives along the position."""
    xp = namespace(value)
    place = (value / extent + 0.5) * (count - 1)
    cell = xp.clip(xp.floor(place), 0, count - 2)
    u = place - cell
    w = 1 - u
    weights = (w**3 / 6, (3 * u**3 - 6 * u * u + 4) / 6, (3 * w**3 - 6 * w * w + 4) / 6, u**3 / 6)
    scale = (count - 1) / extent
    slopes = (-w * w / 2, (3 * u * u - 4 * u) / 2, (4 * w - 3 * w * w) / 2, u * u / 2)
    return xp.astype(cell, xp.int64), weights, tuple(scale * slope for slope in slopes)


@_validate.takes_units(degrees=("angles",))
def intersect_w_sag(
    ray: Array,
    surface: Shape,
    center: Sequence[float] | None = None,
    angles: Sequence[float] | None = None,
    aperture: float | None = None,
    ahead: bool = True,
) -> Hit:
    """Intersect rays with a surface z = sag(x, y).

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[..., 2, 3]``. Directions need not be unit vectors.
    surface : Shape
        The surface, a Conic, EvenAsphere, Toroid or any other shape, its vertex at the origin and its axis along z.
    center : sequence of float, optional
        Position of its vertex.
    angles : sequence of float, optional
        Its rotation in degrees about X, Y and Z, applied in this order.
    aperture : float, optional
        Semi-diameter of the surface.
    ahead : bool
        Whether to accept only intersections in front of the start point; otherwise those behind it are returned as
        well, with negative distances.

    Returns
    -------
    Hit
        Named tuple: distance ``[...]`` in lengths of the direction, point and unit normal ``[..., 3]`` (towards the
        surface's +z), status ``[...]``. NaN where the status is not HIT.

    Notes
    -----
    Conics are intersected in closed form, at the nearest point in front of the start. Other shapes are intersected by
    a bracketed Newton method that starts at the intersection with the approximating conic; of several intersections
    the one closest to it is found.

    A start point that lies on the surface within rounding error is not an intersection. Near the vertex the size of
    the rounding error does not follow from the coordinates: pass `aperture` where rays leave a surface that they may
    intersect again.

    Examples
    --------
    >>> from odak.raytracing import Conic, intersect_w_sag
    >>> intersect_w_sag([[0, 3, -10], [0, 0, 1]], Conic(curvature=1 / 5)).distance
    array(11.)
    """
    return placed_hits(_in_precision_of_rays, ray, surface, center, angles, aperture, ahead)


def _in_precision_of_rays(ray, **others):
    made = _validate.reals(ray=ray, **others)
    dtype = _validate.reals(ray=ray)[0].dtype if is_array(ray) else made[0].dtype
    return [namespace(value).astype(value, dtype) for value in made]


def placed_hits(
    read: Callable[..., Sequence[Array]],
    ray: Array,
    surface: Shape,
    center: Numbers | None,
    angles: Numbers | None,
    aperture: Amount | None,
    ahead: bool,
) -> Hit:
    """Implement :func:`intersect_w_sag` for any array library; `read` converts the arguments to arrays."""
    _validate.instance("surface", surface, Shape, "a shape such as Conic, Toroid or SplineFreeform")
    kinds = {f"surface.{f.name}": getattr(surface, f.name) for f in fields(surface)}
    # Empty sequences of coefficients are not converted.
    held = {name: v for name, v in kinds.items() if not (isinstance(v, (list, tuple)) and len(v) == 0)}
    placed = {"center": center, "angles": angles, "aperture": aperture}
    given = {"ray": ray, **held, **{name: value for name, value in placed.items() if value is not None}}
    made = dict(zip(given, read(**given), strict=True))
    ray = _validate.shaped("ray", made["ray"], "[..., 2, 3]")
    xp = namespace(ray)
    none = xp.zeros(0, dtype=ray.dtype, device=device_of(ray))
    parameters = [made.get(name, none) for name in kinds]
    matrix = rotation_matrix(arguments.vector("angles", made["angles"])) if "angles" in made else None
    place = _validate.shaped("center", made["center"], "[..., 3]") if "center" in made else None
    start, direction = ray[..., 0, :], ray[..., 1, :]
    if place is not None:
        _validate.fitting(ray=start, center=place)
        start = start - cast(place, start)
    if matrix is not None:
        inverse = xp.matrix_transpose(matrix)
        start, direction = apply_matrix(inverse, start), apply_matrix(inverse, direction)
    kind, select = type(surface), "ahead" if _validate.flag("ahead", ahead) else "vertex"
    limits = []
    if "aperture" in made:
        limits = [_validate.real("aperture", made["aperture"])]
        _validate.fitting(ray=ray.shape[:-2], aperture=limits[0])

    def in_own_frame(start, direction, *numbers):
        limit, numbers = (numbers[0], numbers[1:]) if limits else (None, numbers)
        return as_hit(*intersection(start, direction, kind(*numbers), limit, select))

    ranks = (1, 1, *(0 for _ in limits), *kind.ranks_of_parameters())
    distance, point, normal, status = in_pieces(in_own_frame, ranks, start, direction, *limits, *parameters)
    if matrix is not None:
        point, normal = apply_matrix(matrix, point), apply_matrix(matrix, normal)
    return Hit(distance, point if place is None else point + cast(place, point), normal, status)


def intersection(
    start: Array | vec.Vector,
    direction: Array | vec.Vector,
    shape: Shape,
    aperture: Amount | None = None,
    select: str = "ahead",
) -> tuple[intersections.Intersection, Array]:
    """Return the intersections of rays with a surface in its own frame, and their statuses.

    Parameters
    ----------
    start, direction : array or tuple
        ``[..., 3]``, or tuples of three finite components.
    shape : Shape
        The surface.
    aperture : float or array, optional
        Semi-diameter of the surface.
    select : str
        "ahead", "vertex", "through" or "forward", as in :func:`odak.raytracing.intersections.conic`.

    Returns
    -------
    tuple
        :class:`odak.raytracing.intersections.Intersection` and int8 statuses; differentiable.

    Notes
    -----
    Two differentiable steps of Newton's method follow the iteration. By the implicit function theorem the first step
    gives the first derivatives of the distance, the second step the second and third derivatives.
    """
    (aperture,) = _validate.constants(aperture=aperture)
    if isinstance(shape, Plane) and aperture is None and select != "ahead":
        found = intersections.vertex_plane(start, direction)
        return found, status_array(found.hit)
    curvature, conic = shape.base()
    if shape.closed_form:
        found, sheet = intersections.conic(start, direction, curvature, conic, aperture, select)
        return found, conic_status(found, sheet)
    xp, start, direction, kept, differentiable = vec.lines(start, direction, aperture, *shape.parameters())
    kept = kept & xp.isfinite(sum(start) + sum(direction)) & (vec.dot(direction, direction) > 0)
    start = tuple(xp.where(kept, value, 0.0) for value in start)
    direction = tuple(xp.where(kept, value, dummy) for value, dummy in zip(direction, (0.0, 0.0, 1.0), strict=True))
    with _without_graph(*start, *direction, *shape.parameters()):
        distance, status = _solved_by_numpy(start, direction, shape, aperture, select) or _solve(
            start, direction, shape, aperture, select
        )
    status = xp.where(kept, status, xp.ones_like(status) * int(RayStatus.MISS))
    hit = status == int(RayStatus.HIT)
    distance = xp.where(hit, distance, 0.0)
    for _ in range(2 if differentiable else 0):
        error, slope, _ = _level(start, direction, shape, distance, hit)
        regular = hit & (slope != 0)
        distance = distance - xp.where(regular, error, 0.0) / xp.where(regular, slope, 1.0)
    place = vec.along(start, distance, direction)
    here = shape.sag(*(xp.where(hit, value, 0.0) for value in place[:2]))
    normal = vec.unit((-here.slope_x, -here.slope_y, xp.ones_like(here.slope_x)), differentiable)
    distance, place, normal = (vec.nan_outside(value, hit, True) for value in (distance, place, normal))
    return intersections.Intersection(distance, place, normal, hit), status


def _without_graph(*values):
    if any(is_torch(value) for value in values):
        import torch

        return torch.no_grad()
    # NaN marks failed rays; NumPy's warnings about it are suppressed.
    return np.errstate(all="ignore")


def _solved_by_numpy(start, direction, shape: Shape, aperture, select: str):
    """Return what :func:`_solve` returns for arrays or few tensors of the CPU, computed by NumPy; None for others.

    The iteration consists of hundreds of operations, each of which takes NumPy less time to begin than torch.
    """
    given = (start, direction, aperture, shape.parameters())
    tensors = [value for value in _leaves(given) if is_torch(value)]
    # A user's own shape may call functions of torch.
    if type(shape).__module__ != __name__:
        return None
    if not tensors:
        return _solved_arrays(*given, type(shape), select) if isinstance(start[0], np.ndarray) else None
    import torch

    from odak import _torch_private

    # The steps that follow carry the derivatives: forward ones of the iteration would be taken along for nothing.
    given = _mapped(_torch_private.as_constant, given)
    tensors = [value for value in _leaves(given) if is_torch(value)]
    if _torch_private.is_wrapped(*tensors):
        return None
    with _torch_private.without_derivatives():
        dtype = tensors[0].dtype
        plain = dtype in (torch.float32, torch.float64) and all(
            value.dtype == dtype and value.device.type == "cpu" and is_readable(value) and value.numel() <= CHUNK
            for value in tensors
        )
        if not plain or _torch_private.is_transformed(*tensors):
            return None
        start, direction, aperture, parameters = _mapped(lambda value: value.detach().resolve_neg().numpy(), given)
        found = _solved_arrays(start, direction, aperture, parameters, type(shape), select)
        return tuple(torch.from_numpy(np.asarray(value)) for value in found)


def _solved_arrays(start, direction, aperture, parameters, kind: type[Shape], select: str):
    """Return what :func:`_solve` returns for arrays of NumPy; rays with one surface as one row."""
    one = _of_one_surface((aperture, *parameters), (0, *kind.ranks_of_parameters()))
    with np.errstate(all="ignore"):
        if one is None:
            return _solve(start, direction, kind(*parameters), aperture, select)
        (aperture, *parameters), batch = one
        rays = np.broadcast_arrays(*start, *direction, np.empty(batch))[:-1]
        flat = [value.ravel() for value in rays]
        found = _solve(tuple(flat[:3]), tuple(flat[3:]), kind(*parameters), aperture, select)
        return [np.reshape(value, rays[0].shape) for value in found]


def _of_one_surface(parameters, ranks):
    """Return parameters without the axes of a batch, and its shape of ones; None if there are several surfaces."""
    found, axes = [], 0
    for value, rank in zip(parameters, ranks, strict=True):
        if isinstance(value, np.ndarray):
            axes = max(axes, value.ndim - rank)
            if any(length != 1 for length in value.shape[: value.ndim - rank]):
                return None
            value = value.reshape(value.shape[value.ndim - rank :])[()]
            value = tuple(value.tolist()) if rank == 1 else value
        elif any(np.ndim(part) for part in _leaves(value)):
            return None
        found.append(value)
    return found, (1,) * axes


def _leaves(value):
    """Yield the numbers and arrays of nested tuples and lists."""
    if isinstance(value, (tuple, list)):
        for part in value:
            yield from _leaves(part)
    else:
        yield value


def _mapped(function, value):
    """Return nested tuples and lists as tuples, with a function of each tensor."""
    if isinstance(value, (tuple, list)):
        return tuple(_mapped(function, part) for part in value)
    return function(value) if is_torch(value) else value


def _level(start, direction, shape: Shape, distance, where):
    """Return z − sag at a distance along rays, its derivative by the distance, and the sag; at x = y = 0 elsewhere."""
    xp = namespace(distance)
    x, y, z = vec.along(start, distance, direction)
    here = shape.sag(xp.where(where, x, 0.0), xp.where(where, y, 0.0))
    slope = direction[2] - here.slope_x * direction[0] - here.slope_y * direction[1]
    return xp.where(where, z - here.height, 0.0), slope, here


def _solve(start, direction, shape: Shape, aperture, select: str):
    """Return distances by iteration, and int8 statuses."""
    xp = namespace(*start, *direction)
    length = vec.dot(direction, direction) ** 0.5
    curvature, conic = shape.base()
    seed, _ = intersections.conic(start, direction, curvature, conic, None, select)
    flat = intersections.vertex_plane(start, direction)
    guess = xp.where(seed.hit, seed.distance, xp.where(flat.hit, flat.distance, 0.0))

    def solved(guess):
        """Return distances, which of them converged, and which are intersections as selected."""
        distance, found, crossed = newton(start, direction, shape, guess)
        if select == "ahead":
            # A start point on the surface itself is not an intersection.
            scale = abs(distance) * length + vec.dot(start, start) ** 0.5 + (0.0 if aperture is None else aperture)
            crossed = crossed & (distance * length > 64 * epsilon(length) * scale)
        elif select in ("through", "forward"):
            _, slope, here = _level(start, direction, shape, distance, found)
            upward = slope * direction[2] if select == "through" else slope
            crossed = crossed & (~found | (here.defined & (upward > 0)))
        return distance, found, crossed

    distance, found, crossed = solved(guess)
    # Where the conic is met far from the surface, the iteration may diverge: it begins again in the vertex plane.
    again = seed.hit & flat.hit & ~(found & crossed)
    if not is_readable(again) or bool(xp.any(again)):
        second = solved(xp.where(again, flat.distance, distance))
        distance, found, crossed = (
            xp.where(again, b, a) for a, b in zip((distance, found, crossed), second, strict=True)
        )
    x, y, _ = vec.along(start, distance, direction)
    inside = crossed & shape.covers(x, y)
    if aperture is not None:
        inside = inside & (x * x + y * y <= aperture * aperture)
    status = xp.astype(~found, xp.int8) * int(RayStatus.NOT_CONVERGED)
    status = xp.where(found & ~inside, status + int(RayStatus.VIGNETTED), status)
    return distance, xp.where(crossed, status, xp.ones_like(status) * int(RayStatus.MISS))


def newton(
    start: vec.Vector, direction: vec.Vector, shape: Shape, guess: Array, limit: int = 64
) -> tuple[Array, Array, Array]:
    """Solve z = sag(x, y) along rays by Newton's method, restricted to a bracket once one is known.

    Parameters
    ----------
    start, direction : tuple of array
        Components, ``[...]`` each.
    shape : Shape
        The surface.
    guess : array
        First distances, ``[...]``.
    limit : int
        Largest number of steps.

    Returns
    -------
    tuple of array
        Distances, which of them converged, and which rays cross the surface at all, ``[...]``.

    Notes
    -----
    A step that leaves the bracket, or does not reduce the error, is replaced by bisection of the bracket. Before a
    bracket is known, the distance to the best point so far is halved instead; the first such point is the ray's closest
    to the axis, where a surface is most likely defined.
    """
    xp = namespace(guess, *start, *direction)
    (dx, dy, dz), across = direction, direction[0] * direction[0] + direction[1] * direction[1]
    aside = start[0] * dx + start[1] * dy
    best = xp.where(across > 0, -aside / xp.where(across > 0, across, 1.0), guess)
    t, smallest = guess + 0 * best, xp.full_like(best, xp.inf)
    low, high = xp.full_like(best, xp.nan), xp.full_like(best, xp.nan)
    done = crossed = xp.isnan(t)
    transformed = False
    if is_torch(t):
        from odak import _torch_private

        transformed = _torch_private.is_transformed(t)
    # NumPy continues with the rays that are left when half of them are done; `whole` holds those of all.
    whole = places = None
    separable = isinstance(t, np.ndarray) and all(value.shape == t.shape for value in (*start, *direction))
    separable = separable and t.ndim == 1
    separable = separable and _of_one_surface(shape.parameters(), shape.ranks_of_parameters()) is not None
    for step in range(min(limit, 32) if transformed else limit):
        x, y, z = vec.along(start, t, direction)
        here = shape.sag(x, y)
        error, slope = z - here.height, dz - here.slope_x * dx - here.slope_y * dy
        known = here.defined & xp.isfinite(error)
        low, high = xp.where(known & (error <= 0), t, low), xp.where(known & (error >= 0), t, high)
        better = known & (abs(error) < smallest)
        best, smallest = xp.where(better, t, best), xp.where(better, abs(error), smallest)
        size = abs(x) + abs(y) + abs(z) + abs(start[2]) + abs(here.height)
        settled = done | (known & (abs(error) <= 16 * epsilon(t) * size))
        # Heights whose terms cancel are rounded more coarsely than their size tells: there a small step does not help.
        settled = settled | (known & ~better & (abs(error) <= epsilon(t) ** (2 / 3) * size * abs(slope)))
        crossed = crossed | (xp.isfinite(low) & xp.isfinite(high)) | settled
        following = t - error / xp.where(slope == 0, 1.0, slope)
        bracketed = xp.isfinite(low) & xp.isfinite(high)
        usable = better & (slope != 0) & xp.isfinite(following)
        between = (following - low) * (following - high) < 0
        halved = xp.where(bracketed, (low + high) / 2, (t + best) / 2)
        following = xp.where(usable & (between | ~bracketed), following, halved)
        # One further step from within the noise reduces the error to rounding.
        polished = t - xp.where(slope == 0, 0.0, error) / xp.where(slope == 0, 1.0, slope)
        t, done = xp.where(done, t, xp.where(settled, polished, following)), settled
        # A ray without a bracket after 24 steps misses the surface. On a GPU each test synchronises with the device and
        # is therefore made every fourth step.
        over = done if step < 24 else done | ~crossed
        if not transformed and (step % 4 == 3 or is_readable(t)) and bool(xp.all(over)):
            break
        if separable and t.size > FEW and 2 * np.count_nonzero(over) > t.size:
            rest = np.flatnonzero(~over)
            whole, places = _written(whole, places, (t, done, crossed)), rest if places is None else places[rest]
            t, best, smallest, low, high, done, crossed = (
                value[rest] for value in (t, best, smallest, low, high, done, crossed)
            )
            start, direction = tuple(value[rest] for value in start), tuple(value[rest] for value in direction)
            dx, dy, dz = direction
    return _written(whole, places, (t, done, crossed))


def _written(whole, places, parts):
    """Return whole arrays with parts of them at their places; the parts themselves where there are no whole ones."""
    if whole is None:
        return parts
    for array, part in zip(whole, parts, strict=True):
        array[places] = part
    return whole
