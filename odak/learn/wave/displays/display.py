"""Displays as objects: a panel, its light sources, and the images that its light forms.

A display asks its path of light for fields, and takes their means over time and over the areas of pixels. It knows no
kind of path.
"""

import os
from collections.abc import Iterator, Sequence
from typing import Any

import torch

from odak import _array, _show, _torch_private, _validate
from odak._attributes import Prepared
from odak._warnings import AccuracyWarning, ArgumentWarning, warn
from odak.instruments import Calibration, Lens, load_calibration
from odak.learn._tensors import ValuesRead, floating
from odak.learn.wave.displays.judge import Judgement, judged, light_beyond
from odak.learn.wave.displays.observers import REACH, REGISTERED, Observer
from odak.learn.wave.displays.panels import Iris, Modulator
from odak.learn.wave.displays.parts import Part, Shares, Streamed, frames_lit
from odak.learn.wave.displays.paths.base import (
    Kept,
    Lights,
    Path,
    listed,
)
from odak.learn.wave.displays.paths.choice import path_to
from odak.learn.wave.displays.paths.free import Free
from odak.learn.wave.displays.sources import Source
from odak.learn.wave.eyes import Eyes
from odak.learn.wave.fields import exposed, intensity, unit_phasor
from odak.learn.wave.slm import VaryingModulator, spatial_light_modulator
from odak.learn.wave.training import fingerprint, generator_from

# Waves that light may turn by over a pixel before a display warns.
_MOST_TURN = 0.1


