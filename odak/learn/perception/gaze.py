"""Movements of the eye: traces of saccades and fixations, drawn or read from the file of an eye tracker."""

import csv
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from odak import _validate
from odak.learn._tensors import places_between, tensor
from odak.learn.perception.csf import not_negative
from odak.learn.perception.sight import Viewing, checked_viewing
from odak.tools.paths import naming, regular_file, validate_path

# Duration of a saccade in seconds and seconds per degree: Carpenter, Movements of the Eyes (Pion, 1988).
SHORTEST, PER_DEGREE = 0.021, 0.0022
# Speed in degrees per second above which the eye is in a saccade: Salvucci and Goldberg, ETRA (2000).
FASTEST = 30.0
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def saccade_duration(amplitude: torch.Tensor | float) -> torch.Tensor:
    """Return how long a saccade takes, in seconds: 21 ms and 2.2 ms per degree.

    Parameters
    ----------
    amplitude : torch.Tensor or float
        In degrees, 0 or more.

    Returns
    -------
    torch.Tensor
        Float64 of plain numbers; differentiable.

    Raises
    ------
    ValueError, TypeError
        If an amplitude is negative or no number.

    Notes
    -----
    Carpenter, *Movements of the Eyes* (Pion, 1988): the main sequence, which Bahill, Clark and Stark, Math. Biosci. 24,
    191 (1975), named.

    Examples
    --------
    >>> from odak.learn.perception import saccade_duration
    >>> round(saccade_duration(10.0).item(), 3)
    0.043
    """
    return SHORTEST + PER_DEGREE * not_negative("amplitude", amplitude)


@dataclass(frozen=True, repr=False)
class GazeTrace:
    """Where an eye looked at each of a number of times.

    Parameters
    ----------
    seconds : torch.Tensor
        Rising times ``[N]``, at least two.
    gaze : torch.Tensor
        (x, y) at each, 0 to 1 from the top-left corner of the picture ``[N, 2]``.
    viewing : Viewing
        Geometry, for angles.

    Raises
    ------
    ValueError, TypeError
        If times do not rise or the shapes do not fit.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import GazeTrace, Viewing
    >>> trace = GazeTrace(torch.tensor([0.0, 0.1]), torch.tensor([[0.5, 0.5], [0.6, 0.5]]), Viewing(0.7, 0.7))
    >>> trace
    GazeTrace: 2 samples in 0.1 s
    >>> [round(value, 2) for value in trace.at([0.05])[0].tolist()], round(float(trace.speed()[0]))
    ([0.55, 0.5], 57)
    """

    seconds: torch.Tensor
    gaze: torch.Tensor
    viewing: Viewing

    def __post_init__(self) -> None:
        _validate.shaped("seconds", self.seconds, "[N]")
        _validate.shaped("gaze", self.gaze, "[N, 2]")
        checked_viewing(self.viewing)
        if len(self.seconds) < 2 or len(self.seconds) != len(self.gaze):
            raise ValueError(f"gaze must have a row for each of two or more seconds, got {tuple(self.gaze.shape)}")
        if not bool((self.seconds.diff() > 0).all()) or not bool(self.gaze.isfinite().all()):
            raise ValueError("seconds must rise and gaze be finite")

    def at(self, seconds: torch.Tensor | list[float]) -> torch.Tensor:
        """Return the gaze ``[F, 2]`` at some times, between samples linearly; differentiable in gaze and times.

        Parameters
        ----------
        seconds : torch.Tensor or list of float
            Times ``[F]``; before the first and after the last sample the gaze rests.
        """
        wanted = tensor("seconds", seconds, self.seconds.dtype, self.seconds.device)
        _validate.shaped("seconds", wanted, "[F]")
        before, share = places_between(self.seconds, wanted)
        return torch.lerp(self.gaze[before], self.gaze[before + 1], share.to(self.gaze)[:, None])

    def speed(self) -> torch.Tensor:
        """Return the angular speed between the samples in degrees per second ``[N − 1]``."""
        sides = self._directions()
        cross = torch.linalg.vector_norm(torch.linalg.cross(sides[1:], sides[:-1]), dim=-1)
        angle = torch.atan2(cross, (sides[1:] * sides[:-1]).sum(-1))
        return torch.rad2deg(angle) / self.seconds.diff()

    def fixations(self, fastest: float = FASTEST) -> list[tuple[float, float, float, float]]:
        """Return start, end, x and y of each fixation: samples between which the eye is slower than a speed.

        Parameters
        ----------
        fastest : float
            In degrees per second: Salvucci and Goldberg, *Identifying fixations and saccades*, ETRA (2000).
        """
        slow = (self.speed() <= _validate.constant("fastest", fastest, positive=True)).tolist()
        found, begin = [], None
        for index, still in enumerate([*slow, False]):
            if still and begin is None:
                begin = index
            elif not still and begin is not None:
                x, y = self.gaze[begin : index + 1].mean(0).tolist()
                found.append((float(self.seconds[begin]), float(self.seconds[index]), x, y))
                begin = None
        return found

    def __repr__(self) -> str:
        return f"GazeTrace: {len(self.seconds)} samples in {float(self.seconds[-1] - self.seconds[0]):.3g} s"

    def _directions(self):
        return _directions(self.gaze.double(), self.viewing)


