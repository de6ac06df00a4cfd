"""Automatic design: lenses from flat plates, by a curriculum of growing aperture and field."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch

from odak import _show, _validate
from odak._lengths import expansion_in, focal_length_in, in_unit, light_in
from odak._warnings import ConvergenceWarning, warn
from odak.catalog import OpticalMaterial, glass_makers
from odak.catalog.materials import MICROMETRES
from odak.learn.raytracing.system.analysis import rms_spot
from odak.learn.raytracing.system.design import Solve, Variable, lens_design, zoom_design
from odak.learn.raytracing.system.limits import EDGE_SHARES, lens_limits, places_of
from odak.learn.raytracing.system.operands import Operand, glass_pool
from odak.learn.raytracing.system.paraxial import first_order, matrix, signed_indices
from odak.learn.raytracing.system.pupils import trace_fields
from odak.learn.raytracing.system.surfaces import checked_system, optical_system, reference_of, surface
from odak.learn.raytracing.system.zooms import configurations

# Standard deviations of the random curvatures that designs of spheres and of aspheres begin with, in units of 1/focal
# length. Aspheres, of which there are many and which are close to each other, begin flatter.
CURVATURE_SPREAD = (2.5, 1.2)
# Stages of designs of spheres: fractions of the full aperture and field, fraction of the starts that is retained, rings
# of rays in the pupil, and number of fields. Many designs are traced with few rays, few designs with many.
CURRICULUM = (
    (0.25, 0.6, 1.0, 2, 3),
    (0.4, 0.7, 0.5, 2, 3),
    (0.55, 0.8, 0.3, 3, 4),
    (0.7, 0.85, 0.2, 3, 4),
    (0.85, 0.9, 0.15, 3, 5),
    (1.0, 1.0, 0.09, 4, 6),
)

# How often the number of random bendings of spheres is halved before the first stage, and after how many steps.
SCREENINGS, SCREENING_STEPS = 3, 4

# Least and largest thicknesses of elements and of gaps of the usual design of a given lens, in focal lengths.
STANDARD_GLASS, STANDARD_AIR = (0.02, 0.2), (0.002, 0.5)
STANDARD_LIMITS = (
    *("track", "back", "edge", "air_edge"),
    *("distortion", "axial_color", "lateral_color", "chief_ray_angle"),
)
# Circles of confusion in the diagonal of an image, the usual number, by which colour is bounded; a diagonal counts as
# half a focal length at least, since the axial colour of narrow fields is left by the dispersion of glass.
CIRCLES, LEAST_DIAGONAL_OF_IMAGE = 1500, 0.5
# Weight of lateral colour: its bound is as much smaller than that of axial colour at f/2.5.
LATERAL_WEIGHT = 10.0
# Least thickness of elements at the rim and in the middle, in diameters of the beam, where thicknesses are not given.
# Edmund Optics (Understanding Optical Specifications) asks for a sixth in precise flats and less in lenses. Published
# lenses among the samples have rims of 1/45 to 1/8, where they pass the whole beam, and negatives of 1/16 to 1/8.
LEAST_EDGE, LEAST_CENTER = 1 / 20, 1 / 10
# Weight of a glass beyond the hull of the catalogues by 0.01 of n_d or 1 of 1000/V_d, in focal lengths; how many
# designs take real glasses, and how many neighbours of each glass are tried then.
GLASS_WEIGHT, GLASS_STARTS, GLASS_CANDIDATES = 4e-4, 4, 6

# How much further lengths of designs of spheres are limited than required, in focal lengths.
MARGIN = 3e-5

# What follows belongs to designs of aspheres. Their progress is a number from 0 to 1.
# Fractions of the full aperture and field at progress 0, where nearly all random bendings form an image.
INITIAL = (0.2, 0.6)
# Progress at which the field is full; from there on the aperture grows.
FULL_FIELD = 0.4
# Longest step of the progress, and how often a step that fails is halved.
LONGEST_STEP, HALVINGS = 0.05, 4
# Root mean square of the spots, in focal lengths, above which steps are shortened (5.8 um for 4.55 mm), and the factor
# above the merit of such spots beyond which a step is repeated with half its length.
LARGEST_SPOT, MERIT_FACTOR = 1.27e-3, 3.0
# Pairs of a progress and the fraction of the starts that is retained from there on.
RETAINED = ((0.1, 0.67), (FULL_FIELD, 0.42), (0.7, 0.25))
# Fractions of the beam's radius at which slopes and edges are limited. The last one exceeds 1, since the beam of the
# next step is wider and must not meet a steep rim.
BEAM_FRACTIONS = (0.5, 0.7, 0.85, 1.0, 1.1)
# Weights of edges while the aperture grows and at the end, and weight of the distortion, in focal lengths, while it
# grows. A design may violate soft limits for some steps on its way to a better one.
SOFT_EDGES, FIRM_EDGES, SOFT_DISTORTION = 0.4, 4.0, 0.044
# Steepest slope of a surface, tan 50°, which can still be moulded.
LARGEST_SLOPE = 1.2
# Slope of a single term of an asphere at the radius of the beam from which on a design is dropped: sums of such terms
# keep half of the digits of double precision at most. Terms of designs that succeed stay far below.
LARGEST_TERM = 1e8
# Largest sine of the angle between a ray and the normal, of 53 degrees: 1 is total reflection.
LARGEST_SINE = 0.8
# Distance from the centroid, in focal lengths, at which a lost ray counts: large beside any spot.
LOST_DISTANCE = 0.1
# Least element of the diagonal of the normal matrix that damping is relative to, in squared focal lengths: variables on
# which the merit hardly depends are damped too.
LEAST_DIAGONAL = 5e-9
# Least and largest damping with which a run begins where another one ended.
DAMPING_RANGE = (1e-5, 1e-1)
# Root mean square of the spots of the result, in focal lengths, above which a warning is issued: 11 um for 4.55 mm.
ACCEPTED_SPOT = 1 / 400
# Merit over the best one of a run from which on the run has spoilt its designs: beams that are computed anew change it
# less.
SPOILT = 100.0


class DesignStage(NamedTuple):
    """A stage of the curriculum.

    Attributes
    ----------
    aperture, field : float
        Fractions of the full aperture and of the full field (of the tangent of its angle).
    rms : float
        Root mean square over the fields of the spots of the best design; lost rays are left out.
    system : optical_system
        A copy of the best design, with the aperture and the fields of the stage.

    Examples
    --------
    >>> from odak.learn.raytracing.system import DesignSearch, LensRequirements, automatic_design
    >>> search = DesignSearch(starts=2, stages=1, iterations=2, polish=0)
    >>> found = automatic_design(["stop", "N-BK7"], LensRequirements(100.0, 10.0, 1.0), search=search)
    >>> stage = found.stages[-1]
    >>> stage.aperture, stage.field, bool(stage.rms > 0)
    (1.0, 1.0, True)
    """

    aperture: float
    field: float
    rms: float
    system: optical_system


@_show.shown
class AutomaticResult(NamedTuple):
    """An automatic design.

    Attributes
    ----------
    system : optical_system
        The lens.
    stages : tuple of DesignStage
        Stages of the curriculum; the last one is the lens.
    start : optical_system
        The flat plates that the design began with.

    Examples
    --------
    >>> from odak.learn.raytracing.system import DesignSearch, LensRequirements, automatic_design, rms_spot
    >>> search = DesignSearch(starts=2, stages=1, iterations=2, polish=0)
    >>> found = automatic_design(["stop", "N-BK7"], LensRequirements(100.0, 10.0, 1.0), search=search)
    >>> bool(rms_spot(found.system).mean() < rms_spot(found.start).mean())
    True
    """

    system: optical_system
    stages: tuple[DesignStage, ...]
    start: optical_system


@dataclass(frozen=True)
class LensRequirements:
    """What a lens must do: the question that :func:`automatic_design` answers.

    Parameters
    ----------
    focal_length : float or str
        Focal length of the lens. Texts have units of their own, as "50mm", here and in the wavelengths.
    f_number : float
        Focal length divided by the diameter of the entrance pupil; the object is at infinity.
    half_field : float
        Largest field angle in degrees, below 80.
    wavelengths : sequence of float
        Vacuum wavelengths, in `unit`.
    distortion : float
        Largest magnitude of the relative distortion.
    axial_color : float, optional
        Largest distance between the paraxial images of two wavelengths, in `unit`; by default the depth of focus
        2·f_number·c of a circle of confusion c, for elements of different glasses.
    chief_ray_angle : float, optional
        Largest angle of the chief rays against the axis in the image, in degrees.
    unit : str
        Unit of all lengths, also of :class:`LensDimensions`.
    lateral_color : float, optional
        Largest distance in the image between chief rays of a wavelength and of the middle one, in `unit`; by default
        c/2, for elements of different glasses.
    vignetting : float
        Share of the height of the pupil that is vignetted at the edge of the field, half of it on each side: 0 at half
        of the field, from where it grows linearly. The semi-diameters are those of the beams that remain.

    Raises
    ------
    ValueError, TypeError
        If a number is out of range.

    Notes
    -----
    The circle of confusion c is 1/1500 of the diagonal of the image, which counts as half the focal length at least.

    Examples
    --------
    >>> from odak.learn.raytracing.system import LensRequirements
    >>> LensRequirements(50.0, 2.8, 20.0, axial_color=0.1).distortion
    0.02
    """

    focal_length: float
    f_number: float
    half_field: float
    wavelengths: Sequence[Any] = (486.1327e-6, 587.5618e-6, 656.2725e-6)
    distortion: float = 0.02
    axial_color: float | None = None
    chief_ray_angle: float | None = None
    unit: str = "mm"
    lateral_color: float | None = None
    vignetting: float = 0.0

    def __post_init__(self) -> None:
        unit = _validate.one_of("unit", self.unit, MICROMETRES)
        waves = light_in("wavelengths", self.wavelengths, unit)
        object.__setattr__(self, "wavelengths", _validate.several("wavelengths", waves, positive=True))
        for name in ("axial_color", "lateral_color"):
            object.__setattr__(self, name, in_unit(name, getattr(self, name), unit))
        focus = focal_length_in("focal_length", self.focal_length, self.wavelengths, unit)
        object.__setattr__(self, "focal_length", focus)
        for name in ("focal_length", "f_number", "distortion", "axial_color", "lateral_color", "chief_ray_angle"):
            _set_number(self, name, positive=True)
        _set_number(self, "half_field", least=0)
        _set_number(self, "vignetting", least=0, most=0.9)
        if self.half_field >= 80:
            raise ValueError(f"half_field must be below 80 degrees, got {self.half_field}")

    @property
    def _distortion_weight(self) -> float:
        """Weight at which distortion counts as half the height that it displaces the image of the largest field."""
        return 0.5 * self._image_height

    @property
    def _image_height(self) -> float:
        return self.focal_length * math.tan(math.radians(self.half_field))

    def limits(self, dimensions: "LensDimensions | None" = None, molded: bool = False) -> dict[str, Any]:
        """Return all limits with their defaults, for :func:`lens_limits`.

        Parameters
        ----------
        dimensions : LensDimensions, optional
            The room that the lens has.
        molded : bool
            Whether the elements are moulded, as aspheres behind a stop in front: ground ones have limits by diameter.

        Returns
        -------
        dict
            Limits by name.

        Examples
        --------
        >>> from odak.learn.raytracing.system import LensRequirements
        >>> LensRequirements(50.0, 2.8, 20.0).limits()["center_per_diameter"]
        0.1
        """
        given = LensDimensions() if dimensions is None else dimensions
        molded = _validate.flag("molded", molded)
        room, wanted = given._around(self.focal_length), self._with_color(True)
        found = {name: getattr(room, name) for name in ("track", "back", "glass", "air", "edge")}
        found["air_edge"] = room.edge
        by_diameter = (0.0, 0.0) if molded else given._ground
        found |= dict(zip(("edge_per_diameter", "center_per_diameter"), by_diameter, strict=True))
        for name in ("distortion", "axial_color", "lateral_color", "chief_ray_angle", "vignetting"):
            found[name] = getattr(wanted, name)
        return {name: limit for name, limit in found.items() if limit}

    def _with_color(self, correctable: bool) -> "LensRequirements":
        """Return the requirements with the default bounds of colour, where the glasses can correct it."""
        if not correctable:
            return self
        axial, lateral = _color_bounds(self.focal_length, self.f_number, self._image_height)
        return replace(
            self,
            axial_color=axial if self.axial_color is None else self.axial_color,
            lateral_color=lateral if self.lateral_color is None else self.lateral_color,
        )


@dataclass(frozen=True)
class LensDimensions:
    """The room that a lens has: limits of its thicknesses, and what stands in front of the image.

    Parameters
    ----------
    glass : pair of float, optional
        Least and largest thickness of elements on the axis; by default from 0.02 to 0.2 focal lengths, and of ground
        lenses a tenth of the diameter of their beam at least.
    air : pair of float, optional
        Least and largest thickness of gaps on the axis; by default from 0.002 to 0.3 focal lengths.
    edge : float, optional
        Least thickness of elements and gaps at the rim of the beam and at smaller heights; by default the least
        thickness of `air`, and of ground elements a twentieth of the diameter of their beam. Aspheres behind a stop in
        front are moulded, all others ground.
    back : float, optional
        Least distance from the last surface to the image; by default a tenth of the focal length. Behind a cover the
        least distance is 0.3 times `back`.
    track : float, optional
        Largest distance from the first vertex to the image.
    cover : pair, optional
        Material and thickness of a plane plate in front of the image.

    Raises
    ------
    ValueError, TypeError
        If a number is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import LensDimensions
    >>> LensDimensions(glass=(1.5, 9.0), back=20.0).air is None
    True
    """

    glass: Sequence[float] | None = None
    air: Sequence[float] | None = None
    edge: float | None = None
    back: float | None = None
    track: float | None = None
    cover: tuple[str | OpticalMaterial, float] | None = None

    def __post_init__(self) -> None:
        for name in ("glass", "air"):
            if getattr(self, name) is not None:
                least, largest = _validate.several(name, getattr(self, name), 2)
                if not 0 <= least <= largest:
                    raise ValueError(f"{name} must be a least and a larger thickness, got {getattr(self, name)!r:.80}")
                object.__setattr__(self, name, (least, largest))
        for name in ("edge", "back"):
            _set_number(self, name, least=0)
        _set_number(self, "track", positive=True)
        if self.cover is not None:
            if not isinstance(self.cover, Sequence) or isinstance(self.cover, str) or len(self.cover) != 2:
                raise TypeError(f"cover must be a pair of a material and a thickness, got {self.cover!r:.80}")
            thickness = _validate.constant("cover[1]", self.cover[1], positive=True)
            object.__setattr__(self, "cover", (self.cover[0], thickness))

    @property
    def _ground(self) -> tuple[float, float]:
        """Least edges and centres of ground elements in diameters, 0 where thicknesses are given."""
        return LEAST_EDGE if self.edge is None else 0.0, LEAST_CENTER if self.glass is None else 0.0

    def _around(self, f: float) -> "LensDimensions":
        """Return the dimensions with the defaults of a focal length; `back` begins at the last surface then."""
        air = (0.002 * f, 0.3 * f) if self.air is None else self.air
        back = 0.1 * f if self.back is None else self.back
        return replace(
            self,
            glass=(0.02 * f, 0.2 * f) if self.glass is None else self.glass,
            air=air,
            edge=air[0] if self.edge is None else self.edge,
            back=back if self.cover is None else 0.3 * back,
        )


@dataclass(frozen=True)
class DesignSearch:
    """How long :func:`automatic_design` searches.

    Parameters
    ----------
    starts : int, optional
        Number of designs in the first stage; by default 16, 32 with makers of glass, 12 of aspheres behind a stop in
        front. All but the last begin as the best eighth of random bendings of the plates, after a few steps.
    stages : int
        Number of stages in which aperture and field grow, 1 to 6; with 1 both are full from the beginning. Designs of
        aspheres begin at the same fraction of the curriculum, and divide the rest into shorter stages.
    iterations : int, optional
        Steps of the Levenberg–Marquardt method in each stage; by default 15 for spheres, 6 for aspheres.
    polish : int
        Number of runs at the end in which the fields with the larger spots are given more weight.
    seed : int
        Seed of the random bendings: the same seed gives the same lens.
    callback : callable, optional
        Called with each :class:`DesignStage` as it is finished.

    Raises
    ------
    ValueError, TypeError
        If a number is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import DesignSearch
    >>> DesignSearch(starts=4, seed=2).polish
    6
    """

    starts: int | None = None
    stages: int = len(CURRICULUM)
    iterations: int | None = None
    polish: int = 6
    seed: int = 0
    callback: Callable[[DesignStage], Any] | None = None

    def __post_init__(self) -> None:
        for name, least in (("starts", 1), ("stages", 1), ("iterations", 1), ("polish", 0), ("seed", 0)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _validate.integer(name, getattr(self, name), minimum=least))
        if self.stages > len(CURRICULUM):
            raise ValueError(f"stages must be at most {len(CURRICULUM)}, got {self.stages}")
        _validate.function_or_none("callback", self.callback)

    def _filled(self, steep: bool, makers: Sequence[str] | None) -> "DesignSearch":
        """Return the search with its default numbers; steep designs begin as aspheres."""
        starts, iterations = 12 if steep else 32 if makers else 16, 6 if steep else 15
        return replace(self, starts=self.starts or starts, iterations=self.iterations or iterations)


def _color_bounds(focal_length: float, f_number: float, height: float) -> tuple[float, float]:
    """Return the usual bounds of axial and lateral colour of an image of a largest height."""
    circle = max(2 * height, LEAST_DIAGONAL_OF_IMAGE * focal_length) / CIRCLES
    return 2 * f_number * circle, 0.5 * circle


def _is_correctable(system: optical_system) -> bool:
    """Whether colour can be corrected: several wavelengths, and glasses of different dispersion."""
    index = system.prescription().index.detach()
    powers = (index - 1)[:, (index[system.reference] > 1.01)]
    relative = powers / powers[system.reference]
    return len(index) > 1 and bool((relative.amax(-1) - relative.amin(-1) > 1e-4).any())


def _set_number(holder: Any, name: str, **limits: Any) -> None:
    """Check a number of a value class, which may be None, and keep it as a float."""
    if getattr(holder, name) is not None:
        object.__setattr__(holder, name, _validate.constant(name, getattr(holder, name), **limits))


@_validate.takes_fields(
    "elements focal_length f_number half_field wavelengths distortion axial_color chief_ray_angle unit",
    requirements=LensRequirements,
    dimensions=LensDimensions,
    search=DesignSearch,
)
def automatic_design(
    elements: Sequence[Any],
    requirements: LensRequirements,
    *,
    dimensions: LensDimensions | None = None,
    aspheric_terms: int = 0,
    makers: Sequence[str] | None = None,
    search: DesignSearch | None = None,
) -> AutomaticResult:
    """Design a lens from flat plates.

    Use it where no lens is at hand to begin with; a lens that exists is improved faster by :func:`standard_design`.

    Parameters
    ----------
    elements : sequence
        Materials of the elements from the object to the image, and once "stop", in front of one of them: the
        aperture stop. A tuple of materials is a cemented element, each part of which can be ground.
    requirements : LensRequirements
        Focal length, f-number, field and colours, and the aberrations that are limited.
    dimensions : LensDimensions, optional
        Limits of the thicknesses and of the length; by default they follow from the focal length.
    aspheric_terms : int
        Number of coefficients of r⁴, r⁶, … of each surface, 0 for spheres. They are added to paraboloids where the
        stop is in front of all elements, to spheres elsewhere.
    makers : sequence of str, optional
        Makers of glass, names of :func:`odak.catalog.glass_makers`. The glasses of the elements vary then, from those
        of `elements`, within the hull of all glasses of these makers, and are replaced by real ones at the end.
    search : DesignSearch, optional
        Number of designs and steps, and the seed.

    Returns
    -------
    AutomaticResult
        The lens, whose surfaces have the semi-diameters of the beam, and the stages to it.

    Raises
    ------
    ValueError
        If an argument is out of range, or rays are lost in all designs of a stage.

    Warns
    -----
    ConvergenceWarning
        If the largest spot of a lens of aspheres is above 1/400 of the focal length, root mean square: the least
        squares ended in a poor minimum, and another seed may do better.

    Notes
    -----
    Ground elements whose thicknesses are not given have at least a twentieth of the diameter of their beam at the rim
    and a tenth in the middle; limits may be exceeded by a percent.

    The method is the curriculum of Yang et al., Nature Communications 15, 6568 (2024),
    doi 10.1038/s41467-024-50835-7: aperture and field grow to their full size. Here each stage is solved by least
    squares instead of gradient descent, for several designs side by side; the best ones go on to the next stage.
    Before the first stage random bendings are optimised with few steps, and the worse half is dropped three times.

    Aspheres around a stop are designed as spheres up to the full aperture and field, where their coefficients become
    variables one order after the other. Aspheres behind a stop in front, as in telephone cameras, whose fields spheres
    would not pass, are paraboloids with a polynomial, defined at any distance from the axis. Their field grows
    first, so that chief rays fill the rear surfaces; then the aperture grows, in steps that are shortened where the
    spots become large. The least squares vary combinations of the coefficients whose slopes are orthonormal over the
    beam, as proposed by Forbes, Optics Express 15, 5218 (2007), doi 10.1364/OE.15.005218; higher orders become
    variables one after the other as the field grows. The damping of each design is carried over from step to step.
    Slopes above 1.2 within 1.1 beam radii are penalised, and sines of angles of incidence above 0.8. While aspheres
    grow, a lost ray enters the spot as if it arrived at a tenth of the focal length from the centroid; rays that are
    lost at the end raise ValueError.

    Fields of the three classes are also taken as arguments, which is the older form: ``automatic_design(elements,
    focal_length, f_number, half_field, back=20.0, seed=1)``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import DesignSearch, LensRequirements, automatic_design, first_order
    >>> search = DesignSearch(starts=2, stages=1, iterations=2, polish=0)
    >>> found = automatic_design(["stop", "N-BK7"], LensRequirements(100.0, 10.0, 1.0), search=search)
    >>> abs(float(first_order(found.system).focal_length) - 100) < 1
    True
    """
    terms = _validate.integer("aspheric_terms", aspheric_terms)
    if isinstance(elements, str) or not isinstance(elements, Sequence) or not len(elements):
        raise TypeError(f'elements must be a sequence of materials and "stop", got {elements!r:.80}')
    makers = _checked_makers(makers)
    # Behind a stop in front, spheres of wide fields lose rays long before aspheres do.
    steep = bool(terms) and isinstance(elements[0], str) and elements[0] == "stop"
    f = requirements.focal_length
    ground = (0.0, 0.0) if steep else dimensions._ground  # type: ignore[union-attr]
    dimensions, search = dimensions._around(f), search._filled(steep, makers)  # type: ignore[union-attr]
    plates = _flat_plates(elements, terms, steep, dimensions, requirements)
    system = plates[0]
    start = copy.deepcopy(system)
    requirements = requirements._with_color((bool(makers) and len(system.wavelengths) > 1) or _is_correctable(system))
    problem = _Problem(requirements, dimensions, ground, terms, makers, plates, search.callback)
    design = (_designed_aspheres if steep else _designed_spheres)(problem, search)
    if not bool(trace_fields(system, "rings", 8, vignetting=False).arrived.all()):
        raise ValueError("rays are lost at the full aperture and field: try another seed")
    largest = float(rms_spot(system, "rings", 8, vignetting=False).detach().max()) if terms else 0.0
    if largest > ACCEPTED_SPOT * f:
        warn(
            f"automatic_design: the largest spot is {largest:.3g} {requirements.unit} RMS, more than "
            f"1/{1 / ACCEPTED_SPOT:.0f} of the focal length: try another seed",
            ConvergenceWarning,
        )
    heights = design.clear_heights(design.values)
    for item, size in zip(system.surfaces, heights, strict=True):
        item.semi_diameter = 1.001 * float(size)
    return AutomaticResult(system, tuple(problem.stages), start)


def standard_design(
    system: optical_system,
    focal_length: float | str | None = None,
    *,
    limits: Mapping[str, float] | None = None,
    makers: Sequence[str] | None = None,
    aspheric: bool = False,
    aim: str = "paraxial",
    temperatures: Sequence[float] | None = None,
    mount: float = 0.0,
) -> lens_design:
    """Return the usual design of a lens: everything that may change varies, and its spots are the merit.

    Parameters
    ----------
    system : optical_system
        The lens, centred, with the aperture and the fields that it is designed for.
    focal_length : float or str, optional
        Focal length that is held, negative for lenses that diverge, or a text with a unit of its own, "50mm"; by
        default the focal length of the system.
    limits : mapping, optional
        "track", largest distance from the first vertex to the image; "back", least one from the last vertex, by default
        a tenth of the focal length or what it is; "distortion", by default 0.02 or what it is; "axial_color" and
        "lateral_color", by default as in :class:`LensRequirements` or what they are; "chief_ray_angle", largest angle
        of the chief rays in the image in degrees; "edge" and "air_edge", least thickness of elements and of gaps
        between them at the rim of the beam, by default 1/50 and 1/500 of the focal length or what it is.
        :func:`lens_limits` tells more.
    makers : sequence of str, optional
        Makers of glass, in the catalogues of which the glasses vary.
    aspheric : bool
        Whether all surfaces with coefficients become aspheres, and not only those that are.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    temperatures : sequence of float, optional
        Temperatures in degrees Celsius, at each of which spots and limits count alike, without refocusing.
    mount : float
        Coefficient of expansion of the mounts per kelvin, with temperatures.

    Returns
    -------
    lens_design
        With temperatures a :class:`zoom_design`, whose variables and solves are of the lens at 20 °C. Variables are
        curvatures, thicknesses, the defocus, and conic constants and coefficients of aspheres. The last
        curvature is solved for the focal length. Plane plates and a stop in front stay where they are, edges may stay
        as thin as they are.

    Raises
    ------
    ValueError
        If no curvature or, with `makers`, no glass could vary, a limit is unknown or out of range, or glasses vary
        with temperatures, at which their dn/dT would be unknown.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, rms_spot, standard_design
    >>> lens = load_system("cooke_triplet")
    >>> before = rms_spot(lens).square().sum()
    >>> result = standard_design(lens, limits={"track": 60.0}).optimise(3)
    >>> bool(rms_spot(lens).square().sum() < before)
    True
    """
    checked_system(system)
    makers = _checked_makers(makers)
    aspheric = _validate.flag("aspheric", aspheric)
    mount = expansion_in("mount", _validate.constant("mount", mount))
    if focal_length is None:
        focal_length = float(first_order(system).focal_length.detach())
    waves, unit = system.wavelengths, system.unit
    focal_length = _validate.constant("focal_length", focal_length_in("focal_length", focal_length, waves, unit))
    size = abs(focal_length)
    items: list[Any] = list(system.surfaces)
    last = len(items) - 1
    glass, curved, free = _what_varies(system)
    aspheres = [i for i in curved if bool(items[i].conic != 0) or bool(items[i].coefficients.any()) or aspheric]
    powers = [i for i in aspheres if items[i].coefficients.numel() > 1]
    variables = [Variable("thickness", last)]
    for i in curved[:-1]:
        c = float(items[i].curvature)
        variables.append(Variable("curvature", i, min(-1 / (0.15 * size), c), max(1 / (0.15 * size), c)))
    for i in free:
        t, (low, high) = float(items[i].thickness), STANDARD_GLASS if i in glass else STANDARD_AIR
        variables.append(Variable("thickness", i, min(low * size, t), max(high * size, t)))
    variables += [Variable("conic", i) for i in aspheres]
    variables += [Variable("coefficients", i, terms=range(1, items[i].coefficients.numel())) for i in powers]
    operands = [Operand("spot")]
    if makers is not None:
        varied = [i for i in glass if items[i].material is not None]
        if not varied:
            raise ValueError("system has no glass that could be replaced")
        variables.append(Variable("glass", varied))
        # 0.01 in n_d or 1 in V_d away from a real glass counts like a spot of 10⁻⁵ focal lengths.
        options = {"surfaces": varied, "makers": makers}
        operands.append(Operand("glass", weight=1e-5 * size, options=options))
    solves = [Solve("focal_length", curved[-1], focal_length), Solve("marginal_height", last)]
    limits = standard_limits(system, limits, size, aim)
    places = places_of(system)
    for name, of in (("edge", "elements"), ("air_edge", "facing")):
        if name in limits:
            options = {"surfaces": places[of], "shares": EDGE_SHARES}
            operands.append(Operand("edge_thickness", lower=limits[name], options=options))
    if "back" in limits:
        operands.append(Operand("thickness", lower=limits["back"], options={"surfaces": [last]}))
    if "track" in limits:
        operands.append(Operand("total_track", upper=limits["track"]))
    operands += _image_operands(limits, size, 0.5 * _image_height(system, aim))
    if temperatures is None:
        return lens_design(system, operands, variables, solves=solves, aim=aim)
    degrees = _validate.several("temperatures", temperatures)
    zoom = configurations(system, [("temperature", None, degrees), ("mount", None, [mount] * len(degrees))])
    return zoom_design(zoom, operands, variables, solves=solves, aim=aim)


def _what_varies(system: optical_system) -> tuple[list[int], list[int], list[int]]:
    """Return the surfaces in front of glass, the surfaces whose curvature varies, and those whose thickness does."""
    items: list[Any] = list(system.surfaces)
    last = len(items) - 1
    index = system.prescription().index[system.reference].tolist()
    bent = [item.own_shape is None and bool(item.curvature != 0) for item in items]
    acts = [item.reflects or index[i] != index[i + 1] for i, item in enumerate(items)]
    glass = [i for i in range(last) if index[i + 1] > 1.01 and not items[i].reflects]
    # Plane-parallel plates stay; a plane face of a lens may bend.
    faces = {j for i in glass for j in (i, i + 1) if bent[i] or bent[i + 1]}
    curved = [i for i, item in enumerate(items) if acts[i] and item.own_shape is None and (bent[i] or i in faces)]
    if not curved:
        raise ValueError("system has no surface whose curvature could vary")
    outside = {0} if items[0].stop and not acts[0] else set()
    free = [
        i for i in range(last) if float(items[i].thickness) > 0 and i not in outside and (i not in glass or i in faces)
    ]
    return glass, curved, free


def standard_limits(
    system: optical_system, limits: Mapping[str, float] | None, size: float, aim: str = "paraxial"
) -> dict[str, float]:
    """Return the limits of :func:`standard_design` with its defaults, which a lens keeps as it is.

    Parameters
    ----------
    system : optical_system
        The lens.
    limits : mapping or None
        Limits that are asked for.
    size : float
        Magnitude of its focal length.
    aim : str
        How :func:`launch` aims.
    """
    limits = {} if limits is None else limits
    _validate.instance("limits", limits, Mapping, "a mapping")
    asked = {
        _validate.one_of("name of limits", name, STANDARD_LIMITS): _validate.number(f"{name} of limits", value, least=0)
        for name, value in limits.items()
    }
    height = _image_height(system, aim)
    usual = {"back": 0.1 * size, "edge": STANDARD_GLASS[0] * size, "air_edge": STANDARD_AIR[0] * size}
    if float(system.surfaces[-1].thickness) <= 0:  # type: ignore[arg-type]
        del usual["back"]
    if height:
        usual["distortion"] = 0.02
    if _is_correctable(system):
        speed = abs(float(first_order(system).f_number.detach()))
        usual["axial_color"], usual["lateral_color"] = _color_bounds(size, speed, height)
    for row in lens_limits(system, usual, aim=aim):
        worse = min if row.kind == "least" else max
        asked.setdefault(row.name, worse(row.limit, row.value) if math.isfinite(row.value) else row.limit)
    return asked


def _image_height(system: optical_system, aim: str) -> float:
    """Return the largest distance of a chief ray from the axis in the image."""
    with torch.no_grad():
        chief = trace_fields(system, torch.zeros(1, 2, dtype=torch.float64), vignetting=False, aim=aim)
        return float(torch.nan_to_num((chief.x**2 + chief.y**2).sqrt()).max())


def _image_operands(limits: Mapping[str, Any], size: float, distortion: float, share: float = 1.0) -> list[Operand]:
    """Return the operands of the limits of the image.

    Parameters
    ----------
    limits : mapping
        Limits by name, as :func:`lens_limits` takes them.
    size : float
        Magnitude of the focal length.
    distortion : float
        Weight of the distortion.
    share : float
        Share of the bounds of colour that is taken, since least squares exceed limits a little.
    """
    # Of the distortion a tenth remains for the fields between the fields of the operand.
    rows = (
        ("distortion", 0.9, distortion, True),
        ("axial_color", share, 1.0, False),
        ("lateral_color", share, LATERAL_WEIGHT, True),
        ("chief_ray_angle", 1.0, 0.002 * size, False),
    )
    found = []
    for name, part, weight, has_signs in rows:
        if limits.get(name) is not None and weight:
            bound = part * limits[name]
            found.append(Operand(name, weight=weight, lower=-bound if has_signs else None, upper=bound))
    return found


def _checked_makers(makers: Any) -> tuple[str, ...] | None:
    """Return the makers of glass after checking their names."""
    if makers is None:
        return None
    return tuple(_validate.one_of("makers", maker, glass_makers()) for maker in _validate.texts("makers", makers))


class _Problem:
    """An automatic design in progress: requirements, system, surfaces with variable curvature, and finished stages."""

    def __init__(self, requirements, dimensions, ground, terms, makers, plates, callback):
        system, curved, elements, spaces = plates
        self.requirements, self.dimensions, self.terms, self.makers = requirements, dimensions, terms, makers
        self.ground = ground
        self.system, self.curved, self.elements, self.callback = system, curved, elements, callback
        self.last = len(system.surfaces) - 1
        self.first = min(curved)
        self.free_glasses = bool(makers)
        self.stages: list[DesignStage] = []
        self.thicknesses = [
            Variable("thickness", [i for i in spaces if i in elements], *dimensions.glass),
            Variable("thickness", [i for i in spaces if i not in elements], *dimensions.air),
        ]

    def glasses(self) -> list[Variable]:
        """Return the variables of the glasses; none where they are given or real."""
        if not self.free_glasses:
            return []
        known = glass_pool(self.makers or ())[1] / torch.tensor([100.0, 1.0], dtype=torch.float64)
        return [Variable("glass", self.elements, known.amin(0).tolist(), known.amax(0).tolist())]

    def take_glasses(self, design: lens_design, values: torch.Tensor, iterations: int, run: Callable) -> torch.Tensor:
        """Replace variable glasses by real ones, beginning with several designs, and return the values ``[1, V]``."""
        design._take_glasses(values, self.makers or (), GLASS_CANDIDATES, iterations, run)
        self.free_glasses = False
        self.record(1.0, 1.0)
        return design.values[None]

    def set_stage(self, aperture: float, field: float, field_fractions) -> None:
        """Set the system's aperture and fields.

        Parameters
        ----------
        aperture, field : float
            Fractions of the full aperture and of the tangent of the full field.
        field_fractions : sequence of float
            The system's fields as fractions of the tangent of the largest one.
        """
        self.system.aperture = aperture * self.requirements.focal_length / self.requirements.f_number
        largest = math.tan(math.radians(self.requirements.half_field)) * field
        fractions = field_fractions if self.requirements.half_field else [0.0]
        self.system.fields = tuple((0.0, math.degrees(math.atan(largest * k))) for k in fractions)
        if self.requirements.vignetting:
            cuts = (self.requirements.vignetting * max(0.0, 2 * field * k - 1) for k in fractions)
            self.system.vignetting_factors = tuple((0.0, 0.0, 0.0, cut) for cut in cuts)

    def record(self, aperture: float, field: float) -> None:
        """Append a copy of the system to the stages, and call back."""
        rms = rms_spot(self.system, "rings", 6, vignetting=False).detach()
        self.stages.append(DesignStage(aperture, field, float(rms.square().mean().sqrt()), copy.deepcopy(self.system)))
        if self.callback is not None:
            self.callback(self.stages[-1])

    def limits(
        self,
        beam_fractions: Sequence[float],
        edges: float = 1.0,
        distortion: float | None = None,
        margin: float = 0.0,
    ) -> list[Operand]:
        """Return the operands that keep the lens within the requirements.

        Parameters
        ----------
        beam_fractions : sequence of float
            Fractions of the beam's radius at which the thickness of edges is limited.
        edges : float
            Weight of thicknesses.
        distortion : float, optional
            Weight of the distortion; by default the weight in the requirements.
        margin : float
            How much further lengths are limited, since least squares exceed limits a little.
        """
        wanted, room, f = self.requirements, self.dimensions, self.requirements.focal_length
        between = list(range(self.first, self.last))
        options = {"surfaces": between, "shares": beam_fractions}
        found = [
            Operand("edge_thickness", weight=edges, lower=room.edge + margin, options=options),
            Operand("thickness", weight=edges, lower=room.back + margin, options={"surfaces": [self.last]}),
        ]
        for share, at in zip(self.ground, (beam_fractions, (0.0,)), strict=True):
            if share:
                options = {"surfaces": self.elements, "shares": at, "per_diameter": share}
                found.append(Operand("edge_thickness", weight=edges, lower=margin, options=options))
        if self.free_glasses:
            options = {"surfaces": self.elements, "makers": self.makers, "hull": True}
            found.append(Operand("glass", weight=GLASS_WEIGHT * f, upper=0.0, options=options))
        if room.track is not None:
            found.append(Operand("total_track", weight=edges, upper=room.track - margin, options={"first": self.first}))
        weight = wanted._distortion_weight if distortion is None else distortion
        found += _image_operands(vars(wanted), f, weight if wanted.half_field else 0.0, share=0.95)
        return found


def _designed_spheres(problem: _Problem, search: DesignSearch):
    """Return the :class:`lens_design` of the last run of lenses that begin as spheres.

    Their aperture and field grow together. At full aperture and field aspheric terms are added, one order after the
    other.
    """
    system, curved, last = problem.system, problem.curved, problem.last
    starts, iterations = search.starts or 1, search.iterations or 1
    f = problem.requirements.focal_length
    # Radii of at least 0.15 focal lengths.
    limit = 1 / (0.15 * f)
    solves = [Solve("focal_length", curved[0], f), Solve("marginal_height", last)]

    # Orders of the aspheric terms that vary.
    aspheric: list[int] = []

    def design_of(weights, rings: int) -> lens_design:
        operands = [
            Operand("spot", options={"fields": weights}),
            # The curvature that is solved for the focal length, in units of 1/f.
            Operand(lambda _, p: f * p.curvature[..., curved[0]], weight=0.1 * f, lower=-limit * f, upper=limit * f),
            *problem.limits(EDGE_SHARES, margin=MARGIN * f),
        ]
        bounds = () if aspheric else (-limit, limit)
        variables = [
            Variable("curvature", curved[1:], *bounds),
            *problem.thicknesses,
            Variable("thickness", last, -0.1 * f, 0.1 * f),
            *problem.glasses(),
            *(Variable("coefficients", curved, terms=[term]) for term in aspheric),
        ]
        if aspheric:
            operands.append(_slope_limit(f, curved, BEAM_FRACTIONS[:-1]))
        pupil = _pupil_of_fields(len(system.fields), rings)
        return lens_design(system, operands, variables, solves=solves, pupil=pupil)

    values: Any = None
    reached = (0.0, 0.0)
    for aperture, field, retained, rings, count in CURRICULUM[-search.stages :]:
        # Equal areas of the image between the fields.
        fractions = [math.sqrt(k / (count - 1)) for k in range(count)]
        while reached != (aperture, field):
            reached = _set_next_stage(problem, design_of, values, reached, (aperture, field), rings, fractions)
            design = design_of(None, rings)
            if values is None:
                values = _screened_starts(design, starts, CURVATURE_SPREAD[0] / f, search.seed)
            values, loss, _ = _optimised(design, values, iterations)
            design.apply(values[loss.argmin()])
            problem.record(*reached)
        values = values[loss.argsort()[: max(1, math.ceil(retained * starts))]]

    def run(design, values, count: int = 2 * iterations):
        return _optimised(design, values, count, least_diagonal=LEAST_DIAGONAL * f**2 if aspheric else 0.0)[:2]

    for term in range(1, problem.terms + 1):
        aspheric.append(term)
        design = design_of(None, rings)
        # Coefficients are the last variables, by order.
        values = torch.nn.functional.pad(values, (0, len(design.values) - values.shape[-1]))
        values, loss = run(design, values)
        design.apply(values[loss.argmin()])
        problem.record(*reached)
    if problem.free_glasses:
        values, loss = run(design, values, 3 * iterations)
        values = problem.take_glasses(design, values[loss.argsort()[:GLASS_STARTS]], iterations, run)
    return _with_equal_spots(problem, lambda weights, _: design_of(weights, rings), design, run, values, search.polish)


def _with_equal_spots(problem: _Problem, design_of, design: lens_design, run, values, polish: int) -> lens_design:
    """Return the design after runs in which the fields with the larger spots are given more weight.

    Parameters
    ----------
    problem : _Problem
        The automatic design.
    design_of : callable
        Takes the weights of the fields and the fraction of the runs that is finished with this one; returns a design.
    design : lens_design
        The result without a run.
    run : callable
        Takes a design and values of its variables; returns optimised values and their merits.
    values : torch.Tensor or None
        Values of several designs; by default the values of the system.
    polish : int
        Number of runs.
    """
    weights = torch.ones(len(problem.system.fields), dtype=torch.float64)
    for k in range(polish):
        design = design_of(weights.tolist(), (k + 1) / polish)
        values, loss = run(design, design.values[None] if values is None else values)[:2]
        design.apply(values[loss.argmin()])
        spots = rms_spot(problem.system, "rings", 8, vignetting=False).detach()
        values = design.values[None]
        weights = weights * (spots / spots.square().mean().sqrt()) ** 0.5
        weights = weights / weights.square().mean().sqrt()
    if polish:
        problem.record(1.0, 1.0)
    return design


def _designed_aspheres(problem: _Problem, search: DesignSearch):
    """Return the :class:`lens_design` of the last run of aspheres: the field grows first, then the aperture."""
    growth = _Growth(problem, search)
    design, values = growth.grow(1 - (search.stages - 1) / 5)
    # The best design once more, with soft limits.
    _, found = growth.optimised_at(1.0, values[:1], growth.damping[:1], 3 * growth.iterations)
    if found is not None:
        design.apply(found[0][0])
        growth.damping = found[2]
    if problem.free_glasses:
        problem.take_glasses(design, design.values[None], 2 * growth.iterations, growth.run_beside)
    return _with_equal_spots(
        problem,
        lambda weights, firmness: growth.design_of(weights, 5, growth.terms, firmness),
        design,
        growth.run_again,
        None,
        max(1, search.polish),
    )


class _Growth:
    """Aspheres that are optimised while the field grows, then the aperture.

    Parameters
    ----------
    problem : _Problem
        The automatic design.
    search : DesignSearch
        Numbers of starts and iterations, and the seed.
    """

    # Fields are closer to each other at the rim, where spots change faster.
    fractions = tuple((k / 8) ** 0.7 for k in range(9))

    def __init__(self, problem: _Problem, search: DesignSearch):
        self.problem, self.seed = problem, search.seed
        self.starts, self.iterations = search.starts or 1, search.iterations or 1
        self.f, self.terms = problem.requirements.focal_length, problem.terms
        self.image = Variable("thickness", problem.last, problem.dimensions.back, self.f)
        self.power = Operand(_relative_power(self.f), target=1.0, weight=0.22 * self.f)
        self.floor = LEAST_DIAGONAL * self.f**2
        # Merit up to which a design is continued, and the damping of each design.
        self.accepted = 0.0
        self.damping: Any = 0.1

    def design_of(self, weights, rings: int, free_terms: int, firmness: float = 0.0) -> lens_design:
        """Return the design for weights of the fields.

        With a firmness of 0 limits are soft, and the power is an operand. Up to 1 they become firm, and it is a solve.
        """
        problem, system, f, curved = self.problem, self.problem.system, self.f, self.problem.curved
        final = firmness > 0
        firm_weight = problem.requirements._distortion_weight
        operands = [
            Operand("spot", options={"fields": weights, "lost": LOST_DISTANCE * f}),
            *problem.limits(
                (0.3, *BEAM_FRACTIONS),
                edges=SOFT_EDGES ** (1 - firmness) * FIRM_EDGES**firmness,
                distortion=(SOFT_DISTORTION * f) ** (1 - firmness) * firm_weight**firmness,
            ),
            _slope_limit(f, curved, BEAM_FRACTIONS),
            Operand("incidence", weight=0.006 * f, upper=LARGEST_SINE, options={"count": 2}),
        ]
        if not final:
            operands.insert(1, self.power)
        # Coefficients last and by order, so that the values of a design with fewer orders are the first ones.
        variables = [Variable("curvature", curved[1:] if final else curved), *problem.thicknesses, self.image]
        variables += problem.glasses()
        variables += [Variable("coefficients", curved, terms=[term]) for term in range(1, free_terms + 1)]
        solves = [Solve("focal_length", curved[0], f)] if final else []
        return lens_design(
            system, operands, variables, solves=solves, pupil=_pupil_of_fields(len(system.fields), rings)
        )

    @staticmethod
    def fractions_at(progress: float) -> tuple[float, float]:
        """Return the fractions of aperture and field at a progress."""
        of_field = min(progress / FULL_FIELD, 1.0)
        of_aperture = max(progress - FULL_FIELD, 0.0) / (1 - FULL_FIELD)
        return INITIAL[0] + (1 - INITIAL[0]) * of_aperture, INITIAL[1] + (1 - INITIAL[1]) * of_field

    def optimised_at(self, progress: float, values, damping, count: int):
        """Return the design and, of several starts, optimised values, merits and dampings; None if no start is left."""
        self.problem.set_stage(*self.fractions_at(progress), self.fractions)
        growing = min(self.terms, 1 + int(0.8 * self.terms * progress / FULL_FIELD))
        free_terms = self.terms if progress > FULL_FIELD else growing
        design = self.design_of(None, 4, free_terms)
        if values is None:
            values = _random_starts(design, self.starts, CURVATURE_SPREAD[1] / self.f, self.seed)
        values = torch.nn.functional.pad(values, (0, len(design.values) - values.shape[-1]))
        return design, _optimised(design, values, count, damping, self.floor, steep=True)

    def grow(self, progress: float) -> tuple[lens_design, torch.Tensor]:
        """Return the last design, and the values of the designs that are left, the best first."""
        problem, step = self.problem, LONGEST_STEP
        design, found = self.optimised_at(progress, None, self.damping, 3 * self.iterations)
        if found is None:
            raise ValueError("rays are lost in all designs of the first stage: try another seed")
        self.accepted = 0.5 * len(problem.system.fields) * (LARGEST_SPOT * self.f) ** 2
        retained = list(RETAINED)
        while True:
            values, merit, damping = found
            order = merit.argsort()
            order = order[merit[order] <= max(self.accepted, 20 * float(merit.min()))]
            while retained and progress >= retained[0][0]:
                order = order[: max(1, math.ceil(retained.pop(0)[1] * self.starts))]
            values, self.damping = values[order], damping[order].clamp(*DAMPING_RANGE)
            problem.set_stage(*self.fractions_at(progress), self.fractions)
            design.apply(values[0])
            problem.record(*self.fractions_at(progress))
            if progress >= 1:
                return design, values
            halvings, progress, design, found = self._step(progress, step, values)
            least = float(found[1].min())
            if least < self.accepted and halvings == 0:
                step = min(LONGEST_STEP, 1.6 * step)
            else:
                step = max(step / 2 ** (halvings + 1), LONGEST_STEP / 4)
            # Where even the shortest step leaves larger spots, the next steps are measured by these.
            self.accepted = max(self.accepted, least / MERIT_FACTOR)

    def _step(self, progress: float, step: float, values: torch.Tensor) -> tuple[Any, ...]:
        """Advance by a step, which is halved until the merit is small enough.

        Returns
        -------
        tuple
            How often the step was halved, the progress, its design, and values, merits and dampings.
        """
        reached = None
        for halvings in range(HALVINGS + 1):
            tried = min(1.0, progress + step / 2**halvings)
            design, found = self.optimised_at(tried, values, self.damping, self.iterations)
            if found is not None and not found[1].min() < self.accepted:
                design, found = self.optimised_at(tried, found[0], found[2], 2 * self.iterations)
            if found is not None:
                reached = (tried, design, found)
                if found[1].min() < MERIT_FACTOR * self.accepted:
                    break
        if reached is None:
            raise ValueError(
                f"rays are lost in all designs beyond fractions {self.fractions_at(progress)} of aperture and field: "
                "try another seed"
            )
        return halvings, *reached

    def run_beside(self, design: lens_design, values, count: int):
        """Run several designs beside the best one, whose beam and basis they share."""
        design.heights = design.clear_heights(design.values).reshape(1, -1)
        basis = _slope_basis(design).expand(len(values), -1, -1)
        found = design._minimised(values, count, damping=1e-3, basis=basis, floor=self.floor)
        return found.x, found.loss

    def run_again(self, design: lens_design, values):
        """Run designs with the dampings that they have reached; return values and merits."""
        damping = self.damping.clamp(*DAMPING_RANGE)
        found = _optimised(design, values, 2 * self.iterations, damping, self.floor, steep=True)
        if found is None:
            raise ValueError("rays are lost at the full aperture and field: try another seed")
        values, merit, self.damping = found
        return values, merit


def _slope_limit(f: float, curved: list[int], shares: Sequence[float]) -> Operand:
    """Return the operand that limits the slopes of aspheres at shares of the beam's radius."""
    options = {"surfaces": curved, "shares": shares}
    return Operand("slope", None, 0.044 * f, -LARGEST_SLOPE, LARGEST_SLOPE, options)


