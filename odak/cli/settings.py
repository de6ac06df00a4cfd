"""Settings of the commands beside `odak hologram`, one class for each; lengths are in metres."""

# Fields are made by functions.
# ruff: noqa: RUF009

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from odak import _validate
from odak._warnings import ArgumentWarning, warn
from odak.cli.job import (
    GREY_WAVELENGTH,
    PITCH,
    SHIPPED_IMAGES,
    SMALLEST_SIDE,
    parse_pitch,
    pitch_pair,
    warn_of_samples,
)
from odak.cli.options import (
    DeviceSettings,
    InputError,
    RunSettings,
    Settings,
    argument,
    at_least,
    between,
    length,
    option,
    option_name,
    positive,
    refusing,
    up_to,
)

AIMS = ("paraxial", "real")
# Metres above which a width or a distance is taken for centimetres without their unit.
LARGEST_SCREEN = 15.0
LENS_LENGTHS = ("focal_length", "track", "back", "edge", "axial_color", "lateral_color")
DEMANDS = ("focal_length", "f_number", "field", "elements")


def not_negative(name: str, value: float) -> None:
    """Raise ValueError unless a value is a finite number of at least 0."""
    _validate.number(name, value, least=0)


@dataclass(frozen=True, kw_only=True)
class MetamerSettings(DeviceSettings):
    """Settings of `odak metamer`.

    Attributes
    ----------
    image : str
        Picture file, or name of a picture that comes with odak.
    gaze : tuple of float
        Gaze position, 0 to 1 from the left and from the top; may lie outside the picture.
    width : float
        Width of the picture, in metres or with a unit.
    distance : float
        Distance of the eye, in metres or with a unit.
    alpha : float
        Growth of the eye's pooling regions with eccentricity.
    mode : str
        Growth of the pooling regions with eccentricity in radians.
    levels : int
        Number of levels of the pyramid, 2 or more.
    orientations : int
        Number of orientations of the pyramid's bands, 4 or more.
    iterations : int
        Number of evaluations of the metameric loss in the optimisation; 0 gives noise of matched statistics.
    joint : bool
        Match statistics across channels, orientations and scales too: keeps edges, takes longer.
    nominal_width : bool
        Pool over regions as wide as --alpha says, not 1.7 to 1.9 times as wide.
    seed : int
        Seed of the noise.
    """

    image: str = argument("photo", "[IMAGE]", listed=SHIPPED_IMAGES)
    output: Path = option(Path("metamer"), "-o")
    gaze: tuple[float, float] = option((0.5, 0.5), metavar="X Y", check=_validate.real)
    width: float = length(0.6)
    distance: float = length(0.7, "-d")
    alpha: float = option(0.2, metavar="RATIO", check=positive)
    mode: str = option("quadratic", of=("quadratic", "linear"))
    levels: int = option(5, metavar="COUNT", check=at_least(2))
    orientations: int = option(4, metavar="COUNT", check=at_least(1))
    iterations: int = option(40, metavar="COUNT", check=at_least(0))
    joint: bool = option(False)
    nominal_width: bool = option(False)
    seed: int = option(0, check=at_least(0))

    def check(self) -> None:
        """Warn of lengths that were probably meant in centimetres."""
        for name in ("width", "distance"):
            value = getattr(self, name)
            if value > LARGEST_SCREEN:
                warn(f"--{name} {value:g} is {value:g} metres; did you mean {value:g}cm?", ArgumentWarning)


