"""Parameters of `odak hologram`: defaults, checks, units of length, and modulators known by name."""

# Fields are made by functions.

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from odak._call_forms import did_you_mean
from odak._lengths import COARSEST, likely_length, parse_length
from odak._warnings import ArgumentWarning, warn
from odak.cli.eye_settings import EyesSettings
from odak.cli.options import (
    DeviceSettings,
    InputError,
    at_least,
    between,
    in_units,
    length,
    option,
    option_name,
    positive,
)

NOISE = {"slight": 0.3, "normal": 1.0}  # standard deviation in radians
RANDOM_PHASES = (*NOISE, "uniform")
VOLUME_METHODS = ("multiplane", "multi-color")
METHODS = ("sgd", "gs", "double-phase", "network", *VOLUME_METHODS)
SOLVERS = ("lbfgs", "adam", "levels")
# Bits of a pixel up to which levels are searched by default, and at most.
FEW_BITS, MOST_BITS = 4, 6
# Why a solver takes no step size.
STEPS = {"lbfgs": "finds its steps by a line search", "levels": "changes levels"}
LEARNING_RATE = 0.2
# Of a solver by --quality, for as many pixels; the last is an end for what goes on gaining.
_PIXELS = 1080 * 1920
ITERATIONS = {"fast": 20, "good": 200, "best": 2000}
ITERATIONS_OF_LBFGS = {"fast": 4, "good": 30, "best": 400}
ITERATIONS_OF_LEVELS = {"fast": 20, "good": 120, "best": 1000}
# Share of the area of a pixel that emits, of the panels of the presets.
USUAL_FILL = 0.9
OBSERVERS = ("camera", "registered", "points")
COMPUTED_PHASES = ("double-phase", "gs")
INITIAL_PHASES = ("flat", "slight", "quadratic", "normal", "uniform", *COMPUTED_PHASES)
DEFAULT_INITIAL_PHASE = {"gs": "uniform", "double-phase": "flat"}
# What runs in tiles start from, see odak.wave.hologram_in_chunks.
TILES_PHASE = "weak lens"
GREY_WAVELENGTH = 532e-9
COLOUR_WAVELENGTHS = (638e-9, 520e-9, 450e-9)
MOST_PLANES = 1024
_COLOURS = ", ".join(map(str, map(in_units, COLOUR_WAVELENGTHS)))
SMALLEST_SIDE = 16
SHIPPED_IMAGES = {"chart": "chart.png", "photo": "photo.png", "scene": "scene.png"}
# Films, by the endings of their names.
FILMS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm")
SHIPPED_DEPTH_MAPS = {"scene": "scene_depth.png"}
PITCH = "LENGTH[,LENGTH]"
LARGEST_PITCH, LARGEST_RANGE = 1e-3, 100.0
LONGEST_WAVELENGTH = 2e-5
# At this distance a pupil gets light of all pixels of most modulators.
TO_EYES = 0.3
# Points across the longer side of the picture below which a distance is taken for a mistake.
FEWEST_POINTS = 16


class Preset(NamedTuple):
    """Nominal data of a commercial spatial light modulator; its data sheet is authoritative."""

    name: str
    pixel_pitch: float | tuple[float, float]
    resolution: tuple[int, int]
    bits: int
    source: str


PRESETS = {
    "holoeye-pluto-2.1": Preset(
        "HOLOEYE PLUTO-2.1", 8.0e-6, (1080, 1920), 8, "https://holoeye.com/products/spatial-light-modulators"
    ),
    "holoeye-leto-3": Preset(
        "HOLOEYE LETO-3", 6.4e-6, (1080, 1920), 8, "https://holoeye.com/products/spatial-light-modulators"
    ),
    "hamamatsu-x15213": Preset(
        "Hamamatsu X15213 series", 12.5e-6, (1024, 1272), 8, "https://www.hamamatsu.com (LCOS-SLM X15213 series)"
    ),
}


