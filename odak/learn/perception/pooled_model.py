"""Models of peripheral vision with discrete pooling windows: luminance, spectral energy, bands and textures."""

import copy
import math
from typing import NamedTuple

import torch
from torch.nn import functional

from odak import _torch_private, _validate
from odak.learn._tensors import floating_tensor
from odak.learn.perception.color import rgb_2_ycrcb
from odak.learn.perception.foveation import MODES, make_3d_location_map
from odak.learn.perception.joint_statistics import POWER_FLOOR, joint_maps
from odak.learn.perception.pyramids import SpatialSteerablePyramid
from odak.learn.perception.sight import Kept, Point, Viewing, checked_viewing

STATISTICS = ("luminance", "energy", "bands", "texture")
# Reach of a Gaussian window in standard deviations, and its full width at half maximum in the same unit.
_REACH, _FWHM = 4, 2 * math.sqrt(2 * math.log(2))
# Share of a raised cosine's width over which it falls: Freeman and Simoncelli (2011).
_TRANSITION = 0.5
# Least number of windows in a ring around the gaze, and least sum of weights, in pixels, of a window that counts.
_FEWEST, _LEAST = 4, 1e-3
# Planes that are pooled at a time, whose pixels side by side fit a cache line.
_PLANES = 8


class MetamerPaper(NamedTuple):
    """Settings by which stimuli of a publication were made.

    Attributes
    ----------
    statistics : str
        As :class:`PooledModel` takes it.
    scaling : float
        As :class:`PooledModel` takes it.
    growth : str
        As :class:`PooledModel` takes it.
    window : str
        As :class:`PooledModel` takes it.
    compared : str
        What observers compared: two samples, or a sample and the picture.
    source : str
        The publication.

    Examples
    --------
    >>> from odak.learn.perception import METAMER_PAPERS
    >>> METAMER_PAPERS["Freeman 2011 V2"].scaling, METAMER_PAPERS["Freeman 2011 V2"].compared
    (0.5, 'two samples')
    """

    statistics: str
    scaling: float
    growth: str
    window: str
    compared: str
    source: str


_FREEMAN = "Freeman and Simoncelli, Nat. Neurosci. 14, 1195 (2011)"
_BRODERICK = "Broderick, Rufo, Winawer and Simoncelli, eLife 12, RP90554 (2023)"
_WALTON = "Walton et al., ACM Trans. Graph. 40, 48 (2021)"
_WALLIS = "Wallis, Funke, Ecker, Gatys, Wichmann and Bethge, eLife 8, e42512 (2019)"
# Round numbers: 0.5 for V2, and 0.25 for V1, which also stands where a publication compares with V1 or states a ratio.
METAMER_PAPERS: dict[str, MetamerPaper] = {
    "Freeman 2011 V2": MetamerPaper("texture", 0.5, "linear", "raised cosine", "two samples", _FREEMAN),
    "Freeman 2011 V1": MetamerPaper("energy", 0.25, "linear", "raised cosine", "two samples", _FREEMAN),
    "Wallis 2019": MetamerPaper("texture", 0.25, "linear", "raised cosine", "sample and picture", _WALLIS),
    "Broderick 2023 energy": MetamerPaper("energy", 0.25, "linear", "Gaussian", "both", _BRODERICK),
    "Broderick 2023 luminance": MetamerPaper("luminance", 0.0625, "linear", "Gaussian", "both", _BRODERICK),
    "Walton 2021": MetamerPaper("bands", 0.2, "quadratic", "raised cosine", "sample and picture", _WALTON),
}