class Display(Prepared, torch.nn.Module):
    """A holographic display: a modulator, its light sources, and the planes that images are on.

    Use it where you want to know what an eye or a camera sees of phase patterns: :meth:`forward` returns the means of
    the intensity over the areas of pixels, with the spectrum of pixels of finite size. Patterns for it are computed
    by :func:`optimise`.

    Parameters
    ----------
    modulator : Modulator
        The panel.
    wavelengths : float or sequence of float
        Wavelengths of the C light sources in metres.
    distances : float, sequence of float, odak.instruments.Lens, Eyes or Free
        Distances of the D planes from the panel, or from its image by a relay, in metres; or the lens behind which a
        single plane is: the points of its images are λ·focal_length/(rows·pitch) and λ·focal_length/(columns·pitch)
        apart, the axis at rows // 2 and columns // 2, over all that the pixels reach; or :class:`Eyes`, whose D retinal
        images take the place of planes; or :class:`Free`, with a mask, learned distances or another propagation method.
    frames : int, optional
        Patterns F that are shown one after another, faster than an eye tells apart; one for each source by default.
    powers : torch.Tensor, optional
        Power of each source in each frame, ``[F, C]``; by default frame f is lit by source f mod C alone. Images are
        normalised to one unit of power of each source, shared out among its frames. All sources of a frame meet the
        same phases in radians, unless the modulator has a `phase_scale`.
    profile : torch.Tensor or Source, optional
        Amplitude of the light on the modulator, ``[rows, columns]`` or ``[C, rows, columns]``; one by default. Or a
        :class:`Source`: points of light in several directions, or with a line width.
    iris : Iris or str, optional
        "order", a square stop that passes one diffraction order, |f| ≤ 1/(2·pitch); a round :class:`Iris`; or None for
        no stop, where nine orders are computed: 36 transforms of an image instead of four. Eyes get all orders then.
    medium : float
        Refractive index between the modulator and the planes.

    Attributes
    ----------
    samples : int
        Points along each axis of a pixel at which the intensity is computed, from which its mean follows.
    path : object
        What the light meets from the pixels to the images.

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

    _fixed = ("modulator", "wavelengths", "distances", "lens", "eyes", "medium", "iris", "frames", "samples", "path")
    powers: torch.Tensor
    profile: torch.Tensor | None
    _turns_down: torch.Tensor
    _turns_across: torch.Tensor
    _points: torch.Tensor

    @_validate.takes_units("wavelengths", "distances")
    def __init__(
        self,
        modulator: Modulator,
        wavelengths: float | Sequence[float],
        distances: float | Sequence[float] | Lens | Eyes | Free,
        frames: int | None = None,
        powers: torch.Tensor | None = None,
        profile: torch.Tensor | Source | None = None,
        iris: Iris | str | None = "order",
        medium: float = 1.0,
    ):
        super().__init__()
        _validate.instance("modulator", modulator, Modulator, "an odak.learn.wave.Modulator")
        self.modulator: Modulator = modulator
        self.path: Path = path_to(modulator, wavelengths, distances, iris, medium)
        path = self.path
        self.wavelengths: tuple[float, ...] = path.wavelengths
        self.distances: tuple[float, ...] = path.distances
        self.samples: int = path.samples
        self.iris: Iris | str | None = path.iris
        self.medium: float = path.medium
        self.lens: Lens | None = distances if isinstance(distances, Lens) else None
        self.eyes: Eyes | None = distances if isinstance(distances, Eyes) else None
        colours = len(self.wavelengths)
        if modulator.phase_scale is not None and len(modulator.phase_scale) != colours:
            raise ValueError(f"phase_scale must have {colours} factors, one a wavelength, got {modulator.phase_scale}")
        self.frames: int = colours if frames is None else _validate.integer("frames", frames, minimum=1)
        if (responses := len(modulator.responses())) not in (0, self.frames):
            raise ValueError(
                f"modulator must have a response, or one for each of {self.frames} frames, got {responses}"
            )
        if powers is None:
            powers = torch.eye(colours).repeat(-(-self.frames // colours), 1)[: self.frames]
        powers = self._fitting(powers).detach()
        self.register_buffer("powers", powers)
        self._powers_read = ValuesRead(frames_lit)
        self._powers_read(powers)
        self.source: Source | None = profile if isinstance(profile, Source) else None
        given = self._fitting_profile(profile.amplitude if isinstance(profile, Source) else profile)
        self._lines: tuple[tuple[Path, float], ...] = ()
        if self.source is not None:
            given = self._lit_by_points(self.source, given, distances)
        self.register_buffer("profile", given)
        self._kept = Kept(powers.device)
        # Who computes which part of the images where several devices or ranks do.
        self.shares: Shares | Streamed | None = None

    @classmethod
    def from_calibration(
        cls, calibration: Calibration | str | os.PathLike[str], fill: float = 0.9, **options: Any
    ) -> "Display":
        """Return the display of a calibrated table: its panel, response, aberration, illumination and distance.

        Use it for holograms on your own table: patterns for it correct the aberration, and
        :meth:`DisplayedHologram.levels` returns the levels whose measured phases are nearest. Of responses in regions,
        the factor between those of a pixel and the mean over the panel is taken. The light of gaps and the cover glass
        is that of the calibration.

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
        _validate.instance("calibration", calibration, Calibration, "a Calibration or a file")
        bits = (len(calibration.phases) - 1).bit_length()
        if len(calibration.phases) != 2**bits:
            raise ValueError(f"calibration must have 2^bits levels, got {len(calibration.phases)}")
        phases, wavefront = (torch.as_tensor(part) for part in (calibration.phases, calibration.wavefront))
        found: dict[str, Any] = {"bits": bits, "lut": phases, "aberration": wavefront}
        found["zero_order"] = calibration.unmodulated
        factors = calibration.response_factors()
        one = bool((factors == 1).all())
        response = spatial_light_modulator(**found) if one else VaryingModulator(torch.as_tensor(factors), **found)
        modulator = Modulator(calibration.amplitude.shape, calibration.pitch, bits, fill, response)
        known: dict[str, Any] = {"distances": calibration.distance, "profile": torch.as_tensor(calibration.amplitude)}
        return cls(modulator, calibration.wavelength, **(known | options))

    def extra_repr(self) -> str:
        """Return the numbers of the display in a line."""
        panel = self.modulator
        pitch = " × ".join(f"{1e6 * p:.4g}" for p in dict.fromkeys(self.path.pitches))
        levels = "no levels" if panel.bits is None else f"{panel.bits} bits"
        stop = repr(self.iris) if isinstance(self.iris, Iris) else "no iris" if self.iris is None else "one order"
        first = panel.lit_through
        cells = self.path.cells
        mask = "" if panel.expander is None else f", {cells} × {cells} cells of a mask in each"
        before = "" if first is None else f"lit through a panel at {1e3 * first.distance:.4g} mm, "
        lamp = "" if self.source is None else f", {self.source!r}"
        return (
            f"{' × '.join(map(str, panel.resolution))} pixels of {pitch} µm (fill {panel.fill:g}, {levels}{mask}), "
            f"{before}{listed(self.wavelengths, 1e9)} nm, {self.frames} frame{'s' * (self.frames > 1)}, "
            f"{self.path.in_words()}, {stop}{lamp}"
        )

    def __repr__(self) -> str:
        return f"Display: {self.extra_repr()}"

    def _repr_html_(self) -> str:
        return _show.page(self, "odak.learn.wave.displays.sections:view_of")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Planes, colours, rows and columns of the images."""
        return (len(self.distances), len(self.wavelengths), *self.modulator.resolution)  # type: ignore[return-value]

    def _apply(self, function, recurse: bool = True):
        super()._apply(function, recurse)
        self.forget()
        self._powers_read.moved(self.powers)
        return self

    def forget(self) -> None:
        """Drop the transfer functions that are kept from call to call."""
        drawn = self._kept
        self._kept = Kept(self.powers.device)
        self._kept.generator, self._kept.errors = drawn.generator, drawn.errors

    def _seeded(self, seed: int) -> list[torch.Generator]:
        """Begin the random numbers of the path anew, and return what draws them; none where nothing is random."""
        if not self.path.jitter:
            return []
        self._kept.generator = generator_from(seed)
        return [self._kept.generator]

    def _load_from_state_dict(self, *arguments) -> None:
        super()._load_from_state_dict(*arguments)
        self._powers_read(self.powers)

    @property
    def lit_frames(self) -> tuple[tuple[int, ...], ...]:
        """For each colour, the frames in which its source is on."""
        return self._powers_read(self.powers)

    def fingerprint(self) -> str:
        """Return a short text that a display of other lengths, light or panels does not have."""
        panel, first = self.modulator, self.modulator.lit_through
        given = [self.powers] if self.profile is None else [self.powers, self.profile]
        if self._lines:
            given += [self._turns_down, self._turns_across, self._points]
        if isinstance(panel.response, torch.nn.Module):
            given += panel.response.state_dict().values()
        words = self.path.words(), panel.bits, None if first is None else first.bits, *(panel.phase_scale or ())
        return fingerprint(torch.tensor(list(repr(words).encode())), *given)

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
        if self._lines:
            raise ValueError("profile must not be a source of several points, whose light has no field")
        lights = self._lights(phases, amplitudes)
        colours = range(self.shape[1])
        return torch.stack([self.path.middles(self._kept, self._lit_by_source(lights, c), c) for c in colours], -3)

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
        return self.recorded_by(REGISTERED, phases, powers, amplitudes)[0]

    def recorded_by(
        self,
        observer: Observer,
        phases: torch.Tensor,
        powers: torch.Tensor | None = None,
        amplitudes: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return what an observer sees about the middles of pixels and, of a camera at any place, between them.

        Parameters
        ----------
        observer : Observer
            Who looks.
        phases : torch.Tensor
            Phases ``[..., F, rows, columns]`` in radians.
        powers : torch.Tensor, optional
            Powers ``[F, C]`` of the sources, in place of the display's own.
        amplitudes : torch.Tensor, optional
            Amplitudes 0 … 1 of the panel that the modulator is lit through, of the shape of the phases.

        Returns
        -------
        torch.Tensor
            Real ``[grids, ..., D, C, rows, columns]``: one grid for an observer whose pixels are those of the image,
            and four that are half a pixel apart for one at any place; see :meth:`Observer.recorded`.
        """
        _validate.instance("observer", observer, Observer, "an odak.learn.wave.Observer")
        return self._recorded_of(observer, self._lights(phases, amplitudes), powers)

    def _recorded_of(self, observer: Observer, lights: Lights, powers: torch.Tensor | None = None) -> torch.Tensor:
        """Return what an observer sees of the light of panels; see :meth:`recorded_by`."""
        powers = self.powers if powers is None else self._in_its_frames(self._fitting(powers))
        if self.shares is not None:
            return self.shares.images(observer, lights, powers)
        planes = tuple(range(self.shape[0]))
        parts = [Part(colour, planes, frames) for colour, frames in enumerate(self.lit_frames)]
        return torch.stack([self._images_of(part, observer, lights, powers) for part in parts], -3)

    def _replaced(self, amplitudes: torch.Tensor, light: torch.Tensor, color: int) -> torch.Tensor:
        """Return the light on the panel whose images have other amplitudes ``[D, rows, columns]``, by the adjoint."""
        return self.path.replaced(self._kept, amplitudes, light, color)

    def judge(
        self, phases: torch.Tensor, amplitudes: torch.Tensor | None = None, orders: int | None = None
    ) -> Judgement:
        """Return the images of patterns by another computation than :meth:`forward`, and those at points.

        Each pixel is a comb of samples on a grid of four times the panel's extent, wider for small panels, multiplied
        by the spectrum of a square and propagated by the method that :func:`odak.wave.sampling_report` recommends, or
        as plane waves where a large panel's light stays on the grid; the mean over the area of a pixel is a product of
        spectra. It shares neither transfer functions nor weights with :meth:`forward`, and its difference from that is
        the `error` that it states. Images of both are within 2e-3 of direct sums over stops and pupils, edges and
        corners among them: of panels of 24 to 1920 pixels along each axis in free space, in a medium, behind a round
        iris, behind a lens, in eyes and of two panels in series. Of 1080 × 1920 pixels two panels take 11 GB. Without
        a stop both hold nine orders, and :meth:`light_beyond` states what these leave out.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` in radians.
        amplitudes : torch.Tensor, optional
            Amplitudes of a panel in front of the modulator, of the same shape, as in :meth:`forward`.
        orders : int, optional
            Diffraction orders along each axis of one panel without a stop in free space; 3 by default.

        Returns
        -------
        Judgement
            A tuple of means over the areas of pixels, and intensities at their middles, ``[D, C, rows, columns]`` each.
            Its attribute `error`, ``[D, C]``, is the root mean square of the difference of these means from those by
            :meth:`forward`, divided by that of the means: about the error of the worse of the two. It is NaN for other
            `orders` than those of :meth:`forward`, and for distances that are drawn.

        Raises
        ------
        ValueError
            If `orders` are given of a display whose stop, lens, eyes or first panel decides.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.wave import Display, Modulator
        >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, 2e-3)
        >>> seen = display.judge(6.28 * torch.rand(32, 48))
        >>> areas, points = seen
        >>> areas.shape, bool(seen.error < 2e-3)
        (torch.Size([1, 1, 32, 48]), True)
        """
        return judged(self, phases, amplitudes, orders=orders)

    def light_beyond(
        self, phases: torch.Tensor, amplitudes: torch.Tensor | None = None, orders: int | None = None
    ) -> torch.Tensor:
        """Return the share of the light of each colour that is in orders beyond those that images hold.

        Images of one panel without a stop in free space lack this light: their intensity is off by about as much.

        Parameters
        ----------
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` in radians.
        amplitudes : torch.Tensor, optional
            Amplitudes of a panel in front of the modulator, as in :meth:`forward`.
        orders : int, optional
            Diffraction orders along each axis, as in :meth:`judge`.

        Returns
        -------
        torch.Tensor
            Shares ``[C]`` of the light that leaves the panel. What a stop keeps away counts too.

        Raises
        ------
        ValueError
            As :meth:`judge`.

        Examples
        --------
        Random phases fill all orders alike, in which the light falls with their distance:

        >>> import torch
        >>> from odak.learn.wave import Display, Modulator
        >>> display = Display(Modulator((64, 64), 8e-6), 532e-9, 2e-3, iris=None)
        >>> phases = 6.28 * torch.rand(1, 64, 64, generator=torch.Generator().manual_seed(0))
        >>> [round(float(display.light_beyond(phases, orders=n)), 2) for n in (1, 3, 5)]
        [0.44, 0.15, 0.09]
        """
        return light_beyond(self, phases, amplitudes, orders)

    def lit_by(self, powers: torch.Tensor) -> "Display":
        """Return the same display with other powers of the sources, ``[F, C]``."""
        return self._changed(powers=powers)

    def extents(self) -> list[dict[str, Any]]:
        """Return how much light can be told apart in each colour: the étendue, and what eyes have of it.

        Returns
        -------
        list of dict
            For each wavelength in metres: "etendue" in m²·sr, the squared wavelength times the number of pixels, times
            the number of cells of an :class:`Expander` in a pixel, as far as a round iris passes them. Where eyes look
            on, also "eyebox", the height and width in metres of what the pixel on the axis lights, and
            "field_of_view", the angles in degrees at which the panel is seen. For small angles the étendue is
            the product of these four.

        Examples
        --------
        >>> from odak.learn.wave import Display, Expander, Eyes, Modulator
        >>> for cells in (1, 2):
        ...     panel = Modulator((32, 48), 8e-6, expander=Expander.random((32, 48), cells))
        ...     (found,) = Display(panel, 532e-9, Eyes(0.1), iris=None).extents()
        ...     print(", ".join(f"{1e3 * side:.2f} mm" for side in found["eyebox"]), f"{found['etendue']:.2e}")
        6.65 mm, 6.65 mm 4.35e-10
        13.30 mm, 13.30 mm 1.74e-09
        """
        return [{"wavelength": w, **self.path.extents(c)} for c, w in enumerate(self.wavelengths)]

    def looked_at(self, eyes: Eyes) -> "Display":
        """Return the same display with eyes that look at it in place of its planes or eyes.

        Use it to see what eyes see that patterns were not optimised for.

        Parameters
        ----------
        eyes : Eyes
            The eyes.

        Raises
        ------
        ValueError
            If the display has a stop, a mask, a second panel or a medium, through which eyes cannot look.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.wave import Display, Eyes, Modulator
        >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, 2e-3)
        >>> display.looked_at(Eyes(0.1, [(0.0, 0.0), (0.0, 1e-3)])).shape
        (2, 1, 32, 48)
        """
        _validate.instance("eyes", eyes, Eyes, "odak.learn.wave.Eyes")
        if getattr(self.path, "mask", None) is not None:
            raise ValueError("eyes cannot look at a display with a mask in the Fourier plane")
        return self._changed(distances=eyes)

    def _changed(self, **others: Any) -> "Display":
        """Return a display that differs in some arguments, on the same device."""
        own = {name: getattr(self, name) for name in ("modulator", "wavelengths", "frames", "powers", "iris", "medium")}
        own |= {"distances": self.path.ends, "profile": self.profile if self.source is None else self.source}
        return Display(**(own | others)).to(self.powers.device)

    def _lights(self, phases: torch.Tensor, amplitudes: torch.Tensor | None = None) -> Lights:
        """Return what each panel does to the light, in the order in which it meets them, ``[..., F, rows, columns]``.

        The modulator is the last of them; with a `phase_scale`, it has an axis of colours in front.
        """
        self.path.renew(self._kept)
        light, amplitudes = self._light(phases), self._amplitudes(amplitudes)
        return (light,) if amplitudes is None else (amplitudes.to(light.dtype), light)

    def _light(self, phases):
        if "int" in str(getattr(phases, "dtype", "")) and _array.is_readable(phases) and phases.max() > 7:
            raise ValueError(
                f"phases must be in radians, got integers up to {int(phases.max())}: levels of the panel? Their phases "
                "are 2π·level/2^bits"
            )
        phases, panel = self._patterns("phases", floating("phases", phases)), self.modulator
        if panel.phase_scale is None:
            return panel.light(phases)
        return torch.stack([panel.light(phases, scale) for scale in panel.phase_scale])

    def _of_colour(self, light, colour):
        """Return the light of the modulator in a colour."""
        return light if self.modulator.phase_scale is None else light[colour]

    def _patterns(self, name: str, values: torch.Tensor) -> torch.Tensor:
        """Return the values of pixels in each frame, ``[..., F, rows, columns]``, on the device of the display."""
        shape = (self.frames, *self.modulator.resolution)
        if self.frames == 1 and tuple(values.shape) == shape[1:]:
            values = values[None]
        if tuple(values.shape[-3:]) != shape:
            got = _validate.in_order(name, values.shape, shape[1:])
            raise ValueError(f"{name} must be [frames, rows, columns] = {list(shape)}, {got}")
        return values.to(self.powers.device)

    def _amplitudes(self, amplitudes):
        """Return the amplitudes of the first of two panels ``[..., F, rows, columns]``; None where there is one."""
        if self.modulator.lit_through is None:
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

    def _fitting_profile(self, profile: torch.Tensor | None) -> torch.Tensor | None:
        """Return the amplitude of the light on the modulator in each colour, ``[C, rows, columns]``; None for one."""
        if profile is None:
            return None
        profile = _validate.image("profile", floating("profile", profile)).detach()
        resolution, colours = self.modulator.resolution, len(self.wavelengths)
        if profile.shape[-2:] != torch.Size(resolution) or profile.ndim > 3:
            raise ValueError(
                f"profile must be [rows, columns] = {list(resolution)} or [{colours}, rows, columns], "
                f"{_validate.in_order('profile', profile.shape, resolution)}"
            )
        return profile.expand(colours, *resolution)

    def _lit_by_points(self, source: Source, profile: torch.Tensor | None, ends: Any) -> torch.Tensor | None:
        """Prepare the light of the points of a source, and return the amplitude of what all of them share."""
        weights, axes = torch.as_tensor(source.weights), (self.path.sizes, self.path.pitches)
        if weights.ndim > 1 and len(weights) != self.frames:
            raise ValueError(f"profile must be a source with weights of {self.frames} frames, got {len(weights)}")
        turned = float(torch.as_tensor(source.directions).abs().max()) * max(axes[1]) / min(self.wavelengths)
        if turned > _MOST_TURN:
            warn(
                f"the light of a point of the source turns by {turned:.2g} waves over a pixel, over which it is taken "
                "to be as it is in the middle",
                AccuracyWarning,
            )
        if source.coherent:
            light = torch.stack([source.sum(w, *axes) for w in self.wavelengths])
            return light if profile is None else light * profile
        spectra = [source.spectrum(w) for w in self.wavelengths]
        turns: list[list[torch.Tensor]] = [[], []]
        for line, weight in enumerate(spectra[0][1]):
            shifted = [found[line] for found, _ in spectra]
            path = path_to(self.modulator, shifted, ends, self.iris, self.medium) if source.width else self.path
            if any(path.image_pitches(c) != self.path.image_pitches(c) for c in range(len(shifted))):
                raise ValueError("profile must be a source without a width behind a lens, which spreads its colours")
            self._lines += ((path, weight),)
            for own, both in zip(turns, zip(*(source.tilts(w, *axes) for w in shifted), strict=True), strict=True):
                own.append(torch.stack(both))
        for name, own in zip(("_turns_down", "_turns_across"), turns, strict=True):
            self.register_buffer(name, torch.stack(own).to(self.powers), persistent=False)
        self.register_buffer("_points", weights.expand(self.frames, -1).to(self.powers), persistent=False)
        return profile

    def _emitted(self, lights: Lights, colour: int) -> Iterator[tuple[Path, Any, Lights]]:
        """Yield for each point and line of the source its path, its share of each frame ``[F]``, and its light.

        `lights` are what panels do to the light of all of them.
        """
        if not self._lines:
            yield self.path, torch.ones_like(self.powers[:, 0]), lights
        for line, (path, weight) in enumerate(self._lines):
            for point, share in enumerate(self._points.unbind(1)):
                down, across = (turn[line, colour, point] for turn in (self._turns_down, self._turns_across))
                tilt = unit_phasor(down[:, None] + across).to(lights[0].dtype)
                yield path, weight * share, (lights[0] * tilt, *lights[1:])

    def _fitting(self, powers):
        powers, shape = floating("powers", powers), [self.frames, len(self.wavelengths)]
        if list(powers.shape) != shape:
            raise ValueError(f"powers must be [frames, wavelengths] = {shape}, got {list(powers.shape)}")
        return powers

    def _in_its_frames(self, powers):
        """Return powers after a warning where they light a source in a frame in which it stays off."""
        if powers.requires_grad or torch.compiler.is_compiling() or not _array.is_readable(powers):
            return powers
        if any(set(given) - set(own) for given, own in zip(frames_lit(powers), self.lit_frames, strict=True)):
            warn(
                "powers light a source in a frame in which it is off in this display, and where it stays off: "
                "make a display of these powers by lit_by(powers)",
                ArgumentWarning,
            )
        return powers

    def _lit(self, light, colour):
        return light if self.profile is None else light * self.profile[colour].to(light.dtype)

    def _lit_by_source(self, lights: Lights, color: int) -> Lights:
        """Return what panels do to light, the first lit by the source of a colour."""
        first, *others = *lights[:-1], self._of_colour(lights[-1], color)
        return self._lit(first, color), *others

    @torch.no_grad()
    def _flat_light(self, color: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what the light of a flat pattern has: amplitude, of mean square one, and phase, such as aberration."""
        if self.profile is None and self.modulator.response is None:
            return self.powers.new_ones(()), self.powers.new_zeros(())
        flat = self._of_colour(self._light(self.powers.new_zeros(self.frames, *self.modulator.resolution)), color)
        light = self._lit(flat, color)[self.lit_frames[color][0]]
        return light.abs() / intensity(light).mean().sqrt(), light.angle()

    def _images_of(self, part: Part, observer: Observer, lights: Lights, powers: torch.Tensor) -> torch.Tensor:
        """Return a part of what an observer sees of panels, ``[grids, ..., planes, rows, columns]``.

        Parameters
        ----------
        part : Part
            Which colour, planes and frames.
        observer : Observer
            Who looks.
        lights : tuple of torch.Tensor
            What each panel does to the light, ``[..., F, rows, columns]``.
        powers : torch.Tensor
            Powers ``[F, C]`` of the sources.
        """
        colour, frames, power = part.colour, part.frames, powers[:, part.colour]

        whole = len(frames) == self.frames
        if not whole:
            lights = tuple(torch.stack([light[..., f, :, :] for f in frames], -3) for light in lights)
        power = power / power.sum() if whole else torch.stack([power[f] for f in frames]) / power.sum()
        light: Any = 0.0
        batch: Sequence[int] = ()
        for path, share, lit in self._emitted(self._lit_by_source(lights, colour), colour):
            shown = path.points(self._kept, lit, colour, part.planes)
            own = power * (share if whole else torch.stack([share[f] for f in frames]))
            amplitudes = own.sqrt()[:, None].to(shown.real.dtype)
            # The patterns of a batch beside the planes: frames are summed up, and these are not.
            batch, points = shown.shape[:-4], shown.movedim(-4, 0).flatten(1, -3)
            light = light + exposed(points[:, :, None], amplitudes)[:, 0]
        light = light.unflatten(0, (-1, self.samples, self.samples))
        seen = observer.recorded(light, self.path.image_pitches(colour), REACH)
        return seen.reshape(len(seen), *batch, -1, *seen.shape[-2:])