def check_wavelength(name: str, value: float) -> None:
    """Raise InputError for what cannot be a wavelength of light in metres."""
    if not math.isfinite(value) or value <= 0:
        raise InputError(f"{name} must be positive and finite, in metres, got {value!r}")
    if value > 1e-3:
        raise InputError(
            f"{name} {value:g} is {value:g} metres, which is not a wavelength of light: did you mean {value:g}nm?"
        )


def parse_pitch(text: str | float) -> float | tuple[float, float]:
    """Return a pixel pitch in metres from one length, or from two for rows and columns, such as ``8um,6.4um``."""
    if not isinstance(text, str):
        return text
    parts = text.split(",")
    if len(parts) > 2 or len({is_length(part) for part in parts}) > 1:
        raise ValueError(f"{text!r} is not a pixel pitch; write it as 8um, or 8um,6.4um for rows and columns")
    pitch = tuple(parse_length(part) for part in parts)
    return pitch[0] if pitch[0] == pitch[-1] else (pitch[0], pitch[1])


def is_length(text: str) -> bool:
    """Return whether a text is a number with a unit of length."""
    try:
        parse_length(text)
    except ValueError:
        return False
    return text.strip()[-1:].isalpha()


def pitch_pair(pitch: float | tuple[float, float]) -> tuple[float, float]:
    """Return a pixel pitch along rows and columns."""
    return pitch if isinstance(pitch, tuple) else (pitch, pitch)


def _propagation_types() -> tuple[str, ...]:
    from odak.wave.methods import PROPAGATION_TYPES

    return (*PROPAGATION_TYPES, "auto")