class PooledModel:
    """Statistics of a picture in windows that grow with the distance from the gaze: a model of peripheral vision.

    Windows stand in rings around the gaze and overlap. Pictures that share the mean of each statistic in each window,
    and the pixels around the gaze, are metamers of the model.

    Parameters
    ----------
    statistics : {"texture", "energy", "bands", "luminance"}
        "texture": means and deviations of bands, and correlations of pairs of bands, as Portilla and Simoncelli take
        them for textures. "energy": luminance, and root mean square amplitudes of complex bands. "bands": luminance,
        means and deviations of bands. "luminance": luminance alone.
    scaling : float
        Full width at half maximum of a window along the radius, over its eccentricity; with quadratic growth over the
        square of its eccentricity, in radians.
    viewing : Viewing, optional
        Geometry and gaze, one for all pictures.
    growth : {"linear", "quadratic"}
        Of the windows.
    window : {"raised cosine", "Gaussian"}
        Raised cosines add up to one; Gaussians stand one standard deviation apart. Both in the logarithm of the
        eccentricity, for linear growth, and in the angle around the gaze.
    aspect : float
        Width of a window along the radius over that around the gaze.
    fovea : float
        Eccentricity in degrees within which pixels count.
    n_pyramid_levels : int
        Of the steerable pyramid.
    n_orientations : int
        Of its bands.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range.

    Notes
    -----
    Windows: Freeman and Simoncelli, Nat. Neurosci. 14, 1195 (2011), and, Gaussian, Broderick et al., eLife 12, RP90554
    (2023). Metameric losses pool around each pixel instead, and compare the last low-pass pixel by pixel.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import PooledModel, Viewing
    >>> model = PooledModel("energy", 0.5, Viewing(0.4, 0.7), n_pyramid_levels=3)
    >>> model
    PooledModel: energy, scaling 0.5 linear, raised cosine windows
    >>> [tuple(one.shape) for one in model(torch.rand(1, 1, 32, 32))][:2]
    [(1, 1, 0), (1, 1, 154, 1)]
    """

    scaling: float
    aspect: float
    fovea: float

    def __init__(
        self,
        statistics: str = "texture",
        scaling: float = 0.5,
        viewing: Viewing | None = None,
        *,
        growth: str = "linear",
        window: str = "raised cosine",
        aspect: float = 2.0,
        fovea: float = 0.5,
        n_pyramid_levels: int = 4,
        n_orientations: int = 4,
    ) -> None:
        self.statistics: str = _validate.one_of("statistics", statistics, STATISTICS)
        self.growth: str = _validate.one_of("growth", growth, MODES)
        self.window: str = _validate.one_of("window", window, ("raised cosine", "Gaussian"))
        self.scaling, self.aspect, self.fovea = (
            _validate.constant(name, value, positive=True)
            for name, value in (("scaling", scaling), ("aspect", aspect), ("fovea", fovea))
        )
        self.viewing: Viewing = Viewing() if viewing is None else checked_viewing(viewing)
        if not isinstance(self.viewing.gaze, Point):
            raise ValueError(f"viewing must have one gaze, got a track of {len(self.viewing.gaze)}")
        self.n_pyramid_levels: int = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
        self.n_orientations: int = _validate.integer("n_orientations", n_orientations, minimum=1)
        self._makers, self._pools = Kept(), Kept()
        self._pools.room = self.n_pyramid_levels
        self._units: list[torch.Tensor] | None = None

    @classmethod
    def of_paper(cls, paper: str, viewing: Viewing | None = None, **changes: float | str) -> "PooledModel":
        """Return the model of a publication, a key of `METAMER_PAPERS`.

        Parameters
        ----------
        paper : str
            "Freeman 2011 V2", "Freeman 2011 V1", "Wallis 2019", "Broderick 2023 energy", "Broderick 2023 luminance" or
            "Walton 2021".
        viewing : Viewing, optional
            Geometry and gaze.
        **changes : float or str
            Arguments of the class that differ from the publication.

        Examples
        --------
        >>> from odak.learn.perception import PooledModel
        >>> PooledModel.of_paper("Freeman 2011 V1", scaling=0.3)
        PooledModel: energy, scaling 0.3 linear, raised cosine windows
        """
        found = METAMER_PAPERS[_validate.one_of("paper", paper, METAMER_PAPERS)]
        options = {name: getattr(found, name) for name in ("statistics", "scaling", "growth", "window")}
        return cls(viewing=viewing, **{**options, **changes})  # type: ignore[arg-type]

    def __repr__(self) -> str:
        return f"PooledModel: {self.statistics}, scaling {self.scaling:g} {self.growth}, {self.window} windows"

    def __call__(self, picture: torch.Tensor) -> list[torch.Tensor]:
        """Return the statistics of a picture.

        Parameters
        ----------
        picture : torch.Tensor
            Grey or RGB ``[B, C, H, W]``, sides multiples of 2ⁿ⁻¹ for n levels.

        Returns
        -------
        list of torch.Tensor
            Pixels around the gaze ``[B, C, N]``, then the statistics in each window; differentiable.

        Raises
        ------
        ValueError, TypeError
            If the picture does not fit the pyramid.
        """
        found = [weight * value for weight, value in self._statistics(picture)]
        return found if self._units is None else [a / unit.to(a) for a, unit in zip(found, self._units, strict=True)]

    def over_deviations(self, pictures: torch.Tensor) -> "PooledModel":
        """Return this model with each statistic divided by its standard deviation over pictures and windows.

        Parameters
        ----------
        pictures : torch.Tensor
            Two or more ``[B, C, H, W]``, of the channels to be compared, such as natural pictures. Their size may be
            another than that of the pictures to be compared.

        Returns
        -------
        PooledModel
            Its distances have no unit: 1 is the root mean square by which statistics of such pictures vary.

        Raises
        ------
        ValueError, TypeError
            If there is one picture, or they do not fit the pyramid.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.perception import PooledModel, Viewing
        >>> model = PooledModel("luminance", 0.5, Viewing(0.4, 0.7))
        >>> pictures = torch.rand(8, 1, 64, 64, generator=torch.Generator().manual_seed(1))
        >>> model.over_deviations(pictures)(pictures)[1].std() > model(pictures)[1].std()
        tensor(True)
        """
        floating_tensor("pictures", pictures, "a tensor of real floats [B, C, H, W]")
        _validate.shaped("pictures", pictures, "[B, C, H, W], none empty")
        if len(pictures) < 2:
            raise ValueError(f"pictures must be two or more, got {len(pictures)}")
        scaled = copy.copy(self)
        with torch.no_grad():
            values = [value.transpose(0, 1).flatten(1) for _, value in self._statistics(pictures)]
        floor = math.sqrt(POWER_FLOOR)
        # No pixel may lie around the gaze.
        deviations = [one.std(1) if one.numel() else one.new_ones(len(one)) for one in values]
        scaled._units = [one.clamp_min(floor)[:, None, None] for one in deviations]
        scaled._units[0] = scaled._units[0][..., 0]
        return scaled

    def _statistics(self, picture):
        """Return the statistics, each with the weights of its windows."""
        whole = self.pool(picture)
        picture = rgb_2_ycrcb(picture) if picture.shape[1] == 3 else picture
        found = [(whole.inside.double().mean().sqrt().to(picture), picture.flatten(2)[..., whole.inside])]
        found.append((whole.weights, whole(picture)))
        if self.statistics == "luminance":
            return found
        maker = self._makers.get(picture.shape[1], lambda: self._pyramid(picture))
        groups, low = maker.stacked_bands(picture, self.n_pyramid_levels)
        pools = [self.pool(passed) for passed in low]
        pairs = joint_maps(groups[1:], low, pools, maker) if self.statistics == "texture" else [[] for _ in groups[1:]]
        found.append((whole.weights, _moments(groups[0].flatten(1, 2), whole)[1]))
        for bands, passed, pool, more in zip(groups[1:], low, pools, pairs, strict=False):
            if self.statistics == "energy":
                power = pool((bands**2 + maker.quadrature(passed) ** 2).flatten(1, 2))
                more = [power.clamp_min(POWER_FLOOR).sqrt()]
            else:
                more = [*_moments(bands.flatten(1, 2), pool), *more]
            found += [(pool.weights, one) for one in more]
        if self.statistics == "texture":
            found += [(pools[-1].weights, one) for one in _moments(low[-1], pools[-1])]
            found.append((whole.weights, _moments(picture, whole)[1]))
        return found

    def pool(self, picture: torch.Tensor) -> "Windows":
        """Return the windows of pictures of this size, which are kept.

        Parameters
        ----------
        picture : torch.Tensor
            ``[B, C, H, W]``.

        Returns
        -------
        Windows
            A callable that returns the means ``[B, C, K, 1]`` of pictures of this size.
        """
        floating_tensor("picture", picture, "a tensor of real floats [B, C, H, W]")
        _validate.shaped("picture", picture, "[B, C, H, W], none empty")
        size = (picture.shape[-2], picture.shape[-1])
        return self._pools.get((size, picture.dtype, picture.device), lambda: self._windows(size, picture))

    def _pyramid(self, picture):
        return SpatialSteerablePyramid(False, picture.shape[1], 9, self.n_orientations, "full", picture.device)

    def _windows(self, size, like):
        with _torch_private.keeping(), torch.no_grad(), torch.device("cpu"):
            distance, around = _polar(size, self.viewing)
            place = distance.clamp_min(math.radians(self.fovea))
            if self.growth == "linear":
                unit = 2 * math.asinh(self.scaling / 2)
                along, least = place.log(), math.log(math.radians(self.fovea))
            else:
                unit, along, least = self.scaling, -1 / place, -1 / math.radians(self.fovea)
            step = unit / _FWHM if self.window == "Gaussian" else unit
            along = ((along - least) / step).flatten()
            rings = torch.arange(int(along.max()) + 2, dtype=torch.float64) * step + least
            eccentricity = rings.exp() if self.growth == "linear" else -1 / rings.clamp(max=-1e-3)
            width = self.scaling * eccentricity ** (1 if self.growth == "linear" else 2) * step / unit
            counts = (2 * math.pi * self.aspect * eccentricity / width).round().clamp_min(_FEWEST).long()
            means, areas = _overlapping(along, around.flatten() / (2 * math.pi), counts, self.window)
            weights = (areas / areas.mean()).sqrt()[:, None]
            inside = (distance < math.radians(self.fovea)).flatten()
            return Windows(means.to(like.dtype), weights.to(like), inside.to(like.device))


