"""Limits of a lens: what is asked for, what the lens has, and whether it is met."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak.learn.raytracing.system.operands import Operand, View, edge_thicknesses, given_heights, values_of
from odak.learn.raytracing.system.pupils import AIMS, vignetting_factors
from odak.learn.raytracing.system.surfaces import checked_system, optical_system

# Heights at which the thickness at an edge is taken, as shares of the beam's radius.
EDGE_SHARES = (0.5, 0.75, 1.0)
# Share of a limit by which a lens may miss it: least squares hold limits as nearly as this.
TOLERANCE = 0.01


class LensLimit(NamedTuple):
    """A limit, and what a lens has.

    Attributes
    ----------
    name : str
        Of what, as in :func:`lens_limits`.
    kind : str
        "least" or "largest": which side is limited.
    limit : float
        The limit.
    value : float
        What the lens has, the worst of all places and fields; NaN where rays are lost.
    met : bool
        Whether the lens keeps the limit to within a percent of it.

    Examples
    --------
    >>> from odak.learn.raytracing.system import lens_limits, load_system
    >>> row = lens_limits(load_system("cooke_triplet"), {"track": 50.0})[0]
    >>> row.kind, round(row.value, 1), row.met
    ('largest', 60.7, False)
    """

    name: str
    kind: str
    limit: float
    value: float
    met: bool


def _thicknesses(places: str, shares: tuple[float, ...], per_diameter: bool = False):
    """Return a measure of elements or of gaps at shares of their diameter."""

    def measure(view: View, places_of: dict[str, list[int]]) -> torch.Tensor:
        places_here = places_of[places]
        if not places_here:
            return view.prescription.thickness[:0]
        found = edge_thicknesses(view, places_here, shares=shares)
        if per_diameter:
            heights = view.heights
            diameters = 2 * torch.stack([heights[i : i + 2].max() for i in places_here])
            found = (found.reshape(len(shares), -1) / diameters).flatten()
        return found

    return measure


def _track(view: View, places: dict[str, list[int]]) -> torch.Tensor:
    """Return the distance from the first element to the image."""
    return values_of(Operand("total_track", options={"first": min(places["elements"], default=0)}), view)


def _vignetting(view: View, _) -> torch.Tensor:
    """Return the share of the height of the pupil that apertures cut off, of all fields."""
    return vignetting_factors(view.system, list(view.system.fields), aim=view.options["aim"])[:, 3]


def _operand(name: str, **options: Any):
    """Return a measure that is an operand's."""
    return lambda view, _: values_of(Operand(name, options=options), view)


# Of each limit its sides, and what measures it of a view of the lens and of the places of elements and gaps.
LIMITS: dict[str, tuple[tuple[str, ...], Any]] = {
    "track": (("largest",), _track),
    "back": (("least",), _operand("thickness", surfaces=[-1])),
    "glass": (("least", "largest"), _thicknesses("elements", (0.0,))),
    "air": (("least", "largest"), _thicknesses("gaps", (0.0,))),
    "edge": (("least",), _thicknesses("elements", EDGE_SHARES)),
    "air_edge": (("least",), _thicknesses("facing", EDGE_SHARES)),
    "edge_per_diameter": (("least",), _thicknesses("elements", (1.0,), True)),
    "center_per_diameter": (("least",), _thicknesses("elements", (0.0,), True)),
    "distortion": (("largest",), _operand("distortion")),
    "axial_color": (("largest",), _operand("axial_color")),
    "lateral_color": (("largest",), _operand("lateral_color")),
    "chief_ray_angle": (("largest",), _operand("chief_ray_angle")),
    "vignetting": (("largest",), _vignetting),
}


def lens_limits(system: optical_system, limits: Mapping[str, Any], *, aim: str = "paraxial") -> tuple[LensLimit, ...]:
    """Return the table of limits of a lens: each with what the lens has, and whether it is met.

    Parameters
    ----------
    system : optical_system
        The lens, with the aperture and the fields that it is judged for.
    limits : mapping
        "track", largest distance from the first vertex to the image; "back", least one from the last vertex; "glass"
        and "air", pairs of the least and the largest thickness of elements and of gaps on the axis; "edge" and
        "air_edge", least ones at the rim of the beam and at half and three quarters of its radius;
        "edge_per_diameter" and "center_per_diameter", least thickness of elements at the rim and on the axis, in
        diameters of their beam; "distortion", largest relative one; "axial_color", largest distance between the
        paraxial images of two wavelengths; "lateral_color", largest distance in the image between chief rays of a
        wavelength and of the reference wavelength; "chief_ray_angle", largest angle of chief rays in the image in
        degrees; "vignetting", largest share of the height of the pupil that semi-diameters cut off. Lengths are in the
        unit of the system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    tuple of LensLimit
        One row for each side that is limited.

    Raises
    ------
    ValueError, TypeError
        If a limit is unknown or not a number.

    Examples
    --------
    >>> from odak.learn.raytracing.system import lens_limits, load_system
    >>> rows = lens_limits(load_system("cooke_triplet"), {"edge": 0.5, "axial_color": 0.1, "glass": (1.0, 5.0)})
    >>> [(row.name, row.kind, row.met) for row in rows]
    [('edge', 'least', True), ('axial_color', 'largest', True), ('glass', 'least', False), ('glass', 'largest', True)]
    """
    checked_system(system)
    _validate.instance("limits", limits, Mapping, "a mapping")
    aim = _validate.one_of("aim", aim, AIMS)
    rows = []
    with torch.no_grad():
        view, places = View(system, system.prescription(), aim=aim, heights=given_heights(system)), places_of(system)
        for name, given in limits.items():
            sides, measure = LIMITS[_validate.one_of("name of limits", name, LIMITS)]
            bounds = (given,) if len(sides) == 1 else _validate.several(f"{name} of limits", given, 2)
            values = measure(view, places)
            for side, bound in zip(sides, bounds, strict=True):
                if not values.numel():
                    continue
                bound = _validate.constant(f"{name} of limits", bound)
                value = float(values.min() if side == "least" else values.abs().max())
                room = value - bound if side == "least" else bound - value
                rows.append(LensLimit(name, side, bound, value, room >= -TOLERANCE * abs(bound)))
    return tuple(rows)


def places_of(system: optical_system) -> dict[str, list[int]]:
    """Return the surfaces in front of elements with a curved face, of gaps between them, and of gaps without a stop."""
    items: list[Any] = list(system.surfaces)
    index: list[float] = system.prescription().index[system.reference].tolist()  # type: ignore[index]
    bent = [item.own_shape is not None or bool(item.curvature != 0) for item in items]
    inner = range(len(items) - 1)
    glass = [i for i in inner if index[i + 1] > 1.01 and not items[i].reflects]
    elements = [i for i in glass if bent[i] or bent[i + 1]]
    faces = {j for i in elements for j in (i, i + 1)}
    gaps = [i for i in inner if faces and i not in glass and min(faces) < i < max(faces) and not items[i].reflects]
    return {"elements": elements, "gaps": gaps, "facing": [i for i in gaps if {i, i + 1} <= faces]}
