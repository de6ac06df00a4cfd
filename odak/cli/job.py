"""Parameters of `odak hologram`: defaults, checks, units of length, and modulators known by name."""

import math
import os
from collections.abc import Collection
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

from odak import _validate
from odak._validate import did_you_mean, likely_length, parse_length
from odak._warnings import ArgumentWarning, warn

NOISE = {"slight": 0.3, "normal": 1.0}  # standard deviation in radians
RANDOM_PHASES = (*NOISE, "uniform")
VOLUME_METHODS = ("multiplane", "multi-color")
METHODS = ("sgd", "gs", "double-phase", "network", *VOLUME_METHODS)
# Starts of gradient descent that are computed from the picture.
SOLVERS = ("lbfgs", "adam")
LEARNING_RATE = 0.2
# Without wrap-around these are one, the angular spectrum.
EXACT = ("Angular Spectrum", "Bandlimited Angular Spectrum", "Bandextended Angular Spectrum", "Linear Angular Spectrum")
# Share of the area of a pixel that emits, of the panels of the presets.
USUAL_FILL = 0.9
COMPUTED_PHASES = {"double-phase": "double phase", "gs": "gs"}
INITIAL_PHASES = ("flat", "slight", "quadratic", "normal", "uniform", *COMPUTED_PHASES)
DEFAULT_INITIAL_PHASE = {
    "sgd": "gs",
    "gs": "uniform",
    "double-phase": "flat",
    "multiplane": "slight",
    "multi-color": "slight",
}
# What runs in tiles start from, see odak.wave.hologram_in_chunks.
TILES_PHASE = "weak lens"
GREY_WAVELENGTH = 532e-9
COLOUR_WAVELENGTHS = (638e-9, 520e-9, 450e-9)
MOST_PLANES = 1024
SMALLEST_SIDE = 16
SHIPPED_IMAGES = {"chart": "chart.png", "photo": "photo.png", "scene": "scene.png"}
SHIPPED_DEPTH_MAPS = {"scene": "scene_depth.png"}
LARGEST_PITCH, LARGEST_RANGE = 1e-3, 100.0
LONGEST_WAVELENGTH = 2e-5
# Points across the longer side of the picture below which a distance is taken for a mistake.
FEWEST_POINTS = 16


class InputError(Exception):
    """An argument of the command line is not valid; the message states what is accepted."""


class Modulator(NamedTuple):
    """Nominal data of a commercial spatial light modulator; its data sheet is authoritative."""

    name: str
    pixel_pitch: float | tuple[float, float]
    resolution: tuple[int, int]
    bits: int
    source: str


PRESETS = {
    "holoeye-pluto-2.1": Modulator(
        "HOLOEYE PLUTO-2.1", 8.0e-6, (1080, 1920), 8, "https://holoeye.com/products/spatial-light-modulators"
    ),
    "holoeye-leto-3": Modulator(
        "HOLOEYE LETO-3", 6.4e-6, (1080, 1920), 8, "https://holoeye.com/products/spatial-light-modulators"
    ),
    "hamamatsu-x15213": Modulator(
        "Hamamatsu X15213 series", 12.5e-6, (1024, 1272), 8, "https://www.hamamatsu.com (LCOS-SLM X15213 series)"
    ),
}


