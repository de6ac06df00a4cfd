"""Configurations of a system: zoom and focus positions, as one batch of numbers that gradients follow."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, overload

import torch

from odak import _show, _validate
from odak.learn.raytracing.system.environment import Environment, expanded_system, replaced, shared_copy, tell_unknown
from odak.learn.raytracing.system.prescriptions import Prescription
from odak.learn.raytracing.system.specification import SETTINGS, checked_settings
from odak.learn.raytracing.system.surfaces import Row, checked_system, optical_system
from odak.learn.raytracing.system.system_files import fields_of_image_heights

# Results of a function for each configuration that are stacked, and others.
Stacked = TypeVar("Stacked", bound=torch.Tensor | tuple[Any, ...])
Result = TypeVar("Result")


class configurations(torch.nn.Module):
    """Several configurations of one system, which differ in some of its numbers, glasses, fields or apertures.

    Use it for zoom lenses, focus positions and anything else that one set of surfaces does in several states. Numbers
    that do not differ belong to the system: varied, they are shared by all configurations.

    Parameters
    ----------
    system : optical_system
        The system. Its surfaces are shared, not copied.
    settings : sequence of tuple, optional
        What differs, as (name, place, values) with one value for each configuration; by default those that the system
        has, from a file for example. Numbers of surfaces: "thickness", "curvature", "conic", "index", "semi_diameter",
        "material"; `place` is the number of the surface. Of the system, with `place` None: "aperture",
        "object_distance" (infinite for distant objects), "fields" (points of each configuration), "wavelengths",
        "image_heights" and "real_image_heights" (points in the image, for which the fields are found); "temperature",
        "pressure", "mount" and "mirror", as :func:`in_environment` has them: all other numbers hold at 20 °C.

    Attributes
    ----------
    system : optical_system
        The system.
    count : int
        Number of configurations, C.

    Raises
    ------
    ValueError, TypeError
        If a setting has another form, or another number of values than the others, naming it.

    Warns
    -----
    odak.AccuracyWarning
        If the settings have a temperature or a pressure, and the expansion or dn/dT of a glass is not known: it is set
        to 0.

    Examples
    --------
    Two ideal lenses of 50 and −30 mm, 30 and 35 mm apart: 1/f = 1/f₁ + 1/f₂ − d/(f₁f₂).

    >>> from odak.learn.raytracing.system import configurations, first_order, optical_system, surface
    >>> from odak.raytracing.interfaces import IdealLens
    >>> lenses = [surface(phase=IdealLens(50.0), thickness=30.0), surface(phase=IdealLens(-30.0), thickness=60.0)]
    >>> zoom = configurations(optical_system(lenses, 10.0), [("thickness", 0, [30.0, 35.0])])
    >>> [round(float(value), 6) for value in first_order(zoom.system, prescription=zoom.prescription()).focal_length]
    [150.0, 100.0]
    """

    def __init__(self, system: optical_system, settings: Sequence[tuple[Any, ...]] | None = None):
        super().__init__()
        self.system: optical_system = checked_system(system)
        given = system.settings if settings is None else checked_settings(settings, len(system.surfaces), system.unit)
        if not given:
            raise ValueError("settings must have at least one entry (name, place, values), got none")
        self.count: int = len(given[0][2])
        self._others: list[tuple[str, int | None, tuple[Any, ...]]] = []
        self._numbers: dict[tuple[str, int | None], str] = {}
        for name, place, values in given:
            if name in SETTINGS["environment"]:
                self._numbers[name, None] = name
                self.register_buffer(name, torch.tensor(values, dtype=torch.float64))
            elif name in _NUMBERS and place is not None:
                item: Any = system.surfaces[place]
                if name in ("curvature", "conic") and item.own_shape is not None:
                    raise ValueError(f"settings must not have the {name} of surfaces[{place}], whose shape is its own")
                key = f"{name}_{place}"
                self._numbers[name, place] = key
                self.register_buffer(key, torch.tensor(values, dtype=torch.float64))
            else:
                self._others.append((name, place, values))
        if any(place is None for _, place in self._numbers):
            with torch.no_grad():
                tell_unknown(self._view(i, False, False) for i in range(self.count))

    def _repr_html_(self) -> str:
        return _show.page(self, "odak.learn.raytracing.system.drawing:configurations_view")

    extra_repr: Callable[..., str] = _show.numbers_of

    @property
    def settings(self) -> tuple[tuple[Any, ...], ...]:
        """What differs, as (name, place, values), with the current values."""
        numbers = [(name, place, tuple(getattr(self, key).tolist())) for (name, place), key in self._numbers.items()]
        return (*numbers, *self._others)

    def vary(self, name: str, place: int | None = None) -> torch.nn.Parameter:
        """Make a parameter of the values of a setting, one for each configuration, and return it.

        Parameters
        ----------
        name : str
            "thickness", "curvature", "conic" or "index"; "temperature", "pressure", "mount" or "mirror".
        place : int, optional
            Number of the surface; None for what belongs to the whole system.

        Returns
        -------
        torch.nn.Parameter
            ``[C]``.
        """
        name = _validate.one_of("name", name, _NUMBERS + SETTINGS["environment"])
        place = (
            None if name in SETTINGS["environment"] else _validate.place_in("place", place, len(self.system.surfaces))
        )
        key = self._numbers.get((name, place))
        if key is None:
            held = ", ".join(kind if i is None else f"{kind} of surface {i}" for kind, i in self._numbers) or "none"
            what = "name must be among the settings" if place is None else f"place must have a setting of the {name}"
            raise ValueError(f"{what}, got {name if place is None else place}; the settings have {held}")
        if key in self._buffers:
            value: Any = self._buffers.pop(key)
            self.register_parameter(key, torch.nn.Parameter(value.clone()))
        return getattr(self, key)

    def view(self, place: int) -> optical_system:
        """Return one configuration as a system that shares the numbers of this module, with their gradients.

        Parameters
        ----------
        place : int
            Number of the configuration, from 0.

        Returns
        -------
        optical_system
            For tracing and analysis. Its surfaces are shared where they do not differ.
        """
        return self._view(_validate.place_in("place", place, self.count), True)

    def _environment(self, place: int) -> Environment | None:
        """Return the environment of one configuration; None if the settings have none."""
        names = [name for name, i in self._numbers if i is None]
        return Environment(**{name: getattr(self, name)[place] for name in names}) if names else None

    def _view(self, place: int, fields: bool, warmed: bool = True) -> optical_system:
        """Return one configuration; with the fields of image heights if `fields`, in its environment if `warmed`."""
        found = shared_copy(self.system)
        surfaces: list[Any] = list(self.system.surfaces)
        changed: dict[int, Any] = {}

        def item(i: int) -> Any:
            if i not in changed:
                changed[i] = surfaces[i] = shared_copy(surfaces[i])
            return changed[i]

        for (name, i), key in self._numbers.items():
            if i is not None:
                replaced(item(i), name, getattr(self, key)[place])
        later: tuple[str, tuple[Any, ...]] | None = None
        for name, i, values in self._others:
            value = values[place]
            if i is not None:
                if name == "semi_diameter":
                    item(i).semi_diameter = value
                else:
                    _put_material(item(i), value)
            elif name in ("image_heights", "real_image_heights"):
                later = name, value
            else:
                setattr(found, name, value)
        found.surfaces = Row(surfaces, found.object_material)
        found.settings = ()
        found.reference = min(found.reference, len(found.wavelengths) - 1)
        given = self._environment(place) if warmed else None
        if given is not None:
            found = expanded_system(found, given)
        if later is not None and fields:
            with torch.no_grad():
                found.fields = tuple(fields_of_image_heights(found, later[1], later[0].startswith("real"), "real"))
        for name, held in (
            ("field_weights", found.fields),
            ("vignetting_factors", found.fields),
            ("wavelength_weights", found.wavelengths),
        ):
            if getattr(found, name) is not None and len(getattr(found, name)) != len(held):
                setattr(found, name, None)
        return found

    def prescription(self, wavelengths: Sequence[float | str] | torch.Tensor | None = None) -> Prescription:
        """Return the numbers of all configurations, ``[C, …]``, for one call of tracing and analysis.

        Parameters
        ----------
        wavelengths : sequence of float or torch.Tensor, optional
            Wavelengths to trace; by default the system's. The numbers are differentiable in a tensor.

        Returns
        -------
        Prescription
            Differentiable in what is varied here or in the system.

        Raises
        ------
        ValueError
            If configurations have different numbers of wavelengths and none are given.

        Notes
        -----
        Fields, apertures and distances of the object belong to the system that the numbers are passed with; where
        they differ, or a glass takes the place of air, use :meth:`each`.
        """
        parts = [self._view(i, False).prescription(wavelengths) for i in range(self.count)]
        rows = list(zip(*parts, strict=True))
        if len({tuple(part.index.shape) for part in parts}) > 1:
            raise ValueError("wavelengths must be given where configurations have different numbers of them")
        stacked: list[Any] = [
            None if row[0] is None else torch.stack(row) if isinstance(row[0], torch.Tensor) else row[0] for row in rows
        ]
        shapes = parts[0].shapes
        if shapes is not None and self._environment(0) is not None:
            # Shapes of their own expand, so that they differ between temperatures.
            shapes = tuple(many[0] and _stacked_shape(many) for many in zip(*(p.shapes for p in parts), strict=True))
        return Prescription(*stacked)._replace(wavelengths=parts[0].wavelengths, shapes=shapes)

    @overload
    def each(self, function: Callable[..., Stacked], *arguments: Any, **options: Any) -> Stacked: ...
    @overload
    def each(self, function: Callable[..., Result], *arguments: Any, **options: Any) -> list[Result]: ...
    def each(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Return the results of a function of a system for all configurations.

        Parameters
        ----------
        function : callable
            Takes a system first, as all functions of tracing and analysis do.
        *arguments, **options
            Further arguments of the function.

        Returns
        -------
        torch.Tensor, tuple or list
            Stacked, ``[C, …]``, where they have one shape; tuples by their members. Otherwise a list.

        Examples
        --------
        >>> from odak.learn.raytracing.system import configurations, load_system, rms_spot
        >>> focus = configurations(load_system("cooke_triplet"), [("thickness", -1, [42.0, 42.2])])
        >>> tuple(focus.each(rms_spot).shape)
        (2, 3)
        """
        _validate.function("function", function)
        return _stacked([function(self.view(i), *arguments, **options) for i in range(self.count)])


_NUMBERS = ("thickness", "curvature", "conic", "index")


def _put_material(item, value) -> None:
    if isinstance(value, (int, float)):
        item.material = None
        item._parameters.pop("index", None)
        item._buffers["index"] = torch.tensor(float(value), dtype=torch.float64)
    else:
        item.material = value


def _stacked(results: list[Any]) -> Any:
    first = results[0]
    if isinstance(first, torch.Tensor) and all(value.shape == first.shape for value in results):
        return torch.stack(results)
    if isinstance(first, tuple) and hasattr(first, "_fields"):
        return type(first)(*map(_stacked, map(list, zip(*results, strict=True))))
    return results


def _stacked_shape(many: Sequence[Any]) -> Any:
    """Return shapes of one kind as one, whose numbers have an axis of configurations in front."""
    rows = zip(*(shape.parameters() for shape in many), strict=True)
    return type(many[0])(*(torch.stack(row) if isinstance(row[0], torch.Tensor) else row[0] for row in rows))