def _relative_power(f: float) -> Callable[..., Any]:
    """Return the operand that is a system's power times a focal length."""

    def power(system, prescription) -> torch.Tensor:
        p = prescription.at(reference_of(system, prescription))
        return -f * matrix(p, signed_indices(system, p), 0, len(system.surfaces)).c

    return power


def _pupil_of_fields(fields: int, rings: int) -> torch.Tensor:
    """Return points ``[F, P, 2]`` of a pupil for each field, in rings whose radii differ from field to field.

    Rays of different fields then meet a surface at different heights, so that a polynomial of high order cannot
    oscillate between them. The points on the rim include both of the meridional plane, whose rays are refracted most.
    No two points are mirror images of each other, whose rays would be mirror images too.
    """
    arms = 5
    ring, arm = torch.arange(1.0, rings + 1, dtype=torch.float64)[:, None], torch.arange(arms, dtype=torch.float64)
    # The golden section spreads the offsets evenly; the largest field has offset 0: rings of equal area.
    offset = (0.618034 * torch.arange(fields - 1, -1, -1, dtype=torch.float64))[:, None, None] % 1
    radius = ((ring - 0.95 * offset) / rings).sqrt()
    radius[:, -1] = 1.0
    inner = (rings - ring) % 2
    turn = math.pi * ((1 - inner) * arm / (arms - 1) + inner * (arm + 0.5) / arms)
    side = 1 - 2 * ((ring + arm) % 2)
    return torch.stack([radius * side * turn.sin(), radius * turn.cos()], -1).flatten(1, 2)


