"""Lens design: variables with bounds, pickups and solves, optimised by exact Jacobians; real glasses; restarts."""

import copy
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from odak import _show, _validate
from odak.catalog import material
from odak.catalog.materials import MICROMETRES, cauchy_through, model_glass
from odak.learn.raytracing.system.environment import Environment, expanded
from odak.learn.raytracing.system.operands import (
    Operand,
    Operands,
    View,
    checked_operands,
    clear_heights,
    given_heights,
    merit_deviations,
    merit_residuals,
    nearest_glasses,
    values_of,
)
from odak.learn.raytracing.system.optimise import LADDER, least_squares, linearised_forward
from odak.learn.raytracing.system.paraxial import check_media, entrance_pupil, matrix, signed_indices
from odak.learn.raytracing.system.pupils import AIMS, Pupil, pupil_of
from odak.learn.raytracing.system.specification import SETTINGS
from odak.learn.raytracing.system.surfaces import Prescription, checked_system, is_break, optical_system
from odak.learn.raytracing.system.zooms import configurations

VARIED = ("curvature", "conic", "thickness", "coefficients", "index", "shift", "tilt", "glass")
COPIED = ("curvature", "conic", "thickness", "coefficients")
# Share of the merit that an exchange of glasses must gain for another one.
LEAST_GAIN = 1e-3
SOLVES = ("focal_length", "marginal_height", "edge_thickness")


class Variable(NamedTuple):
    """Numbers of surfaces that an optimisation may change; of a number that a solve gives, the term added to it.

    Attributes
    ----------
    name : str
        "curvature", "conic", "thickness", "coefficients", "index" (of what is behind the surface, the same for all
        wavelengths), "shift", "tilt", or "glass": index n_d and Abbe number V_d of a model glass behind the surface.
    surfaces : int or sequence of int
        Of which surfaces.
    lower, upper : float or sequence of float, optional
        Bounds, one or one for each term; of glass for n_d and V_d, by default (1.44, 20) and (1.95, 85).
    terms : sequence of int, optional
        Which coefficients (0 is the coefficient of r²) or which of x, y (and z); all by default.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Variable
    >>> radii = Variable("curvature", [0, 1], lower=-0.05, upper=0.05)
    >>> radii.name, radii.upper
    ('curvature', 0.05)
    """

    name: str
    surfaces: int | Iterable[int]
    lower: float | Sequence[float] | None = None
    upper: float | Sequence[float] | None = None
    terms: Sequence[int] | None = None


class Pickup(NamedTuple):
    """A number that follows the number of another surface: scale·number + offset.

    Attributes
    ----------
    name : str
        "curvature", "conic", "thickness" or "coefficients".
    surface, source : int
        The surface that follows, and the one that it follows.
    scale, offset : float
        As above.

    Examples
    --------
    The second radius is the negative of the first:

    >>> from odak.learn.raytracing.system import Pickup
    >>> symmetric = Pickup("curvature", surface=1, source=0, scale=-1.0)
    >>> symmetric.scale * 0.02 + symmetric.offset
    -0.02
    """

    name: str
    surface: int
    source: int
    scale: float = 1.0
    offset: float = 0.0


class Solve(NamedTuple):
    """A parameter that is computed such that a first-order or an edge condition is met exactly.

    Attributes
    ----------
    kind : str
        "focal_length": the surface's curvature gives the system this focal length. "marginal_height": its thickness
        brings the paraxial marginal ray to this height at the next surface or the image, 0 for the paraxial focus.
        "edge_thickness": its thickness gives this distance to the next surface, along z, at `height`.
    surface : int
        Whose number is solved for.
    value : float
        As above.
    height : float, optional
        Distance from the axis of the edge.

    Examples
    --------
    The curvature of surface 1 gives the system a focal length of 100, its thickness the paraxial focus:

    >>> from odak.learn.raytracing.system import Solve
    >>> solves = [Solve("focal_length", 1, 100.0), Solve("marginal_height", 1)]
    >>> [solve.value for solve in solves]
    [100.0, 0.0]
    """

    kind: str
    surface: int
    value: float = 0.0
    height: float | None = None


class DesignResult(NamedTuple):
    """Result of an optimisation.

    Attributes
    ----------
    merit : float
        Half the sum of squares at the end.
    history : tuple of float
        The same at the start and after each step.
    converged : bool
        Whether it ended because nothing changed any more.
    values : torch.Tensor
        The variables at the end, ``[V]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Variable, lens_design, optical_system, surface
    >>> lens = optical_system([surface(80.0, thickness=4.0, material="N-BK7"), surface(-120.0, thickness=90.0)], 20.0)
    >>> found = lens_design(lens, ["spot"], [Variable("thickness", 1)]).optimise()
    >>> found.converged, found.merit == found.history[-1] < found.history[0], tuple(found.values.shape)
    (True, True, (1,))
    """

    merit: float
    history: tuple[float, ...]
    converged: bool
    values: torch.Tensor


