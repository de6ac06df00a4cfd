"""Holographic displays as objects, and one function that computes holograms for them.

A :class:`Display` is a modulator of real pixels, its light sources, and the planes that images are on; :func:`optimise`
computes the patterns that show a target on it, by one of several solvers, and returns them with their images and a
quality that another computation has judged.
"""

import ast
import copy
import itertools
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, overload

import numpy as np
import torch
from scipy.fft import next_fast_len

from odak import _array, _show, _torch_private, _validate
from odak._attributes import Prepared
from odak._bars import tqdm
from odak._torch_private import differentiates, in_own_precision
from odak._warnings import AccuracyWarning, ArgumentWarning, SamplingWarning, warn
from odak.instruments import Calibration, Lens, load_calibration
from odak.learn._tensors import ValuesRead, floating
from odak.learn.tools.iterations import Run, minimise
from odak.learn.wave.devices import DISTRIBUTED, Ranks, on_devices, shares_of, used_devices
from odak.learn.wave.eyes import Eyes, Sight, seen_by_eye
from odak.learn.wave.fields import exposure, intensity, unit_phasor
from odak.learn.wave.holograms import STARTS, best_scale, encode_double_phase, named, network_on, starting_phase
from odak.learn.wave.loss import FocalTargets, multiplane_loss
from odak.learn.wave.propagation import propagate_beam
from odak.learn.wave.slm import TURN, even_levels, spatial_light_modulator
from odak.learn.wave.training import checked_intensities, cosine, fingerprint, recorded, seeded_loss, started
from odak.wave import phase_retrieval
from odak.wave.linear_kernels import checked_pixel_fill, linear_kernel
from odak.wave.sampling import sampling_report
from odak.wave.torch_convolution import convolve
from odak.wave.transfer_functions import (
    Request,
    angular_spectrum,
    checked_pitch,
    divided_pitch,
    pitches,
    plane_wave_transfer,
)
from odak.wave.viewing import check_blur, covered

# Diffraction orders along each axis that are computed without an iris: the zeroth and its neighbours.
_ORDERS = 3
# Pixels on either side that a mean over the area of a pixel is computed from; see _taps.
_REACH = 4
# Pixels around a modulator, at least, in which the light of its edges is followed behind another panel.
_MARGIN = 32
# Where an iris passes fewer periods across the panel, its spot is wider than all that is computed.
_FEWEST_PERIODS = 0.5
# Least amplitude of the light on the panel, as a share of its root mean square, that double phase makes up for.
_DIMMEST = 0.1


@_validate.takes_units("radius", "focal_length")
@dataclass(frozen=True)
class Iris:
    """A round stop in the focal plane of a lens, which limits the frequencies that reach an image.

    Use it for a 4f relay whose iris you know. Frequencies up to ``radius / (wavelength · focal_length)`` pass.

    Parameters
    ----------
    radius : float
        Radius in metres.
    focal_length : float
        Focal length of the lens in front of it in metres.

    Examples
    --------
    >>> from odak.learn.wave import Iris
    >>> round(Iris(2e-3, 0.2).cutoff(532e-9))
    18797
    """

    radius: float
    focal_length: float

    def __post_init__(self):
        _validate.real("radius", self.radius, positive=True)
        _validate.real("focal_length", self.focal_length, positive=True)

    def cutoff(self, wavelength: float) -> float:
        """Return the highest frequency that passes at a wavelength, in cycles per metre."""
        return self.radius / (wavelength * self.focal_length)


@_validate.takes_units("distance")
@dataclass(frozen=True)
class AmplitudePanel:
    """A panel that attenuates the light on its way to a phase modulator, with pixels of the same number and pitch.

    Use it as `lit_through` of a :class:`Modulator` for two panels in series, with which a display forms amplitude and
    phase. A relay images it onto the modulator or beside it, or the light travels freely between the two, through air.

    Parameters
    ----------
    distance : float
        Distance from the panel, or from its image by the relay, to the modulator in metres.
    bits : int, optional
        Bits of a pixel, 2^bits levels spread evenly over the amplitudes 0 … 1; None for amplitudes without levels.
    fill : float
        Share of the area of a pixel that transmits.
    iris : Iris or str, optional
        Stop of the relay: "order", a square one that passes one diffraction order, |f| ≤ 1/(2·pitch), or a round
        :class:`Iris`. None without a relay, where nine orders are computed.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import AmplitudePanel, Display, Modulator
    >>> panel = Modulator((32, 48), 8e-6, lit_through=AmplitudePanel())
    >>> display = Display(panel, 532e-9, 3e-3)
    >>> phases, amplitudes = torch.zeros(32, 48), torch.full((32, 48), 0.5)
    >>> round(float((display(phases, amplitudes=amplitudes) / display(phases)).mean()), 3)
    0.25
    """

    distance: float = 0.0
    bits: int | None = 8
    fill: float = 0.9
    iris: Iris | str | None = "order"

    def __post_init__(self):
        _validate.constant("distance", self.distance)
        _checked_bits(self.bits)
        checked_pixel_fill(self.fill)
        _checked_iris(self.iris)

    def shown(self, amplitudes: torch.Tensor) -> torch.Tensor:
        """Return the nearest amplitudes that the levels of the panel can show."""
        if self.bits is None:
            return amplitudes
        return self.levels(amplitudes).to(amplitudes) / (2**self.bits - 1)

    def levels(self, amplitudes: torch.Tensor) -> torch.Tensor:
        """Return the levels whose amplitudes are nearest, int32 of the shape of the amplitudes; 256 without bits."""
        return torch.round(amplitudes * (255 if self.bits is None else 2**self.bits - 1)).to(torch.int32)


@_validate.takes_units("pitch")
@dataclass(frozen=True)
class Modulator:
    """A phase-only spatial light modulator: its pixels, levels and response.

    Use it to tell a :class:`Display` which panel you have. Of real panels only the inner part of each pixel, a square
    of the share `fill`, modulates light, and this is the default; ``fill=1`` is a panel without gaps.

    Parameters
    ----------
    resolution : sequence of int
        Rows and columns.
    pitch : float or sequence of float
        Distance of neighbouring pixels in metres, one number or a pair (rows, columns).
    bits : int, optional
        Bits of a pixel, 2^bits levels spread evenly over 2π; None for a phase without levels.
    fill : float
        Share of the area of a pixel that emits.
    response : callable or sequence of callable, optional
        ``response(phase)`` returns the field of a phase pattern, such as
        :class:`odak.learn.wave.spatial_light_modulator`; an ideal one by default. Its own fill factor must be 1. The
        levels are its own where it has a table of their phases, `lut`. A sequence of modules holds one for each frame,
        such as a table for each colour of a panel that shows colours in sequence.
    lit_through : AmplitudePanel, optional
        Panel that the light passes first, for two panels in series.

    Examples
    --------
    >>> from odak.learn.wave import Modulator
    >>> Modulator((1080, 1920), 8e-6).fill
    0.9
    """

    resolution: Sequence[int]
    pitch: float | Sequence[float]
    bits: int | None = 8
    fill: float = 0.9
    response: Callable[..., Any] | Sequence[torch.nn.Module] | None = None
    lit_through: AmplitudePanel | None = None

    def __post_init__(self):
        object.__setattr__(self, "resolution", _validate.size("resolution", self.resolution))
        checked_pitch("pitch", self.pitch)
        _checked_bits(self.bits)
        if not (self.lit_through is None or isinstance(self.lit_through, AmplitudePanel)):
            raise TypeError(f"lit_through must be an AmplitudePanel or None, got {type(self.lit_through).__name__}")
        checked_pixel_fill(self.fill)
        if isinstance(self.response, (list, tuple)) and all(isinstance(one, torch.nn.Module) for one in self.response):
            object.__setattr__(self, "response", torch.nn.ModuleList(self.response))
        for one in self._responses() or [_validate.function_or_none("response", self.response)]:
            if float(getattr(one, "fill_factor", 1.0)) != 1 or getattr(one, "samples_per_pixel", 1) > 1:
                raise ValueError(
                    "response must have a fill factor of 1 and one sample per pixel; give fill here instead"
                )

    def _responses(self) -> list[torch.nn.Module]:
        """Return the responses of the frames where each has its own."""
        return list(self.response) if isinstance(self.response, torch.nn.ModuleList) else []

    def _of_frames(self, method: str, phases: torch.Tensor) -> torch.Tensor:
        """Return what a method gives for phases ``[..., frames, rows, columns]``, each frame by its own response."""
        alone = [replace(self, response=one) for one in self._responses()]
        if phases.ndim < 3 or phases.shape[-3] != len(alone):
            raise ValueError(f"phases must be of {len(alone)} frames, one for each response, got {list(phases.shape)}")
        parts = zip(alone, phases.unbind(-3), strict=True)
        return torch.stack([getattr(one, method)(part) for one, part in parts], -3)

    def light(self, phases: torch.Tensor) -> torch.Tensor:
        """Return the field of phases ``[..., rows, columns]`` in radians, at the pixels."""
        if self._responses():
            return self._of_frames("light", phases)
        return unit_phasor(phases) if self.response is None else self.response(phases)  # type: ignore[operator]

    def shown(self, phases: torch.Tensor) -> torch.Tensor:
        """Return the nearest phases that the levels of the panel can show, 0 … 2π."""
        if self.bits is None:
            return torch.remainder(phases, TURN)
        if self._responses():
            return self._of_frames("shown", phases)
        if getattr(self.response, "lut", None) is not None:
            return self.response.lut.to(phases)[self.levels(phases).long()]  # type: ignore[union-attr]
        return even_levels(phases, 2**self.bits) * (TURN / 2**self.bits)

    def levels(self, phases: torch.Tensor) -> torch.Tensor:
        """Return the levels whose phases are nearest, int32 of the shape of the phases; 256 where there are none."""
        if self._responses():
            return self._of_frames("levels", phases)
        if self.bits is not None and getattr(self.response, "lut", None) is not None:
            return self.response.levels(phases)  # type: ignore[union-attr]
        return even_levels(phases, 256 if self.bits is None else 2**self.bits).to(torch.int32)