def _flat_plates(elements, terms: int, paraboloids: bool, dimensions: Any, requirements: LensRequirements):
    """Return plates and a stop, surfaces that may be curved, those in front of glass and of variable thicknesses."""
    if isinstance(elements, str) or not any(isinstance(item, str) and item == "stop" for item in elements):
        raise ValueError('elements must be materials and one "stop"')
    elements = list(elements)
    glass, air, cover, f = dimensions.glass, dimensions.air, dimensions.cover, requirements.focal_length
    if elements.count("stop") > 1 or elements[-1] == "stop":
        raise ValueError('elements must contain one "stop", in front of a material')
    thick = (glass[0] * glass[1]) ** 0.5
    gap = min(max(air[0], 0.05 * f), air[1])
    flat: dict[str, Any] = {
        "curvature": 0.0,
        "conic": -1.0 if paraboloids else 0.0,
        "coefficients": [0.0] * (terms + 1 if terms else 0),
    }
    row: list[surface] = []
    curved: list[int] = []
    glasses: list[int] = []
    for item in elements:
        if isinstance(item, str) and item == "stop":
            row.append(surface(thickness=air[0] if not row else gap, stop=True))
            continue
        # Cemented elements share the surface between them.
        first = len(row)
        row += [surface(**flat, thickness=thick, material=glass) for glass in _cemented(item)]
        row.append(surface(**flat, thickness=gap))
        glasses += range(first, len(row) - 1)
        curved += range(first, len(row))
    spaces = list(range(len(row) - 1))
    if cover is not None:
        spaces.append(len(row) - 1)
        row += [surface(thickness=float(cover[1]), material=cover[0]), surface(thickness=f)]
    row[-1].thickness.fill_(f / 4 if paraboloids else f)
    wavelengths, unit = list(requirements.wavelengths), requirements.unit
    system = optical_system(row, 1.0, wavelengths=wavelengths, unit=unit)
    return system, curved, glasses, spaces