@dataclass(frozen=True, kw_only=True)
class EyeboxSettings(DeviceSettings):
    """Settings of `odak eyebox`.

    Attributes
    ----------
    images : tuple of str
        Picture file, or name of a picture that comes with odak; one for all places of the pupil, or one for each. The
        target is the light of its luminance.
    linear : bool
        Take the stored values of the pictures as the light; by default they are decoded by the colour profile or as
        sRGB.
    wavelength : float
        Wavelength, in metres or with a unit.
    pixel_pitch : float or tuple of float
        Pixel pitch of the modulator, in metres or with a unit (8um); two of them, with a comma, where rows and columns
        have different pitches (8um,6.4um).
    distance : float
        Distance from the modulator, or its image by an eyepiece, to the pupil, in metres or with a unit.
    resolution : tuple of int
        Resolution of the modulator in pixels: rows and columns, or width x height in one word (1920x1080).
    places : tuple of int
        Number of places of the pupil, one above and beside another.
    spacing : float
        Distance of neighbouring places of the pupil; at most half a pupil for pictures without gaps between them.
    pupil : float
        Diameter of the pupil.
    frames : int
        Number of patterns shown one after another, which the eye averages.
    iterations : int
        Number of iterations.
    learning_rate : float, optional
        Step size in radians of Adam, in place of L-BFGS or, for at most 4 bits, a search over levels.
    seed : int
        Seed of the random initial phases.
    bits : int
        Bits per pixel of the modulator, 1 to 16; above 8 the file is a 16-bit PNG.
    """

    images: tuple[str, ...] = argument(("photo",), "[IMAGE]...", shown="photo", listed=SHIPPED_IMAGES)
    output: Path = option(Path("eyebox"), "-o")
    linear: bool = option(False)
    wavelength: float = length(GREY_WAVELENGTH, "-w")
    pixel_pitch: float | tuple[float, float] = length(8e-6, parse=parse_pitch, metavar=PITCH)
    distance: float = length(0.1, "-d")
    resolution: tuple[int, int] = option((512, 512), metavar="ROWS COLUMNS", check=at_least(SMALLEST_SIDE))
    places: tuple[int, int] = option((1, 3), metavar="ROWS COLUMNS", check=at_least(1))
    spacing: float = length(2e-3)
    pupil: float = length(2e-3)
    frames: int = option(2, metavar="COUNT", check=at_least(1))
    iterations: int = option(60, metavar="COUNT", check=at_least(1))
    learning_rate: float | None = option(None, metavar="RADIANS", check=positive)
    seed: int = option(0, check=at_least(0))
    bits: int = option(8, check=between(1, 16))

    def check(self) -> None:
        """Check the number of pictures, and that the places lie in the light of the pixels."""
        count = self.places[0] * self.places[1]
        if len(self.images) not in (1, count):
            raise InputError(
                f"IMAGE must be given once, or {count} times for --places {self.places[0]} {self.places[1]}, got "
                f"{len(self.images)} pictures"
            )
        for pitch in pitch_pair(self.pixel_pitch):
            warn_of_samples("--wavelength", self.wavelength, "--pixel-pitch", pitch, self.wavelength / 2)
        spans = ((count - 1) * self.spacing + self.pupil for count in self.places)
        if any(span > side for span, side in zip(spans, self.light_box, strict=True)):
            raise InputError(
                f"--places {self.places[0]} {self.places[1]} with --spacing {self.spacing:g} and --pupil "
                f"{self.pupil:g} reach beyond the light of the pixels, {1e3 * self.light_box[0]:.3g} x "
                f"{1e3 * self.light_box[1]:.3g} mm at --distance {self.distance:g}"
            )

    @property
    def light_box(self) -> tuple[float, float]:
        """Height and width in metres of what the light of the pixels reaches at the pupil."""
        down, across = (self.wavelength * self.distance / float(pitch) for pitch in pitch_pair(self.pixel_pitch))
        return down, across

    def middles(self) -> list[tuple[float, float]]:
        """Return the middles of the pupil (y, x) in metres, in reading order."""
        rows, columns = ([self.spacing * (k - (count - 1) / 2) for k in range(count)] for count in self.places)
        return [(y, x) for y in rows for x in columns]


# --- Lenses


@dataclass(frozen=True, kw_only=True)
class TraceSettings(RunSettings):
    """Settings of `odak trace`.

    Attributes
    ----------
    system : str
        Name of a sample, or a .json, .zmx, .seq or .len file.
    rings : int
        Number of rings of the rays that are counted, 1 to 100.
    aim : str
        Pupil that the rays are aimed at: the paraxial or the real one.
    glasses : tuple of Path
        Glass catalogue (.agf), .json or .yml to read first; may be repeated.
    figures : str
        File format of the figures.
    focus : str
        Where the image is: as drawn, or in the plane of the least spots.
    temperature : float, optional
        Temperature of the lens in degrees Celsius; as drawn without one.
    mount : float
        Coefficient of expansion of the mounts, per kelvin, with a temperature.
    solids : str
        File format of the lenses as solids, "none" for no such file.
    """

    system: str = argument(..., "SYSTEM")
    output: Path = option(Path("trace"), "-o")
    rings: int = option(6, metavar="COUNT", check=between(1, 100))
    aim: str = option("paraxial", of=AIMS)
    glasses: tuple[Path, ...] = option((), metavar="FILE")
    figures: str = option("png", of=("png", "svg", "pdf"))
    focus: str = option("as-drawn", of=("as-drawn", "best"))
    temperature: float | None = option(None, metavar="DEGREES")
    mount: float = option(0.0, metavar="PER_KELVIN")
    solids: str = option("none", of=("none", "stl", "ply", "glb", "step"))

    def check(self) -> None:
        """Check that a mount has a temperature."""
        if self.mount and self.temperature is None:
            raise InputError("--mount needs --temperature, to which the mount expands")