class Windows:
    """Means over windows, as a sparse matrix of weights.

    Parameters
    ----------
    means : torch.Tensor
        Sparse ``[K, H·W]`` on the CPU, the weights of the pixels of each window adding up to one.
    weights : torch.Tensor
        By which the statistics of each window count ``[K, 1]``, the root of its area, 1 in the quadratic mean.
    inside : torch.Tensor
        Which pixels are around the gaze ``[H·W]``.
    """

    def __init__(self, means: torch.Tensor, weights: torch.Tensor, inside: torch.Tensor) -> None:
        self.means: torch.Tensor = means
        self.weights: torch.Tensor = weights
        self.inside: torch.Tensor = inside
        matrices = means, means.t().coalesce()
        self._tables = [[part.to(weights.device) for part in _table(one)] for one in matrices]

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """Return the means ``[B, N, K, 1]`` of values ``[B, N, H, W]``."""
        found = _torch_private.linear(self, False, values.flatten(2).flatten(0, 1))
        return found.reshape(*values.shape[:2], -1, 1)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the means of planes ``[N, H·W]``, ten times as fast as sparse tensors."""
        return _summed(planes, *self._tables[0])

    def adjoint(self, values: torch.Tensor) -> torch.Tensor:
        """Return the adjoint of :meth:`forward`."""
        return _summed(values, *self._tables[1])


def _summed(planes, columns, starts, weights):
    """Return the sums of planes by a table of :func:`_table`."""
    result = planes.new_empty(len(planes), len(starts))
    for part, target in zip(planes.split(_PLANES), result.split(_PLANES), strict=True):
        rows = part.T.contiguous()
        target.copy_(functional.embedding_bag(columns, rows, starts, mode="sum", per_sample_weights=weights).T)
    return result


def _table(matrix):
    """Return the columns of a sparse matrix row by row, the place at which each row starts, and the values."""
    row, column = matrix.indices()
    counts = torch.bincount(row, minlength=len(matrix))
    return column.contiguous(), counts.cumsum(0) - counts, matrix.values()


def _moments(values, pool):
    """Return means and standard deviations in each window."""
    mean, power = pool(torch.cat([values, values**2], 1)).chunk(2, 1)
    return [mean, (power - mean**2).clamp_min(POWER_FLOOR).sqrt()]


def _polar(size, viewing):
    """Return the angle of each pixel from the gaze and the angle around it, in radians."""
    place = make_3d_location_map(size, viewing=viewing, dtype=torch.float64)
    width, (x, y) = viewing.real_image_width, viewing.gaze
    height = width / size[1] * size[0]
    gaze = torch.tensor([(x - 0.5) * width, (y - 0.5) * height, viewing.real_viewing_distance], dtype=torch.float64)
    gaze = gaze / torch.linalg.vector_norm(gaze)
    across = torch.stack([gaze[2], torch.zeros_like(gaze[0]), -gaze[0]])
    across = across / torch.linalg.vector_norm(across)
    down = torch.linalg.cross(gaze, across)
    ahead, right, below = (torch.tensordot(axis, place, 1) for axis in (gaze, across, down))
    return torch.atan2(torch.hypot(right, below), ahead), torch.atan2(below, right)


def _overlapping(along, around, counts, window):
    """Return the means over windows at whole numbers of `along`, at equal angles in each ring, and their areas."""
    starts = counts.cumsum(0) - counts
    reach = range(1 - _REACH, _REACH + 1) if window == "Gaussian" else range(2)
    rows, columns, values = [], [], []
    pixels = torch.arange(len(along))
    for outward in reach:
        ring = along.floor().long() + outward
        kept = (ring >= 0) & (ring < len(counts)) & (along > 0)
        ring, pixel = ring[kept], pixels[kept]
        count, turn = counts[ring], around[kept] * counts[ring]
        radial = _profile(along[kept] - ring, window)
        for sideways in reach:
            place = turn.floor().long() + sideways
            rows.append(starts[ring] + place.remainder(count))
            columns.append(pixel)
            values.append(radial * _profile(turn - place, window))
    size, value = (int(counts.sum()), len(along)), torch.cat(values)
    row, column = torch.cat(rows), torch.cat(columns)
    areas = torch.zeros(size[0], dtype=torch.float64).index_add_(0, row, value)
    used = areas > _LEAST
    kept = used[row]
    places = torch.stack([(used.cumsum(0) - 1)[row], column])[:, kept]
    share, size = (value / areas[row])[kept], (int(used.sum()), size[1])
    return torch.sparse_coo_tensor(places, share, size, check_invariants=True).coalesce(), areas[used]


def _profile(distance, window):
    if window == "Gaussian":
        return torch.exp(-(distance**2) / 2)
    fall = ((distance.abs() - 0.5) / _TRANSITION + 0.5).clamp(0, 1)
    return torch.cos(math.pi / 2 * fall) ** 2