def _cemented(item: Any) -> tuple[Any, ...]:
    """Return the materials of an element, of several where it is cemented."""
    if not isinstance(item, (tuple, list)):
        return (item,)
    if len(item) < 2 or any(isinstance(part, str) and part == "stop" for part in item):
        raise ValueError(f"cemented elements must be two materials or more, without the stop, got {item!r:.80}")
    return tuple(item)


def _set_next_stage(
    problem: _Problem, design_of, values, reached, goal, rings: int, field_fractions
) -> tuple[float, float]:
    """Set and return the fractions of aperture and field nearest to a goal at which some design loses no ray."""
    if values is None:
        problem.set_stage(goal[0], goal[1], field_fractions)
        return goal
    step = 1.0
    for _ in range(6):
        tried = goal
        if step < 1:
            tried = (reached[0] + step * (goal[0] - reached[0]), reached[1] + step * (goal[1] - reached[1]))
        problem.set_stage(tried[0], tried[1], field_fractions)
        design = design_of(None, rings)
        with torch.no_grad():
            design.heights = design.clear_heights(values)
            if bool(torch.isfinite(design.residuals(values)).all(-1).any()):
                return tried
        step /= 2
    raise ValueError(f"rays are lost in all designs beyond fractions {reached} of aperture and field: try another seed")