@dataclass(frozen=True, kw_only=True)
class Job(EyesSettings, DeviceSettings):
    """Settings of `odak hologram` for one picture.

    Attributes
    ----------
    image : str
        Picture, or the name of one that comes with odak; one of those that the command names.
    wavelengths : tuple of float
        Wavelength, in metres or with a unit (532nm); give it three times for red, green and blue. If it is given once,
        or with --grey, one hologram of the picture's luminance is computed.
    grey : bool
        Compute one hologram of the luminance of a colour picture.
    linear : bool
        Take the stored values of the picture as the light of the sources. By default they are decoded by the picture's
        colour profile or as sRGB, but for OpenEXR and Radiance files, which hold light, and colours are mixtures of the
        sources.
    pixel_pitch : float or tuple of float
        Pixel pitch of the modulator, in metres or with a unit (8um); two of them, with a comma, where rows and columns
        have different pitches (8um,6.4um).
    resolution : tuple of int
        Resolution of the modulator in pixels: rows and columns, or width x height in one word (1920x1080).
    distance : float
        Distance from modulator to picture, or to the pupils with --views, --mesh and --splats, in metres or with a unit
        (15cm).
    planes : int
        Number of depth planes, to which the depth map assigns the pixels.
    depth_map : str, optional
        Grey picture of the depth: 0 (black) is the first plane, nearest to the modulator, 1 the last.
    volume_depth : float
        Distance from the first plane to the last, centred at --distance.
    frames : int, optional
        Number of patterns shown in rapid sequence, whose images the eye averages: for each colour (sgd) or for all
        colours together (multi-color).
    method : str, optional
        sgd: gradient descent; gs: Gerchberg-Saxton; double-phase: no iterations, verified through the half-band Fourier
        filter that such holograms need; network: one pass of a trained network, for planes at distances at which the
        light of a pixel covers 5 to 75 pixels; multiplane: one pattern for each colour, for all planes; multi-color:
        patterns that are each lit by all colours, with source powers that are optimised too.
    propagation_type : str
        Propagation method of the computation, or 'auto'.
    quality : str
        How long the computation takes on two cores, for all methods except double-phase and network: about a quarter of
        a minute (fast), a minute (good), or until nothing is gained (best). Smaller pictures get more iterations in
        proportion, until nothing is gained either, and larger ones fewer; beyond 1080 x 1920 pixels, start and report
        take longer than that. With --tiles the numbers do not depend on the size.
    iterations : int, optional
        Number of iterations, in place of --quality.
    learning_rate : float, optional
        Step size in radians of Adam (sgd, multiplane, multi-color).
    optimizer : str, optional
        Solver of the method sgd, and of those for several planes or colours. L-BFGS reaches the quality of Adam in half
        as many iterations or fewer; levels searches for the levels of a modulator of few bits, where most of the
        quality is lost if phases are rounded to them.
    scale : bool
        Optimise the brightness of the image as well (methods with a step size) instead of reproducing the stored
        values: 10 dB better on the picture 'photo', because less light must be directed outside the image.
    initial_phase : str, optional
        Initial phase of the hologram, or of the picture with the method double-phase: zero (flat), normal noise of 0.3
        rad (slight), a lens whose focal length is twice the distance (quadratic), normal noise of 1 rad (normal),
        uniform noise over 2 pi (uniform). With sgd also the double phase of the picture, or ten accelerated iterations
        of Gerchberg-Saxton (gs).
    start : str, optional
        Folder of earlier results for the same modulator and colours, whose patterns the iterations begin with in place
        of an initial phase. For a picture that differs little, these need fewer iterations.
    seed : int
        Seed of the random initial phases.
    grating : bool
        Add a binary grating (pi on every second column) to the pattern that is saved.
    bits : int
        Bits per pixel of the modulator, 1 to 16; above 8 the file is a 16-bit PNG.
    fill_factor : float, optional
        Fill factor of the square pixels, the emitting share of their area. The holograms are computed for such pixels
        and an aperture that passes one diffraction order; images and report are averages over pixel areas. 0: pixels
        are points, and images are sampled at points.
    observer : str, optional
        Who looks at the image, for whom the methods with a step size compute it and who is reported: a camera of the
        modulator's pitch at any place, one whose pixels are registered with those of the image, or points in the
        middles of pixels, for one plane whose colours share no frames.
    preset : str, optional
        Commercial modulator that sets pixel pitch, resolution and bits unless these options are given.
    calibration : str, optional
        Results of `odak calibrate` (calibration.h5): pixel pitch, resolution, bits, wavelength and, unless it is given,
        distance are taken from it; levels follow the measured phase response, the aberration is corrected, and the
        image is computed with the measured illumination, for which the method sgd optimises.
    lut : str, optional
        Text file of the phase in radians that each level shows at the wavelength: a line for each of the 2^bits levels,
        with the phase, or level and phase.
    slm_range : float, optional
        Phase range of the modulator at the wavelength, over which its 2^bits levels are spread evenly.
    tiles : bool
        Read, compute and evaluate in chunks stored on disk, for pictures larger than memory: TIFF, .npy and Zarr, with
        one modulator pixel per picture pixel unless --resolution is given. An interrupted run is resumed. With
        --cluster local, worker processes write to disk what does not fit in memory.
    """

    deferred: ClassVar[bool] = True

    image: str = "photo"
    wavelengths: tuple[float, ...] = length(
        (),
        "--wavelength",
        "-w",
        shown=f"{in_units(GREY_WAVELENGTH)}; colour pictures: {_COLOURS}",
        check=check_wavelength,
    )
    grey: bool = option(False)
    linear: bool = option(False)
    pixel_pitch: float | tuple[float, float] = length(8e-6, parse=parse_pitch, metavar=PITCH)
    resolution: tuple[int, int] = option((1080, 1920), metavar="ROWS COLUMNS", check=at_least(SMALLEST_SIDE))
    distance: float = length(0.15, "-d", shown=f"15cm; {in_units(TO_EYES)} with --views, --mesh and --splats")
    planes: int = option(1, metavar="COUNT", check=at_least(1))
    depth_map: str | None = option(None, metavar="PICTURE", shown="its own for the picture 'scene'")
    volume_depth: float = length(4e-3)
    frames: int | None = option(
        None, metavar="COUNT", shown="sgd: 1; multi-color: one for each colour", check=at_least(1)
    )
    method: str | None = option(None, of=METHODS, shown="sgd; multiplane for more than one plane")
    propagation_type: str = option("Bandlimited Angular Spectrum", metavar="NAME", listed=_propagation_types)
    quality: str = option("good", of=("fast", "good", "best"))
    iterations: int | None = option(
        None,
        metavar="COUNT",
        shown="for 1080 x 1920 pixels, of L-BFGS 4, 30 or as many as help; of levels 20, 120, 1000; of other solvers "
        "20, 200",
        check=at_least(1),
    )
    learning_rate: float | None = option(None, metavar="RADIANS", shown=str(LEARNING_RATE), check=positive)
    optimizer: str | None = option(
        None,
        of=SOLVERS,
        shown="lbfgs; levels for modulators of at most 4 bits; adam with --learning-rate or --tiles",
    )
    scale: bool = option(True)
    initial_phase: str | None = option(
        None,
        of=INITIAL_PHASES,
        shown="gs with sgd, flat with the method double-phase, uniform with the method gs, none with the method "
        "network, otherwise slight",
    )
    start: str | None = option(None, metavar="FOLDER")
    seed: int = option(0, check=at_least(0))
    grating: bool = option(False)
    bits: int = option(8, check=between(1, 16))
    fill_factor: float | None = option(
        None, metavar="RATIO", shown=f"{USUAL_FILL}; 0 with --tiles and other propagation types"
    )
    observer: str | None = option(None, of=OBSERVERS, shown="camera; points with --fill-factor 0")
    preset: str | None = option(None, metavar="NAME", listed=PRESETS)
    calibration: str | None = option(None, metavar="FILE")
    lut: str | None = option(None, metavar="FILE", shown="phases spread evenly over 2 pi")
    slm_range: float | None = option(None, metavar="RADIANS", shown="2 pi")
    tiles: bool = option(False)

    def check(self) -> None:
        """Set what depends on other settings, and check what they say together."""
        self._set("method", self.method or ("multiplane" if self.planes > 1 else "sgd"))
        self.check_scene()
        if self.scene is not None and self.distance == Job.distance and "distance" not in self.given:
            self._set("distance", TO_EYES)
        self._set_volume()
        if self.tiles:
            self._check_tiles()
        self._set_fill_factor()
        self._set_observer()
        self._set_initial_phase()
        self._set_optimizer()
        if self.iterations is None:
            self._set("iterations", self._most)
        self._check_wavelengths()
        self._check_response()
        self._check_effects()
        if self.scene is not None:
            self._check_eyes()

    def _check_eyes(self) -> None:
        """Refuse what is not computed for eyes."""
        without = {
            f"--method {self.method}": self.method != "sgd",
            "--planes": self.planes > 1,
            "--tiles": self.tiles,
            f"--propagation-type {self.propagation_type}": self.propagation_type != Job.propagation_type,
            "--fill-factor 0": not self.fill_factor,
            f"--observer {self.observer}": self.observer == "points",
            "--initial-phase double-phase": self.initial_phase == "double-phase",
            "--calibration": self.calibration is not None,
        }
        for name, used in without.items():
            if used:
                raise InputError(f"{name} cannot be used with --{self.scene}, of which eyes see pictures by sgd")

    def _set_fill_factor(self) -> None:
        """Set the usual fill factor of panels, but for what is computed for points alone."""
        given = self.fill_factor
        if given is not None and not 0 <= given <= 1:
            raise InputError(f"--fill-factor must be from 0, which stands for points, to 1, got {given}")
        if given is None and not self.tiles:
            self._set("fill_factor", USUAL_FILL if self.propagation_type == Job.propagation_type else 0.0)

    def _set_observer(self) -> None:
        """Set the usual observer, and refuse one that does not see the pixels or is not reported."""
        points = not self.fill_factor
        if self.observer is None:
            self._set("observer", "points" if points else "camera")
        elif points and self.observer != "points":
            raise InputError(f"--observer {self.observer} needs a --fill-factor above 0, otherwise pixels are points")
        elif self.observer == "points" and not points and (self.planes > 1 or self.method in VOLUME_METHODS):
            raise InputError(f"--observer points cannot be used with --planes and --method {self.method}")

    @property
    def descends(self) -> bool:
        """Whether the method follows the gradient of what an observer sees."""
        return self.method in ("sgd", *VOLUME_METHODS)

    def _check_response(self) -> None:
        """Check the options that state the modulator's response, which is that at one wavelength."""
        names = ("calibration", "lut", "slm_range")
        chosen = [option_name(name) for name in names if getattr(self, name) is not None]
        if len(chosen) > 1:
            raise InputError(f"{' and '.join(chosen)} all state the modulator's response: give one of them")
        if chosen and self.tiles:
            raise InputError(f"{chosen[0]} cannot be used with --tiles")
        if chosen and len(self.wavelengths) != 1:
            raise InputError(f"{chosen[0]} states the response at one wavelength: give --wavelength once")
        if self.slm_range is not None and not 0 < self.slm_range <= LARGEST_RANGE:
            raise InputError(f"--slm-range must be above 0 and at most {LARGEST_RANGE} radians, got {self.slm_range}")

    def _set_volume(self) -> None:
        """Check the options of planes and frames."""
        if max(self.planes, self.frames or 1) > MOST_PLANES:
            raise InputError(
                f"--planes and --frames must be at most {MOST_PLANES}, got {self.planes} and {self.frames}"
            )
        if self.frames is not None and self.method not in ("sgd", "multi-color"):
            raise InputError(
                "--frames needs --method sgd or multi-color: other methods compute one frame for each colour"
            )
        if self.planes == 1:
            if self.depth_map is not None:
                raise InputError("--depth-map needs --planes of at least 2")
            return
        if self.method not in (*VOLUME_METHODS, "network"):
            raise InputError(
                f"--planes {self.planes} needs --method {', '.join(VOLUME_METHODS)} or network, got {self.method!r}"
            )
        if self.volume_depth >= 2 * self.distance:
            raise InputError(
                f"--volume-depth must be less than twice --distance, otherwise planes lie behind the modulator; "
                f"got {self.volume_depth!r} at {self.distance!r}"
            )
        if self.depth_map is None:
            if self.image not in SHIPPED_DEPTH_MAPS:
                raise InputError(f"--planes {self.planes} needs --depth-map, which assigns each pixel to a plane")
            self._set("depth_map", self.image)

    def _check_tiles(self) -> None:
        """Refuse what is not computed in chunks."""
        if self.method not in ("sgd", "gs"):
            raise InputError(f"--tiles needs --method sgd or gs, got {self.method!r}")
        without = {
            "--frames": self.frames not in (None, 1),
            "--initial-phase": self.initial_phase not in (None, TILES_PHASE),
            "--start": self.start is not None,
            "--no-scale": not self.scale,
            f"--optimizer {self.optimizer}": self.optimizer not in (None, "adam"),
            "--grating": self.grating,
            "--fill-factor": self.fill_factor is not None,
            "--observer": self.observer is not None,
            "--device": self.device not in ("auto", "cpu"),
        }
        for name, used in without.items():
            if used:
                raise InputError(f"{name} cannot be used with --tiles")

    def _set_initial_phase(self) -> None:
        if self.tiles:
            self._set("initial_phase", TILES_PHASE)
            return
        chosen = self.initial_phase
        if self.start is not None:
            if not self.descends or chosen is not None:
                used = f"--method {self.method}" if chosen is None else "--initial-phase"
                raise InputError(f"--start has no effect with {used}")
            if not any(Path(os.path.expanduser(self.start)).glob("hologram*.png")):
                raise InputError(f"--start must be a folder with results of odak hologram, got {self.start!r}")
        if self.method == "network":
            if chosen is not None:
                raise InputError("--initial-phase has no effect with --method network, which makes the phase itself")
            return
        if chosen is None:
            chosen = DEFAULT_INITIAL_PHASE.get(str(self.method), "gs")
        self._set("initial_phase", chosen)
        if chosen in COMPUTED_PHASES and not self.descends:
            raise InputError(
                f"--initial-phase {chosen} needs --method sgd or one for several planes or colours; got {self.method!r}"
            )

    def _set_optimizer(self) -> None:
        if self.descends:
            even = self.method != "multi-color" and not any((self.calibration, self.lut, self.slm_range))
            usual = "levels" if even and self.bits <= FEW_BITS else "lbfgs"
            if self.tiles or self.learning_rate is not None:
                usual = "adam"
            self._set("optimizer", self.optimizer or usual)
            if self.optimizer == "levels" and not (even and self.bits <= MOST_BITS):
                raise InputError(
                    f"--optimizer levels needs --bits of at most {MOST_BITS}, evenly spread phases, and --method "
                    f"sgd or multiplane; got {self.bits} bits and {self.method!r}"
                )
            if self.optimizer in STEPS:
                if self.learning_rate is not None:
                    raise InputError(
                        f"--learning-rate has no effect with --optimizer {self.optimizer}, which "
                        f"{STEPS[self.optimizer]}"
                    )
                return
        elif self.optimizer is not None:
            raise InputError(
                f"--optimizer needs --method sgd or one for several planes or colours; got {self.method!r}"
            )
        if self.learning_rate is None:
            self._set("learning_rate", LEARNING_RATE)

    def _check_wavelengths(self) -> None:
        count = len(self.wavelengths)
        if count not in (0, 1, 3):
            raise InputError(f"--wavelength must be given once, or three times (red, green, blue); got {count}")
        if self.grey and count == 3:
            raise InputError("--grey makes one hologram: give --wavelength once, not three times")
        if len({pattern_name(value) for value in self.wavelengths}) < count:
            raise InputError(f"--wavelength must be three different values, got {list(self.wavelengths)}")

    def _check_effects(self) -> None:
        """Raise InputError if an option of the command line has no effect on this run."""
        random = self.initial_phase in RANDOM_PHASES or self.method in VOLUME_METHODS or (self.frames or 1) > 1
        effects = {
            "iterations": (self.iterates, "which does not iterate"),
            "quality": (self.iterates, "which does not iterate"),
            "learning_rate": (self.descends, "which has no step size"),
            "scale": (self.descends, "which always leaves the brightness free"),
            "propagation_type": (self.method != "network", "which was trained with Angular Spectrum"),
            "seed": (self.method != "network", "which draws no random numbers"),
        }
        for name in self.given:
            effective, reason = effects.get(name, (True, ""))
            if not effective:
                raise InputError(f"{option_name(name)} has no effect with --method {self.method}, {reason}")
        if "volume_depth" in self.given and self.planes == 1:
            raise InputError("--volume-depth has no effect without --planes of at least 2")
        if "seed" in self.given and not random:
            raise InputError(
                f"--seed has no effect with --initial-phase {self.initial_phase}; "
                f"the random ones are {', '.join(RANDOM_PHASES)}"
            )

    def warn_of_doubtful_lengths(self) -> None:
        """Warn of lengths that are possible but probably not intended, and state the probable intention."""
        wavelengths = self.wavelengths or (GREY_WAVELENGTH,)
        side, steps = max(self.resolution), self.pitches
        if any(
            warn_of_samples("--wavelength", max(wavelengths), "--pixel-pitch", pitch, min(wavelengths) / 2)
            for pitch in steps
        ):
            return
        reach = max(wavelengths) * self.distance
        longest = max(n * pitch for n, pitch in zip(self.resolution, steps, strict=True))
        points = longest**2 / reach if reach > 0 else math.inf
        if points < max(FEWEST_POINTS, side / 32):
            meant = likely_length(self.distance, 1e-3, 1.0, "mm")
            warn(
                f"--distance {self.distance:g}: at {self.distance:g} metres this modulator resolves only {points:.2g} "
                f"points across the picture; did you mean {meant}?",
                ArgumentWarning,
            )
        overlap = max(steps) ** 2 / min(wavelengths)
        if self.distance < overlap:
            warn(
                f"--distance {self.distance:g}: the light of neighbouring pixels overlaps only beyond "
                f"{overlap:.2g} metres; at shorter distances a phase pattern forms no image",
                ArgumentWarning,
            )

    @property
    def pitches(self) -> tuple[float, float]:
        """Pixel pitch along rows and columns."""
        return pitch_pair(self.pixel_pitch)

    @property
    def settles(self) -> bool:
        """Whether the iterations end when nothing is gained any more."""
        if "iterations" in self.given or self.optimizer == "levels" or self.iterations != self._most:
            return False
        return self.quality == "best" or (not self.tiles and math.prod(self.resolution) < _PIXELS)

    @property
    def _most(self) -> int:
        """Iterations of a quality, as many as the number of pixels leaves time for."""
        counts = {"lbfgs": ITERATIONS_OF_LBFGS, "levels": ITERATIONS_OF_LEVELS}.get(str(self.optimizer), ITERATIONS)
        share = 1.0 if self.tiles else _PIXELS / math.prod(self.resolution)
        end = counts["best"]
        return end if self.quality == "best" else min(end, math.ceil(share * counts[self.quality]))

    @property
    def iterates(self) -> bool:
        """Whether the method iterates."""
        return self.method not in ("double-phase", "network")

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters as plain JSON values."""
        values = {**self.values(), "output": self.output, "quiet": self.quiet}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


def warn_of_samples(name: str, wavelength: float, pitch_name: str, pitch: float, finest: float = 0.0) -> bool:
    """Warn of a wavelength or a pixel pitch that was probably not intended, and return whether there was one.

    Pixels that no propagation takes raise InputError.
    """
    if wavelength > LONGEST_WAVELENGTH:
        meant = likely_length(wavelength, 1e-7, LONGEST_WAVELENGTH, "nm")
        warn(f"{name} {wavelength:g} is {wavelength:g} metres; did you mean {meant}?", ArgumentWarning)
        return True
    if pitch > LARGEST_PITCH or pitch < finest:
        why = "larger than the pixels of any modulator" if pitch > LARGEST_PITCH else "below half a wavelength"
        meant = likely_length(pitch, 1e-6, 1e-4, "um")
        message = f"{pitch_name} {pitch:g} is {pitch:g} metres, {why}; did you mean {meant}?"
        if pitch > COARSEST * wavelength:
            raise InputError(message)
        warn(message, ArgumentWarning)
        return True
    return False


def find_preset(name: str) -> Preset:
    """Return a modulator by its name; raise InputError with the nearest names otherwise."""
    if name.casefold() not in PRESETS:
        raise InputError(f"--preset must be one of {', '.join(PRESETS)}; got {name!r}.{did_you_mean(name, PRESETS)}")
    return PRESETS[name.casefold()]


def pattern_name(wavelength: float, frame: int | None = None) -> str:
    """Return the file name of the pattern for a wavelength in metres, such as ``hologram_532nm.png``.

    Parameters
    ----------
    wavelength : float
        In metres.
    frame : int, optional
        Number of the frame, counted from one, where there are several: ``hologram_532nm_frame1.png``.
    """
    return f"hologram_{wavelength * 1e9:.6g}nm{'' if frame is None else f'_frame{frame}'}.png"


def is_film(image: str) -> bool:
    """Return whether the name of a file is that of a film."""
    return Path(image).suffix.lower() in FILMS


def image_path(image: str) -> Path:
    """Return the path of the requested picture: an included one by name, otherwise the file itself.

    Parameters
    ----------
    image : str
        Path, or the name of a shipped picture.

    Returns
    -------
    Path
        Existing file.

    Raises
    ------
    InputError
        If there is no such file.
    """
    return _existing("IMAGE", image, SHIPPED_IMAGES)


def depth_map_path(depth_map: str) -> Path:
    """Return the path of the requested depth map, as :func:`image_path` does for the picture."""
    return _existing("--depth-map", depth_map, SHIPPED_DEPTH_MAPS)


def _existing(name, value, shipped) -> Path:
    path = Path(os.path.expanduser(value))
    if (path / "zarr.json").is_file() or (path / ".zarray").is_file():
        return path.resolve()
    if value in shipped and not path.is_file():
        return Path(__file__).resolve().parents[1] / "assets" / shipped[value]
    if path.is_dir():
        raise InputError(f"{name} must be a picture, but {str(path)!r} is a directory")
    if name == "IMAGE" and not path.exists() and is_length(value):
        raise InputError(f"IMAGE {value!r} is a length: give --wavelength before each one (-w 638nm -w 520nm -w 450nm)")
    if not path.is_file():
        raise InputError(
            f"{name} not found: {str(path)!r} (shipped: {', '.join(shipped)}).{did_you_mean(value, shipped)}"
        )
    return path.resolve()