@dataclass(frozen=True, kw_only=True)
class ToleranceSettings(RunSettings):
    """Settings of `odak tolerance`.

    Attributes
    ----------
    system : str
        Name of a sample, or a .json, .zmx, .seq or .len file.
    samples : int
        Number of lenses.
    limit : float, optional
        Largest RMS spot that is accepted, in the lens's unit; by default twice the largest.
    share : float, optional
        Scale the deviations to this share of good lenses, in place of those of ISO 10110-11.
    focus : bool
        Refocus each lens.
    seed : int
        Seed of the random numbers.
    """

    system: str = argument(..., "SYSTEM")
    output: Path = option(Path("tolerance"), "-o")
    samples: int = option(200, metavar="COUNT", check=at_least(1))
    limit: float | None = option(None, metavar="SIZE", check=positive)
    share: float | None = option(None, "--yield", metavar="SHARE")
    focus: bool = option(True)
    seed: int = option(0, metavar="NUMBER", check=at_least(0))

    def check(self) -> None:
        """Check the yield."""
        if self.share is not None and not 0 < self.share < 1:
            raise InputError(f"--yield must be between 0 and 1, got {self.share:g}")


@dataclass(frozen=True, kw_only=True)
class DesignSettings(RunSettings):
    """Settings of `odak design`.

    Attributes
    ----------
    system : str, optional
        Name of a sample, or a .json, .zmx, .seq or .len file to begin with; flat plates without one.
    focal_length : float, optional
        Focal length, in metres or with a unit (50mm).
    f_number : float, optional
        Focal length over entrance pupil.
    field : float, optional
        Largest field angle; of a near object its height, in the lens's unit.
    elements : str, optional
        1 to 6, or materials and the stop: N-LAK33B,stop,SF5,N-LAK33B; + cements, as in N-LAK33B+SF5.
    aspheric_terms : int
        Terms r^4, r^6, ... of curved surfaces.
    track : float, optional
        Largest length from the first vertex to the image.
    back : float, optional
        Least distance from the last vertex to the image.
    edge : float, optional
        Least thickness of elements at the rim of the beam.
    distortion : float, optional
        Largest distortion.
    axial_color : float, optional
        Largest distance between the foci of two wavelengths.
    lateral_color : float, optional
        Largest distance in the image of chief rays from that of the middle wavelength.
    chief_ray_angle : float, optional
        Largest angle of chief rays in the image.
    vignetting : float, optional
        Share of the pupil's height that is vignetted at the edge of the field, of flat plates.
    aim : str
        Pupil that rays are aimed at; the real one with a SYSTEM.
    starts : int, optional
        Random starts.
    iterations : int, optional
        Steps of each run.
    seed : int
        Seed of the random starts.
    glasses : tuple of Path
        Glass catalogue (.agf), .json or .yml to read first; may be repeated.
    substitute : str, optional
        Vary the glasses, then take glasses of these makers: schott,ohara.
    zmx : bool
        Write lens.zmx, a Zemax file, too.
    temperature : str, optional
        Temperatures in degrees Celsius at which spots and limits count alike, such as -20,20,60; with a SYSTEM.
    mount : float
        Coefficient of expansion of the mounts, per kelvin, with temperatures.
    """

    system: str | None = argument(None, "[SYSTEM]")
    output: Path = option(Path("design"), "-o")
    focal_length: float | None = length()
    f_number: float | None = option(None, metavar="RATIO", check=positive)
    field: float | None = option(None, metavar="DEGREES", check=not_negative)
    elements: str | None = option(None, metavar="COUNT|NAMES")
    aspheric_terms: int = option(0, metavar="COUNT", check=at_least(0))
    track: float | None = length()
    back: float | None = length(check=not_negative)
    edge: float | None = length(check=not_negative)
    distortion: float | None = option(None, metavar="RATIO", check=positive, shown="0.02, or the SYSTEM's if larger")
    axial_color: float | None = length(shown="2·F·c, c = diagonal of the image/1500, or the SYSTEM's if larger")
    lateral_color: float | None = length(shown="c/2, or the SYSTEM's if larger")
    chief_ray_angle: float | None = option(None, metavar="DEGREES", check=positive)
    vignetting: float | None = option(None, metavar="RATIO", check=not_negative)
    aim: str = option("paraxial", of=AIMS)
    starts: int | None = option(
        None, metavar="COUNT", check=at_least(1), shown="16, with --substitute 32; with a SYSTEM 1"
    )
    iterations: int | None = option(None, metavar="COUNT", check=at_least(1), shown="15; with a SYSTEM 40")
    seed: int = option(0, metavar="NUMBER", check=at_least(0))
    glasses: tuple[Path, ...] = option((), metavar="FILE")
    substitute: str | None = option(None, metavar="MAKERS")
    zmx: bool = option(False)
    temperature: str | None = option(None, metavar="DEGREES,...")
    mount: float = option(0.0, metavar="PER_KELVIN")

    def check(self) -> None:
        """Check the makers of glass, temperatures, chief rays, and what flat plates or a SYSTEM leave open."""
        if self.temperature is not None:
            self._check_temperatures()
        elif self.mount:
            raise InputError("--mount needs --temperature, to which the mount expands")
        for name in LENS_LENGTHS:
            value = getattr(self, name)
            if value is not None and value >= 5:
                warn(f"{option_name(name)} {value:g} is {value:g} metres; did you mean {value:g}mm?", ArgumentWarning)
        if self.makers():
            from odak.learn.raytracing.system.system_files import glass_makers

            for maker in self.makers():
                _validate.one_of("--substitute", maker, glass_makers())
        if self.chief_ray_angle is not None and self.chief_ray_angle >= 90:
            raise InputError(f"--chief-ray-angle must be below 90 degrees, got {self.chief_ray_angle:g}")
        if self.system is None:
            self._check_demands()
        elif self.elements is not None:
            raise InputError("--elements has no effect with a SYSTEM, whose elements are given")
        elif self.vignetting is not None:
            raise InputError("--vignetting has no effect with a SYSTEM, whose apertures are given")

    def _check_demands(self) -> None:
        """Check what a design from flat plates is asked for."""
        missing = [option_name(name) for name in DEMANDS if getattr(self, name) is None]
        if missing:
            raise InputError(
                f"give a SYSTEM to begin with, or all of {', '.join(map(option_name, DEMANDS))}; missing are "
                f"{', '.join(missing)}"
            )
        if self.aim != AIMS[0]:
            raise InputError(f"--aim {self.aim} needs a SYSTEM; flat plates are designed with paraxial pupils")
        if self.f_number is not None and self.f_number < 0.5:
            raise InputError(f"--f-number must be at least 0.5, the limit of a lens in air; got {self.f_number:g}")

    def _check_temperatures(self) -> None:
        """Check that a lens is given that can be designed over temperatures."""
        if self.system is None:
            raise InputError("--temperature needs a SYSTEM; a lens from flat plates can be the SYSTEM of a second run")
        if self.substitute is not None:
            raise InputError("--temperature keeps the glasses: dn/dT of others is unknown; leave out --substitute")
        self.temperatures()

    def temperatures(self) -> list[float] | None:
        """Return the temperatures of the design, None without."""
        if self.temperature is None:
            return None
        told = f"--temperature must be degrees separated by commas, such as -20,20,60; got {self.temperature!r}"
        with refusing(lambda _: told, ValueError):
            return [_validate.number("--temperature", float(word)) for word in self.temperature.split(",")]

    def makers(self) -> list[str]:
        """Return the makers whose glasses replace the glasses of the lens."""
        return [] if self.substitute is None else [word.strip().lower() for word in self.substitute.split(",")]