def _random_starts(design: lens_design, count: int, spread: float, seed: int) -> torch.Tensor:
    """Return starts ``[N, V]`` with random curvatures that lose no ray, decreased until there are enough of them."""
    generator = torch.Generator().manual_seed(seed)
    found: list[torch.Tensor] = []
    columns = design.columns["curvature"]
    while sum(len(part) for part in found) < count:
        values = design.values.expand(4 * count, -1).clone()
        drawn = torch.randn(4 * count, len(columns), dtype=torch.float64, generator=generator)
        values[:, columns] = spread * drawn
        values = values.clamp(design.lower, design.upper)
        with torch.no_grad():
            design.heights = design.clear_heights(values)
            found.append(values[torch.isfinite(design.residuals(values)).all(-1)])
        spread *= 0.8
    return torch.cat(found)[:count]


def _screened_starts(design: lens_design, count: int, spread: float, seed: int) -> torch.Tensor:
    """Return the best of many random starts ``[N, V]``, of which half are left after every few steps."""
    values = _random_starts(design, count * 2**SCREENINGS, spread, seed)
    while len(values) > count:
        values, loss, _ = _optimised(design, values, SCREENING_STEPS)
        values = values[loss.argsort()[: len(values) // 2]]
    return values


def _optimised(
    design: lens_design,
    values: torch.Tensor,
    iterations: int,
    damping: Any = 1e-2,
    least_diagonal: float = 0.0,
    steep: bool = False,
):
    """Return optimised values of several starts, their merits and dampings; None if rays are lost in all of them.

    The run is divided into parts, before each of which the radii of the beam are computed anew. Starts with
    steep aspheres often lose all rays on their way: such starts are dropped. Where no start is left after a part, or
    rays that are nearly lost spoil all of them, the values before the part that began best are returned.
    """
    aspheres = "coefficients" in design.places
    parts = max(1, iterations // 3) if aspheres else 2
    best: Any = None
    for _ in range(parts):
        with torch.no_grad():
            design.heights = design.clear_heights(values)
            basis = _slope_basis(design) if aspheres else None
            if steep and basis is not None:
                # Designs that no ray passes are dropped, as are those whose terms leave few digits of each other: rays
                # that are nearly lost intersect far from the axis, where high powers of this distance swamp the others.
                steepest = _steepest_term(design, values)
                kept = torch.isfinite(design.heights).all(-1) & (steepest < LARGEST_TERM)
                values, design.heights, basis = values[kept], design.heights[kept], basis[kept]
                damping = damping[kept] if isinstance(damping, torch.Tensor) else damping
                merit = 0.5 * design.residuals(values).square().sum(-1) if bool(kept.any()) else None
                if merit is None or not bool(torch.isfinite(merit).any()):
                    return best
                merit = merit.nan_to_num(math.inf, math.inf)
                if best is None or merit.min() < best[1].min():
                    best = values, merit, torch.as_tensor(damping).expand(len(values))
        found = design._minimised(
            values, max(1, iterations // parts), damping=damping, basis=basis, floor=least_diagonal
        )
        values, damping = found.x, found.damping if aspheres else damping
    if best is not None and bool(found.loss.min() > SPOILT * best[1].min()):
        return best
    return values, found.loss, found.damping


def _terms_of_surfaces(design: lens_design):
    """Yield, for each surface with variable terms, columns, powers and the scale of the terms' slopes, of N designs.

    The slope of a term at the beam's radius is the value of its column times its power over its scale ``[N, terms]``.
    """
    heights: Any = torch.where(torch.isfinite(design.heights), design.heights, 1.0)  # type: ignore[arg-type]
    held: dict[int, list[tuple[int, int]]] = {}
    for name in ("curvature", "coefficients"):
        for (place, term), column in zip(design.places[name], design.columns[name], strict=True):
            held.setdefault(place, []).append((0 if name == "curvature" else term, column))
    for place, entries in held.items():
        terms, columns = (torch.tensor(value) for value in zip(*entries, strict=True))
        powers = 2.0 * (terms.double() + 1)
        # The term of r² is half the curvature.
        yield columns, powers, heights[:, place, None] ** (1 - powers) * torch.where(terms == 0, 2.0, 1.0)


def _steepest_term(design: lens_design, values: torch.Tensor) -> torch.Tensor:
    """Return the largest slope ``[N]`` of a single term, r², r⁴, …, of a surface at the radius of the beam."""
    slopes = [values[:, columns] * powers / scale for columns, powers, scale in _terms_of_surfaces(design)]
    return torch.cat(slopes, -1).abs().amax(-1)


def _slope_basis(design: lens_design) -> torch.Tensor:
    """Return matrices ``[N, V, V]`` from coefficients of functions with orthonormal slopes to variables of N designs.

    The functions of a surface are combinations of r², r⁴, … up to increasing powers; the mean over the beam of the
    product of the slopes of two of them is 1 or 0. Variables other than curvatures and coefficients remain as they are.
    """
    designs, count = len(design.heights), len(design.values)  # type: ignore[arg-type]
    found = torch.eye(count, dtype=torch.float64).expand(designs, count, count).clone()
    for columns, powers, scale in _terms_of_surfaces(design):
        gram = 2 * powers[:, None] * powers / (powers[:, None] + powers)
        functions = torch.linalg.inv(torch.linalg.cholesky(gram)).mT
        found[:, columns[:, None], columns] = scale[..., None] * functions
    return found