class Display(Prepared, torch.nn.Module):
    """A holographic display: a modulator, its light sources, and the planes that images are on.

    Use it where you want to know what an eye or a camera sees of phase patterns: :meth:`forward` returns the means of
    the intensity over the areas of pixels, with the spectrum of pixels of finite size. Patterns for it are computed
    by :func:`optimise`. For fields at points or a relay, use :class:`odak.learn.wave.propagator`.

    Parameters
    ----------
    modulator : Modulator
        The panel.
    wavelengths : float or sequence of float
        Wavelengths of the C light sources in metres.
    distances : float, sequence of float, odak.instruments.Lens or Eyes
        Distances of the D planes from the panel, or from its image by a relay, in metres; or the lens behind which a
        single plane is: the points of its images are λ·focal_length/(rows·pitch) and λ·focal_length/(columns·pitch)
        apart, the axis at rows // 2 and columns // 2, over all that the pixels reach; or :class:`Eyes`, whose D retinal
        images take the place of planes.
    frames : int, optional
        Patterns F that are shown one after another, faster than an eye tells apart; one for each source by default.
    powers : torch.Tensor, optional
        Power of each source in each frame, ``[F, C]``; by default frame f is lit by source f mod C alone. Images are
        normalised to one unit of power of each source, shared out among its frames. All sources of a frame meet the
        same phases in radians; for a panel that shows one path difference to all of them, use
        :class:`odak.learn.wave.propagator` and its `phase_scale`.
    profile : torch.Tensor, optional
        Amplitude of the light on the modulator, ``[rows, columns]`` or ``[C, rows, columns]``; one by default.
    iris : Iris or str, optional
        "order", a square stop that passes one diffraction order, |f| ≤ 1/(2·pitch); a round :class:`Iris`; or None for
        no stop, where nine orders are computed: 36 transforms of an image instead of four. Eyes get all orders then.
    medium : float
        Refractive index between the modulator and the planes.

    Attributes
    ----------
    samples : int
        Points along each axis of a pixel at which the intensity is computed, from which its mean follows.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    AccuracyWarning
        If the iris passes less than half a period across the modulator, and images are mere tails of its spot.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator
    >>> display = Display(Modulator((32, 48), 8e-6), [639e-9, 515e-9, 473e-9], [2e-3, 3e-3])
    >>> display(torch.zeros(3, 32, 48)).shape
    torch.Size([2, 3, 32, 48])
    >>> display(torch.zeros(5, 3, 32, 48)).shape  # a batch of five
    torch.Size([5, 2, 3, 32, 48])
    >>> display
    Display: 32 × 48 pixels of 8 µm (fill 0.9, 8 bits), 639, 515, 473 nm, 3 frames, planes at 2, 3 mm, one order
    """

    _fixed = ("modulator", "wavelengths", "distances", "lens", "eyes", "medium", "iris", "frames", "samples")
    powers: torch.Tensor
    profile: torch.Tensor | None

    @_validate.takes_units("wavelengths", "distances")
    def __init__(
        self,
        modulator: Modulator,
        wavelengths: float | Sequence[float],
        distances: float | Sequence[float] | Lens | Eyes,
        frames: int | None = None,
        powers: torch.Tensor | None = None,
        profile: torch.Tensor | None = None,
        iris: Iris | str | None = "order",
        medium: float = 1.0,
    ):
        super().__init__()
        if not isinstance(modulator, Modulator):
            raise TypeError(f"modulator must be an odak.learn.wave.Modulator, got {type(modulator).__name__}")
        self.modulator = modulator
        self.wavelengths = _numbers("wavelengths", wavelengths, positive=True)
        self.lens = distances if isinstance(distances, Lens) else None
        self.eyes = distances if isinstance(distances, Eyes) else None
        ends = distances.distance if isinstance(distances, Eyes) else distances
        found = _numbers("distances", ends.after if isinstance(ends, Lens) else ends)
        self.distances = found if self.eyes is None else found * len(self.eyes)
        _validate.lengths_together(self.wavelengths, modulator.pitch, names=("wavelengths", "pitch", "distances"))
        self.medium = _validate.constant("medium", medium, positive=True)
        _checked_iris(iris)
        self.iris = iris
        if isinstance(iris, Iris) and self.lens is None:
            across = min(n * p for n, p in zip(modulator.resolution, _pitch_pair(modulator.pitch), strict=True))
            periods = across * min(iris.cutoff(wavelength) for wavelength in self.wavelengths)
            if periods < _FEWEST_PERIODS:
                warn(
                    f"iris passes {periods:.2g} periods across the modulator, whose light it spreads far beyond "
                    f"the images: is its radius of {iris.radius:g} m right?",
                    AccuracyWarning,
                )
        if self.eyes is not None:
            for name, given, other in (
                ("iris", iris, "'order' or None"),
                ("medium", self.medium, "1"),
                ("lit_through", modulator.lit_through, "None"),
            ):
                if isinstance(given, (Iris, AmplitudePanel)) or (name == "medium" and given != 1):
                    raise ValueError(f"{name} must be {other} for a display that eyes look at, got {given!r:.80}")
        self._first = modulator.lit_through
        if self._first is not None and (self.lens is not None or self._orders() > 1):
            got = "a display behind a lens" if self.lens is not None else f"iris={iris!r}"
            raise ValueError(
                "modulator must be without lit_through behind a lens, and where more than one order passes the iris of "
                f"the display, got {got}"
            )
        colours = len(self.wavelengths)
        self.frames = colours if frames is None else _validate.integer("frames", frames, minimum=1)
        if (responses := len(modulator._responses())) not in (0, self.frames):
            raise ValueError(
                f"modulator must have a response, or one for each of {self.frames} frames, got {responses}"
            )
        if powers is None:
            powers = torch.eye(colours).repeat(-(-self.frames // colours), 1)[: self.frames]
        powers = self._fitting(powers).detach()
        self.register_buffer("powers", powers)
        self._powers_read = ValuesRead(_frames_lit)
        self._powers_read(powers)
        if profile is not None:
            profile = _validate.image("profile", floating("profile", profile)).detach()
            if profile.shape[-2:] != torch.Size(modulator.resolution) or profile.ndim > 3:
                raise ValueError(
                    f"profile must be [rows, columns] = {list(modulator.resolution)} or [{colours}, rows, columns], "
                    f"got {list(profile.shape)}"
                )
            profile = profile.expand(colours, *modulator.resolution)
        self.register_buffer("profile", profile)
        self.samples = 2 * self._orders() if self.eyes is None else self._checked_eyes()
        self._kept: dict[Any, torch.Tensor] = {}
        self._geometry = self._in_words()
        rows, columns = modulator.resolution
        # Rows and columns in which light is followed.
        self._window = rows, columns
        if self._first is not None:
            self._window = next_fast_len(rows + 2 * _MARGIN), next_fast_len(columns + 2 * _MARGIN)
        # Who computes which part of the images where several devices or ranks do; see _shared_among.
        self._parts: list[tuple[Display, list[_Part]]] = []
        self._ranks: Ranks | None = None

    @classmethod
    def from_calibration(
        cls, calibration: Calibration | str | os.PathLike[str], fill: float = 0.9, **options: Any
    ) -> "Display":
        """Return the display of a calibrated table: its panel, response, aberration, illumination and distance.

        Use it for holograms on your own table: patterns for it correct the aberration, and
        :meth:`DisplayedHologram.levels` returns the levels whose measured phases are nearest. Of responses in regions
        the mean over the panel is taken.

        Parameters
        ----------
        calibration : odak.instruments.Calibration, str or os.PathLike
            From :func:`odak.instruments.calibrate_table`, or the file of one, as `odak calibrate` writes it.
        fill : float
            Share of the area of a pixel that emits, which is not measured.
        **options
            Parameters of :class:`Display` beside the modulator, the wavelength and the profile; by default `distances`
            is the distance of the camera.

        Returns
        -------
        Display
            The display, whose images lie on the pixels of the panel.

        Raises
        ------
        ValueError
            If the file cannot be read, or the number of levels is no power of two.

        Examples
        --------
        >>> from odak.instruments import Calibration, SimulatedTable
        >>> from odak.learn.wave import Display
        >>> table = SimulatedTable(seed=1, shape=(32, 48), camera_shape=(40, 48))
        >>> found = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
        >>> Display.from_calibration(found, iris=None)
        Display: 32 × 48 pixels of 8 µm (fill 0.9, 8 bits), 532 nm, 1 frame, plane at 20 mm, no iris
        """
        if isinstance(calibration, (str, os.PathLike)):
            calibration = load_calibration(calibration)
        elif not isinstance(calibration, Calibration):
            raise TypeError(f"calibration must be a Calibration or a file, got {type(calibration).__name__}")
        bits = (len(calibration.phases) - 1).bit_length()
        if len(calibration.phases) != 2**bits:
            raise ValueError(f"calibration must have 2^bits levels, got {len(calibration.phases)}")
        phases, wavefront = (torch.as_tensor(part) for part in (calibration.phases, calibration.wavefront))
        response = spatial_light_modulator(bits=bits, lut=phases, aberration=wavefront)
        modulator = Modulator(calibration.amplitude.shape, calibration.pitch, bits, fill, response)
        known: dict[str, Any] = {"distances": calibration.distance, "profile": torch.as_tensor(calibration.amplitude)}
        return cls(modulator, calibration.wavelength, **(known | options))

    def extra_repr(self) -> str:
        """Return the numbers of the display in a line."""
        panel = self.modulator
        pitch = " × ".join(f"{1e6 * p:.4g}" for p in dict.fromkeys(_pitch_pair(panel.pitch)))
        levels = "no levels" if panel.bits is None else f"{panel.bits} bits"
        stop = repr(self.iris) if isinstance(self.iris, Iris) else "no iris" if self.iris is None else "one order"
        before = "" if self._first is None else f"lit through a panel at {1e3 * self._first.distance:.4g} mm, "
        return (
            f"{' × '.join(map(str, panel.resolution))} pixels of {pitch} µm (fill {panel.fill:g}, {levels}), "
            f"{before}{_listed(self.wavelengths, 1e9)} nm, {self.frames} frame{'s' * (self.frames > 1)}, "
            f"{self._planes_in_words()}, {stop}"
        )

    def _planes_in_words(self) -> str:
        if self.eyes is not None:
            lens, count = self.eyes.distance, len(self.eyes)
            length, place = (lens.focal_length, "behind a lens of") if isinstance(lens, Lens) else (lens, "at")
            pupils = _listed(sorted(set(self.eyes.diameter)), 1e3)  # type: ignore[arg-type]
            return f"{count} eye{'s' * (count > 1)} {place} {1e3 * length:.4g} mm, pupils of {pupils} mm"
        if self.lens is not None:
            return f"lens of {1e3 * self.lens.focal_length:.4g} mm"
        return f"plane{'s' * (len(self.distances) > 1)} at {_listed(self.distances, 1e3)} mm"

    def __repr__(self) -> str:
        return f"Display: {self.extra_repr()}"

    def _repr_html_(self) -> str:
        return _show.page(self, Display._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: a section with the light of a pixel in each colour, and its numbers."""
        panel = self.modulator
        pair, (rows, columns) = _pitch_pair(panel.pitch), panel.resolution
        size = f"{1e3 * rows * pair[0]:.4g} mm × {1e3 * columns * pair[1]:.4g} mm"
        table: list = [
            ("property", "value"),
            ("pixels, rows × columns", f"{rows} × {columns}"),
            ("pitch", " × ".join(f"{1e6 * p:.4g}" for p in dict.fromkeys(pair)) + " µm"),
            ("size of panel and images", size),
            ("share of a pixel that emits", f"{panel.fill:g}"),
            ("levels", "any" if panel.bits is None else str(2**panel.bits)),
            ("frames", str(self.frames)),
            ("stop", "one diffraction order" if self.iris == "order" else repr(self.iris)),
            ("refractive index", f"{self.medium:g}"),
        ]
        angles = []
        for wavelength in self.wavelengths:
            sine = wavelength / (2 * max(pair) * self.medium)
            angles.append(math.asin(min(1.0, sine)))
            table.append((f"largest angle at {1e9 * wavelength:.4g} nm", f"{math.degrees(angles[-1]):.4g}°"))
        if self.eyes is None:
            table += [(f"plane {i}", f"{1e3 * distance:.6g} mm") for i, distance in enumerate(self.distances)]
        else:
            table += [
                (f"pupil {i}", ", ".join(f"{1e3 * p:.4g}" for p in place) + " mm")
                for i, place in enumerate(self.eyes.positions)
            ]
        section = _section(rows * pair[0], self.distances, list(zip(self.wavelengths, angles, strict=True)))
        return _show.View(repr(self), [("section: panel, planes, and the light of a pixel", section)], table)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Planes, colours, rows and columns of the images."""
        return (len(self.distances), len(self.wavelengths), *self.modulator.resolution)  # type: ignore[return-value]

    def _apply(self, function, recurse: bool = True):
        self._kept = {}
        super()._apply(function, recurse)
        self._powers_read.moved(self.powers)
        return self

    def _load_from_state_dict(self, *arguments) -> None:
        super()._load_from_state_dict(*arguments)
        self._powers_read(self.powers)

    @property
    def _lit_frames(self) -> tuple[tuple[int, ...], ...]:
        """For each colour, the frames in which its source is on."""
        return self._powers_read(self.powers)

    def _in_words(self) -> str:
        """Return what the transfer functions depend on; see :func:`_of_geometry`."""

        def stop(iris):
            return (float(iris.radius), float(iris.focal_length)) if isinstance(iris, Iris) else iris

        panel, first = self.modulator, self._first
        before = None if first is None else (float(first.distance), float(first.fill), stop(first.iris))
        pixels = tuple(panel.resolution), _pitch_pair(panel.pitch), float(panel.fill)
        return repr((pixels, before, self.wavelengths, _in_numbers(self._path), stop(self.iris), float(self.medium)))

    @property
    def _path(self) -> "tuple[float, ...] | Lens | Eyes":
        """Return what was given as `distances`."""
        return self.eyes or self.lens or self.distances

    def _fingerprint(self) -> str:
        """Return a short text that a display of other lengths, light or panels does not have."""
        panel, first = self.modulator, self._first
        given = [self.powers] if self.profile is None else [self.powers, self.profile]
        if isinstance(panel.response, torch.nn.Module):
            given += panel.response.state_dict().values()
        words = self._geometry, panel.bits, None if first is None else first.bits
        return fingerprint(torch.tensor(list(repr(words).encode())), *given)

    def _once(self, make: str, *given):
        """Return the tensor that a method makes from constants, which is kept until the display moves."""
        if torch.compiler.is_dynamo_compiling():
            return _of_geometry(self._geometry, str(self.powers.device), make, *given)[0]
        key = make, *given
        if key not in self._kept:
            with torch.no_grad(), _torch_private.keeping():
                self._kept[key] = getattr(self, make)(*given)
        return self._kept[key]

    def _orders(self) -> int:
        """Return how many diffraction orders along each axis are computed: behind a lens, the others lie elsewhere."""
        if self.lens is not None:
            return 1
        return self._passing(self.iris)

    def _passing(self, iris) -> int:
        """Return how many diffraction orders along each axis a stop passes."""
        if not isinstance(iris, Iris):
            return _ORDERS if iris is None else 1
        widest = max(iris.cutoff(w) for w in self.wavelengths) * max(_pitch_pair(self.modulator.pitch))
        return min(_ORDERS, max(1, math.ceil(2 * widest - 1e-9)))

    def _cutoff(self, colour: int) -> float | None:
        """Return the highest frequency that a round iris passes, in cycles per metre; None without one."""
        return self.iris.cutoff(self.wavelengths[colour]) if isinstance(self.iris, Iris) else None

    def _kernels(self, colour: int, dtype: torch.dtype, planes: Sequence[int] | None = None) -> torch.Tensor:
        """Return the transfer functions to all points of a pixel on some planes, ``[planes·samples², 2m, 2n]``."""
        return self._once("_of_planes", colour, dtype, tuple(range(self.shape[0]) if planes is None else planes))

    def _of_planes(self, colour, dtype, planes):
        rows, columns = self._window
        # Column by column, which is the order that the propagation reads them in on a CPU.
        shape = len(planes) * self.samples**2, 2 * columns, 2 * rows
        kept = torch.empty(shape, dtype=dtype, device=self.powers.device).mT
        kept = kept if kept.is_cpu else kept.contiguous()
        each = (kernel for plane in planes for kernel in self._of_plane(colour, plane, dtype))
        for place, kernel in zip(kept, each, strict=True):
            place.copy_(kernel)
        return kept

    def _of_plane(self, colour, plane, dtype):
        wavelength, panel, orders = self.wavelengths[colour] / self.medium, self.modulator, self._orders()
        cutoff = self._cutoff(colour)
        # Light that has passed two panels has the spectrum of their pixels already.
        fill, xp = panel.fill if self._first is None else None, _array.namespace(torch.empty(0))

        def grid(samples):
            shape = tuple(2 * n * samples for n in self._window)
            pitch = divided_pitch(panel.pitch, samples)
            return Request(pitch, wavelength, self.distances[plane]).grid(shape, xp, self.powers.device, dtype)

        if orders == 1:
            quarters = itertools.product((False, True), repeat=2)
            yield from (linear_kernel(angular_spectrum, cutoff, fill, halves=h)(grid(1)) for h in quarters)
        else:
            # The response at all points of the pixels of the image. Each point takes its own lags, every so many of
            # them, and with them the repetitions of the spectrum.
            pair, count = _pitch_pair(panel.pitch), self.samples
            transfer = _PixelTransfer(
                (math.sqrt(panel.fill) * pair[0], math.sqrt(panel.fill) * pair[1]),
                (orders / (2 * pair[0]), orders / (2 * pair[1])),
            )
            kernel = linear_kernel(transfer, math.inf if cutoff is None else cutoff)(grid(count))
            response = torch.fft.ifft2(kernel) * count**2
            points = itertools.product(range(count), repeat=2)
            yield from (torch.fft.fft2(response[down::count, across::count]) for down, across in points)

    def _through_both(self, light, amplitudes, colour, kernels):
        """Return the fields ``[..., F, kernel, rows, columns]`` of the light of two panels, filtered by kernels.

        The modulator multiplies the light of the first panel, which holds the diffraction orders that pass its stop.
        Frequencies of the modulator up to one order beyond these reach the images, and with one sample more in each
        pixel than orders pass, no other frequencies are aliased onto them.
        """
        finer = 1 + self._passing(self._first.iris)  # type: ignore[union-attr]
        window, pair = self._window, _pitch_pair(self.modulator.pitch)
        between = self._once("_between", colour, finer, light.dtype)
        there = convolve(_comb(self._lit(amplitudes.to(light.dtype), colour), window, finer), between)
        width = math.sqrt(self.modulator.fill)
        down, across = (
            torch.sinc(width * p * torch.fft.fftfreq(n * finer, p / finer, dtype=light.real.dtype, device=light.device))
            for n, p in zip(window, pair, strict=True)
        )
        spectrum = torch.fft.fft2(_comb(light, window, finer)) * (down[:, None] * across * finer**2)
        product = there * torch.fft.ifft2(spectrum)
        for axis, n in zip((-1, -2), window[::-1], strict=True):
            whole = torch.fft.fft(product, 2 * n * finer, axis) / finer
            product = torch.cat([whole.narrow(axis, 0, n), whole.narrow(axis, 2 * n * finer - n, n)], axis)
        shown = torch.fft.ifft2(product[..., None, :, :] * kernels)
        for axis, n, m in zip((-2, -1), window, self.modulator.resolution, strict=True):
            shown = shown.narrow(axis, (n - m) // 2, m)
        return shown

    def _between(self, colour, finer, dtype) -> torch.Tensor:
        """Return the transfer function from the pixels of the first panel to points at the modulator."""
        first: Any = self._first
        orders, pair = self._passing(first.iris), _pitch_pair(self.modulator.pitch)
        cutoff = first.iris.cutoff(self.wavelengths[colour]) if isinstance(first.iris, Iris) else math.inf
        width = math.sqrt(first.fill)
        transfer = _PixelTransfer((width * pair[0], width * pair[1]), (orders / (2 * pair[0]), orders / (2 * pair[1])))
        request = Request(divided_pitch(self.modulator.pitch, finer), self.wavelengths[colour], first.distance)
        shape = tuple(2 * n * finer for n in self._window)
        xp = _array.namespace(torch.empty(0))
        return linear_kernel(transfer, cutoff)(request.grid(shape, xp, self.powers.device, dtype)) * finer**2

    def fields(self, phases: torch.Tensor, amplitudes: torch.Tensor | None = None) -> torch.Tensor:
        """Return the fields at the middles of the pixels, of unit power of the sources.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[..., F, rows, columns]`` in radians, or ``[rows, columns]`` for a single frame.
        amplitudes : torch.Tensor, optional
            Amplitudes of a panel in front of the modulator, of the same shape, as in :meth:`forward`.

        Returns
        -------
        torch.Tensor
            Complex ``[..., F, D, C, rows, columns]``.
        """
        light, amplitudes = self._light(phases), self._amplitudes(amplitudes)
        colours = range(self.shape[1])
        if self.lens is not None:
            return torch.stack([self._focused(self._lit(light, c).unsqueeze(-3), c) for c in colours], -3)
        if self.eyes is not None:
            lit = [self._lit(light, c).unsqueeze(-3) for c in colours]
            seen = [[self._seen(lit[c], c, e)[..., 0, 0, :, :] for e in range(self.shape[0])] for c in colours]
            return torch.stack([torch.stack(one, -3) for one in seen], -3)
        middles = [self._kernels(c, light.dtype)[:: self.samples**2] for c in colours]
        if self._first is not None:
            return torch.stack([self._through_both(light, amplitudes, c, k) for c, k in enumerate(middles)], -3)
        return torch.stack([convolve(self._lit(light, c).unsqueeze(-3), k) for c, k in enumerate(middles)], -3)

    def forward(
        self, phases: torch.Tensor, powers: torch.Tensor | None = None, amplitudes: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Return what is seen: for each plane and colour the mean over time, and over the area of each pixel.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` in radians, or ``[rows, columns]`` for a single frame; differentiable. More
            axes in front are a batch of patterns, each of which is shown by itself.
        powers : torch.Tensor, optional
            Powers ``[F, C]`` of the sources, in place of the display's own; differentiable. A source that is off in a
            frame of the display stays off, of which an ArgumentWarning tells; :meth:`lit_by` lights it.
        amplitudes : torch.Tensor, optional
            Amplitudes 0 … 1 of the panel that the modulator is lit through, of the shape of the phases; differentiable.
            One by default.

        Returns
        -------
        torch.Tensor
            Real ``[..., D, C, rows, columns]``, in units of what a flat phase sends into the order in the middle: the
            light on the modulator times the square of its `fill`, and of the `fill` of a panel before it.
        """
        light, amplitudes = self._light(phases), self._amplitudes(amplitudes)
        powers = self.powers if powers is None else self._in_its_frames(self._fitting(powers))
        if self._parts:
            return self._in_parts(light, powers)
        parts = [_Part(colour, None, frames) for colour, frames in enumerate(self._lit_frames)]
        return torch.stack([self._image(light, part, powers, amplitudes) for part in parts], -3)

    def _shared_among(self, devices: Sequence[torch.device] | Ranks) -> "Display":
        """Return this display with its images computed in parts by several devices, or by the ranks of a group.

        The parts are nearly equal in number of planes, colours and frames. Each device has the transfer functions of
        its own part alone.
        """
        ranks = devices if isinstance(devices, Ranks) else None
        where = [self.powers.device] if isinstance(devices, Ranks) else devices
        units = [
            (colour, plane, frame)
            for colour in range(self.shape[1])
            for plane in range(self.shape[0])
            for frame in self._lit_frames[colour]
        ]
        shares = shares_of(units, len(where) if ranks is None else ranks.size)
        shares = shares if ranks is None else [shares[ranks.rank]]
        whole = self._on(self.powers.device)
        whole._ranks = ranks
        whole._parts = [
            (self._on(device), _grouped(share)) for device, share in zip(where, shares, strict=True) if share or ranks
        ]
        return whole

    def _on(self, device: torch.device) -> "Display":
        """Return a copy of this display on a device, which has transfer functions of its own."""
        modulator = self.modulator
        if isinstance(modulator.response, torch.nn.Module) and device != self.powers.device:
            modulator = replace(modulator, response=copy.deepcopy(modulator.response).to(device))
        return copy.deepcopy(self, {id(self._kept): {}, id(self.modulator): modulator}).to(device)

    def _in_parts(self, light, powers):
        """Return what :meth:`forward` does, the sum of what each device computes of it."""
        images: list[list[Any]] = [[0.0] * self.shape[1] for _ in range(self.shape[0])]
        if self._ranks is not None:
            light, powers = self._ranks.sharing(light), self._ranks.sharing(powers)
        for display, parts in self._parts:
            there, own = (values.to(display.powers.device, non_blocking=True) for values in (light, powers))
            # A rank without a part computes one that does not count, since all ranks take part in the gradient.
            for part in parts or [_Part(0, (0,), self._lit_frames[0][:1])]:
                shown = display._image(there, part, own).to(light.device, non_blocking=True)
                for plane, image in zip(part.planes or (), (shown if parts else 0 * shown).unbind(-3), strict=True):
                    images[plane][part.colour] = images[plane][part.colour] + image
        if self._ranks is None:
            return torch.stack([torch.stack(row, -3) for row in images], -4)
        nothing = torch.zeros_like(light.real[..., 0, :, :])
        return self._ranks.sum(torch.stack([torch.stack([nothing + one for one in row], -3) for row in images], -4))

    def _light(self, phases):
        if "int" in str(getattr(phases, "dtype", "")) and _array.is_readable(phases) and phases.max() > 7:
            raise ValueError(
                f"phases must be in radians, got integers up to {int(phases.max())}: levels of the panel? Their phases "
                "are 2π·level/2^bits"
            )
        return self.modulator.light(self._patterns("phases", floating("phases", phases)))

    def _patterns(self, name: str, values: torch.Tensor) -> torch.Tensor:
        """Return the values of pixels in each frame, ``[..., F, rows, columns]``, on the device of the display."""
        shape = (self.frames, *self.modulator.resolution)
        if self.frames == 1 and tuple(values.shape) == shape[1:]:
            values = values[None]
        if tuple(values.shape[-3:]) != shape:
            raise ValueError(f"{name} must be [frames, rows, columns] = {list(shape)}, got {list(values.shape)}")
        return values.to(self.powers.device)

    def _amplitudes(self, amplitudes):
        """Return the amplitudes of the first of two panels ``[..., F, rows, columns]``; None where there is one."""
        if self._first is None:
            if amplitudes is not None:
                raise ValueError("amplitudes must be None for a modulator without lit_through")
            return None
        if amplitudes is None:
            return self.powers.new_ones(self.frames, *self.modulator.resolution)
        amplitudes = self._patterns("amplitudes", floating("amplitudes", amplitudes))
        # Reading them would wait for the device at each step of an optimisation.
        known = not (amplitudes.requires_grad or torch.compiler.is_compiling() or _torch_private.is_wrapped(amplitudes))
        if known and not bool(((amplitudes >= 0) & (amplitudes <= 1)).all()):
            raise ValueError(f"amplitudes must be 0 … 1, got {float(amplitudes.min())} to {float(amplitudes.max())}")
        return amplitudes

    def _fitting(self, powers):
        powers, shape = floating("powers", powers), [self.frames, len(self.wavelengths)]
        if list(powers.shape) != shape:
            raise ValueError(f"powers must be [frames, wavelengths] = {shape}, got {list(powers.shape)}")
        return powers

    def _in_its_frames(self, powers):
        """Return powers after a warning where they light a source in a frame in which it stays off."""
        if powers.requires_grad or torch.compiler.is_compiling() or not _array.is_readable(powers):
            return powers
        if any(set(given) - set(own) for given, own in zip(_frames_lit(powers), self._lit_frames, strict=True)):
            warn(
                "powers light a source in a frame in which it is off in this display, and where it stays off: "
                "make a display of these powers by lit_by(powers)",
                ArgumentWarning,
            )
        return powers

    def _lit(self, light, colour):
        return light if self.profile is None else light * self.profile[colour].to(light.dtype)

    @torch.no_grad()
    def _flat(self, colour: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what the light of a flat pattern has: amplitude, of mean square one, and phase, such as aberration."""
        if self.profile is None and self.modulator.response is None:
            return self.powers.new_ones(()), self.powers.new_zeros(())
        flat = self._light(self.powers.new_zeros(self.frames, *self.modulator.resolution))
        light = self._lit(flat, colour)[self._lit_frames[colour][0]]
        return light.abs() / intensity(light).mean().sqrt(), light.angle()

    def _image(self, light, part: "_Part", powers, amplitudes=None):
        """Return the means over pixels of a part, ``[..., planes, rows, columns]``."""
        colour, frames, power = part.colour, part.frames, powers[:, part.colour]

        def shown_in(values):
            return values if len(frames) == self.frames else torch.stack([values[..., f, :, :] for f in frames], -3)

        lit = shown_in(light)
        light = self._lit(lit, colour).unsqueeze(-3)
        if self._first is not None:
            kernels = self._kernels(colour, lit.dtype, part.planes)
            shown = self._through_both(lit, shown_in(amplitudes), colour, kernels)
        elif self.eyes is not None:
            eyes = range(self.shape[0]) if part.planes is None else part.planes
            shown = torch.cat([self._seen(light, colour, eye).flatten(-4, -3) for eye in eyes], -3)
        elif self.lens is None:
            # One kernel for each plane and point of a pixel takes one transform back, but a single forward one.
            shown = convolve(light, self._kernels(colour, light.dtype, part.planes))
        else:
            quarters = itertools.product((0.0, 0.5), repeat=2)
            shown = torch.cat([self._focused(light, colour, half) for half in quarters], -3)
        amplitudes = (torch.stack([power[f] for f in frames]) / power.sum()).sqrt()[:, None].to(shown.real.dtype)
        # The patterns of a batch beside the planes: frames are summed up, and these are not.
        batch, points = shown.shape[:-4], shown.movedim(-4, 0).flatten(1, -3)
        areas = _over_areas(
            exposure(points[:, :, None], amplitudes)[:, 0].unflatten(0, (-1, self.samples, self.samples))
        )
        return areas.reshape(*batch, -1, *areas.shape[-2:])

    def _seen(self, light, colour, eye):
        """Return the field on a retina at the points of a pixel, ``[..., samples, samples, rows, columns]``."""
        parts = (self._once("_of_eye", colour, eye, part, light.dtype) for part in range(5))
        shown = seen_by_eye(light, *parts)
        samples = self.samples
        rows, columns = self.modulator.resolution
        return (
            shown[..., 0, :, :]
            .unflatten(-2, (rows, samples))
            .unflatten(-1, (columns, samples))
            .movedim((-3, -1), (-4, -3))
        )

    def _back_from_eye(self, amplitudes, light, colour, eye):
        """Return the light on the panel, by the adjoint, of the image of an eye with its amplitudes replaced."""
        down, across, pupil, *back = (self._once("_of_eye", colour, eye, part, light.dtype) for part in range(5))
        # Every so many rows of the matrices are the middles of pixels.
        back_down, back_across = (matrix[:: self.samples] for matrix in back)
        shown = seen_by_eye(light, down, across, pupil, back_down, back_across)
        there = back_down.mH @ (amplitudes * unit_phasor(shown.angle())) @ back_across.conj() * pupil.conj()
        return down.mH @ there @ across.conj()

    def _of_eye(self, colour, eye, part, dtype):
        made = self._sight(colour, eye).part(part, self.samples)
        return torch.from_numpy(made).to(self.powers.device, dtype)

    def _sight(self, colour, eye) -> Sight:
        """Return the way of the light of a colour to the retina of an eye."""
        panel = self.modulator
        pixels = tuple(panel.resolution), _pitch_pair(panel.pitch)
        width, one_order = math.sqrt(panel.fill), self.iris == "order"
        return Sight(self.eyes, eye, *pixels, self.wavelengths[colour], width, one_order)  # type: ignore[arg-type]

    def _checked_eyes(self) -> int:
        """Return how many points of a pixel describe what eyes see; warn where they see no image of the panel."""
        sights = [self._sight(c, e) for c in range(len(self.wavelengths)) for e in range(len(self.eyes or ()))]
        worst = min(sights, key=Sight.seen)
        if self.iris == "order" and worst.seen() < 1:
            place = ", ".join(f"{1e3 * p:.3g}" for p in worst.eyes.positions[worst.eye])
            wide = 1e3 * min(map(worst.box, (0, 1)))
            warn(
                f"the light of {1 - worst.seen():.0%} of the rows or columns of the panel passes by the pupil at "
                f"({place}) mm at {1e9 * worst.wavelength:.4g} nm: one order is {wide:.3g} mm wide there",
                SamplingWarning,
            )
        check_blur(max(map(Sight.blur, sights)), worst.sizes, worst.pitches)
        return max(map(Sight.samples, sights))

    def _focused(self, light, colour, beside=(0.0, 0.0)):
        """Return the field behind the lens, at the middles of the points of an image or a part of one beside them."""
        before, behind = self._of_lens(colour, light.dtype, beside)
        lit = torch.fft.ifftshift(light * before, dim=(-2, -1))
        return torch.fft.fftshift(torch.fft.fft2(lit, norm="ortho"), dim=(-2, -1)) * behind

    def _back(self, field, colour):
        """Return the light on the panel of a field behind the lens, as if all frequencies passed."""
        before, _ = self._of_lens(colour, field.dtype)
        lit = torch.fft.ifft2(torch.fft.ifftshift(field, dim=(-2, -1)), norm="ortho")
        return torch.fft.fftshift(lit, dim=(-2, -1)) * before.conj()

    def _of_lens(self, colour, dtype, beside=(0.0, 0.0)):
        """Return the factors of the light on the panel and of the field behind the lens, which its pixels envelop."""
        return self._once("_before_lens", colour, dtype, beside), self._once("_behind_lens", colour, dtype, beside)

    def _before_lens(self, colour, dtype, beside):
        cycles = self._curvature(colour)
        for axis, (n, part) in enumerate(zip(self.modulator.resolution, beside, strict=True)):
            turn = -part / n * (torch.arange(n, dtype=torch.float64) - n // 2)
            cycles = cycles + (turn[:, None] if axis == 0 else turn)
        turn = 2 * math.pi * torch.remainder(cycles, 1)
        return torch.polar(torch.ones_like(turn), turn).to(self.powers.device, dtype)

    def _behind_lens(self, colour, dtype, beside):
        frequencies = [
            (torch.arange(n, dtype=torch.float64) - n // 2 + part) / n
            for n, part in zip(self.modulator.resolution, beside, strict=True)
        ]
        return self._envelope(frequencies, colour).to(self.powers.device, dtype.to_real())

    def _curvature(self, colour) -> torch.Tensor:
        """Return the phase of the light on the panel that the lens leaves at a plane beside its focus, in cycles."""
        a, b = self.lens.ray_matrix  # type: ignore[union-attr]
        y, x = (
            (torch.arange(n, dtype=torch.float64) - n // 2) * p
            for n, p in zip(self.modulator.resolution, _pitch_pair(self.modulator.pitch), strict=True)
        )
        return a * self.medium / (2 * self.wavelengths[colour] * b) * (y[:, None] ** 2 + x**2)

    def _envelope(self, frequencies: Sequence[torch.Tensor], colour: int) -> torch.Tensor:
        """Return what square pixels, the block and the iris pass of frequencies along rows and columns, per pixel."""
        lens: Any = self.lens
        down, across = (torch.sinc(math.sqrt(self.modulator.fill) * f) for f in frequencies)
        pair, wavelength = _pitch_pair(self.modulator.pitch), self.wavelengths[colour]
        radius = torch.hypot(frequencies[0][:, None] / pair[0], frequencies[1] / pair[1])
        passed = torch.outer(down, across)
        passed = passed * (wavelength / self.medium * abs(lens.ray_matrix[1]) * radius >= lens.block)
        return passed * (radius <= self.iris.cutoff(wavelength)) if isinstance(self.iris, Iris) else passed

    @torch.no_grad()
    def judge(self, phases: torch.Tensor, amplitudes: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the images of patterns by another computation than :meth:`forward`, and those at points.

        Each pixel is a comb of samples, propagated by the method that :func:`odak.wave.sampling_report` recommends on a
        grid of twice the size that :meth:`forward` takes, and multiplied by the spectrum of a square; the mean over the
        area of a pixel is a product of spectra. It shares neither transfer functions nor weights with :meth:`forward`.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` in radians.
        amplitudes : torch.Tensor, optional
            Amplitudes of a panel in front of the modulator, of the same shape, as in :meth:`forward`.

        Returns
        -------
        tuple of torch.Tensor
            Means over the areas of pixels, and intensities at their middles, ``[D, C, rows, columns]`` each.
        """
        light, amplitudes = self._light(phases), self._amplitudes(amplitudes)
        if light.ndim > 3:
            raise ValueError(f"phases must be without a batch, [frames, rows, columns], got {list(light.shape)}")
        images = torch.stack([torch.zeros(self.shape, device=light.device, dtype=light.real.dtype)] * 2)
        for c, wavelength in enumerate(self.wavelengths):
            power = self.powers[:, c] / self.powers[:, c].sum()
            for d, distance in enumerate(self.distances):
                for f in self._lit_frames[c]:
                    lit, finer = self._lit(light[f : f + 1], c)[0], self._orders() if self.lens is None else 2
                    if amplitudes is not None:
                        finer = 2 + self._passing(self._first.iris)  # type: ignore[union-attr]
                        first = self._lit(amplitudes[f : f + 1].to(light.dtype), c)[0]
                        lit = self._both(first, light[f], wavelength, finer)
                        shown = self._spread_freely(lit, wavelength, distance, finer)
                    elif self.eyes is not None:
                        shown, finer = self._on_retina(lit, self._sight(c, d))
                    elif self.lens is None:
                        # Without a round stop the grid has no frequencies but those that pass.
                        round_stop = isinstance(self.iris, Iris)
                        passed = self._passed(finer, wavelength, self.iris, lit.device) if round_stop else 1.0
                        lit = self._sampled(lit, finer, self.modulator.fill, passed)
                        shown = self._spread_freely(lit, wavelength, distance, finer)
                    else:
                        shown = self._spread(lit, c)
                    images[0, d, c] += power[f] * mean_over_areas(shown, self.modulator.resolution, finer)
                    images[1, d, c] += power[f] * _middles(intensity(shown), self.modulator.resolution, finer)
        return images[0], images[1]

    def lit_by(self, powers: torch.Tensor) -> "Display":
        """Return the same display with other powers of the sources, ``[F, C]``."""
        given = self.modulator, self.wavelengths, self._path, self.frames, powers, self.profile
        return Display(*given, self.iris, self.medium).to(self.powers.device)

    def _spread(self, light, colour):
        """Return the field behind the lens at twice as many points as an image has, over twice its extent."""
        sizes = self.modulator.resolution
        turn = 2 * math.pi * torch.remainder(self._curvature(colour), 1)
        light = light * torch.polar(torch.ones_like(turn), turn).to(light.device, light.dtype)
        # In the order of the transform, whose period is one order.
        field = torch.fft.fft2(light, s=[2 * n for n in sizes]).tile(2, 2) / math.sqrt(math.prod(sizes))
        frequencies = [(torch.arange(4 * n, dtype=torch.float64) - 2 * n) / (2 * n) for n in sizes]
        # The panel begins at the first sample, its axis is pixel n // 2.
        moved = [f * (n // 2) for f, n in zip(frequencies, sizes, strict=True)]
        turn = 2 * math.pi * torch.remainder(moved[0][:, None] + moved[1], 1)
        passed = torch.polar(self._envelope(frequencies, colour), turn).to(light.device, light.dtype)
        return torch.fft.fftshift(field) * passed

    def _on_retina(self, light, sight: Sight):
        """Return the field that an eye sees, over an area of twice the extent of the panel, and its samples per pixel.

        Along each axis the light of square pixels passes the stop, and is transformed to the plane of the pupil with
        the curvature that the path gives it, and back.
        """
        (a, b, _), kind = sight.ray_matrix(), {"dtype": torch.float64, "device": light.device}
        boxes, lengths, places, spacing = [sight.box(axis) for axis in (0, 1)], [], [], []
        axes = list(zip((-2, -1), light.shape, sight.pitches, boxes, *sight.pupil(), strict=True))
        # Zeros around a small panel bring the points of the pupil nearer to each other.
        wide = max(math.ceil(16 * box / (n * half)) for _, n, _, box, _, half in axes)
        for axis, n, pitch, box, middle, half in axes:
            # All orders that reach the pupil, from the rim of the panel too.
            finer = math.ceil(2 * (abs(middle) + half) / box + 1)
            count, step = 2 * n * finer * wide, pitch / finer
            comb = light.new_zeros(*(count if k == axis else light.shape[k] for k in (-2, -1)))
            first = count // 2 - n // 2 * finer
            comb.narrow(axis, first, n * finer).unfold(axis, finer, finer)[..., 0].copy_(light)
            f = torch.fft.fftfreq(count, step, **kind)
            passed = torch.sinc(math.sqrt(self.modulator.fill) * pitch * f) * finer
            if self.iris is not None:
                # Half of the last frequency, which is rounded.
                passed = passed * sum(0.5 * (f.abs() < (0.5 + shift) / pitch) for shift in (-1e-6, 1e-6))
            x = (torch.arange(count, **kind) - count // 2) * step
            bent = torch.fft.ifftshift(_array.phasor_of_cycles(a / (2 * sight.wavelength * b) * x**2))

            passed, bent = (v.to(light.dtype)[:, None] if axis == -2 else v.to(light.dtype) for v in (passed, bent))
            spectrum = torch.fft.fft(torch.fft.ifftshift(comb, axis), dim=axis) * passed
            there = torch.fft.fft(torch.fft.ifft(spectrum, dim=axis) * bent, dim=axis)
            u = f * sight.wavelength * b - middle
            inside = torch.nonzero(u.abs() < half + sight.wavelength * abs(b) / (count * step))[:, 0]
            inside = inside[f[inside].argsort()]
            light = there.index_select(axis, inside)
            places.append(u[inside] / half)
            spacing.append(sight.wavelength * abs(b) / (count * step * half))
            lengths.append(count)
        down, across = places[0][:, None], places[1]
        halves = sight.pupil()[1]
        blur = sight.defocus() / (2 * sight.wavelength) * ((halves[0] * down) ** 2 + (halves[1] * across) ** 2)
        light = light * (covered(torch, down, across, spacing) * _array.phasor_of_cycles(blur)).to(light.dtype)
        # Tilts of the light as a whole have no effect on the image.
        finer = max(math.ceil(len(p) / (2 * n * wide)) for p, (_, n, *_) in zip(places, axes, strict=True))
        for count, (axis, n, *_) in zip(lengths, axes, strict=True):
            size = 2 * n * finer * wide
            more = size - light.shape[axis]
            around = (more // 2, more - more // 2)
            light = torch.nn.functional.pad(light, (0, 0, *around) if axis == -2 else around)
            shown = torch.fft.ifft(torch.fft.ifftshift(light, axis), dim=axis) * (size / count)
            light = torch.fft.fftshift(shown, axis)
            light = light.narrow(axis, (size - 2 * n * finer) // 2, 2 * n * finer)
        return light, finer

    def _sampled(self, light, samples, fill, passed: torch.Tensor | float = 1.0):
        """Return the field of square pixels on a grid of twice its extent, with several samples in each pixel.

        `passed` is what a stop passes of the frequencies of the grid.
        """
        sizes = self.modulator.resolution
        comb = light.new_zeros([2 * n * samples for n in sizes])
        # The middle of the panel, its pixel n // 2, lies on the middle of the finer grid.
        first = [n * samples - n // 2 * samples for n in sizes]
        comb[tuple(slice(a, a + n * samples, samples) for a, n in zip(first, sizes, strict=True))] = light
        down, across = (
            torch.sinc(math.sqrt(fill) * p * f) * samples
            for p, f in zip(_pitch_pair(self.modulator.pitch), self._frequencies(samples, light.device), strict=True)
        )
        return torch.fft.ifft2(torch.fft.fft2(comb) * (down[:, None] * across * passed))

    def _frequencies(self, samples, device) -> list[torch.Tensor]:
        """Return the frequencies along rows and columns of a grid of twice the extent of the panel."""
        pair = _pitch_pair(divided_pitch(self.modulator.pitch, samples))
        return [
            torch.fft.fftfreq(2 * n * samples, p, device=device)
            for n, p in zip(self.modulator.resolution, pair, strict=True)
        ]

    def _passed(self, samples, wavelength, iris, device) -> torch.Tensor:
        """Return what a stop passes of the frequencies of a grid."""
        down, across = self._frequencies(samples, device)
        if isinstance(iris, Iris):
            return down[:, None] ** 2 + across**2 <= iris.cutoff(wavelength) ** 2
        # Half of the last frequency itself, which is rounded, on either side.
        half = [0.5 * self._passing(iris) / p for p in _pitch_pair(self.modulator.pitch)]
        down, across = (
            0.5 * (f.abs() < (1 - 1e-6) * h) + 0.5 * (f.abs() < (1 + 1e-6) * h)
            for f, h in zip((down, across), half, strict=True)
        )
        return down[:, None] * across

    def _both(self, amplitudes, light, wavelength, samples):
        """Return the field behind the second of two panels, as far as the iris of the display passes it."""
        first: Any = self._first
        passed = self._passed(samples, wavelength, first.iris, light.device)
        there = self._spread_freely(
            self._sampled(amplitudes, samples, first.fill, passed), wavelength, first.distance, samples, 1.0
        )
        product = torch.fft.fft2(there * self._sampled(light, samples, self.modulator.fill))
        return torch.fft.ifft2(product * self._passed(samples, wavelength, self.iris, light.device))

    def _spread_freely(self, field, wavelength, distance, samples, medium=None):
        """Return a field with several samples in each pixel after it has travelled a distance."""
        if distance == 0:
            return field
        pitch, inside = divided_pitch(self.modulator.pitch, samples), wavelength / (medium or self.medium)
        with_padding = sampling_report(tuple(field.shape), pitch, inside, distance, zero_padding=True)
        return propagate_beam(
            field, None, distance, pitch, inside, with_padding.recommended, zero_padding=[True, False, True]
        )


@_array.constant_in_graphs
def _of_geometry(geometry: str, device: str, make: str, *given) -> tuple[torch.Tensor]:
    """Return what a display of some geometry keeps, for a graph of torch.compile to hold.

    The compiler recognises the constant by the text of the geometry. By the object alone it would not: what a method of
    one display returns, it takes for all displays; and numbers may become variables of the graph. The result is in a
    tuple because one graph can hold several tuples, but only one tensor from each function.
    """

    def stop(iris):
        return Iris(*iris) if isinstance(iris, tuple) else iris

    (resolution, pitch, fill), before, wavelengths, path, iris, medium = ast.literal_eval(geometry)
    with _torch_private.outside_functional_transforms(), torch.no_grad(), _torch_private.keeping():
        first = None if before is None else AmplitudePanel(before[0], None, before[1], stop(before[2]))
        modulator = Modulator(resolution, pitch, None, fill, lit_through=first)
        display = Display(modulator, wavelengths, _of_numbers(path), iris=stop(iris), medium=medium)
        return (getattr(display.to(device), make)(*given),)


def _in_numbers(path):
    """Return a path of light as a tuple of numbers, texts and tuples of them."""
    if isinstance(path, (Lens, Eyes)):
        return (type(path).__name__, *(_in_numbers(getattr(path, one.name)) for one in fields(path)))
    if isinstance(path, tuple):
        return tuple(map(_in_numbers, path))
    # Infinity is a focus of eyes, and no number in a text of Python.
    return path if path is None or math.isfinite(path) else str(path)


def _of_numbers(path):
    """Return what :func:`_in_numbers` has been given."""
    if isinstance(path, tuple):
        kind = {"Lens": Lens, "Eyes": Eyes}.get(path[0])
        parts = map(_of_numbers, path if kind is None else path[1:])
        return tuple(parts) if kind is None else kind(*parts)
    return float(path) if isinstance(path, str) else path


def _frames_lit(powers: torch.Tensor) -> tuple[tuple[int, ...], ...]:
    """Return for each colour the frames in which its source is on, of powers ``[F, C]`` that light each colour."""
    if bool((powers < 0).any()):
        raise ValueError(f"powers must be at least 0, got {float(powers.min())}")
    if not bool((powers.sum(0) > 0).all()):
        raise ValueError(
            f"powers must light each wavelength in a frame, got {powers.sum(0).tolist()} over all {len(powers)} "
            "frames; give more frames, or powers"
        )
    return tuple(tuple(f for f, power in enumerate(row) if power) for row in powers.T.tolist())


@dataclass(frozen=True)
class _Part:
    """Part of the images of a display: the frames of one colour on some planes, on all of them by None."""

    colour: int
    planes: tuple[int, ...] | None
    frames: tuple[int, ...]


def _grouped(units: Sequence[tuple[int, int, int]]) -> list[_Part]:
    """Return few parts that are all of some colours, planes and frames, in this order, each plane in one part."""
    planes = [(key, tuple(f for *_, f in own)) for key, own in itertools.groupby(units, lambda unit: unit[:2])]
    alike = itertools.groupby(planes, lambda found: (found[0][0], found[1]))
    return [_Part(colour, tuple(plane for (_, plane), _ in own), frames) for (colour, frames), own in alike]


@dataclass(frozen=True)
class _PixelTransfer:
    """Transfer function of free space for square pixels of some width, in a band that a square stop passes."""

    width: tuple[float, float]
    band: tuple[float, float]

    def __call__(self, grid):
        def kernel(fy, fx):
            spectrum = plane_wave_transfer(grid, fy, fx)
            for frequency, width, limit in zip((fy, fx), self.width, self.band, strict=True):
                passed = torch.sinc(width * frequency) * (0.5 * (frequency < limit) + 0.5 * (frequency <= limit))
                spectrum = spectrum * passed.to(spectrum.dtype)
            return spectrum

        return grid.evaluate(kernel)


def _numbers(name, values, positive=False) -> tuple[float, ...]:
    (values,) = _validate.constants(**{name: values})
    given = [values] if np.ndim(values) == 0 else values
    checked = tuple(float(value) for value in _validate.several(name, given, positive=positive))
    if not checked:
        raise ValueError(f"{name} must contain at least one number, got none")
    return checked


def _checked_bits(bits: int | None) -> None:
    if bits is not None and not 1 <= _validate.integer("bits", bits) <= 16:
        raise ValueError(f"bits must be 1 to 16 or None, got {bits}")


def _checked_iris(iris: Any) -> None:
    if iris is not None and iris != "order" and not isinstance(iris, Iris):
        raise ValueError(f"iris must be 'order', an Iris or None, got {iris!r:.80}")


def _comb(light: torch.Tensor, window: Sequence[int], samples: int) -> torch.Tensor:
    """Return values of pixels ``[..., rows, columns]`` in the middle of a window, each followed by zeros."""
    rows, columns = light.shape[-2:]
    comb = light.new_zeros(*light.shape[:-2], *(n * samples for n in window))
    top, left = ((n - m) // 2 * samples for n, m in zip(window, (rows, columns), strict=True))
    comb[..., top : top + rows * samples : samples, left : left + columns * samples : samples] = light
    return comb


def _listed(lengths: Sequence[float], scale: float) -> str:
    return ", ".join(f"{length * scale:.4g}" for length in lengths)


def _pitch_pair(pitch) -> tuple[float, float]:
    rows, columns = (float(_validate.numbers(p)[0]) for p in pitches(pitch))
    return rows, columns


@_array.constant_in_graphs
def _taps(samples: int) -> tuple[torch.Tensor]:
    """Return the weights of the mean over a pixel of an intensity that is known at some points of each pixel.

    The intensity has frequencies up to samples/2 cycles per pixel, at which its spectrum, an autocorrelation, falls to
    zero. The spectrum of the weights is the nearest one to sin(πf)/(πf), by least squares with the square of that fall.
    """
    reach = _REACH * samples
    cycles = np.linspace(0, samples / 2, 64 * samples)
    lags = np.arange(reach + 1)
    columns = np.cos(2 * np.pi * cycles[:, None] * lags / samples) * np.where(lags == 0, 1, 2)
    weight = (1 - cycles / (samples / 2))[:, None] ** 2 + 1e-4
    half = np.linalg.lstsq(columns * weight, np.sinc(cycles)[:, None] * weight, rcond=None)[0][:, 0]
    whole = np.concatenate([half[:0:-1], half])
    return (torch.from_numpy(whole / whole.sum()),)


@in_own_precision
def _over_areas(points: torch.Tensor) -> torch.Tensor:
    """Return the means over pixels of intensities at their points ``[planes, samples, samples, rows, columns]``."""
    planes, samples, _, rows, columns = points.shape
    finer = points.permute(0, 3, 1, 4, 2).reshape(planes, 1, rows * samples, columns * samples)
    taps, reach = _taps(samples)[0].to(points), _REACH * samples
    padded = torch.nn.functional.pad(finer, (reach, reach, reach, reach), mode="replicate")
    across = torch.nn.functional.conv2d(padded, taps[None, None, None], stride=(1, samples))
    return torch.nn.functional.conv2d(across, taps[None, None, :, None], stride=(samples, 1))[:, 0]


def _middles(image: torch.Tensor, shape: Sequence[int], orders: int) -> torch.Tensor:
    first = [n * orders - n // 2 * orders for n in shape]
    return image[tuple(slice(a, a + n * orders, orders) for a, n in zip(first, shape, strict=True))]


def mean_over_areas(shown: torch.Tensor, shape: Sequence[int], orders: int = 1) -> torch.Tensor:
    """Return the mean intensity over the area of each pixel of a window in the middle of a field.

    The intensity has twice the band of the field, so that samples at half steps describe it; its mean over squares is a
    product of spectra: exact, but for what the grid wraps around. The samples at half steps are computed one
    shift after the other, which takes a quarter of the memory of a finer grid.

    Parameters
    ----------
    shown : torch.Tensor
        Band-limited field ``[rows, columns]`` with `orders` samples per pixel along each axis.
    shape : sequence of int
        Rows and columns of pixels of the window.
    orders : int
        Samples per pixel.
    """
    # In the order of the transform: sample 0 is the optical axis.
    spectrum, total = torch.fft.fft2(torch.fft.ifftshift(shown)), 0.0
    shifted, weights = zip(*(_half_steps(n, orders, shown.real) for n in shown.shape), strict=True)
    for a, b in itertools.product(range(2), range(2)):
        light = intensity(torch.fft.ifft2(spectrum * shifted[0][a][:, None] * shifted[1][b]))
        half = weights[1][b][: shown.shape[1] // 2 + 1]
        total = total + torch.fft.rfft2(light) * weights[0][a][:, None] * half
    return _middles(torch.fft.fftshift(torch.fft.irfft2(total, shown.shape)), shape, orders)


def _half_steps(n: int, orders: int, like: torch.Tensor) -> list[list[torch.Tensor]]:
    """Return factors of a spectrum that shift a field by 0 and ½ sample, and those that take means of its intensity.

    The intensity at whole and half samples has frequencies up to one cycle per sample. At whole samples those above a
    half fall on those below; each is weighted by the transform of a pixel.
    """
    f = torch.fft.fftfreq(n, dtype=torch.float64)
    alias = f - torch.where(f < 0, -1.0, 1.0)
    between, sinc = torch.polar(torch.ones_like(f), math.pi * f), [torch.sinc(orders * g) for g in (f, alias)]
    # The highest frequency is one with its negative: half of it turns each way.
    shifts = [torch.ones_like(between), torch.where(f == -0.5, 0.0, 1.0) * between]
    # A shift by half a sample changes the sign of the aliases.
    means = [(sinc[0] + sinc[1]) / 2 + 0j, (sinc[0] - sinc[1]) / 2 * between.conj()]
    kind = torch.complex64 if like.dtype == torch.float32 else torch.complex128
    return [[v.to(like.device, kind) for v in row] for row in (shifts, means)]


@dataclass(frozen=True)
class Problem:
    """What a solver is given: a display, the images to show, how they are compared, and the phases to begin with.

    Attributes
    ----------
    display : Display
        The display.
    target : torch.Tensor
        Intensities ``[D, C, rows, columns]``.
    loss : callable
        ``loss(image, target)``.
    start : torch.Tensor
        Phases ``[F, rows, columns]`` in radians.
    run : Run
        How long, with what progress and seed.
    free : bool
        Whether the brightness of the images is free.

    Examples
    --------
    A solver of your own: the phases of the light that would travel back from the target.

    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Problem, optimise, propagate_beam
    >>> class Backwards:
    ...     def solve(self, problem: Problem) -> torch.Tensor:
    ...         display = problem.display
    ...         field = problem.target[0, 0].sqrt() * torch.exp(1j * problem.start[0])
    ...         back = propagate_beam(
    ...             field, dx=8e-6, wavelength=display.wavelengths[0], distance=-display.distances[0]
    ...         )
    ...         return back.angle()[None]
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> hologram = optimise(display, torch.ones(48, 64), solver=Backwards(), start="flat")
    >>> bool(hologram.psnr > 10)
    True
    """

    display: Display
    target: torch.Tensor
    loss: Callable[..., Any]
    start: torch.Tensor
    run: Run
    free: bool = True

    def loss_of(
        self, phases: torch.Tensor, powers: torch.Tensor | None = None, amplitudes: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Return the loss of patterns.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` in radians.
        powers : torch.Tensor, optional
            Powers ``[F, C]`` of the sources; by default the display's own.
        amplitudes : torch.Tensor, optional
            Amplitudes ``[F, rows, columns]`` of the panel that the modulator is lit through; one by default.

        Returns
        -------
        torch.Tensor
            The loss.
        """
        return self.loss(self.scaled(self.display(phases, powers, amplitudes)), self.target)

    def scaled(self, images: torch.Tensor) -> torch.Tensor:
        """Return images at the brightness of each colour that is closest to the target: sources can be dimmed."""
        return images * brightness_of(images.detach(), self.target) if self.free else images


class Solver(Protocol):
    """What finds the phases of a problem: an object of one method."""

    def solve(self, problem: Problem) -> torch.Tensor | tuple[torch.Tensor | None, ...]:
        """Return the phases ``[frames, rows, columns]`` in radians, or them and what else was found.

        These are the powers of the sources or None and, third, the amplitudes of the panel in front of the modulator.
        """
        ...


@dataclass(frozen=True)
class Descent:
    """Gradient descent over the phases, by L-BFGS or Adam: the solver to begin with.

    Use L-BFGS unless the loss changes from one iteration to the next, as with random numbers in it or a camera.

    Parameters
    ----------
    method : {"lbfgs", "adam"}
        The method; see :func:`odak.learn.wave.stochastic_gradient_descent`.
    learning_rate : float
        Step of Adam in radians, which falls to a half along a cosine.
    powers : bool
        Find the powers of the sources in each frame too, beginning with the display's own; a source that is off in
        a frame stays off. With ``powers=torch.ones(F, C)`` in the display all colours share all frames (Kavaklı et al.,
        Multi-color holograms improve brightness in holographic displays, SIGGRAPH Asia 2023).
    graph : bool
        Record the loss and its gradient as one CUDA graph and replay it in each iteration: one launch instead of some
        hundred kernels, which is faster for small displays on a GPU. The loss must depend on the images and the target
        alone and read no number from the device.

    Examples
    --------
    >>> from odak.learn.wave import Descent
    >>> Descent("adam").learning_rate
    0.1
    """

    method: str = "lbfgs"
    learning_rate: float = 0.1
    powers: bool = False
    # No part of the text by which a checkpoint is recognised: the results are the same.
    graph: bool = field(default=False, repr=False)

    def solve(self, problem: Problem) -> torch.Tensor | tuple[torch.Tensor | None, ...]:
        """Return the phases of a problem, ``[F, rows, columns]``, or with the powers ``[F, C]`` and the amplitudes.

        Powers are None where they are not to be found, and amplitudes are left out without a panel in front.
        """
        phases, run = problem.start.clone().requires_grad_(), problem.run
        learned, powers = {"phase": phases}, problem.display.powers
        # The slope along a phase falls with the number of pixels, that along the amplitude of a source does not; these
        # units make them alike. Adam takes the same step in all.
        unit = math.sqrt(powers.numel() / phases.numel()) if self.method == "lbfgs" else 1.0
        if self.powers:
            learned["amplitude"] = (powers.sqrt() / unit).to(phases.dtype).requires_grad_()
        if problem.display.modulator.lit_through is not None:
            # Amplitudes are squares of sines, between 0 and 1; they begin at 0.75.
            learned["turn"] = torch.full_like(problem.start, math.pi / 3).requires_grad_()
        loss, drawn_from = seeded_loss(problem.loss, run.seed, phases.device)
        problem = replace(problem, loss=loss)

        def found():
            return (unit * learned["amplitude"]).square() if self.powers else None

        def attenuation():
            return learned["turn"].sin().square() if "turn" in learned else None

        def value():
            return problem.loss_of(phases, found(), attenuation())

        if self.graph and (drawn_from or problem.display._parts):
            what = "the loss draws random numbers" if drawn_from else "several devices share one picture"
            raise ValueError(f"graph must be False where {what}, got True")
        evaluate = recorded(value, list(learned.values())) if self.graph else value
        rate = cosine(self.learning_rate, self.learning_rate / 2, run.iterations)
        display, given = problem.display, (problem.target, problem.start)
        minimise(
            learned,
            lambda iteration: evaluate(),
            rate,
            run,
            solver=self.method,
            about=lambda: {"solver": repr(self), "display": display._fingerprint(), "target": fingerprint(*given)},
            generators=drawn_from,
        )
        powers = found().detach() if self.powers else None
        if "turn" in learned:
            return phases.detach(), powers, attenuation().detach()
        return phases.detach() if powers is None else (phases.detach(), powers)

    def __post_init__(self):
        _validate.one_of("method", self.method, ("lbfgs", "adam"))
        _validate.flag("powers", self.powers)
        _validate.flag("graph", self.graph)
        _validate.real("learning_rate", self.learning_rate, positive=True)


def _frames_alone(display: Display, solver: str) -> list[tuple[int, int, int]]:
    """Return frame, plane and colour for each frame, for solvers whose frames show one colour on one plane each."""
    if display.modulator.lit_through is not None:
        raise ValueError(f"{solver} needs a modulator without lit_through: use the solver 'lbfgs'")
    if display.lens is not None or display.eyes is not None:
        raise ValueError(f"{solver} needs a display without a lens or eyes: use the solver 'lbfgs'")
    lit = [[c for c, frames in enumerate(display._lit_frames) if f in frames] for f in range(display.frames)]
    if len(display.distances) > 1 or any(len(colours) != 1 for colours in lit):
        raise ValueError(
            f"{solver} shows one colour on one plane in each frame; this display has {len(display.distances)} planes "
            f"and up to {max(map(len, lit))} colours in a frame: use the solver 'lbfgs'"
        )
    return [(frame, 0, colours[0]) for frame, colours in enumerate(lit)]


@dataclass(frozen=True)
class AlternatingProjections:
    """Gerchberg–Saxton, accelerated: an image on one plane in few iterations, without a gradient.

    Use it where a hologram has to be there within seconds; :class:`Descent` comes closer to the target. Uneven light on
    the panel and its aberration are made up for, and the image is one of the frequencies that an :class:`Iris` passes.

    Examples
    --------
    >>> from odak.learn.wave import AlternatingProjections
    >>> AlternatingProjections()
    AlternatingProjections()
    """

    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display = problem.display
        phases = problem.start.clone()
        for frame, plane, colour in _frames_alone(display, "alternating projections"):
            illumination, aberration = display._flat(colour)
            hologram = phase_retrieval.retrieve(
                problem.target[plane, colour].sqrt() + 0j,
                range(problem.run.iterations),
                display.distances[plane],
                display.modulator.pitch,
                display.wavelengths[colour] / display.medium,
                TURN,
                "Bandlimited Angular Spectrum",
                phases[frame] + aberration,
                problem.run.seed,
                fill=display.modulator.fill,
                cutoff=display._cutoff(colour),
                accelerated=True,
                illumination=illumination.to(phases),
            )[0]
            phases[frame] = hologram.angle() - aberration
        return phases


@dataclass(frozen=True)
class DoublePhase:
    """The double-phase encoding of the image, propagated back with a flat phase: smooth, and at once.

    Use it where images must be free of speckle and the display has an iris of about half an order along each axis;
    without one, the orders of its checkerboard lie over the image.

    Examples
    --------
    >>> from odak.learn.wave import DoublePhase
    >>> DoublePhase()
    DoublePhase()
    """

    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display, phases = problem.display, problem.start.clone()
        quarter = 0.25 / max(_pitch_pair(display.modulator.pitch))
        passes = [
            w
            for w in display.wavelengths
            if not isinstance(display.iris, Iris) or display.iris.cutoff(w) > 1.5 * quarter
        ]
        if passes:
            warn(
                "double phase needs an iris that passes frequencies up to about 1/(4·pitch), or the orders of its "
                f"checkerboard lie over the image; this display has {display.iris!r}",
                AccuracyWarning,
            )
        for frame, plane, colour in _frames_alone(display, "double phase"):
            there: Any = propagate_beam(
                problem.target[plane, colour].sqrt() + 0j,
                None,
                -display.distances[plane],
                display.modulator.pitch,
                display.wavelengths[colour] / display.medium,
                "auto",
                zero_padding=[True, False, True],
            )
            illumination, aberration = display._flat(colour)
            phases[frame] = encode_double_phase(there / illumination.clamp_min(_DIMMEST)) - aberration
        return phases


@dataclass(frozen=True)
class Network:
    """A network that computes the hologram at once, such as :class:`odak.learn.models.hologram_network`.

    Parameters
    ----------
    model : callable, optional
        ``model(target, wavelength, pitch, distance)`` returns the phase of an image ``[rows, columns]``. By default
        :class:`odak.learn.models.hologram_network` with the weights included in odak.

    Examples
    --------
    >>> from odak.learn.models import hologram_network
    >>> from odak.learn.wave import Network
    >>> fewer_steps = Network(hologram_network(refinements=4, pretrained=True))
    >>> fewer_steps.model.training
    False
    """

    model: Callable[..., Any] | None = None

    @torch.no_grad()
    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display, phases = problem.display, problem.start.clone()
        model = network_on(phases.device) if self.model is None else self.model
        for frame, plane, colour in _frames_alone(display, "a network"):
            wavelength, distance = display.wavelengths[colour] / display.medium, display.distances[plane]
            wanted = model(problem.target[plane, colour], wavelength, display.modulator.pitch, distance)
            phases[frame] = wanted - display._flat(colour)[1]
        return phases


SOLVERS: dict[str, Callable] = {
    "lbfgs": Descent,
    "adam": lambda: Descent("adam"),
    "gs": AlternatingProjections,
    "double phase": DoublePhase,
    "network": Network,
}


def _section(height: float, distances: Sequence[float], colours: list[tuple[float, float]]) -> str:
    """Return a drawing of a panel, planes and cones of light, lengths along the axis and across it to scales apart."""
    near, far = min(0.0, *distances), max(0.0, *distances)
    length = far - near or 1.0

    def at(z: float, y: float) -> str:
        return f"{40 + 560 * (z - near) / length:.1f},{110 - 80 * y / height:.1f}"

    def line(z: float, colour: str, width: float) -> str:
        return f'<polyline points="{at(z, -height / 2)} {at(z, height / 2)}" stroke="{colour}" stroke-width="{width}"/>'

    parts = []
    for wavelength, angle in colours:
        # Visible light from violet to red.
        hue = max(0.0, min(270.0, 270 * (700e-9 - wavelength) / 300e-9))
        for end in (near, far):
            reach = min(math.tan(angle) * abs(end) if angle < 1.5 else height, 1.3 * height)
            stop = end if reach < 1.3 * height else math.copysign(reach / math.tan(angle) if angle < 1.5 else 0.0, end)
            points = f"{at(0, 0)} {at(stop, reach)} {at(stop, -reach)}"
            parts.append(f'<polygon points="{points}" fill="hsl({hue:.0f},90%,50%)" fill-opacity="0.2"/>')
    parts += [line(distance, "#9a9a9a", 2) for distance in distances] + [line(0.0, "#202020", 5)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 220" width="640" fill="none">{"".join(parts)}</svg>'
    )


@dataclass(frozen=True)
class DisplayedHologram:
    """Patterns for a display, what is seen of them, and how good it is.

    Attributes
    ----------
    display : Display
        The display they are for. If powers of the sources were found, they are its own, relative to the brightest.
    target : torch.Tensor
        What was to be seen, ``[D, C, rows, columns]``.
    phases : torch.Tensor
        Phases in radians as the panel shows them, by its levels, ``[F, rows, columns]``.
    images : torch.Tensor
        Means over the areas of pixels, at the brightness closest to the target, ``[D, C, rows, columns]``, by
        :meth:`Display.judge`.
    brightness : torch.Tensor
        Factor of each colour by which images are brighter than what :meth:`Display.forward` returns, ``[C]``.
    psnr : torch.Tensor
        Peak signal-to-noise ratio of the images in decibels, ``[D, C]``.
    psnr_at_points : torch.Tensor
        The same of the intensities at the middles of pixels, which no sensor sees.
    losses : tuple of float
        Loss after each iteration.
    psnr_in_focus : torch.Tensor, optional
        Of a target with depth: the same ratio of each colour with each pixel from its own plane, ``[C]``.
    amplitudes : torch.Tensor, optional
        Amplitudes of the panel that the modulator is lit through, by its levels, ``[F, rows, columns]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Run, optimise
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> hologram = optimise(display, torch.ones(48, 64), run=Run(iterations=2, progress=False))
    >>> hologram.levels().shape, sorted(hologram.table()[0])[:2]
    (torch.Size([1, 48, 64]), ['brightness', 'distance'])
    """

    display: Display
    target: torch.Tensor
    phases: torch.Tensor
    images: torch.Tensor
    brightness: torch.Tensor
    psnr: torch.Tensor
    psnr_at_points: torch.Tensor
    losses: tuple[float, ...] = field(default=(), repr=False)
    psnr_in_focus: torch.Tensor | None = None
    amplitudes: torch.Tensor | None = None

    def levels(self) -> torch.Tensor:
        """Return the levels to send to the panel, int32 ``[F, rows, columns]``."""
        return self.display.modulator.levels(self.phases)

    def table(self) -> list[dict[Any, Any]]:
        """Return one row of numbers for each plane or eye and colour: lengths in metres, ratios in decibels."""
        eyes = self.display.eyes
        return [
            {
                "distance": distance,
                **({} if eyes is None else {"pupil": eyes.positions[d]}),
                "wavelength": wavelength,
                "psnr_db": float(self.psnr[d, c]),
                "psnr_at_points_db": float(self.psnr_at_points[d, c]),
                "brightness": float(self.brightness[c]),
            }
            for d, distance in enumerate(self.display.distances)
            for c, wavelength in enumerate(self.display.wavelengths)
        ]

    def __repr__(self) -> str:
        worst, best = (f"{float(v):.1f}" for v in (self.psnr.min(), self.psnr.max()))
        span = worst if worst == best else f"{worst} to {best}"
        return f"DisplayedHologram: {span} dB over the areas of pixels, {self.display.extra_repr()}"

    def _repr_html_(self) -> str:
        return _show.page(self, DisplayedHologram._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: target, image and pattern, and the quality of each plane and colour."""
        named = (("target", self.target[0]), ("image", self.images[0]))
        pictures = [(name, _show.png(_picture(planes.detach().cpu()))) for name, planes in named]
        pictures.append(("pattern", _show.png((self.phases[0] / TURN).detach().cpu())))

        def plane(row):
            if "pupil" in row:
                return ", ".join(f"{1e3 * p:.3g}" for p in row["pupil"]) + " mm"
            return f"{1e3 * row['distance']:.4g} mm"

        head = (
            "plane" if self.display.eyes is None else "pupil",
            "wavelength",
            "PSNR over areas",
            "at points",
            "brightness",
        )
        rows = [
            (
                *(plane(r), f"{1e9 * r['wavelength']:.4g} nm"),
                *(f"{r['psnr_db']:.1f} dB", f"{r['psnr_at_points_db']:.1f} dB", f"{r['brightness']:.4g}"),
            )
            for r in self.table()
        ]
        return _show.View(repr(self), pictures, [head, *rows])


def _picture(planes: torch.Tensor) -> torch.Tensor:
    """Return a picture, ``[rows, columns]`` or in colour ``[rows, columns, 3]``, of images ``[C, rows, columns]``."""
    values = planes.clamp(0, 1) ** (1 / 2.2)
    return values.movedim(0, -1) if len(values) == 3 else values.mean(0)


Target = torch.Tensor | tuple[torch.Tensor, torch.Tensor] | FocalTargets


@overload
def optimise(
    display: Display,
    target: Target,
    loss: Callable[..., Any] | None = None,
    solver: str | Solver = "lbfgs",
    start: str | torch.Tensor = "gs",
    run: Run | None = None,
    devices: Sequence[torch.device | str | int] | str | None = None,
) -> DisplayedHologram: ...


@overload
def optimise(
    display: Display,
    target: list[Target] | list[torch.Tensor],
    loss: Callable[..., Any] | None = None,
    solver: str | Solver = "lbfgs",
    start: str | torch.Tensor = "gs",
    run: Run | None = None,
    devices: Sequence[torch.device | str | int] | str | None = None,
) -> list[DisplayedHologram]: ...


@differentiates
@in_own_precision
def optimise(
    display: Display,
    target: Target | list[Target] | list[torch.Tensor],
    loss: Callable[..., Any] | None = None,
    solver: str | Solver = "lbfgs",
    start: str | torch.Tensor = "gs",
    run: Run | None = None,
    devices: Sequence[torch.device | str | int] | str | None = None,
) -> DisplayedHologram | list[DisplayedHologram]:
    """Return the patterns that show a target on a display, with their images and quality.

    Use it for a picture on one plane, for several planes, colours and frames alike. What is optimised is what is
    stated: means over the areas of pixels, on planes or on the retinas of :class:`Eyes`.

    Parameters
    ----------
    display : Display
        The display.
    target : torch.Tensor, tuple of torch.Tensor, multiplane_loss or list of them
        Intensities 0 … 1, ``[rows, columns]`` for one plane and colour, ``[C, rows, columns]`` for one plane, or
        ``[D, C, rows, columns]``; eyes that get no targets of their own see the same. Its brightness is free: the
        sources of each colour are dimmed to it. A picture with depth is a pair of ``[C, rows, columns]`` and a depth
        ``[rows, columns]``, 0 the first plane and 1 the last: each pixel is in focus on its own plane, and blurred on
        the others by the cone of its light. For another blur, give a :class:`odak.learn.wave.multiplane_loss`. A list
        is of several pictures, each with a hologram of its own.
    loss : callable, optional
        ``loss(images, target)``, both ``[D, C, rows, columns]``; the mean squared error by default, for a picture with
        depth its :class:`odak.learn.wave.multiplane_loss`. One that takes a `generator` is given one.
    solver : str or object
        "lbfgs", "adam", "gs" (or "gerchberg-saxton"), "double phase" or "network", or an object with a method
        ``solve(problem) -> phases``, or phases and powers, such as :class:`Descent` or :class:`Network`.
    start : str or torch.Tensor
        "gs", "double phase" or "network", a hologram by these methods, or "quadratic", "flat" or "random", see
        :func:`odak.learn.wave.stochastic_gradient_descent`; or phases ``[F, rows, columns]`` in radians.
    run : Run, optional
        Iterations, progress, callback, checkpoint and seed.
    devices : sequence of torch.device, str or int, or "distributed", optional
        Devices that share the work, such as ``["cuda:0", "cuda:1"]``; by default the display's own device. Of a list,
        each picture is computed by one device; of a single picture the planes, colours and frames are shared out, for
        solvers that descend along a gradient. "distributed" shares out in the same way among the processes of
        `torch.distributed`, each on the device of its display: all call this with the same arguments.

    Returns
    -------
    DisplayedHologram or list of DisplayedHologram
        Patterns, images and quality, one for each picture of a list, on the device of the display; in every process.
        It shows itself in a notebook.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit the display, naming it.
    RuntimeError
        If a picture of a list failed in another process, naming that.

    Notes
    -----
    Pictures of a list are computed as they are alone, to the bit on equal devices. The shared images of one picture
    are sums in another order, equal to rounding. A loss or a response that is a `torch.nn.Module` is copied to each
    device; other objects must accept tensors of every device, and a callback is called from a thread per device. Where
    processes share one picture, they need equal hardware, and one whose callback returns True stops all.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Run, optimise
    >>> target = torch.zeros(48, 64)
    >>> target[12:36, 16:48] = 1.0
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> hologram = optimise(display, target, run=Run(iterations=20, progress=False))
    >>> hologram.phases.shape, bool(hologram.psnr > 20)
    (torch.Size([1, 48, 64]), True)
    """
    if not isinstance(display, Display):
        raise TypeError(f"display must be an odak.learn.wave.Display, got {type(display).__name__}")
    run = Run() if run is None else run
    if not isinstance(run, Run):
        raise TypeError(f"run must be an odak.learn.wave.Run, got {type(run).__name__}")
    where = None if devices is None else used_devices(devices, display.powers.device)
    if isinstance(target, list):
        return _optimise_each(display, target, where, {"loss": loss, "solver": solver, "start": start}, run)
    focal = target if isinstance(target, FocalTargets) else _focal_targets(display, target)
    target = _checked_target(display, target if focal is None else focal.targets)
    if isinstance(solver, str):
        solver = SOLVERS[named("solver", solver, tuple(SOLVERS))]()
    if not callable(getattr(solver, "solve", None)):
        raise TypeError(f"solver must have a method solve(problem), got {type(solver).__name__}")
    if where is not None and isinstance(solver, (AlternatingProjections, DoublePhase, Network)):
        raise ValueError(f"devices must be None for one picture by {type(solver).__name__}, got {devices!r:.80}")
    first = display.modulator.lit_through
    if where is not None and first is not None:
        raise ValueError(f"devices must be None for one picture on two panels, got {devices!r:.80}")
    if isinstance(where, Ranks) and run.checkpoint is not None:
        raise ValueError(f"run must be without a checkpoint where devices={DISTRIBUTED!r}, got {run.checkpoint!r:.80}")
    usual = torch.nn.functional.mse_loss if focal is None else focal
    loss = usual if loss is None else _validate.function_or_none("loss", loss)
    losses: list[torch.Tensor] = []

    def record(iteration, value):
        losses.append(value)
        stops = run.callback is not None and run.callback(iteration, value) is True
        return where.any(stops, value.device) if isinstance(where, Ranks) and run.callback is not None else stops

    begun = starting_phases(display, target, start, run.seed)
    own = replace(run, callback=record, progress=run.progress and not (isinstance(where, Ranks) and where.rank))
    problem = Problem(display if where is None else display._shared_among(where), target, loss, begun, own)
    solved = solver.solve(problem)
    solved = solved if isinstance(solved, tuple) else (solved,)
    phases, powers, amplitudes = (*solved, None, None)[:3]
    amplitudes = None if first is None or amplitudes is None else first.shown(amplitudes)
    phases, display = display.modulator.shown(phases), display if powers is None else display.lit_by(powers)
    areas, points = display.judge(phases, amplitudes)
    brightness = brightness_of(areas, target)
    images, lights = areas * brightness, brightness[:, 0, 0]
    if powers is not None:
        shared = powers / powers.sum(0) * lights.clamp_min(1e-6)
        display = display.lit_by(shared / shared.max())

    def ratio(shown, wanted=target):
        return -10 * torch.log10((shown - wanted).square().mean((-2, -1)).clamp_min(1e-30))

    at_points = ratio(points * brightness_of(points, target))
    sharp = None if focal is None else ratio((images * focal.masks).sum(0), (target * focal.masks).sum(0))
    history = tuple(torch.stack(losses).tolist()) if losses else ()
    ratios = ratio(images), at_points
    return DisplayedHologram(display, target, phases, images, lights, *ratios, history, sharp, amplitudes)


def _optimise_each(display, targets, where, options: dict[str, Any], run: Run) -> list[DisplayedHologram]:
    """Return the holograms of several pictures, each computed on one of some devices or by one of the ranks."""
    if not targets:
        raise ValueError("target must hold at least one picture, got an empty list")
    if run.checkpoint is not None:
        raise ValueError(f"run must be without a checkpoint for a list of pictures, got {run.checkpoint!r:.80}")
    home = display.powers.device
    first = not (isinstance(where, Ranks) and where.rank)
    bar = tqdm(total=len(targets), desc="pictures", disable=not (run.progress and first))
    alone = replace(run, progress=False)

    def prepared(device):
        own = display if device == home else display._on(device)
        given = {name: _on_device(value, device, home) for name, value in options.items()}

        def work(target):
            found = optimise(own, _on_device(target, device, home), **given, run=alone)
            bar.update()
            return _packed(found, own, torch.device("cpu") if isinstance(where, Ranks) else home)

        return work

    with bar:
        if isinstance(where, Ranks):
            packed = where.each(prepared(home), targets)
        else:
            packed = on_devices(prepared, targets, [home] if where is None else where)
    return [_unpacked(parts, display) for parts in packed]


def _on_device(value, device, home):
    """Return a loss or a target whose tensors are on a device; a module is copied, unless it is at home there."""
    return copy.deepcopy(value).to(device) if isinstance(value, torch.nn.Module) and device != home else value


def _packed(hologram: DisplayedHologram, display: Display, device: torch.device) -> dict[str, Any]:
    """Return the parts of a hologram on a device; of its display those powers that were found, or None."""
    parts = {part.name: getattr(hologram, part.name) for part in fields(hologram)}
    parts["display"] = None if hologram.display is display else hologram.display.powers
    return {name: value.to(device) if isinstance(value, torch.Tensor) else value for name, value in parts.items()}


def _unpacked(parts: dict[str, Any], display: Display) -> DisplayedHologram:
    home = display.powers.device
    moved: dict[str, Any] = {k: v.to(home) if isinstance(v, torch.Tensor) else v for k, v in parts.items()}
    powers = moved.pop("display")
    return DisplayedHologram(display if powers is None else display.lit_by(powers), **moved)


def _projected(display, target, colour, phase, iterations: int = 10):
    """Return a phase after iterations of Gerchberg and Saxton's between the panel and what a lens or eyes show."""
    amplitudes, light = target[:, colour].sqrt(), unit_phasor(phase)
    for _ in range(iterations):
        if display.eyes is None:
            there = amplitudes[0] * unit_phasor(display._focused(light, colour).angle())
            back = display._back(there, colour)
        else:
            back = sum(display._back_from_eye(a, light, colour, eye) for eye, a in enumerate(amplitudes))
        light = unit_phasor(back.angle())
    return light.angle()


def _focal_targets(display, target):
    """Return the targets of the planes of a picture with depth; None for any other target."""
    if not isinstance(target, tuple) or len(target) != 2:
        return None
    if display.eyes is not None:
        raise ValueError("target must be images [eyes, colours, rows, columns] where eyes look on, got one with depth")
    iris = display.iris
    # An iris passes frequencies up to radius/(λ·focal_length), λ in air: in a medium the sine of the cone is smaller.
    sine = iris.radius / (iris.focal_length * display.medium) if isinstance(iris, Iris) else None
    return multiplane_loss(
        *target,
        number_of_planes=display.shape[0],
        device=display.powers.device,
        distances=display.distances,
        wavelengths=[wavelength / display.medium for wavelength in display.wavelengths],
        pixel_pitch=display.modulator.pitch,
        numerical_aperture=sine,
    )


def brightness_of(images, target):
    """Return the factor of each colour, over all its planes, at which images are closest to a target, ``[C, 1, 1]``."""
    return best_scale(images, target, (0, -2, -1))[0]


def _checked_target(display, target):
    target = checked_intensities("target", floating("target", target))
    planes, colours, rows, columns = display.shape
    accepted = {(planes, colours, rows, columns)}
    # Eyes may all see the same.
    alike = planes == 1 or display.eyes is not None
    accepted |= {(colours, rows, columns)} if alike else set()
    accepted |= {(rows, columns)} if alike and colours == 1 else set()
    if tuple(target.shape) not in accepted:
        raise ValueError(
            f"target must be [planes, colours, rows, columns] = {list(display.shape)}, got {list(target.shape)}"
        )
    if float(target.max()) > 2:
        raise ValueError(f"target must be intensities of 0 … 1, got up to {float(target.max()):.4g}: divide by 255?")
    if not bool(target.any()):
        warn(
            "target is black: a modulator of phases leaves its light somewhere, and the quality means nothing",
            ArgumentWarning,
        )
    return target.expand(display.shape).to(display.powers.device)


def starting_phases(display, target, start, seed) -> torch.Tensor:
    """Return the phases to start from; a named start is computed for the brightest colour of each frame."""
    shape = (display.frames, *display.modulator.resolution)
    if not isinstance(start, str):
        shapes = (shape, shape[1:]) if display.frames == 1 else (shape,)
        return started("start", start, shapes, target, torch.zeros, STARTS).reshape(shape)
    name = named("start", start, STARTS)
    if display.lens is not None and name in ("double phase", "network"):
        raise ValueError(f"start must be 'gs', 'quadratic', 'random', 'flat' or phases behind a lens, got {name!r}")
    if display.eyes is not None and name not in ("gs", "random", "flat"):
        raise ValueError(f"start must be 'gs', 'random', 'flat' or phases where eyes look on, got {name!r}")
    begun = name
    if name == "gs":
        begun = "random" if display.eyes is not None else "quadratic" if display.lens is not None else name
    plane, phases = display.shape[0] // 2, torch.zeros(shape, dtype=target.dtype, device=target.device)
    brightest = display.powers.argmax(1).tolist()
    for colour in sorted(set(brightest)):
        frames = [frame for frame, lit in enumerate(brightest) if lit == colour]
        wavelength, distance = display.wavelengths[colour] / display.medium, display.distances[plane]
        found = starting_phase(
            begun,
            target[plane, colour],
            wavelength,
            distance,
            display.modulator.pitch,
            "Bandlimited Angular Spectrum",
            seed=seed,
            frames=len(frames),
        )
        aberration = 0.0 if name in ("flat", "random") else display._flat(colour)[1]
        for frame, phase in zip(frames, found.reshape(len(frames), *shape[1:]), strict=True):
            if begun != name:
                phase = _projected(display, target, colour, phase)
            phases[frame] = phase - aberration
    return phases