def _directions(gaze, viewing):
    """Return unit vectors of gazes [N, 2] on a display, whose height is that of its pixels or its width."""
    rows, columns = viewing.resolution or (1, 1)
    width = viewing.real_image_width
    sizes = gaze.new_tensor([width, width * rows / columns])
    ahead = gaze.new_full((len(gaze), 1), viewing.real_viewing_distance)
    return torch.nn.functional.normalize(torch.cat([(gaze - 0.5) * sizes, ahead], 1), dim=-1)


def simulate_gaze(
    fixations: torch.Tensor | list[tuple[float, float]],
    viewing: Viewing,
    *,
    rate: float = 1000.0,
    mean_fixation: float = 0.33,
    seed: int = 0,
) -> GazeTrace:
    """Return the trace of an eye that looks at some places in turn.

    Parameters
    ----------
    fixations : torch.Tensor or list of tuple
        Places (x, y), 0 to 1 from the top-left corner ``[K, 2]``.
    viewing : Viewing
        Geometry.
    rate : float
        Samples per second.
    mean_fixation : float
        Mean time in seconds for which the eye rests; times are drawn from a gamma distribution of shape 4.
    seed : int
        Of the times.

    Returns
    -------
    GazeTrace
        In float64.

    Raises
    ------
    ValueError, TypeError
        If the places are not two or more, or a number is not positive.

    Notes
    -----
    Durations of saccades: :func:`saccade_duration`. Their course is that of least jerk, 10τ³ − 15τ⁴ + 6τ⁵ (Flash and
    Hogan, J. Neurosci. 5, 1688 (1985)), whose largest speed is 1.875 times the mean: 436 degrees per second for 10
    degrees. Fixations in scenes: 330 ms on average, Henderson, Trends Cogn. Sci. 7, 498 (2003).

    Examples
    --------
    >>> from odak.learn.perception import Viewing, simulate_gaze
    >>> trace = simulate_gaze([(0.3, 0.5), (0.7, 0.5)], Viewing(0.7, 0.7))
    >>> len(trace.fixations()), 300 < float(trace.speed().max()) < 700
    (2, True)
    """
    places = tensor("fixations", fixations, torch.float64)
    _validate.shaped("fixations", places, "[K, 2]")
    if len(places) < 2 or not bool(places.isfinite().all()):
        raise ValueError(f"fixations must be two or more places of finite numbers, got {tuple(places.shape)}")
    rate = _validate.constant("rate", rate, positive=True)
    mean_fixation = _validate.constant("mean_fixation", mean_fixation, positive=True)
    random = np.random.default_rng(_validate.integer("seed", seed))
    rests = torch.from_numpy(random.gamma(4.0, mean_fixation / 4, len(places))).to(places)
    sides = _directions(places, checked_viewing(viewing))
    moves = saccade_duration(torch.rad2deg(torch.acos((sides[1:] * sides[:-1]).sum(-1).clamp(-1, 1))))
    ends = (rests[:-1] + moves).cumsum(0)
    starts = ends - moves
    seconds = torch.arange(math.ceil(float(ends[-1] + rests[-1]) * rate) + 1).to(places) / rate
    share = ((seconds[:, None] - starts) / moves).clamp(0, 1)
    course = share**3 * (10 - 15 * share + 6 * share**2)
    return GazeTrace(seconds, places[0] + course @ places.diff(dim=0), viewing)