@dataclass(frozen=True)
class Job:
    """Parameters of one run of `odak hologram`; lengths in metres.

    Attributes
    ----------
    image : str
        Path of the picture, or the name of a shipped one: "photo", "chart", "scene".
    output : Path
        Folder to write to.
    wavelengths : tuple of float
        None for the defaults, one for a single hologram, or three for the red, green and blue of the picture.
    grey : bool
        Compute one hologram of the picture's brightness.
    pixel_pitch : float or tuple of float
        Pixel pitch of the modulator, one number or (rows, columns).
    distance : float
        Distance from it to the picture.
    resolution : tuple of int
        Rows and columns of the modulator.
    planes : int
        Planes that the picture is spread over by its depth.
    depth_map : str, optional
        Path of a grey picture of the depth, 0 the first plane and 1 the last; "scene" names that picture's own.
    volume_depth : float
        Distance from the first plane to the last, about `distance`.
    frames : int, optional
        Patterns shown one after another: for each colour with "sgd", 1 by default; for all colours with the method
        "multi-color", as many as colours by default.
    method : str, optional
        One of `METHODS`; by default "sgd", or "multiplane" for more than one plane.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`.
    iterations : int
        Number of iterations, for the methods that iterate.
    learning_rate : float, optional
        Step size in radians of gradient descent by Adam, 0.2 by default. None with L-BFGS, which has none.
    optimizer : str, optional
        One of `SOLVERS`, of the method "sgd" and where areas are optimised: "lbfgs" by default, "adam" where a learning
        rate is given or in tiles.
    scale : bool
        Let gradient descent choose the picture's brightness.
    initial_phase : str, optional
        One of `INITIAL_PHASES`; by default the one that serves the method best. None with the method "network".
    seed : int
        Seed of the random initial phases.
    grating : bool
        Add a binary grating of π to the pattern.
    bits : int
        Bits per pixel of the modulator, 1 to 16.
    fill_factor : float, optional
        Share of the area of a square pixel that emits, 0.9 by default; the holograms are computed for such pixels,
        except by the network, and pictures are means over the areas of pixels. 0 computes and reports points, as runs
        in tiles and other propagation types do by default.
    device : str
        "auto", "cpu", "cuda", "cuda:1", …
    quiet : bool
        Show no progress and no summary.
    preset : str, optional
        Name of the modulator that pitch, resolution and bits were taken from, one of `PRESETS`.
    tiles : bool
        Read, compute and evaluate in chunks stored on disk, for pictures larger than memory.
    calibration : str, optional
        File of a calibration, whose response, aberration and illumination are used.
    lut : str, optional
        Text file of the phase of each level in radians.
    slm_range : float, optional
        Phase in radians over which the levels are spread evenly.
    """

    image: str = "photo"
    output: Path = Path("output")
    wavelengths: tuple[float, ...] = ()
    grey: bool = False
    pixel_pitch: float | tuple[float, float] = 8e-6
    resolution: tuple[int, int] = (1080, 1920)
    distance: float = 0.15
    planes: int = 1
    depth_map: str | None = None
    volume_depth: float = 4e-3
    frames: int | None = None
    method: str | None = None
    propagation_type: str = "Bandlimited Angular Spectrum"
    iterations: int = 200
    learning_rate: float | None = None
    optimizer: str | None = None
    scale: bool = True
    initial_phase: str | None = None
    seed: int = 0
    grating: bool = False
    bits: int = 8
    fill_factor: float | None = None
    device: str = "auto"
    quiet: bool = False
    preset: str | None = None
    tiles: bool = False
    calibration: str | None = None
    lut: str | None = None
    slm_range: float | None = None

    def __post_init__(self) -> None:
        """Check every parameter; the messages name the option of the command line."""
        try:
            _validate.several("--pixel-pitch", self.pitches, 2, positive=True)
            _validate.real("--distance", self.distance, positive=True)
            if self.learning_rate is not None:
                _validate.real("--learning-rate", self.learning_rate, positive=True)
            _validate.integer("--iterations", self.iterations, minimum=1)
            _validate.integer("--seed", self.seed)
            for side in self.resolution:
                _validate.integer("--resolution", side, minimum=SMALLEST_SIDE)
            chosen = self.method or ("multiplane" if self.planes > 1 else "sgd")
            self._set("method", _validate.one_of("--method", chosen, METHODS))
            self._set_volume()
            if self.tiles:
                self._check_tiles()
            self._set_fill_factor()
            self._set_initial_phase()
            self._set_optimizer()
        except (TypeError, ValueError) as error:
            raise InputError(str(error)) from None
        if not 1 <= self.bits <= 16:
            raise InputError(f"--bits must be from 1 to 16, got {self.bits}")
        self._check_wavelengths()
        self._check_response()

    def _set_fill_factor(self) -> None:
        """Set the usual fill factor of panels, but for what is computed for points alone."""
        given = self.fill_factor
        if given is not None and not 0 <= given <= 1:
            raise InputError(f"--fill-factor must be from 0, which stands for points, to 1, got {given}")
        if given == 0:
            self._set("fill_factor", None)
        if given is None and not self.tiles and self.propagation_type == Job.propagation_type:
            self._set("fill_factor", USUAL_FILL)

    @property
    def over_areas(self) -> bool:
        """Whether gradient descent optimises means over the areas of pixels."""
        descends = self.method in ("sgd", *VOLUME_METHODS)
        return descends and self.fill_factor is not None and self.propagation_type in EXACT

    def _check_response(self) -> None:
        """Check the options that state the modulator's response, which is that at one wavelength."""
        names = ("calibration", "lut", "slm_range")
        chosen = [option(name) for name in names if getattr(self, name) is not None]
        if len(chosen) > 1:
            raise InputError(f"{' and '.join(chosen)} all state the modulator's response: give one of them")
        if chosen and self.tiles:
            raise InputError(f"{chosen[0]} cannot be used with --tiles")
        if chosen and len(self.wavelengths) != 1:
            raise InputError(f"{chosen[0]} states the response at one wavelength: give --wavelength once")
        if self.slm_range is not None and not 0 < self.slm_range <= LARGEST_RANGE:
            raise InputError(f"--slm-range must be above 0 and at most {LARGEST_RANGE} radians, got {self.slm_range}")

    def _set(self, name: str, value) -> None:
        object.__setattr__(self, name, value)

    def _set_volume(self) -> None:
        """Check the options of planes and frames: lengths and counts first, then their combinations."""
        _validate.integer("--planes", self.planes, minimum=1)
        if max(self.planes, self.frames or 1) > MOST_PLANES:
            raise InputError(
                f"--planes and --frames must be at most {MOST_PLANES}, got {self.planes} and {self.frames}"
            )
        _validate.real("--volume-depth", self.volume_depth, positive=True)
        if self.frames is not None:
            _validate.integer("--frames", self.frames, minimum=1)
            if self.method not in ("sgd", "multi-color"):
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
            "--no-scale": not self.scale,
            "--optimizer lbfgs": self.optimizer == "lbfgs",
            "--grating": self.grating,
            "--fill-factor": self.fill_factor is not None,
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
        if self.method == "network":
            if chosen is not None:
                raise InputError("--initial-phase has no effect with --method network, which makes the phase itself")
            return
        if chosen is None:
            chosen = "gs" if self.over_areas else DEFAULT_INITIAL_PHASE[str(self.method)]
        self._set("initial_phase", _validate.one_of("--initial-phase", chosen, INITIAL_PHASES))
        if chosen in COMPUTED_PHASES and self.method != "sgd" and not self.over_areas:
            raise InputError(
                f"--initial-phase {chosen} needs --method sgd, or one for areas of pixels; got {self.method!r}"
            )

    def _set_optimizer(self) -> None:
        if self.method == "sgd" or self.over_areas:
            usual = "adam" if self.tiles or self.learning_rate is not None else "lbfgs"
            self._set("optimizer", _validate.one_of("--optimizer", self.optimizer or usual, SOLVERS))
            if self.optimizer == "lbfgs":
                if self.learning_rate is not None:
                    raise InputError(
                        "--learning-rate has no effect with --optimizer lbfgs, which finds its steps by a line search"
                    )
                return
        elif self.optimizer is not None:
            raise InputError(f"--optimizer needs --method sgd, or one for areas of pixels; got {self.method!r}")
        if self.learning_rate is None:
            self._set("learning_rate", LEARNING_RATE)

    def _check_wavelengths(self) -> None:
        count = len(self.wavelengths)
        if count not in (0, 1, 3):
            raise InputError(f"--wavelength must be given once, or three times (red, green, blue); got {count}")
        if self.grey and count == 3:
            raise InputError("--grey makes one hologram: give --wavelength once, not three times")
        for value in self.wavelengths:
            check_wavelength("--wavelength", value)
        if len({pattern_name(value) for value in self.wavelengths}) < count:
            raise InputError(f"--wavelength must be three different values, got {list(self.wavelengths)}")

    def check_effect(self, given: Collection[str]) -> None:
        """Raise InputError if a parameter that was given by name has no effect on this run."""
        random = self.initial_phase in RANDOM_PHASES or self.method in VOLUME_METHODS or (self.frames or 1) > 1
        descends = self.method not in ("gs", "double-phase", "network")
        effects = {
            "iterations": (self.iterates, "which does not iterate"),
            "learning_rate": (descends, "which has no step size"),
            "scale": (descends, "which always leaves the brightness free"),
            "propagation_type": (self.method != "network", "which was trained with Angular Spectrum"),
            "seed": (self.method != "network", "which draws no random numbers"),
        }
        for name in given:
            effective, reason = effects.get(name, (True, ""))
            if not effective:
                raise InputError(f"{option(name)} has no effect with --method {self.method}, {reason}")
        if "volume_depth" in given and self.planes == 1:
            raise InputError("--volume-depth has no effect without --planes of at least 2")
        if "seed" in given and not random:
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
        return self.pixel_pitch if isinstance(self.pixel_pitch, tuple) else (self.pixel_pitch, self.pixel_pitch)

    @property
    def iterates(self) -> bool:
        """Whether the method iterates."""
        return self.method not in ("double-phase", "network")

    def to_dict(self) -> dict:
        """Return all parameters as plain JSON values."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


def check_wavelength(name: str, value: float) -> None:
    """Raise InputError for what cannot be a wavelength of light in metres."""
    if not math.isfinite(value) or value <= 0:
        raise InputError(f"{name} must be positive and finite, in metres, got {value!r}")
    if value > 1e-3:
        raise InputError(
            f"{name} {value:g} is {value:g} metres, which is not a wavelength of light: did you mean {value:g}nm?"
        )


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
        if pitch > _validate.COARSEST * wavelength:
            raise InputError(message)
        warn(message, ArgumentWarning)
        return True
    return False


def option(name: str) -> str:
    """Return the command-line option of a parameter."""
    return "--" + name.replace("_", "-")


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


def find_preset(name: str) -> Modulator:
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