@dataclass(frozen=True, kw_only=True)
class SimulateSettings(RunSettings):
    """Settings of `odak simulate`.

    Attributes
    ----------
    config : Path, optional
        TOML or JSON file of the bench.
    schema : bool
        Print the JSON schema of the file.
    """

    config: Path | None = argument(None, "CONFIG")
    output: Path = option(Path("bench"), "-o")
    schema: bool = option(False)

    def check(self) -> None:
        """Ask for the file."""
        if self.config is None and not self.schema:
            raise InputError("CONFIG is missing: the TOML or JSON file of a bench; --schema prints its schema")


# --- Optical tables


@dataclass(frozen=True, kw_only=True)
class TableSettings(RunSettings):
    """Settings of an optical table.

    Attributes
    ----------
    modulator : str
        Driver of the modulator.
    camera : str
        Driver of the camera.
    option : tuple of str
        Option of a driver, such as camera.source=0 or simulated.shape=[96,96]; may be repeated.
    wavelength : float
        Vacuum wavelength.
    distance : float
        Distance from the modulator to the camera.
    lens : str, optional
        Focal length of a lens between modulator and camera, in place of the distance; with before= and after= where
        these are not at its focal planes, and block=, the radius of a disc that blocks the light on the axis:
        200mm,before=150mm,block=0.5mm.
    seed : int
        Seed of the simulated table.
    faults : str
        Faults of the simulated table.
    """

    modulator: str = option("simulated", metavar="NAME")
    camera: str = option("simulated", metavar="NAME")
    wavelength: float = length(532e-9, check=up_to(1e-3))
    distance: float = length(20e-3, check=up_to(10.0))
    lens: str | None = option(None, metavar="LENGTH[,NAME=LENGTH]")
    seed: int = option(0, metavar="NUMBER", check=at_least(0))
    faults: str = option("some", of=("some", "all"))
    option: tuple[str, ...] = option((), metavar="INSTRUMENT.NAME=VALUE")

    def check(self) -> None:
        """Refuse two distances."""
        if self.lens is not None and "distance" in self.given:
            raise InputError("--distance has no effect with --lens, which has its distances in before= and after=")