def read_gaze(
    path: str | os.PathLike[str],
    viewing: Viewing,
    *,
    columns: tuple[str, str, str] = ("time", "x", "y"),
    unit: str = "s",
    pixels: bool = False,
) -> GazeTrace:
    r"""Return the trace in a table of an eye tracker.

    Parameters
    ----------
    path : str or os.PathLike
        ``.csv`` file with commas, semicolons or tabs, or ``.tsv`` with tabs; its first line names the columns.
    viewing : Viewing
        Geometry, with the resolution for gazes in pixels.
    columns : tuple of str
        Names of the columns of time, x and y.
    unit : {"s", "ms", "us"}
        Of the times.
    pixels : bool
        Gazes are pixels of the display, else shares of its width and height.

    Returns
    -------
    GazeTrace
        In float64, from the time 0 on, without the rows in which a value is missing, as in blinks.

    Raises
    ------
    ValueError, TypeError
        If the table has no such columns, too few rows, or values that are no numbers.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.perception import Viewing, read_gaze
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "gaze.csv")
    ...     with open(name, "w") as stream:
    ...         _ = stream.write("ms,px,py\n10,96,54\n12,NaN,NaN\n14,192,54\n")
    ...     seen = Viewing(0.7, 0.7, (108, 192))
    ...     read_gaze(name, seen, columns=("ms", "px", "py"), unit="ms", pixels=True).gaze.tolist()
    [[0.5, 0.5], [1.0, 0.5]]
    """
    path = validate_path(path, [".csv", ".tsv"])
    factor, viewing = _UNITS[_validate.one_of("unit", unit, _UNITS)], checked_viewing(viewing)
    if not isinstance(columns, (tuple, list)) or len(columns) != 3 or not all(isinstance(n, str) for n in columns):
        raise ValueError(f"columns must be three names, got {columns!r}")
    if _validate.flag("pixels", pixels) and viewing.resolution is None:
        raise ValueError("viewing must have a resolution for gazes in pixels, got None")
    with naming(path):
        text = Path(regular_file(path)).read_text(encoding="utf-8-sig")
        try:
            return _trace_in(text, path, viewing, columns, factor, pixels)
        except csv.Error as error:
            raise ValueError(f"path must be a table, got {path!r}: {error}") from None


def _trace_in(text, path, viewing, columns, factor, pixels):
    """Return the trace in the text of a table."""
    line = text.partition("\n")[0]
    delimiter = max("\t;,", key=line.count) if path.endswith(".csv") else "\t"
    table = csv.DictReader(text.splitlines(), delimiter=delimiter)
    names = [name.strip() for name in table.fieldnames or ()]
    if missing := [name for name in columns if name not in names]:
        raise ValueError(f"columns must be among {names}, got {missing} beside: {path!r}")
    table.fieldnames = names
    rows = []
    for row in table:
        try:
            values = [float(row[name] or "nan") for name in columns]
        except ValueError as error:
            raise ValueError(f"path must hold numbers, line {table.line_num} of {path!r}: {error}") from None
        if all(map(math.isfinite, values)):
            rows.append(values)
    if len(rows) < 2:
        raise ValueError(f"path must hold two rows of numbers, got {len(rows)} in {path!r}")
    found = torch.tensor(rows, dtype=torch.float64)
    gaze = found[:, 1:]
    if pixels and viewing.resolution is not None:
        gaze = gaze / torch.tensor(viewing.resolution[::-1], dtype=torch.float64)
    return GazeTrace((found[:, 0] - found[0, 0]) * factor, gaze, viewing)
