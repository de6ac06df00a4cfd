"""One surface of an optical system, as a module whose numbers may be parameters."""

import math
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any

import torch

from odak import _validate
from odak.catalog.dispersion import Material
from odak.catalog.materials import material as find_material

MIRROR, AIR = "mirror", "air"
VARIABLES = ("curvature", "radius", "conic", "coefficients", "thickness", "index", "shift", "tilt")


class surface(torch.nn.Module):
    """A surface, and what lies between it and the next one; lengths in the system's unit.

    Parameters
    ----------
    radius : float or torch.Tensor
        Radius of curvature, positive with the centre behind the vertex; infinite for a plane.
    curvature : float or torch.Tensor, optional
        1/radius, in its place. The better variable of the two: it passes through the plane smoothly.
    conic : float or torch.Tensor
        Conic constant k: 0 a sphere, −1 a paraboloid.
    coefficients : sequence of float or torch.Tensor
        Of r², r⁴, r⁶, …, added to the conic.
    thickness : float or torch.Tensor
        Distance to the next vertex, that of the last surface to the image plane. Negative after a mirror.
    material : str, float, torch.Tensor or Material
        What is behind it: a name of :func:`odak.catalog.material_names`, "air" (index 1), "mirror", or an index that
        holds for all wavelengths.
    semi_diameter : float, optional
        Distance from the axis beyond which rays are vignetted.
    stop : bool
        Whether it is the aperture stop.
    shift, tilt : sequence of float or torch.Tensor
        Of this surface alone: its vertex off the axis along x and y, and rotations in degrees about x, then about y.

    Raises
    ------
    ValueError
        If a number is out of range, or the material unknown: the message names the nearest known ones.

    Notes
    -----
    A `torch.nn.Parameter` stays one. :meth:`vary` makes parameters of numbers.

    Examples
    --------
    >>> from odak.learn.raytracing.system import surface
    >>> front = surface(radius=51.5, thickness=4.0, material="N-BK7", semi_diameter=12.5)
    >>> float(front.radius)
    51.5
    """

    radius_value: torch.Tensor
    curvature_value: torch.Tensor
    conic: torch.Tensor
    coefficients: torch.Tensor
    thickness: torch.Tensor
    shift: torch.Tensor
    tilt: torch.Tensor
    index: torch.Tensor

    def __init__(
        self,
        radius: float = math.inf,
        *,
        curvature: float | None = None,
        conic: float = 0.0,
        coefficients: Sequence[float] = (),
        thickness: float = 0.0,
        material: Any = "air",
        semi_diameter: float | None = None,
        stop: bool = False,
        shift: Sequence[float] = (0.0, 0.0),
        tilt: Sequence[float] = (0.0, 0.0),
    ):
        super().__init__()
        if isinstance(radius, torch.nn.Parameter):
            self._hold("radius_value", radius)
        elif curvature is None:
            value = float(number_or_infinity("radius", radius))
            if value == 0:
                raise ValueError(f"radius must not be 0, got {value}")
            # As it was given, to the last digit.
            self._hold(*(("curvature_value", 0.0) if math.isinf(value) else ("radius_value", value)))
        else:
            self._hold("curvature_value", _validate.real("curvature", curvature))
        self._hold("conic", _validate.real("conic", conic))
        coefficients = _listed("coefficients", coefficients)
        self._hold("coefficients", _validate.real("coefficients", coefficients) if len(coefficients) else coefficients)
        self._hold("thickness", _validate.real("thickness", thickness))
        self._hold("shift", _pair("shift", shift))
        self._hold("tilt", _pair("tilt", tilt))
        self.material = _medium(material)
        if isinstance(self.material, (Real, torch.Tensor)):
            self._hold("index", _validate.real("material", material, positive=True))
            self.material = None
        self.semi_diameter = semi_diameter
        if semi_diameter is not None:
            self.semi_diameter = float(_validate.number("semi_diameter", semi_diameter, positive=True))
        self.stop = _validate.flag("stop", stop)

    @property
    def curvature(self) -> torch.Tensor:
        """1/radius."""
        return 1 / self.radius_value if self._has("radius_value") else self.curvature_value

    @property
    def radius(self) -> torch.Tensor:
        """Radius of curvature, infinite for a plane."""
        return self.radius_value if self._has("radius_value") else 1 / self.curvature_value

    @property
    def reflects(self) -> bool:
        """Whether it is a mirror."""
        return self.material == MIRROR

    @property
    def is_off_axis(self) -> bool:
        """Whether it is shifted or tilted, or may come to be."""
        return any(value.requires_grad or bool(value.any()) for value in (self.shift, self.tilt))

    def vary(self, name: str) -> torch.nn.Parameter:
        """Make a parameter of a number, and return it.

        Parameters
        ----------
        name : str
            "curvature", "radius", "conic", "coefficients", "thickness", "index" (of a material given as a number),
            "shift" or "tilt".
        """
        name = _validate.one_of("name", name, VARIABLES)
        if name in ("curvature", "radius"):
            value = getattr(self, name).detach()
            if not bool(torch.isfinite(value)):
                raise ValueError("the radius of a plane cannot be varied; vary its curvature")
            for old in ("curvature_value", "radius_value"):
                if self._has(old) and old != f"{name}_value":
                    delattr(self, old)
            name = f"{name}_value"
        elif not self._has(name):
            raise ValueError(
                f"{name} of this surface cannot be varied: its material is {self.material!r}, not a number"
            )
        else:
            value = getattr(self, name).detach()
        if name in self._parameters:
            return getattr(self, name)
        if value.numel() == 0:
            raise ValueError(f"{name} of this surface is empty; give it zeros to vary")
        if name in self._buffers:
            delattr(self, name)
        self.register_parameter(name, torch.nn.Parameter(value.clone()))
        return getattr(self, name)

    def _has(self, name: str) -> bool:
        return name in self._parameters or name in self._buffers

    def _hold(self, name: str, value) -> None:
        if isinstance(value, torch.nn.Parameter):
            self.register_parameter(name, value)
        elif isinstance(value, torch.Tensor):
            if value.requires_grad:
                raise TypeError(f"{name} must be a number, a tensor without graph or a torch.nn.Parameter")
            self.register_buffer(name, value.detach().to(torch.float64))
        else:
            self.register_buffer(name, torch.tensor(value, dtype=torch.float64))

    def extra_repr(self) -> str:
        """Return the surface in a line."""
        medium = getattr(self.material, "name", self.material)
        medium = f"index {float(self.index.detach()):g}" if medium is None else medium
        radius, thickness = (float(value.detach()) for value in (self.radius, self.thickness))
        return f"radius={radius:g}, thickness={thickness:g}, material={medium}, stop={self.stop}"


def number_or_infinity(name: str, value):
    """Return a real number that may be infinite."""
    if isinstance(value, Real) and not isinstance(value, bool) and math.isinf(value):
        return value
    if isinstance(value, torch.Tensor) and value.numel() == 1 and bool(torch.isinf(value.detach()).all()):
        return value
    return _validate.number(name, value)


def _listed(name: str, values):
    if isinstance(values, torch.Tensor):
        return values
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise TypeError(f"{name} must be a sequence of numbers, got {type(values).__name__}")
    return [float(_validate.number(name, value)) for value in values]


def _pair(name: str, values):
    values = _validate.real(name, _listed(name, values))
    if len(values) != 2:
        raise ValueError(f"{name} must be two numbers (x, y), got {values!r}")
    return values


def _medium(value):
    """Return "air", "mirror", a material of the catalogue, or the number or tensor that came."""
    if isinstance(value, bool) or not isinstance(value, (str, Real, torch.Tensor, Material)):
        raise TypeError(f"material must be a name, an index or a Material, got {type(value).__name__}")
    if isinstance(value, str):
        return value.casefold() if value.casefold() in (MIRROR, AIR) else find_material(value)
    return value