@dataclass(frozen=True, kw_only=True)
class CalibrateSettings(TableSettings):
    """Settings of `odak calibrate`.

    Attributes
    ----------
    step : str
        What to measure.
    polariser : str, optional
        Driver of the polariser's mount.
    results : Path, optional
        HDF5 file of the results (.h5); a .npz file of earlier versions is read.
    """

    step: str = argument(..., "STEP")
    output: Path = option(Path("calibration"), "-o")
    polariser: str | None = option(None, metavar="NAME")
    results: Path | None = option(None, metavar="FILE", shown="calibration.h5 in the folder")


@dataclass(frozen=True, kw_only=True)
class CaptureSettings(TableSettings):
    """Settings of `odak capture`.

    Attributes
    ----------
    pattern : Path
        Grey picture of the levels, or folder of `odak hologram`.
    calibration : Path, optional
        Results of `odak calibrate`, which the prediction takes its values from.
    captures : int
        Number of captures of each pattern.
    """

    pattern: Path = argument(..., "PATTERN")
    output: Path = option(Path("capture"), "-o")
    calibration: Path | None = option(None, metavar="FILE", shown="nominal values")
    captures: int = option(4, metavar="COUNT", check=at_least(1))


@dataclass(frozen=True, kw_only=True)
class InstrumentsSettings(RunSettings):
    """Settings of `odak instruments`.

    Attributes
    ----------
    action : str
        What to do: test.
    driver : str
        Driver of the camera or the modulator to test; "simulated" for both of a simulated table.
    beside : str, optional
        Driver of the modulator whose light a camera sees, or of the camera that sees the light of a modulator.
    option : tuple of str
        Option of a driver, such as driver.pitch=3.45e-6 or beside.display=1; may be repeated.
    captures : int
        Number of captures in a row.
    """

    action: str = argument(..., "ACTION", of=("test",))
    driver: str = argument(..., "DRIVER")
    output: Path = option(Path("instruments"), "-o")
    beside: str | None = option(None, metavar="NAME")
    captures: int = option(1000, metavar="COUNT", check=at_least(2))
    option: tuple[str, ...] = option((), metavar="DRIVER.NAME=VALUE")


# --- Clusters


@dataclass(frozen=True, kw_only=True)
class CertificateSettings(Settings):
    """Settings of `odak certificates`.

    Attributes
    ----------
    folder : Path
        Folder to write to; created if it does not exist.
    days : int
        Number of days for which the certificates are valid.
    """

    folder: Path = argument(..., "FOLDER")
    days: int = option(365, metavar="COUNT")


