"""What `odak hologram` is asked to do: every parameter, its default and its check."""

import math
import os
from dataclasses import dataclass, fields
from pathlib import Path

from odak import _validate
from odak.cli.errors import InputError

VOLUME_METHODS = ("multiplane", "multi-color")
METHODS = ("sgd", "gs", "double-phase", *VOLUME_METHODS)
INITIAL_PHASES = ("flat", "slight", "quadratic", "normal", "uniform")
DEFAULT_INITIAL_PHASE = {
    "sgd": "flat",
    "gs": "uniform",
    "double-phase": "flat",
    "multiplane": "slight",
    "multi-color": "slight",
}
GREY_WAVELENGTH = 532e-9
COLOUR_WAVELENGTHS = (638e-9, 520e-9, 450e-9)
MOST_PLANES = 1024
SMALLEST_SIDE = 16
SHIPPED_IMAGES = {"chart": "chart.png", "photo": "photo.png", "scene": "scene.png"}
SHIPPED_DEPTH_MAPS = {"scene": "scene_depth.png"}


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
    pixel_pitch, distance : float
        Pixel pitch of the modulator, and distance from it to the picture.
    resolution : tuple of int
        Rows and columns of the modulator.
    planes : int
        Planes that the picture is spread over by its depth.
    depth_map : str, optional
        Path of a grey picture of the depth, 0 the first plane and 1 the last; "scene" names that picture's own.
    volume_depth : float
        Distance from the first plane to the last, about `distance`.
    frames : int, optional
        Patterns shown one after another with the method "multi-color"; as many as colours by default.
    method : str, optional
        One of `METHODS`; by default "sgd", or "multiplane" for more than one plane.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`.
    iterations : int
        Number of iterations, for the methods that iterate.
    learning_rate : float
        Step size in radians of gradient descent.
    scale : bool
        Let gradient descent choose the picture's brightness.
    initial_phase : str, optional
        One of `INITIAL_PHASES`; by default the one that serves the method best.
    seed : int
        Seed of the random initial phases.
    grating : bool
        Add a binary grating of π to the pattern.
    bits : int
        Bits per pixel of the modulator, 1 to 16.
    device : str
        "auto", "cpu", "cuda", "cuda:1", …
    quiet : bool
        Show no progress and no summary.
    """

    image: str = "photo"
    output: Path = Path("output")
    wavelengths: tuple[float, ...] = ()
    grey: bool = False
    pixel_pitch: float = 8e-6
    resolution: tuple[int, int] = (1080, 1920)
    distance: float = 0.15
    planes: int = 1
    depth_map: str | None = None
    volume_depth: float = 4e-3
    frames: int | None = None
    method: str | None = None
    propagation_type: str = "Bandlimited Angular Spectrum"
    iterations: int = 200
    learning_rate: float = 0.2
    scale: bool = True
    initial_phase: str | None = None
    seed: int = 0
    grating: bool = False
    bits: int = 8
    device: str = "auto"
    quiet: bool = False

    def __post_init__(self) -> None:
        """Check every parameter; the messages name the option of the command line."""
        try:
            for name in ("pixel_pitch", "distance", "learning_rate"):
                _validate.real(option(name), getattr(self, name), positive=True)
            _validate.integer("--iterations", self.iterations, minimum=1)
            _validate.integer("--seed", self.seed)
            for side in self.resolution:
                _validate.integer("--resolution", side, minimum=SMALLEST_SIDE)
            chosen = self.method or ("multiplane" if self.planes > 1 else "sgd")
            self._set("method", _validate.one_of("--method", chosen, METHODS))
            self._set_volume()
            self._set_initial_phase()
        except (TypeError, ValueError) as error:
            raise InputError(str(error)) from None
        if not 1 <= self.bits <= 16:
            raise InputError(f"--bits must be from 1 to 16, got {self.bits}")
        self._check_wavelengths()

    def _set(self, name: str, value) -> None:
        object.__setattr__(self, name, value)

    def _set_volume(self) -> None:
        """Check what planes and frames ask for; lengths and counts first, then what goes with what."""
        _validate.integer("--planes", self.planes, minimum=1)
        if max(self.planes, self.frames or 1) > MOST_PLANES:
            raise InputError(
                f"--planes and --frames must be at most {MOST_PLANES}, got {self.planes} and {self.frames}"
            )
        _validate.real("--volume-depth", self.volume_depth, positive=True)
        if self.frames is not None:
            _validate.integer("--frames", self.frames, minimum=1)
            if self.method != "multi-color":
                raise InputError("--frames needs --method multi-color: other methods show one frame for each colour")
        if self.planes == 1:
            if self.depth_map is not None:
                raise InputError("--depth-map needs --planes of at least 2")
            return
        if self.method not in VOLUME_METHODS:
            raise InputError(
                f"--planes {self.planes} needs --method {' or '.join(VOLUME_METHODS)}, got {self.method!r}"
            )
        if self.volume_depth >= 2 * self.distance:
            raise InputError(
                f"--volume-depth must be below twice --distance, or planes lie behind the modulator; "
                f"got {self.volume_depth!r} at {self.distance!r}"
            )
        if self.depth_map is None:
            if self.image not in SHIPPED_DEPTH_MAPS:
                raise InputError(f"--planes {self.planes} needs --depth-map, to say what lies where")
            self._set("depth_map", self.image)

    def _set_initial_phase(self) -> None:
        chosen = self.initial_phase
        if chosen is None:
            chosen = DEFAULT_INITIAL_PHASE[str(self.method)]
        self._set("initial_phase", _validate.one_of("--initial-phase", chosen, INITIAL_PHASES))

    def _check_wavelengths(self) -> None:
        count = len(self.wavelengths)
        if count not in (0, 1, 3):
            raise InputError(f"--wavelength must be given once, or three times (red, green, blue); got {count}")
        if self.grey and count == 3:
            raise InputError("--grey makes one hologram: give --wavelength once, not three times")
        for value in self.wavelengths:
            if not math.isfinite(value) or value <= 0:
                raise InputError(f"--wavelength must be positive and finite, in metres, got {value!r}")
            if value > 1e-3:
                raise InputError(f"--wavelength is in metres: {value!r} is not light (532 nm is 532e-9)")
        if len({pattern_name(value) for value in self.wavelengths}) < count:
            raise InputError(f"--wavelength must be three different values, got {list(self.wavelengths)}")

    @property
    def iterates(self) -> bool:
        """Whether the method iterates."""
        return self.method != "double-phase"

    def to_dict(self) -> dict:
        """Return all parameters as plain JSON values."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


def option(name: str) -> str:
    """Return the command-line option of a parameter."""
    return "--" + name.replace("_", "-")


def pattern_name(wavelength: float) -> str:
    """Return the file name of the pattern for a wavelength in metres, such as ``hologram_532nm.png``."""
    return f"hologram_{wavelength * 1e9:.6g}nm.png"


def image_path(image: str) -> Path:
    """Return the path of the picture asked for: a shipped one by name, else the file itself.

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
    """Return the path of the depth map asked for, as :func:`image_path` does that of the picture."""
    return _existing("--depth-map", depth_map, SHIPPED_DEPTH_MAPS)


def _existing(name, value, shipped) -> Path:
    path = Path(os.path.expanduser(value))
    if value in shipped and not path.is_file():
        return Path(__file__).resolve().parents[1] / "assets" / shipped[value]
    if path.is_dir():
        raise InputError(f"{name} must be a picture, but {str(path)!r} is a directory")
    if not path.is_file():
        raise InputError(f"{name} not found: {str(path)!r} (shipped: {', '.join(shipped)})")
    return path.resolve()