class lens_design(_show.Shown):
    """Optimisation problem of a system: its operands, variables, pickups and solves.

    Parameters
    ----------
    system : optical_system
        The system; :meth:`optimise` and :meth:`apply` change it in place.
    operands : sequence of Operand or str
        Operands of the merit function; names alone are operands with the target 0.
    variables : sequence of Variable
        What may change.
    pickups : sequence of Pickup
        Numbers that follow others, applied in order after the variables.
    solves : sequence of Solve
        Solves, applied in order after the pickups: a solve for the focal length precedes one
        for the image distance.
    pupil : str, PupilQuadrature or torch.Tensor
        Pattern of :func:`pupil_samples` for spots and wavefronts, or points ``[P, 2]``, or points for each
        field ``[F, P, 2]``: surfaces of many coefficients then cannot wave between the rays.
    count : int
        Count of :func:`pupil_samples`.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Raises
    ------
    ValueError, TypeError
        If a description is malformed or names what the system does not have.

    Notes
    -----
    The Jacobian is exact and takes one pass for any number of variables and residuals: directions of all
    variables are carried forward together, and through the surfaces, where the work is, each ray's own derivatives are
    taken backward at once. Steps are computed with the bounds of operands that they would exceed.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Operand, Solve, Variable, lens_design, optical_system, surface
    >>> lens = optical_system([surface(80.0, thickness=4.0, material="N-BK7"), surface(-120.0, thickness=90.0)], 20.0)
    >>> design = lens_design(
    ...     lens,
    ...     ["spot"],
    ...     [Variable("curvature", 0)],
    ...     solves=[Solve("focal_length", 1, 100.0), Solve("marginal_height", 1)],
    ... )
    >>> design.optimise().converged, round(float(lens.surfaces[0].radius))
    (True, 60)
    """

    values: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    micrometres: torch.Tensor

    def __init__(
        self,
        system: optical_system,
        operands: Operands,
        variables: Variable | Iterable[Variable],
        *,
        pickups: Sequence[Pickup] = (),
        solves: Sequence[Solve] = (),
        pupil: Pupil = "rings",
        count: int = 4,
        aim: str = "paraxial",
    ):
        self.system: optical_system = checked_system(system)
        self.operands: list[Operand] = checked_operands(operands)
        self.pupil: Pupil = pupil
        self.count: int = _validate.integer("count", count, minimum=1)
        self.aim: str = _validate.one_of("aim", aim, AIMS)
        pupil_of(pupil, self.count, system)
        with torch.no_grad():
            held = (v.detach() if isinstance(v, torch.Tensor) else v for v in system.prescription())
            self.base: Prescription = Prescription._make(held)
        # That of one of several configurations; variables, pickups and solves are of the numbers at the nominal one.
        self.environment: Environment | None = None
        # Of several designs, which glasses are real ones already, [N, glasses].
        self.real: torch.Tensor | None = None
        self.pickups: list[Pickup] = [self._checked_pickup(item) for item in _items("pickups", pickups, Pickup)]
        self.solves: list[Solve] = [self._checked_solve(item) for item in _items("solves", solves, Solve)]
        self.solved: set[tuple[str, int]] = {(_number_of(item), item.surface) for item in self.solves}
        self.places: dict[str, list[tuple[int, int]]] = {}
        self.columns: dict[str, list[int]] = {}
        rows: list[tuple[float, ...]] = []
        for item in _items("variables", variables, Variable):
            item = item._replace(name=_validate.one_of("name of a variable", item.name, VARIED))
            for place, term, value, bounds in self._entries(item):
                if (place, term) in self.places.setdefault(item.name, []):
                    raise ValueError(f"{item.name} of surface {place} is a variable twice")
                self.places[item.name].append((place, term))
                self.columns.setdefault(item.name, []).append(len(rows))
                rows.append((value, *bounds))
        if not rows:
            raise ValueError("variables must contain at least one")
        self.values, self.lower, self.upper = torch.tensor(rows, dtype=torch.float64).T.contiguous()
        if bool((self.lower > self.upper).any()):
            raise ValueError("lower bounds of variables must be at most their upper bounds")
        self.micrometres = torch.tensor(system.wavelengths, dtype=torch.float64) * MICROMETRES[system.unit]
        self._check_followers()
        for item in self.solves:
            # The design starts from the present system: the variable is the difference from the value of the solve.
            name = _number_of(item)
            if (item.surface, 0) in self.places.get(name, ()):
                column = self.columns[name][self.places[name].index((item.surface, 0))]
                number = getattr(self._nominal(self.values), name)[item.surface]
                self.values[column] = getattr(self.base, name)[item.surface] - number
        self.refresh()

    def _entries(self, item: Variable):
        """Yield surface, term, value and bounds of all numbers of a variable."""
        name, count = item.name, len(self.system.surfaces)
        for place in _listed(item.surfaces):
            place = _validate.place_in("surfaces of a variable", place, count)
            values = [0.0] if (name, place) in self.solved else self._now(name, place)
            terms = range(len(values)) if item.terms is None else _listed(item.terms)
            for j, term in enumerate(terms):
                term = _validate.place_in("terms of a variable", term, len(values))
                usual = ((1.44, 20.0), (1.95, 85.0)) if name == "glass" else ((-torch.inf,), (torch.inf,))
                sides = [
                    default[j if len(default) > 1 else 0]
                    if side is None
                    else float(
                        _validate.number("bound of a variable", _listed(side)[j if len(_listed(side)) > 1 else 0])
                    )
                    for side, default in ((item.lower, usual[0]), (item.upper, usual[1]))
                ]
                yield place, term, float(values[term]), sides

    def _now(self, name: str, place: int) -> list[float]:
        """Return the numbers of a surface as they are."""
        item: Any = self.system.surfaces[place]
        if name == "glass":
            if item.material is None or isinstance(item.material, str):
                raise ValueError(f"glass of surface {place} must be a material of the catalogue to vary")
            return [float(item.material.index(0.5875618)), float(item.material.abbe_number())]
        if name == "index":
            if item.material is not None:
                raise ValueError(f"index of surface {place} cannot vary: its material is not a number")
            return [float(self.base.index[self.system.reference, place + 1])]
        if name in ("curvature", "conic", "coefficients"):
            self._check_own_numbers(name, place)
        if name in ("shift", "tilt"):
            return [float(v) for v in getattr(item, name)]
        if name == "coefficients":
            if not item.coefficients.numel():
                raise ValueError(f"coefficients of surface {place} are empty; give it zeros to vary")
            return [float(v) for v in item.coefficients]
        return [float(getattr(self.base, name)[place])]

    def _check_own_numbers(self, name: str, place: int) -> None:
        """Raise ValueError for a surface whose shape has other numbers than curvature, conic and coefficients."""
        item: Any = self.system.surfaces[place]
        if item.own_shape is not None or is_break(item):
            kind = "coordinate break" if is_break(item) else item.own_shape.kind.__name__
            raise ValueError(f"{name} of surface {place} cannot vary: it is a {kind}")

    def _checked_pickup(self, item: Pickup) -> Pickup:
        count = len(self.system.surfaces)
        name = _validate.one_of("name of a pickup", item.name, COPIED)
        places = [_validate.place_in("surface of a pickup", place, count) for place in (item.surface, item.source)]
        scale, offset = (_validate.constant("scale of a pickup", v) for v in (item.scale, item.offset))
        for place in places if name != "thickness" else ():
            self._check_own_numbers(name, place)
        return Pickup(name, places[0], places[1], scale, offset)

    def _checked_solve(self, item: Solve) -> Solve:
        kind = _validate.one_of("kind of a solve", item.kind, SOLVES)
        place = _validate.place_in("surface of a solve", item.surface, len(self.system.surfaces))
        value = _validate.constant("value of a solve", item.value)
        if kind == "edge_thickness" and item.height is None:
            raise ValueError("a solve for the edge thickness needs the height of the edge")
        if kind == "focal_length":
            if value == 0:
                raise ValueError("value of a solve for the focal length must not be 0")
            self._check_own_numbers("curvature", place)
            here = self.system.surfaces[place]
            before, behind = self.base.index[self.system.reference, place : place + 2]
            if not here.reflects and here.own_gradient is None and bool(before == behind):
                raise ValueError(f"curvature of surface {place} has no power for a solve: one medium is on both sides")
        if kind != "edge_thickness":
            check_media(self.system, self.base)
        if kind == "marginal_height" and self.system.surfaces[place].own_gradient is not None:
            raise ValueError(f"thickness of surface {place} cannot be solved for: the medium behind it is graded")
        height = None if item.height is None else _validate.constant("height of a solve", item.height, least=0)
        return Solve(kind, place, value, height)

    def _check_followers(self) -> None:
        taken = {(name, place) for name, places in self.places.items() for place, _ in places} - self.solved
        followers: list[Pickup | Solve] = [*self.pickups, *self.solves]
        for item in followers:
            name = item.name if isinstance(item, Pickup) else _number_of(item)
            if (name, item.surface) in taken:
                raise ValueError(f"{name} of surface {item.surface} is given twice: by a variable, pickup or solve")
            taken.add((name, item.surface))

    def refresh(self) -> None:
        """Take the clear semi-diameters, at which edges are evaluated, from the surfaces if all of them have one.

        Otherwise they are those of the rays, at whatever values of the variables an operand is evaluated.
        """
        self.heights: torch.Tensor | None = given_heights(self.system)

    def clear_heights(self, values: torch.Tensor) -> torch.Tensor:
        """Return the largest distance from the axis of rays on each surface, ``[..., S]``, for values ``[..., V]``."""
        return clear_heights(self.system, self.prescription(values), aim=self.aim)

    def prescription(self, values: torch.Tensor) -> Prescription:
        """Return the numbers of the system for values of the variables.

        Parameters
        ----------
        values : torch.Tensor
            ``[..., V]``.

        Returns
        -------
        Prescription
            With the axes ``[...]`` as a batch of systems; pickups and solves applied.
        """
        p = self._nominal(values)
        return p if self.environment is None else expanded(self.system, p, self.environment)

    def _nominal(self, values: torch.Tensor) -> Prescription:
        """Return the numbers for values of the variables, those at the nominal temperature."""
        values, p = self._checked(values), self.base
        if p.index.ndim > 2:
            # One row for each of several designs, each of which may be evaluated at several values.
            p = p._replace(index=p.index.reshape(len(p.index), *(1,) * (values.ndim - 2), *p.index.shape[-2:]))
        for name, places in self.places.items():
            chosen = values[..., self.columns[name]]
            if name == "glass":
                p = p._replace(index=self._glass_indices(p.index, chosen, places))
                continue
            old = p.index if name == "index" else getattr(p, name)
            if old is None:
                items: list[Any] = list(self.system.surfaces)
                count = 2 if name == "shift" else max(2, *(len(item.tilt) for item in items))
                old = torch.zeros(len(self.system.surfaces), count, dtype=torch.float64)
            p = _with(p, name, _placed(old, chosen, places, name))
        for item in self.pickups:
            own = getattr(p, item.name)
            axis = -2 if item.name == "coefficients" else -1
            followed = own.select(axis, item.source) * item.scale + item.offset
            p = _with(p, item.name, _set(own, item.surface, followed, axis))
        for item in self.solves:
            name, added = _number_of(item), getattr(p, _number_of(item))[..., item.surface]
            p = _SOLVERS[item.kind](self.system, p, item)
            if (item.surface, 0) in self.places.get(name, ()):
                # The entry contained the variable, which is added to the value of the solve.
                given = getattr(p, name)
                p = _with(p, name, _set(given, item.surface, given[..., item.surface] + added, -1))
        return p

    def _checked(self, values: Any) -> torch.Tensor:
        """Return values of the variables in float64 after checking how many they are."""
        values = _validate.real("values", values)
        _validate.instance("values", values, torch.Tensor, "a tensor")
        _validate.shaped("values", values, f"[..., {len(self.values)}]")
        return values.double()

    def _glass_indices(self, index, chosen, places):
        """Return refractive indices in which the columns of some surfaces are replaced by model glasses."""
        squared = self.micrometres**2
        for j in range(0, len(places), 2):
            a, b, c = cauchy_through(chosen[..., j, None], chosen[..., j + 1, None])
            found, place = a + b / squared + c / squared**2, places[j][0] + 1
            if self.real is not None:
                real = self.real[:, j // 2].reshape(-1, *(1,) * (found.ndim - 1))
                found = torch.where(real, index[..., place], found)
            index = _set(index, place, found, -1)
        return index

    def view(self, values: torch.Tensor) -> View:
        """Return the system at some values of the variables, ``[..., V]``, for operands."""
        glass, values = None, self._checked(values)
        if "glass" in self.places:
            shape = (*values.shape[:-1], len(self.system.surfaces), 2)
            zero = torch.zeros(shape, dtype=torch.float64)
            glass = _placed(zero, values[..., self.columns["glass"]], self.places["glass"], "glass")
        heights = self.heights
        if heights is not None and heights.ndim > 1:
            # One row for each of several designs, each of which may be evaluated at several values.
            heights = heights.reshape(len(heights), *(1,) * (values.ndim - 2), -1)
        return View(self.system, self.prescription(values), self.pupil, self.count, self.aim, heights, glass)

    def residuals(self, values: torch.Tensor) -> torch.Tensor:
        """Return the residuals ``[..., R]`` at values ``[..., V]``; NaN where a ray is lost."""
        return merit_residuals(self.operands, self.view(values))

    def linearised(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the residuals ``[..., R]`` and their exact Jacobian ``[..., R, V]`` at values ``[..., V]``."""
        return linearised_forward(self.residuals, self._checked(values))

    def _deviations(self, values: torch.Tensor) -> tuple[torch.Tensor, list[bool]]:
        """Return the residuals and which of them are of bounds; a bound that is kept has a negative one."""
        return merit_deviations(self.operands, self.view(values))

    def _linearised_with_limits(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return what :meth:`_deviations` does, and their Jacobian as :meth:`linearised` does."""
        limits: list[bool] = []

        def deviations(values):
            found, limits[:] = self._deviations(values)
            return found

        value, jacobian = linearised_forward(deviations, self._checked(values))
        return value, jacobian, torch.tensor(limits, device=value.device)

    def report(self) -> list[tuple[Operand, torch.Tensor, float]]:
        """Return each operand with its values and its share of the merit, for the variables as they are."""
        with torch.no_grad():
            view = self.view(self.values)
            found = []
            for operand in self.operands:
                values = values_of(operand, view)
                found.append((operand, values, 0.5 * float(operand.residuals(values).square().sum())))
        return found

    def optimise(
        self,
        iterations: int = 50,
        *,
        damping: float = 1e-2,
        tolerance: float = 1e-9,
        rounds: int = 1,
        callback: Callable[[int, float], bool | None] | None = None,
    ) -> DesignResult:
        """Minimise the merit by Levenberg and Marquardt's method, and change the system.

        Parameters
        ----------
        iterations : int
            Steps at most, in each round.
        damping : float
            Damping of the first step, relative to the diagonal of JᵀJ.
        tolerance : float
            A round ends when the merit or the numbers change by less than this, relatively.
        rounds : int
            Runs one after the other; before each the clear semi-diameters are taken anew.
        callback : callable, optional
            Told of each step, ``callback(number, merit)``; ends the run by returning True.

        Returns
        -------
        DesignResult
            Within a round the merit never rises.

        Raises
        ------
        ValueError
            If rays are lost at the start.
        """
        damping, tolerance = _validate.constants(damping=damping, tolerance=tolerance)
        history: list[float] = []
        _validate.integer("rounds", rounds, minimum=1)
        _validate.function_or_none("callback", callback)
        for _ in range(rounds):
            found = self._minimised(
                self.values[None],
                iterations,
                damping,
                tolerance,
                None if callback is None else lambda number, loss: callback(number, float(loss[0])),
            )
            history += [float(loss[0]) for loss in found.history]
            self.apply(found.x[0])
        return DesignResult(history[-1], tuple(history), found.converged, self.values)

    def _minimised(
        self,
        starts,
        iterations: int,
        damping: Any = 1e-2,
        tolerance: float = 1e-9,
        callback=None,
        basis=None,
        floor=0.0,
    ):
        """Minimise from several starts ``[N, V]`` side by side, over their coefficients in the columns of a basis.

        The basis ``[N, V, V]`` must leave variables with bounds other than 0 and infinity as they are.
        """
        _validate.integer("iterations", iterations, minimum=1)
        if not isinstance(damping, torch.Tensor):
            _validate.number("damping", damping, positive=True)
        _validate.number("tolerance", tolerance, least=0)

        def losses(candidates):
            with torch.no_grad():
                values = candidates if basis is None else candidates @ basis.mT
                return 0.5 * self.residuals(values).square().sum(-1)

        def linearised(numbers):
            if basis is None:
                return self._linearised_with_limits(numbers)
            value, jacobian, limits = self._linearised_with_limits((numbers[:, None] @ basis.mT)[:, 0])
            return value, jacobian @ basis, limits

        found = least_squares(
            linearised,
            losses,
            starts if basis is None else torch.linalg.solve(basis, starts),
            lower=self.lower,
            upper=self.upper,
            iterations=iterations,
            damping=damping,
            tolerance=tolerance,
            callback=callback,
            ladder=LADDER,
            floor=floor,
        )
        return found if basis is None else found._replace(x=(found.x[:, None] @ basis.mT)[:, 0])

    def restarts(self, count: int = 16, spread: float = 0.2, seed: int = 0, iterations: int = 30) -> DesignResult:
        """Optimise from several random starts, and change the system to the best result if it is better.

        Parameters
        ----------
        count : int
            Number of starts; the first is the system as it is.
        spread : float
            Standard deviation of the starts, relative to the range of a number with bounds on both sides, otherwise to
            its size or, if larger, to the mean size of the numbers of its kind.
        seed : int
            Of the random numbers: the same seed gives the same result.
        iterations : int
            Steps at most from each start.

        Returns
        -------
        DesignResult
            Of the best one.
        """
        count = _validate.integer("count", count, minimum=1)
        spread = _validate.constant("spread", spread, positive=True)
        generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
        scale = self.values.abs()
        for columns in self.columns.values():
            scale[columns] = torch.maximum(scale[columns], scale[columns].mean())
        bounded = torch.isfinite(self.upper - self.lower)
        scale = torch.where(bounded, self.upper - self.lower, scale)
        drawn = torch.randn(count, len(scale), dtype=torch.float64, generator=generator)
        drawn[0] = 0.0
        found = self._minimised(self.values + spread * scale * drawn, iterations)
        best = int(found.loss.argmin())
        self.apply(found.x[best])
        history = tuple(float(loss[best]) for loss in found.history)
        return DesignResult(history[-1], history, found.converged, self.values)

    def apply(self, values: torch.Tensor) -> None:
        """Write values of the variables, and what follows from them, to the system.

        Parameters
        ----------
        values : torch.Tensor
            ``[V]``.
        """
        with torch.no_grad():
            self.values = self._checked(values).detach().clone()
            p = self._nominal(self.values)
            followers: dict[str, set[int]] = {name: set() for name in COPIED}
            for name, places in self.places.items():
                followers.setdefault(name, set()).update(place for place, _ in places)
            for item in self.pickups:
                followers[item.name].add(item.surface)
            for item in self.solves:
                followers[_number_of(item)].add(item.surface)
            for name, places in followers.items():
                for place in sorted(places):
                    self._write(name, place, p)
            self.base = p
        self.refresh()

    def _write(self, name: str, place: int, p: Prescription) -> None:
        item: Any = self.system.surfaces[place]
        if name == "glass":
            j = next(j for j, (i, _) in enumerate(self.places["glass"]) if i == place)
            nd, vd = (float(self.values[self.columns["glass"][j + k]]) for k in (0, 1))
            item.material = model_glass(nd, vd)
        elif name == "index":
            item.index.copy_(p.index[self.system.reference, place + 1])
        elif name == "curvature":
            if "radius_value" in dict(item.named_buffers()) | dict(item.named_parameters()):
                value = p.curvature[place]
                if value == 0:
                    raise ValueError(f"curvature of surface {place} became 0, and it is held as a radius")
                item.radius_value.copy_(1 / value)
            else:
                item.curvature_value.copy_(p.curvature[place])
        elif name == "coefficients":
            item.coefficients.copy_(p.coefficients[place, : item.coefficients.numel()])
        else:
            held = getattr(item, name)
            held.copy_(getattr(p, name)[place][: held.numel()] if held.ndim else getattr(p, name)[place])

    def substitute_glasses(
        self, makers: Iterable[str] = ("schott",), candidates: int = 3, iterations: int = 20
    ) -> tuple[str, ...]:
        """Replace the variable glasses by real ones, and optimise the rest.

        Parameters
        ----------
        makers : iterable of str
            Of :func:`odak.catalog.glass_makers`.
        candidates : int
            How many of the nearest glasses are tried for each surface.
        iterations : int
            Steps at most for each choice of glasses.

        Returns
        -------
        tuple of str
            The names, in the order of the surfaces. The variables of glass are gone afterwards.

        Notes
        -----
        First one of the glasses becomes real, any of them and any of the nearest, while the others still vary, then the
        next. At last all lenses in which one glass is exchanged for one of its neighbours are optimised side by side,
        and the best takes the place of the lens, until none is better.
        """
        candidates = _validate.integer("candidates", candidates, minimum=1)
        makers = tuple(_validate.texts("makers", makers))
        _validate.integer("iterations", iterations, minimum=1)
        if "glass" not in self.places:
            return ()
        return self._take_glasses(self.values[None], makers, candidates, iterations, _run)

    def _take_glasses(self, starts, makers: tuple[str, ...], candidates: int, iterations: int, run: Callable[..., Any]):
        """Do the work of :meth:`substitute_glasses` from several starts ``[N, V]``.

        `run` takes a design, values ``[N, V]`` and a number of steps, and returns optimised values and merits.
        """
        columns = torch.tensor(self.columns["glass"]).reshape(-1, 2).tolist()
        places = [place for place, _ in self.places["glass"][::2]]

        def best_of(rows: list[Any], values: list[Any], keep: int) -> list[Any]:
            """Return merits, glasses and values of the best of several choices: first few steps, then all for a few."""
            held = torch.stack(values)
            for row, own in zip(rows, held, strict=True):
                for pair, name in zip(columns, row, strict=True):
                    if name is not None:
                        own[pair] = torch.tensor(_published(name), dtype=torch.float64)
            for count in (max(1, iterations // 4), iterations):
                held, merit = run(self._with_glasses(rows), held, count)
                order = merit.argsort(stable=True)[: max(keep, len(rows) // 4)].tolist()
                rows, held, merit = [rows[i] for i in order], held[order], merit[order]
            order = merit.argsort(stable=True)[:keep].tolist()
            return [(float(merit[i]), rows[i], held[i]) for i in order]

        found: list[Any] = [(0.0, (None,) * len(columns), start) for start in starts]
        for _ in columns:
            choices: dict[Any, Any] = {}
            for _, row, values in found:
                for j, pair in enumerate(columns):
                    for name in nearest_glasses(values[pair].tolist(), candidates, makers) if row[j] is None else ():
                        choices.setdefault((*row[:j], name, *row[j + 1 :]), values)
            found = best_of(list(choices), list(choices.values()), len(starts))
        best, tried = found[0], {row for _, row, _ in found}
        while candidates > 1:
            rows = [
                (*best[1][:j], other, *best[1][j + 1 :])
                for j, own in enumerate(best[1])
                for other in nearest_glasses(_published(own), candidates + 1, makers)
            ]
            rows = [row for row in dict.fromkeys(rows) if row not in tried]
            tried.update(rows)
            found = best_of(rows, [best[2]] * len(rows), 1) if rows else [best]
            if not found[0][0] < (1 - LEAST_GAIN) * best[0]:
                break
            best = found[0]
        _, chosen, values = best
        kept = self._settle(chosen)
        self.apply(values[kept])
        return tuple(name for _, name in sorted(zip(places, chosen, strict=True)))

    def _with_glasses(self, rows: Sequence[Sequence[str | None]]) -> "lens_design":
        """Return the design of N lenses with real glasses, N rows of them, in place of the variable ones but None."""
        found = copy.copy(self)
        found.real = torch.tensor([[name is not None for name in row] for row in rows])
        index = self.base.index.expand(len(rows), *self.base.index.shape[-2:]).clone()
        for k, row in enumerate(rows):
            for (place, _), name in zip(self.places["glass"][::2], row, strict=True):
                if name is not None:
                    index[k, :, place + 1] = material(name).index(self.micrometres)
        found.base = self.base._replace(index=index)
        return found

    def _settle(self, names: Sequence[str]) -> list[int]:
        """Put real glasses in place of all variable ones, and return the columns of the variables that remain."""
        self.base = self.base._replace(index=self._with_glasses([names]).base.index[0])
        for (place, _), name in zip(self.places["glass"][::2], names, strict=True):
            item: Any = self.system.surfaces[place]
            item.material = material(name)
        taken = self.columns.pop("glass")
        del self.places["glass"]
        kept = [c for c in range(len(self.values)) if c not in taken]
        self.columns = {key: [kept.index(c) for c in columns] for key, columns in self.columns.items()}
        self.values, self.lower, self.upper = (v[kept] for v in (self.values, self.lower, self.upper))
        self.operands = [item for item in self.operands if item.kind != "glass"]
        return kept


class zoom_design(lens_design):
    """Optimisation over all configurations of a system: one merit, shared numbers, and numbers of each configuration.

    Parameters
    ----------
    zoom : configurations
        The configurations; :meth:`optimise` and :meth:`apply` change them and their system in place.
    operands : sequence of Operand or str
        Operands, which count in every configuration. `target`, `lower`, `upper` and `weight` may be sequences of one
        number for each.
    variables : sequence of Variable
        What may change. Numbers that the settings of the configurations have, and differences from solves, are
        variables of each configuration; all others are shared.
    pickups : sequence of Pickup
        Numbers that follow others.
    solves : sequence of Solve
        Solves of numbers that the settings have; of any numbers where the settings are temperatures, pressures and
        mounts alone.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points; of :class:`lens_design`.
    count : int
        Count of :func:`pupil_samples`.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Raises
    ------
    ValueError, TypeError
        If a description is malformed, names what the system does not have, solves for a shared number, or varies a
        glass where the settings have temperatures.

    Notes
    -----
    Fields, apertures and distances of the object may differ between the configurations. The columns of
    `values` are in the order of the first configuration; a variable that each configuration has for itself is followed
    by the same variable of the others. Where the
    settings have temperatures, variables, pickups and solves are of the numbers at 20 °C, and operands are evaluated
    at the temperature. Glasses, whose dn/dT would be unknown, are then no variables.

    Examples
    --------
    Two ideal lenses whose distances give focal lengths of 150 and 100 and a sharp image:

    >>> from odak.learn.raytracing.system import Operand, Variable, configurations, optical_system, surface, zoom_design
    >>> from odak.raytracing.interfaces import IdealLens
    >>> lenses = [surface(phase=IdealLens(50.0), thickness=32.0), surface(phase=IdealLens(-30.0), thickness=50.0)]
    >>> zoom = configurations(
    ...     optical_system(lenses, 10.0), [("thickness", 0, [31.0, 34.0]), ("thickness", 1, [50.0, 40.0])]
    ... )
    >>> wanted = Operand("focal_length", target=[150.0, 100.0])
    >>> found = zoom_design(zoom, [wanted, "spot"], Variable("thickness", [0, 1])).optimise()
    >>> [round(value, 3) for value in found.values.tolist()]
    [30.0, 35.0, 60.0, 30.0]
    """

    def __init__(
        self,
        zoom: configurations,
        operands: Operands,
        variables: Variable | Iterable[Variable],
        *,
        pickups: Sequence[Pickup] = (),
        solves: Sequence[Solve] = (),
        pupil: Pupil = "rings",
        count: int = 4,
        aim: str = "paraxial",
    ):
        _validate.instance("zoom", zoom, configurations, "configurations of a system")
        self.zoom = zoom
        options: dict[str, Any] = {"pickups": pickups, "solves": solves, "pupil": pupil, "count": count, "aim": aim}
        listed = _listed(operands) if not isinstance(operands, (str, Operand)) else [operands]
        with torch.no_grad():
            self.each: list[lens_design] = [
                lens_design(
                    zoom._view(c, True, False),
                    [_of_configuration(item, c, zoom.count) for item in listed],
                    variables,
                    **options,
                )
                for c in range(zoom.count)
            ]
            for c, design in enumerate(self.each):
                design.environment = zoom._environment(c)
                design.refresh()
        if "glass" in self.each[0].places and zoom._environment(0) is not None:
            raise ValueError("variables must not be glasses where the settings have temperatures: dn/dT is unknown")
        first = self.each[0]
        self.__dict__.update({name: value for name, value in first.__dict__.items() if name not in self.__dict__})
        self.system: optical_system = zoom.system
        self.heights: torch.Tensor | None = None
        own = {(name, place) for name, place, _ in zoom.settings}
        # Where the environment alone differs, solves are of the same numbers everywhere, those at 20 °C.
        alone = all(name in SETTINGS["environment"] for name, _ in own)
        for name, place in () if alone else sorted(self.solved - own):
            raise ValueError(f"solves must be for what the settings have, got one for the {name} of surface {place}")
        values: list[tuple[Any, ...]] = []
        self.columns: dict[str, list[int]] = {}
        self.rows: list[list[int]] = [[0] * len(first.values) for _ in self.each]
        for name, places in self.places.items():
            for (place, _), column in zip(places, first.columns[name], strict=True):
                for design, row in zip(self.each, self.rows, strict=True):
                    if design is first or (name, place) in own:
                        self.columns.setdefault(name, []).append(len(values))
                        values.append((design.values[column], design.lower[column], design.upper[column]))
                    row[column] = len(values) - 1
        self.values, self.lower, self.upper = (torch.stack(part) for part in zip(*values, strict=True))

    def prescription(self, values: torch.Tensor) -> Prescription:
        """Return the numbers of all configurations for values of the variables.

        Parameters
        ----------
        values : torch.Tensor
            ``[..., V]``.

        Returns
        -------
        Prescription
            With the axes ``[..., C]`` as a batch of systems.
        """
        values = self._checked(values)
        parts = [design.prescription(values[..., row]) for design, row in zip(self.each, self.rows, strict=True)]

        def stacked(column: tuple[Any, ...]) -> Any:
            if not isinstance(column[0], torch.Tensor):
                return column[0]
            return torch.stack(torch.broadcast_tensors(*column), min(values.ndim - 1, column[0].ndim - 1))

        waves = parts[0].wavelengths
        return Prescription(*map(stacked, zip(*parts, strict=True)))._replace(wavelengths=waves)

    def residuals(self, values: torch.Tensor) -> torch.Tensor:
        """Return the residuals of all configurations ``[..., R]`` at values ``[..., V]``; NaN where a ray is lost."""
        values = self._checked(values)
        parts = [design.residuals(values[..., row]) for design, row in zip(self.each, self.rows, strict=True)]
        return torch.cat(parts, -1)

    def _deviations(self, values: torch.Tensor) -> tuple[torch.Tensor, list[bool]]:
        values = self._checked(values)
        parts = [design._deviations(values[..., row]) for design, row in zip(self.each, self.rows, strict=True)]
        return torch.cat([part for part, _ in parts], -1), [flag for _, flags in parts for flag in flags]

    def refresh(self) -> None:
        """Compute the clear semi-diameters of each configuration from its rays."""
        for design in self.each:
            design.refresh()

    def report(self) -> list[tuple[Operand, torch.Tensor, float]]:
        """Return the reports of the configurations one after the other."""
        return [row for design in self.each for row in design.report()]

    def apply(self, values: torch.Tensor) -> None:
        """Write values of the variables, and what follows from them, to the system and its settings.

        Parameters
        ----------
        values : torch.Tensor
            ``[V]``.
        """
        self.values = self._checked(values).detach().clone()
        for design, row in zip(self.each, self.rows, strict=True):
            design.apply(self.values[row])
        self._share_glasses([place for place, _ in self.places.get("glass", ())])

    def _share_glasses(self, places: Iterable[int]) -> None:
        """Give the system the glasses that the configurations have behind some surfaces."""
        for place in places:
            item, held = (system.surfaces[place] for system in (self.system, self.each[0].system))
            item.material = held.material  # type: ignore[union-attr]

    def _with_glasses(self, rows: Sequence[Sequence[str | None]]) -> "lens_design":
        found = copy.copy(self)
        found.each = [design._with_glasses(rows) for design in self.each]
        return found

    def _settle(self, names: Sequence[str]) -> list[int]:
        taken, places = self.columns["glass"], [place for place, _ in self.places["glass"]]
        kept = [c for c in range(len(self.values)) if c not in taken]
        for k, design in enumerate(self.each):
            self.rows[k] = [kept.index(self.rows[k][c]) for c in design._settle(names)]
        self.places, self.operands = self.each[0].places, self.each[0].operands
        self.columns = {
            key: [kept.index(c) for c in columns] for key, columns in self.columns.items() if key != "glass"
        }
        self.values, self.lower, self.upper = (v[kept] for v in (self.values, self.lower, self.upper))
        self._share_glasses(places)
        return kept


def _of_configuration(item: Any, place: int, count: int) -> Any:
    """Return an operand with its numbers for one of several configurations."""
    if not isinstance(item, Operand):
        return item
    numbers = {name: getattr(item, name) for name in ("target", "weight", "lower", "upper")}
    for name, value in numbers.items():
        if isinstance(value, Iterable):
            numbers[name] = _validate.several(f"{name} of an operand", value, count)[place]
    return item._replace(**numbers)


def _published(name: str) -> tuple[float, float]:
    glass: Any = material(name)  # only glasses with a published n_d and V_d are taken
    return glass.nd, glass.vd


def _run(design: lens_design, values: torch.Tensor, iterations: int) -> tuple[torch.Tensor, torch.Tensor]:
    found = design._minimised(values, iterations)
    return found.x, found.loss


def _number_of(item: Solve) -> str:
    """Return which number of its surface a solve gives."""
    return "curvature" if item.kind == "focal_length" else "thickness"


def _items(name: str, values: Any, kind: type[Any]) -> list[Any]:
    listed = [values] if isinstance(values, kind) else list(values) if isinstance(values, Iterable) else [values]
    if not all(isinstance(item, kind) for item in listed):
        raise TypeError(f"{name} must be a sequence of {kind.__name__}, got {values!r:.80}")
    return listed


def _listed(values: Any) -> list[Any]:
    return list(values) if isinstance(values, Iterable) else [values]


def _placed(old: torch.Tensor, chosen: torch.Tensor, places: list[Any], name: str) -> torch.Tensor:
    """Return numbers with those chosen, ``[..., n]``, in their places."""
    if name == "index":
        for j, (place, _) in enumerate(places):
            old = _set(old, place + 1, chosen[..., j, None], -1)
        return old
    deep = name in ("coefficients", "shift", "tilt", "glass")
    tail = old.shape[-2:] if deep else old.shape[-1:]
    where = torch.tensor([place * tail[-1] + term if deep else place for place, term in places])
    spread = torch.nn.functional.one_hot(where, tail.numel()).to(old)
    kept = old.reshape(*old.shape[: old.ndim - len(tail)], -1) * (1 - spread.sum(0))
    return (kept + chosen @ spread).unflatten(-1, tail)


def _set(whole: torch.Tensor, place: int, value: torch.Tensor, axis: int) -> torch.Tensor:
    """Return numbers with one of them, along an axis counted from the end, replaced."""
    shape = np.broadcast_shapes(whole.select(axis, 0).shape, value.shape)
    whole = whole.expand(*shape[: len(shape) + axis + 1], whole.shape[axis], *shape[len(shape) + axis + 1 :])
    parts = list(whole.unbind(axis))
    parts[place] = value.expand(shape)
    return torch.stack(parts, axis)


def _with(p: Prescription, name: str, value: Any) -> Prescription:
    """Return a prescription with one of its fields, given by name, replaced."""
    return p._replace(**{name: value})


def _solve_focal_length(system, p: Prescription, item: Solve) -> Prescription:
    """Return the numbers with a curvature for the focal length: element C of the whole is linear in the curvature."""
    one = p.at(system.reference)
    index, scale = signed_indices(system, one), abs(1 / item.value)
    found = []
    for curvature in (0.0, scale):
        bent = _set(one.curvature, item.surface, torch.full_like(one.curvature[..., item.surface], curvature), -1)
        found.append(matrix(one._replace(curvature=bent), index, 0, len(system.surfaces)).c)
    curvature = (-1 / item.value - found[0]) * scale / (found[1] - found[0])
    return p._replace(curvature=_set(p.curvature, item.surface, curvature, -1))


def _solve_marginal_height(system, p: Prescription, item: Solve) -> Prescription:
    """Return the numbers with a thickness behind which the marginal ray has a height."""
    one = p.at(system.reference)
    index = signed_indices(system, one)
    to = matrix(one, index, 0, item.surface + 1)
    pupil = entrance_pupil(system, prescription=one)
    far = system.at_infinity
    height, slope = (pupil.reach, 0 * pupil.reach) if far else (system.object_distance * pupil.reach, pupil.reach)
    y = to.a * height + to.b * index[..., 0] * slope
    nu = to.c * height + to.d * index[..., 0] * slope
    thickness = (item.value - y) * index[..., item.surface + 1] / nu
    return p._replace(thickness=_set(p.thickness, item.surface, thickness, -1))


def _solve_edge_thickness(system, p: Prescription, item: Solve) -> Prescription:
    """Return the numbers with a thickness that leaves a distance at the edge."""
    i, height = item.surface, torch.tensor(item.height, dtype=torch.float64)
    thickness = item.value + p.shape(i).sag(0 * height, height).height
    if i + 1 < len(system.surfaces):
        thickness = thickness - p.shape(i + 1).sag(0 * height, height).height
    return p._replace(thickness=_set(p.thickness, i, torch.as_tensor(thickness), -1))


_SOLVERS = {
    "focal_length": _solve_focal_length,
    "marginal_height": _solve_marginal_height,
    "edge_thickness": _solve_edge_thickness,
}