@dataclass(frozen=True, kw_only=True)
class ShowSettings(Settings):
    """Settings of `odak show`.

    Attributes
    ----------
    file : str
        Folder, picture, .npy, .pt, .json, .zmx, .seq, .len or sample lens.
    output : Path, optional
        HTML file to write.
    browser : bool
        Open the page in the browser.
    """

    file: str = argument(..., "FILE")
    output: Path | None = option(None, "-o", shown="one among the temporary files")
    browser: bool = option(True, "--open/--no-open")


@dataclass(frozen=True, kw_only=True)
class ExamplesSettings(Settings):
    """Settings of `odak examples`.

    Attributes
    ----------
    names : tuple of str
        Names of scripts, or of their groups, to copy; without any, all scripts are listed.
    output : Path
        Folder to copy to; created if it does not exist.
    again : bool
        Replace files that are there already.
    """

    names: tuple[str, ...] = argument((), "[NAME]...")
    output: Path = option(Path("."), "-o")
    again: bool = option(False)


@dataclass(frozen=True, kw_only=True)
class ClusterSettings(Settings):
    """Settings of workers and of their scheduler.

    Attributes
    ----------
    workers : int, optional
        Number of worker processes.
    timeout : float
        Longest time to wait for the scheduler and the workers.
    tls_ca_file : str, optional
        Certificate of the certificate authority.
    tls_cert : str, optional
        This machine's certificate.
    tls_key : str, optional
        Private key of this machine's certificate.
    trusted_network : bool
        Accept plain TCP from other machines: everybody on that network can then run code here.
    """

    workers: int | None = option(None, metavar="COUNT", shown="one per GPU, or per core if there is no GPU")
    timeout: float = option(60.0, metavar="SECONDS")
    tls_ca_file: str | None = option(None, metavar="FILE")
    tls_cert: str | None = option(None, metavar="FILE")
    tls_key: str | None = option(None, metavar="FILE")
    trusted_network: bool = option(False)

    TLS: ClassVar = ("tls_ca_file", "tls_cert", "tls_key")

    def security(self) -> Any:
        """Return Dask's form of the certificates, None without any."""
        given = [getattr(self, name) for name in self.TLS]
        if not any(given):
            return None
        if not all(given):
            raise InputError("--tls-ca-file, --tls-cert and --tls-key must be given together")
        for name, file in zip(self.TLS, given, strict=True):
            if not os.path.isfile(str(file)):
                raise InputError(f"{option_name(name)} is not a file: {file!r}")
        from odak.manager.server import require_dask, tls_security

        with refusing("", ImportError):
            require_dask("A cluster")
        return tls_security(*map(str, given))


@dataclass(frozen=True, kw_only=True)
class WorkerSettings(ClusterSettings):
    """Settings of `odak worker`.

    Attributes
    ----------
    address : str
        Address of a scheduler, such as tls://10.0.0.1:8786.
    threads : int, optional
        Number of threads of each worker.
    memory_limit : float, optional
        Memory of a worker in GiB, above which it is restarted.
    name : str, optional
        Name of the workers, to which a number is appended.
    quiet : bool
        Show no progress and no summary; warnings and errors still go to stderr.
    """

    address: str = argument(..., "ADDRESS")
    threads: int | None = option(None, metavar="COUNT", shown="the cores divided by the workers")
    memory_limit: float | None = option(None, metavar="GIB", shown="the memory divided by the workers")
    name: str | None = option(None, metavar="NAME")
    quiet: bool = option(False, "-q")


@dataclass(frozen=True, kw_only=True)
class SpreadSettings(ClusterSettings):
    """Settings of `odak hologram` for many pictures.

    Attributes
    ----------
    images : tuple of str
        Picture file, folder of pictures, or name of a picture that comes with odak. The target is the light of the
        picture, its colours being mixtures of the sources, up to a white of the same light as D65. It is resized to the
        largest size that fits the resolution and padded with black.
    cluster : str, optional
        Compute the pictures on worker processes of this machine (local) or of a Dask scheduler, such as
        tls://10.0.0.1:8786. The results of each picture are written to a folder of its name.
    retries : int
        Number of times that a failed picture is computed again.
    watch : bool
        Wait for new and changed pictures in the folders, until Ctrl-C.
    """

    images: tuple[str, ...] = argument(("photo",), "[IMAGE]...", shown="photo", listed=SHIPPED_IMAGES)
    cluster: str | None = option(None, metavar="local|ADDRESS", shown="one picture after another in this process")
    retries: int = option(1, metavar="COUNT")
    watch: bool = option(False)
