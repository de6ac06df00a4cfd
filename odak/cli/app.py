"""Commands of the command line, their options, their messages and their exit codes.

Exit codes: 0 success, 1 unexpected failure, 2 the command line or a file that it names cannot be used, 130 interrupted
by Ctrl-C.
"""

import functools
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from odak.cli.job import GREY_WAVELENGTH, InputError, Job, find_preset

if TYPE_CHECKING:
    from odak.cli import files
from typing import Any

from odak.cli.job import (
    COLOUR_WAVELENGTHS,
    INITIAL_PHASES,
    LEARNING_RATE,
    METHODS,
    PRESETS,
    SHIPPED_IMAGES,
    SOLVERS,
    parse_length,
    parse_pitch,
)

LENGTH = "LENGTH"


def length(text: str | float) -> float:
    """Parse a length; raise the exception that typer reports as a usage error."""
    try:
        return parse_length(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def pitch(text: str | float) -> float | tuple[float, float]:
    """Parse a pixel pitch; raise the exception that typer reports as a usage error."""
    try:
        return parse_pitch(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def _complete(names):
    """Return a function that completes one of some names."""
    return lambda incomplete: [name for name in names if name.casefold().startswith(incomplete.casefold())]


def _propagation_types(incomplete: str) -> list[str]:
    from odak.wave.methods import PROPAGATION_TYPES

    return _complete((*PROPAGATION_TYPES, "auto"))(incomplete)


_COLOURS = ", ".join(f"{value * 1e9:g}nm" for value in COLOUR_WAVELENGTHS)

Images = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[IMAGE]...",
        help="Picture file, folder of pictures, or name of a picture that comes with odak: "
        + ", ".join(sorted(SHIPPED_IMAGES))
        + ". Its stored values, 0 to 1, are the target intensity; no display gamma is removed. It is resized to the "
        "largest size that fits the resolution and padded with black.",
        show_default="photo",
    ),
]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; created if it does not exist.")]
Wavelengths = Annotated[
    list[float] | None,
    typer.Option(
        "--wavelength",
        "-w",
        parser=length,
        metavar=LENGTH,
        help="Wavelength, in metres or with a unit (532nm); give it three times for red, green and blue. If it is "
        "given once, or with --grey, one hologram of the picture's brightness is computed.",
        show_default=f"{GREY_WAVELENGTH * 1e9:g}nm; colour pictures: {_COLOURS}",
    ),
]
Grey = Annotated[bool, typer.Option("--grey", help="Compute one hologram of the brightness of a colour picture.")]
PixelPitch = Annotated[
    # Typer calls the parser of an option, and shows its type as the metavar says.
    Any,
    typer.Option(
        parser=pitch,
        metavar=f"{LENGTH}[,{LENGTH}]",
        help="Pixel pitch of the modulator, in metres or with a unit (8um); two of them, with a comma, where rows "
        "and columns have different pitches (8um,6.4um).",
        show_default="8um",
    ),
]
Resolution = Annotated[
    tuple[int, int],
    typer.Option(
        metavar="ROWS COLUMNS",
        help="Resolution of the modulator in pixels: rows and columns, or width x height in one word (1920x1080).",
    ),
]
Distance = Annotated[
    float,
    typer.Option(
        "--distance",
        "-d",
        parser=length,
        metavar=LENGTH,
        help="Distance from modulator to picture, in metres or with a unit (15cm).",
        show_default="15cm",
    ),
]
Preset = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Commercial modulator that sets pixel pitch, resolution and bits unless these options are given: "
        + ", ".join(PRESETS)
        + ".",
        autocompletion=_complete(PRESETS),
    ),
]
Watch = Annotated[bool, typer.Option("--watch", help="Wait for new and changed pictures in the folders, until Ctrl-C.")]
Tiles = Annotated[
    bool,
    typer.Option(
        "--tiles",
        help="Read, compute and evaluate in chunks stored on disk, for pictures larger than memory: TIFF, .npy and "
        "Zarr, with one modulator pixel per picture pixel unless --resolution is given. An interrupted run is resumed. "
        "With --cluster local, worker processes write to disk what does not fit in memory.",
    ),
]
Planes = Annotated[
    int, typer.Option(metavar="COUNT", help="Number of depth planes, to which the depth map assigns the pixels.")
]
DepthMap = Annotated[
    str | None,
    typer.Option(
        metavar="PICTURE",
        help="Grey picture of the depth: 0 (black) is the first plane, nearest to the modulator, 1 the last.",
        show_default="its own for the picture 'scene'",
    ),
]
VolumeDepth = Annotated[
    float,
    typer.Option(
        parser=length,
        metavar=LENGTH,
        help="Distance from the first plane to the last, centred at --distance.",
        show_default="4mm",
    ),
]
Frames = Annotated[
    int | None,
    typer.Option(
        metavar="COUNT",
        help="Number of patterns shown in rapid sequence, whose images the eye averages: for each colour (sgd) or for "
        "all colours together (multi-color).",
        show_default="sgd: 1; multi-color: one for each colour",
    ),
]
Method = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(METHODS),
        autocompletion=_complete(METHODS),
        help="sgd: gradient descent; gs: Gerchberg-Saxton; double-phase: no iterations, verified through the half-band "
        "Fourier filter that such holograms need; network: one pass of a trained network, for planes at distances at "
        "which the light of a pixel covers 5 to 75 pixels; multiplane: one pattern for each colour, for all planes; "
        "multi-color: patterns that are each lit by all colours, with source powers that are optimised too.",
        show_default="sgd; multiplane for more than one plane",
    ),
]
PropagationType = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Propagation method of the computation, or 'auto'.",
        autocompletion=_propagation_types,
    ),
]
EyeboxIterations = Annotated[int, typer.Option(metavar="COUNT", help="Number of iterations.")]
EyeboxLearningRate = Annotated[
    float | None, typer.Option(metavar="RADIANS", help="Step size in radians of Adam, in place of L-BFGS.")
]
Iterations = Annotated[
    int, typer.Option(metavar="COUNT", help="Number of iterations (all methods except double-phase and network).")
]
LearningRate = Annotated[
    float | None,
    typer.Option(
        metavar="RADIANS",
        help="Step size in radians of Adam (sgd, multiplane, multi-color).",
        show_default=str(LEARNING_RATE),
    ),
]
Optimizer = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(SOLVERS),
        autocompletion=_complete(SOLVERS),
        help="Solver of the method sgd. L-BFGS reaches the quality of Adam in half as many iterations or fewer.",
        show_default="lbfgs; adam with --learning-rate or --tiles",
    ),
]
Scale = Annotated[
    bool,
    typer.Option(
        help="Optimise the brightness of the image as well (methods with a step size) instead of reproducing the "
        "stored values: 10 dB better on the picture 'photo', because less light must be directed outside the image."
    ),
]
InitialPhase = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(INITIAL_PHASES),
        autocompletion=_complete(INITIAL_PHASES),
        help="Initial phase of the hologram, or of the picture with the method double-phase: zero (flat), normal noise "
        "of 0.3 rad (slight), a lens whose focal length is twice the distance (quadratic), normal noise of 1 rad "
        "(normal), uniform noise over 2 pi (uniform). With sgd also the double phase of the picture, or ten "
        "accelerated iterations of Gerchberg-Saxton (gs).",
        show_default="gs with sgd, flat with the method double-phase, uniform with the method gs, none with the method "
        "network, otherwise slight",
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the random initial phases.")]
Grating = Annotated[
    bool, typer.Option(help="Add a binary grating (pi on every second column) to the pattern that is saved.")
]
Bits = Annotated[int, typer.Option(help="Bits per pixel of the modulator, 1 to 16; above 8 the file is a 16-bit PNG.")]
FillFactor = Annotated[
    float | None,
    typer.Option(
        metavar="RATIO",
        help="Fill factor of the square pixels, the emitting share of their area. The holograms are computed for such "
        "pixels and an aperture that passes one diffraction order; images and report are averages over pixel areas. "
        "0: pixels are points, and images are sampled at points.",
        show_default="0.9; 0 with --tiles and other propagation types",
    ),
]
CalibrationFile = Annotated[
    str | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="Results of `odak calibrate` (calibration.h5): pixel pitch, resolution, bits, wavelength and, unless it "
        "is given, distance are taken from it; levels follow the measured phase response, the aberration is "
        "corrected, and the image is computed with the measured illumination, for which the method sgd optimises.",
    ),
]
Lut = Annotated[
    str | None,
    typer.Option(
        "--lut",
        metavar="FILE",
        help="Text file of the phase in radians that each level shows at the wavelength: a line for each of the 2^bits "
        "levels, with the phase, or level and phase.",
        show_default="phases spread evenly over 2 pi",
    ),
]
SlmRange = Annotated[
    float | None,
    typer.Option(
        metavar="RADIANS",
        help="Phase range of the modulator at the wavelength, over which its 2^bits levels are spread evenly.",
        show_default="2 pi",
    ),
]
Device = Annotated[str, typer.Option(help="auto (the GPU if there is one), cpu, cuda, cuda:1, ...")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress and no summary; warnings and errors still go to stderr.")
]

# --- Clusters
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="local|ADDRESS",
        help="Compute the pictures on worker processes of this machine (local) or of a Dask scheduler, such "
        "as tls://10.0.0.1:8786. The results of each picture are written to a folder of its name.",
        show_default="one picture after another in this process",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        metavar="COUNT", help="Number of worker processes.", show_default="one per GPU, or per core if there is no GPU"
    ),
]
Retries = Annotated[int, typer.Option(metavar="COUNT", help="Number of times that a failed picture is computed again.")]
Again = Annotated[
    bool,
    typer.Option("--again", help="Compute results that exist already again, and replace others without asking."),
]
Address = Annotated[str, typer.Argument(metavar="ADDRESS", help="Address of a scheduler, such as tls://10.0.0.1:8786.")]
Threads = Annotated[
    int | None,
    typer.Option(
        metavar="COUNT", help="Number of threads of each worker.", show_default="the cores divided by the workers"
    ),
]
MemoryLimit = Annotated[
    float | None,
    typer.Option(
        metavar="GIB",
        help="Memory of a worker in GiB, above which it is restarted.",
        show_default="the memory divided by the workers",
    ),
]
Name = Annotated[str | None, typer.Option(metavar="NAME", help="Name of the workers, to which a number is appended.")]
Timeout = Annotated[
    float, typer.Option(metavar="SECONDS", help="Longest time to wait for the scheduler and the workers.")
]
CaFile = Annotated[
    str | None, typer.Option("--tls-ca-file", metavar="FILE", help="Certificate of the certificate authority.")
]
Cert = Annotated[str | None, typer.Option("--tls-cert", metavar="FILE", help="This machine's certificate.")]
Key = Annotated[
    str | None, typer.Option("--tls-key", metavar="FILE", help="Private key of this machine's certificate.")
]
TrustedNetwork = Annotated[
    bool,
    typer.Option(
        "--trusted-network",
        help="Accept plain TCP from other machines: everybody on that network can then run code here.",
    ),
]

# --- Metamers
EyeboxImages = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[IMAGE]...",
        help="Picture file, or name of a picture that comes with odak: "
        + ", ".join(sorted(SHIPPED_IMAGES))
        + "; one for all places of the pupil, or one for each.",
        show_default="photo",
    ),
]
OneWavelength = Annotated[
    float,
    typer.Option(
        "--wavelength",
        "-w",
        parser=length,
        metavar=LENGTH,
        help="Wavelength, in metres or with a unit.",
        show_default=f"{GREY_WAVELENGTH * 1e9:g}nm",
    ),
]
PupilDistance = Annotated[
    float,
    typer.Option(
        "--distance",
        "-d",
        parser=length,
        metavar=LENGTH,
        help="Distance from the modulator, or its image by an eyepiece, to the pupil, in metres or with a unit.",
        show_default="10cm",
    ),
]
Places = Annotated[
    tuple[int, int],
    typer.Option(metavar="ROWS COLUMNS", help="Number of places of the pupil, one above and beside another."),
]
Spacing = Annotated[
    float,
    typer.Option(
        parser=length,
        metavar=LENGTH,
        help="Distance of neighbouring places of the pupil; at most half a pupil for "
        "pictures without gaps between them.",
        show_default="2mm",
    ),
]
Pupil = Annotated[float, typer.Option(parser=length, metavar=LENGTH, help="Diameter of the pupil.", show_default="2mm")]
EyeboxFrames = Annotated[
    int,
    typer.Option(
        "--frames", metavar="COUNT", help="Number of patterns shown one after another, which the eye averages."
    ),
]
MetamerImage = Annotated[
    str,
    typer.Argument(
        metavar="[IMAGE]",
        help="Picture file, or name of a picture that comes with odak: " + ", ".join(sorted(SHIPPED_IMAGES)) + ".",
    ),
]
Gaze = Annotated[
    tuple[float, float],
    typer.Option(
        metavar="X Y", help="Gaze position, 0 to 1 from the left and from the top; may lie outside the picture."
    ),
]
Width = Annotated[
    float,
    typer.Option("--width", parser=length, metavar=LENGTH, help="Width of the picture, in metres or with a unit."),
]
ViewingDistance = Annotated[
    float,
    typer.Option(
        "--distance", "-d", parser=length, metavar=LENGTH, help="Distance of the eye, in metres or with a unit."
    ),
]
Alpha = Annotated[float, typer.Option(metavar="RATIO", help="Growth of the eye's pooling regions with eccentricity.")]
PoolingMode = Annotated[
    str,
    typer.Option(
        metavar="quadratic|linear",
        help="Growth of the pooling regions with eccentricity in radians.",
        autocompletion=_complete(("quadratic", "linear")),
    ),
]
Levels = Annotated[int, typer.Option(metavar="COUNT", help="Number of levels of the pyramid, 2 or more.")]
Orientations = Annotated[
    int, typer.Option(metavar="COUNT", help="Number of orientations of the pyramid's bands, 4 or more.")
]
Refinements = Annotated[
    int,
    typer.Option(
        metavar="COUNT",
        help="Number of evaluations of the metameric loss in the optimisation; 0 gives noise of matched statistics.",
    ),
]
Joint = Annotated[
    bool,
    typer.Option(
        "--joint", help="Match statistics across channels, orientations and scales too: keeps edges, takes longer."
    ),
]
NominalWidth = Annotated[
    bool,
    typer.Option("--nominal-width", help="Pool over regions as wide as --alpha says, not 1.7 to 1.9 times as wide."),
]
NoiseSeed = Annotated[int, typer.Option(help="Seed of the noise.")]

# --- Optical tables
ModulatorName = Annotated[str, typer.Option(metavar="NAME", help="Driver of the modulator.")]
CameraName = Annotated[str, typer.Option(metavar="NAME", help="Driver of the camera.")]
InstrumentOptions = Annotated[
    list[str] | None,
    typer.Option(
        metavar="INSTRUMENT.NAME=VALUE",
        help="Option of a driver, such as camera.source=0 or simulated.shape=[96,96]; may be repeated.",
    ),
]
TableWavelength = Annotated[str, typer.Option(metavar="LENGTH", help="Vacuum wavelength.")]
TableDistance = Annotated[str, typer.Option(metavar="LENGTH", help="Distance from the modulator to the camera.")]
TableLens = Annotated[
    str | None,
    typer.Option(
        "--lens",
        metavar="LENGTH[,NAME=LENGTH]",
        help="Focal length of a lens between modulator and camera, in place of the distance; with before= and after= "
        "where these are not at its focal planes, and block=, the radius of a disc that blocks the light on the axis: "
        "200mm,before=150mm,block=0.5mm.",
    ),
]
TableSeed = Annotated[int, typer.Option(metavar="NUMBER", help="Seed of the simulated table.")]
TableFaults = Annotated[str, typer.Option(metavar="some|all", help="Faults of the simulated table.")]

# --- Lenses
Glasses = Annotated[
    list[Path] | None,
    typer.Option(metavar="FILE", help="Glass catalogue (.agf), .json or .yml to read first; may be repeated."),
]
FocalLength = Annotated[
    float | None,
    typer.Option(parser=length, metavar=LENGTH, help="Focal length, in metres or with a unit (50mm)."),
]
Track = Annotated[
    float | None, typer.Option(parser=length, metavar=LENGTH, help="Largest length from the first vertex to the image.")
]
Back = Annotated[
    float | None, typer.Option(parser=length, metavar=LENGTH, help="Least distance from the last vertex to the image.")
]
AxialColor = Annotated[
    float | None,
    typer.Option(parser=length, metavar=LENGTH, help="Largest distance between the foci of two wavelengths."),
]


BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after the program's name; by default the arguments of the process.

    Returns
    -------
    int
        Exit code: 0 success, 1 unexpected failure, 2 bad command line or input, 130 interrupted by Ctrl-C.

    Examples
    --------
    >>> from odak.cli import main
    >>> code = main(["--version"])  # doctest: +ELLIPSIS
    0...
    >>> code
    0
    """
    if arguments is not None:
        if isinstance(arguments, str) or not isinstance(arguments, Sequence):
            raise TypeError(f"arguments must be a sequence of strings, got {arguments!r:.80}")
        arguments = list(arguments)
    command = _command()
    # Only what has a size in one word is rewritten: click itself expands the process's own arguments on Windows.
    given = sys.argv[1:] if arguments is None else arguments
    if (sizes := _apart(given)) != given:
        arguments = sizes
    try:
        code = command.main(args=arguments, prog_name="odak", standalone_mode=False)
    except typer.Abort:
        return _fail("interrupted", INTERRUPTED)
    except Exception as error:
        # typer carries its own copy of click in some releases and not in others: errors of either have this method.
        if not hasattr(error, "format_message"):
            raise
        usage, message = _usage_of(error), error.format_message()
        return _fail((message.rstrip(".") + "." + usage) if usage else message, BAD_INPUT)
    if code == INTERRUPTED:
        # Releases of typer differ: some return this code where others raise Abort.
        return _fail("interrupted", INTERRUPTED)
    return code if isinstance(code, int) else 0


@functools.cache  # made from the annotations of all commands, which takes longer than to read a command line
def _command():
    return typer.main.get_command(app)


def _apart(arguments: list[str]) -> list[str]:
    """Return arguments with a resolution in one word, width x height, as the rows and columns that its option takes."""
    found: list[str] = []
    for argument in arguments:
        size = re.fullmatch(r"(--resolution=)?(\d+)[x×](\d+)", argument)
        if size and (size[1] or found[-1:] == ["--resolution"]):
            found += [*(["--resolution"] if size[1] else []), size[3], size[2]]
        else:
            found.append(argument)
    return found


@app.callback(invoke_without_command=True)
def _start(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
) -> None:
    """Optics: wave optics, computer-generated holography, lenses and perception."""
    if version:
        from odak import __version__

        typer.echo(__version__)
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command(
    help="Compute phase-only holograms of a picture, save them as PNG, and report how well the saved files reproduce "
    "it.\n\n"
    "Writes hologram_<nm>nm.png (one per wavelength; phase = grey * 2 pi / 256, or / 65536 for 16-bit files), with "
    "--frames hologram_<nm>nm_frame<k>.png or, with multi-color, hologram_frame<k>.png; reconstruction.png, "
    "comparison.png and report.json; with planes also focal_stack.png.\n\n"
    "Several pictures, or folders of them, are computed one after another or, with --cluster, in parallel. The results "
    "of each are written to a folder of its name in the output folder. Results of the same options that exist already "
    "are kept; results of other options are listed before they are replaced."
)
def hologram(
    context: typer.Context,
    images: Images = None,
    output: Output = Job.output,
    wavelength: Wavelengths = None,
    grey: Grey = Job.grey,
    pixel_pitch: PixelPitch = Job.pixel_pitch,
    resolution: Resolution = Job.resolution,
    distance: Distance = Job.distance,
    planes: Planes = Job.planes,
    depth_map: DepthMap = Job.depth_map,
    volume_depth: VolumeDepth = Job.volume_depth,
    frames: Frames = Job.frames,
    method: Method = Job.method,
    propagation_type: PropagationType = Job.propagation_type,
    iterations: Iterations = Job.iterations,
    learning_rate: LearningRate = Job.learning_rate,
    optimizer: Optimizer = Job.optimizer,
    scale: Scale = Job.scale,
    initial_phase: InitialPhase = Job.initial_phase,
    seed: Seed = Job.seed,
    grating: Grating = Job.grating,
    bits: Bits = Job.bits,
    fill_factor: FillFactor = Job.fill_factor,
    preset: Preset = Job.preset,
    calibration: CalibrationFile = Job.calibration,
    lut: Lut = Job.lut,
    slm_range: SlmRange = Job.slm_range,
    device: Device = Job.device,
    quiet: Quiet = Job.quiet,
    again: Again = False,
    watch: Watch = False,
    tiles: Tiles = Job.tiles,
    cluster: Cluster = None,
    workers: Workers = None,
    retries: Retries = 1,
    timeout: Timeout = 60.0,
    tls_ca_file: CaFile = None,
    tls_cert: Cert = None,
    tls_key: Key = None,
    trusted_network: TrustedNetwork = False,
) -> None:
    """Compute the holograms of pictures; the parameters are as in :class:`odak.cli.job.Job`."""
    values = dict(locals())
    given = _given(values.pop("context"))
    with _messages():
        images = values.pop("images") or [Job.image]
        values["wavelengths"] = tuple(values.pop("wavelength") or ())
        spread = {name: values.pop(name) for name in ("cluster", "workers", "retries", "timeout", "trusted_network")}
        certificates = [values.pop(name) for name in ("tls_ca_file", "tls_cert", "tls_key")]
        again, watch = values.pop("again"), values.pop("watch")
        if preset is not None:
            modulator = find_preset(preset)
            values["preset"] = preset.casefold()
            values |= {name: getattr(modulator, name) for name in {"pixel_pitch", "resolution", "bits"} - given}
        if calibration is not None:
            from odak.cli.files import calibrated

            values |= calibrated(calibration, values, given)
        if lut is not None:
            values["lut"] = str(Path(lut).expanduser().absolute())
        if tiles:
            if len(images) > 1 or watch or (spread["cluster"] or "local") != "local":
                raise InputError("--tiles takes one IMAGE and no --watch, and --cluster must be local or left out")
            if "resolution" not in given and preset is None:
                from odak.cli.tiles import picture_size

                values["resolution"] = picture_size(images[0])
        many = not tiles and (
            cluster is not None or watch or len(images) > 1 or os.path.isdir(os.path.expanduser(images[0]))
        )
        for name in sorted(given & {*spread, "tls_ca_file", "tls_cert", "tls_key"}):
            if tiles and cluster is not None and name in ("cluster", "workers"):
                continue
            if not many or (cluster is None and name not in ("cluster", "retries", "workers")):
                raise InputError(f"--{name.replace('_', '-')} has no effect without --cluster")
        if many:
            from odak.cli.cluster import Certificates

            spread |= {"again": again, "security": Certificates(*certificates).security(), "given": given}
            raise typer.Exit(_many(images, values, spread, watch))
        job = Job(**values, image=images[0])
        job.check_effect(given)
        report = _single(job, again, None if cluster is None else workers or os.cpu_count())
    if not quiet:
        _summarise(job, report)


def _single(job: Job, again: bool, workers: int | None) -> dict:
    from odak.cli import files

    notices = _notices(again, job.quiet)
    # Before the modules of the computation are imported, which takes seconds.
    report = files.kept_report(job.output, files.fingerprint_of(job), notices)
    if report is not None:
        return report
    if job.tiles:
        from odak.cli import tiles

        return tiles.run(job, notices, again, workers)
    from odak.cli import hologram

    return hologram.run(job, notices)


@app.command(
    help="Start workers on this machine for a Dask scheduler: one per GPU, or one per core if there is no GPU. They "
    "run until the scheduler ends or Ctrl-C is pressed.\n\n"
    "Everybody who can connect to the scheduler can run code on this machine. A scheduler on another machine must use "
    "certificates, which `odak certificates` makes, unless --trusted-network is given. A scheduler is started with "
    "`dask scheduler --protocol tls --host ADDRESS --tls-ca-file ... --tls-cert ... --tls-key ...`."
)
def worker(
    address: Address,
    workers: Workers = None,
    threads: Threads = None,
    memory_limit: MemoryLimit = None,
    name: Name = None,
    timeout: Timeout = 60.0,
    tls_ca_file: CaFile = None,
    tls_cert: Cert = None,
    tls_key: Key = None,
    trusted_network: TrustedNetwork = False,
    quiet: Quiet = False,
) -> None:
    """Join a cluster; see :func:`odak.cli.cluster.join`."""
    with _messages():
        from odak.cli.cluster import Certificates, join

        join(
            address,
            Certificates(tls_ca_file, tls_cert, tls_key),
            (lambda _: None) if quiet else typer.echo,
            workers=workers,
            threads=threads,
            memory_limit=memory_limit,
            name=name,
            timeout=timeout,
            trusted_network=trusted_network,
        )


@app.command(
    help="Make TLS certificates for a cluster: ca.pem, cert.pem and key.pem. Copy the folder to each machine; only "
    "those who have it can run code on the cluster."
)
def certificates(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder to write to; created if it does not exist.")],
    days: Annotated[
        int, typer.Option(metavar="COUNT", help="Number of days for which the certificates are valid.")
    ] = 365,
) -> None:
    """Make certificates; see :func:`odak.manager.make_certificates`."""
    with _messages():
        from odak.manager import make_certificates

        try:
            made = make_certificates(folder, days)
        except (ImportError, TypeError, ValueError) as error:
            raise InputError(str(error)) from None
    typer.echo(f"ca.pem, cert.pem, key.pem in {made}; keep key.pem secret")


@app.command(
    help="Make a picture that looks the same as another to an eye with a fixed gaze.\n\n"
    "Away from the gaze its details are displaced; its local statistics are the same as the picture's. Writes "
    "metamer.png, pooling_map.png (the width of the pooling regions of the eye, on a logarithmic scale), "
    "comparison.png and report.json."
)
def metamer(
    image: MetamerImage = "photo",
    output: Output = Path("metamer"),
    gaze: Gaze = (0.5, 0.5),
    width: Width = 0.6,
    distance: ViewingDistance = 0.7,
    alpha: Alpha = 0.2,
    mode: PoolingMode = "quadratic",
    levels: Levels = 5,
    orientations: Orientations = 4,
    iterations: Refinements = 40,
    joint: Joint = False,
    nominal_width: NominalWidth = False,
    seed: NoiseSeed = 0,
    device: Device = "auto",
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Make a metamer; for the parameters see :class:`odak.cli.metamer.MetamerJob`."""
    values = dict(locals())
    notices = _notices(values.pop("again"), quiet)
    with _messages():
        from odak.cli.metamer import MetamerJob, run

        report = run(MetamerJob(**values), notices)
    if not quiet:
        psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
        typer.echo(
            f"PSNR {psnr}, metameric loss {report['loss']:.3g}, loss of white noise of the same PSNR "
            f"{report['noise_loss']:.3g}, largest pooling region {report['largest_pooling']:.3g} px"
        )
        if report["texture_distance"] is not None:
            typer.echo(
                f"distance by statistics of textures {report['texture_distance']:.3g}, distance of the noise "
                f"{report['noise_texture_distance']:.3g}"
            )
        typer.echo(f"metamer.png, pooling_map.png, comparison.png, report.json in {output}")


@app.command(
    help="Compute a hologram that shows an eye its picture at several places of the pupil.\n\n"
    "Several pictures, one for each place in reading order, give parallax. Writes a pattern for each frame, views.png "
    "with what an eye sees from each place, by exact propagation of the saved patterns, and report.json."
)
def eyebox(
    images: EyeboxImages = None,
    output: Output = Path("eyebox"),
    wavelength: OneWavelength = GREY_WAVELENGTH,
    pixel_pitch: PixelPitch = 8e-6,
    distance: PupilDistance = 0.1,
    resolution: Resolution = (512, 512),
    places: Places = (1, 3),
    spacing: Spacing = 2e-3,
    pupil: Pupil = 2e-3,
    frames: EyeboxFrames = 2,
    iterations: EyeboxIterations = 60,
    learning_rate: EyeboxLearningRate = None,
    seed: Seed = 0,
    bits: Bits = 8,
    device: Device = "auto",
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Compute a hologram for an eyebox; the parameters are as in :class:`odak.cli.eyebox_views.EyeboxJob`."""
    values = dict(locals())
    notices = _notices(values.pop("again"), quiet)
    values["images"] = tuple(images or ["photo"])
    with _messages():
        from odak.cli.eyebox_views import EyeboxJob, run

        report = run(EyeboxJob(**values), notices)
    if not quiet:
        for view in report["views"]:
            y, x = (f"{1e3 * value:.3g}" for value in view["place"])
            typer.echo(f"pupil at {y}, {x} mm: PSNR {view['psnr_db']:.2f} dB, {view['share']:.1%} of the light")
        typer.echo(f"{', '.join(report['files'])}, views.png, report.json in {output}")


@app.command(
    help="Trace rays through a lens: a sample (singlet, cooke_triplet, double_gauss, double_gauss_f28, "
    "triplet_f28, phone_f2), a .json file of odak, or a file of Zemax (.zmx), CODE V (.seq) or OSLO (.len).\n\n"
    "Writes figures of all analyses (layout, spots, fans, transfer, through focus, wavefront, field, image, "
    "performance over the field, pupil, footprint, polarisation, Seidel coefficients), report.html with all of them, "
    "the prescription and the aberrations, and report.json with first-order properties, spot sizes, wavefronts, Strehl "
    "ratios, modulation and vignetting."
)
def trace(
    system: Annotated[
        str, typer.Argument(metavar="SYSTEM", help="Name of a sample, or a .json, .zmx, .seq or .len file.")
    ],
    output: Output = Path("trace"),
    rings: Annotated[
        int, typer.Option(metavar="COUNT", help="Number of rings of the rays that are counted, 1 to 100.")
    ] = 6,
    aim: Annotated[
        str,
        typer.Option(metavar="paraxial|real", help="Pupil that the rays are aimed at: the paraxial or the real one."),
    ] = "paraxial",
    glasses: Glasses = None,
    figures: Annotated[str, typer.Option(metavar="png|svg|pdf", help="File format of the figures.")] = "png",
    focus: Annotated[
        str,
        typer.Option(metavar="as-drawn|best", help="Where the image is: as drawn, or in the plane of the least spots."),
    ] = "as-drawn",
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Trace a system; see :mod:`odak.cli.trace`."""
    with _messages():
        from odak.cli.trace import run, summary

        report = run(system, output, rings, aim, glasses or (), figures, focus, _notices(again, quiet))
    if quiet:
        return
    for line in summary(report):
        typer.echo(line)
    for line in report["ignored"]:
        typer.echo(f"ignored: {line}", err=True)
    typer.echo(f"{', '.join(report['figures'])}, report.html, report.json in {output}")


@app.command(
    help="Tolerance a lens: trace many with random deviations of their numbers: by ISO 10110-11 for drawings "
    "without any, or as large as a --yield allows.\n\n"
    "Each lens is refocused. Writes figures of the yield, with histograms, and of the sensitivities, report.html and "
    "report.json. The same seed gives the same lenses."
)
def tolerance(
    system: Annotated[
        str, typer.Argument(metavar="SYSTEM", help="Name of a sample, or a .json, .zmx, .seq or .len file.")
    ],
    output: Output = Path("tolerance"),
    samples: Annotated[int, typer.Option(metavar="COUNT", help="Number of lenses.")] = 200,
    limit: Annotated[
        float | None,
        typer.Option(
            metavar="SIZE", help="Largest RMS spot that is accepted, in the lens's unit; by default twice the largest."
        ),
    ] = None,
    share: Annotated[
        float | None,
        typer.Option("--yield", metavar="SHARE", help="Scale the deviations to this share of good lenses."),
    ] = None,
    focus: Annotated[bool, typer.Option("--focus/--no-focus", help="Refocus each lens.")] = True,
    seed: Annotated[int, typer.Option(metavar="NUMBER", help="Seed of the random numbers.")] = 0,
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Tolerance a system; see :mod:`odak.cli.trace`."""
    with _messages():
        from odak.cli.trace import run_tolerance

        report = run_tolerance(system, output, samples, seed, limit, share, focus, _notices(again, quiet))
    if quiet:
        return
    unit, median = report["system"]["unit"], report["rms_quantiles"].get("0.5")
    typer.echo(f"RMS spot {report['rms_as_drawn']:.3g} {unit} as drawn, median of {samples} lenses {median:.3g} {unit}")
    typer.echo(f"yield {report['yield']:.0%} within {report['limit']:.3g} {unit}")
    typer.echo(f"{', '.join(report['figures'])}, report.html, report.json in {output}")


@app.command(
    help="Design a lens: improve one that is there (a sample, a .json or a .zmx file) or, without one, make one from "
    "flat plates for --focal-length, --f-number, --field and --elements.\n\n"
    "Curvatures, thicknesses, the focus and what aspheres there are vary, so that the spots of all fields become small "
    "under limits of distortion, edges and lengths; focal length, f-number and field are as asked for, or as in "
    "the SYSTEM. Writes lens.json, layout.png and report.json. The same seed gives the same lens."
)
def design(
    system: Annotated[
        str | None, typer.Argument(metavar="[SYSTEM]", help="Name of a sample, or a .json, .zmx, .seq or .len file.")
    ] = None,
    output: Output = Path("design"),
    focal_length: FocalLength = None,
    f_number: Annotated[float | None, typer.Option(metavar="RATIO", help="Focal length over entrance pupil.")] = None,
    field: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="Largest field angle; of a near object its height, in the lens's unit."),
    ] = None,
    elements: Annotated[
        str | None,
        typer.Option(metavar="COUNT|NAMES", help="1 to 6, or materials and the stop: N-LAK33B,stop,SF5,N-LAK33B."),
    ] = None,
    aspheric_terms: Annotated[int, typer.Option(metavar="COUNT", help="Terms r^4, r^6, ... of curved surfaces.")] = 0,
    track: Track = None,
    back: Back = None,
    distortion: Annotated[
        float | None,
        typer.Option(metavar="RATIO", help="Largest distortion.", show_default="0.02, or the SYSTEM's if larger"),
    ] = None,
    axial_color: AxialColor = None,
    chief_ray_angle: Annotated[
        float | None, typer.Option(metavar="DEGREES", help="Largest angle of chief rays in the image.")
    ] = None,
    aim: Annotated[
        str, typer.Option(metavar="paraxial|real", help="Pupil that rays are aimed at; the real one with a SYSTEM.")
    ] = "paraxial",
    starts: Annotated[
        int | None,
        typer.Option(metavar="COUNT", help="Random starts.", show_default="16, with --substitute 32; with a SYSTEM 1"),
    ] = None,
    iterations: Annotated[
        int | None, typer.Option(metavar="COUNT", help="Steps of each run.", show_default="15; with a SYSTEM 40")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="NUMBER", help="Seed of the random starts.")] = 0,
    glasses: Glasses = None,
    substitute: Annotated[
        str | None,
        typer.Option(metavar="MAKERS", help="Vary the glasses, then take glasses of these makers: schott,ohara."),
    ] = None,
    zmx: Annotated[bool, typer.Option("--zmx", help="Write lens.zmx, a Zemax file, too.")] = False,
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Design a lens; the parameters are as in :class:`odak.cli.lens_design.DesignJob`."""
    values = dict(locals()) | {"glasses": glasses or ()}
    notices = _notices(values.pop("again"), quiet)
    with _messages():
        from odak.cli.lens_design import MICROMETRES, DesignJob, run

        report = run(DesignJob(**values), notices)
    if quiet:
        return
    unit, found = report["unit"], report["first_order"]
    for line in report["did"]:
        typer.echo(line)
    typer.echo(f"focal length {found['focal_length']:.6g} {unit}, F/{found['f_number']:.3g}")
    for place in report["fields"]:
        before, after = (
            "rays lost" if value is None else f"{value * MICROMETRES[unit]:.3g} µm"
            for value in (place["rms_spot_at_start"], place["rms_spot"])
        )
        typer.echo(f"field {place['label']}: RMS spot {before} -> {after}")
    typer.echo(f"{', '.join(report['files'])} in {output}; `odak trace {output / 'lens.json'}` analyses the lens")


@app.command(
    help="Pass light through an optical bench that a TOML or JSON file describes: sources, apertures, lenses, "
    "modulators, propagations.\n\n"
    "Writes, for each record in the file, the field (NAME.npy) and its pictures (NAME.png), and report.json, which "
    "repeats the whole file with powers and peaks."
)
def simulate(
    config: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="TOML or JSON file of the bench.")] = None,
    output: Output = Path("bench"),
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of the file.")] = False,
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Simulate a bench; see :mod:`odak.cli.simulate`."""
    with _messages():
        from odak.cli import simulate as bench
        from odak.wave import bench_schema

        if schema:
            import json

            typer.echo(json.dumps(bench_schema(), indent=2))
            return
        if config is None:
            raise InputError("CONFIG is missing: the TOML or JSON file of a bench; --schema prints its schema")
        report = bench.run(config, output, _notices(again, quiet))
    if not quiet:
        for step in report["steps"]:
            share = "" if step["share_of_source"] is None else f"{step['share_of_source']:.4g} of the source's power"
            peak = f", peak {step['peak']:.4g} in {step['name']}.npy and .png" if step["kind"] == "record" else ""
            typer.echo(f"{step['kind']:<20}{share}{peak}")
        typer.echo(f"report.json in {output}")


@app.command(
    help="Calibrate an optical table by one step: exposure, settling, polarisation, phase, registration, wavefront, "
    "distance, illumination, regions, or all (phase to illumination).\n\n"
    "Instruments are named by the entry points of their drivers (screen, video, file-modulator, file-camera and those "
    "of installed packages); without names, a simulated table is calibrated, whose faults a seed draws. Writes "
    "calibration.h5 (HDF5 with units and uncertainties), which each step takes as known and adds to, STEP.png and "
    "report.json."
)
def calibrate(
    context: typer.Context,
    step: Annotated[str, typer.Argument(metavar="STEP", help="What to measure.")],
    output: Output = Path("calibration"),
    modulator: ModulatorName = "simulated",
    camera: CameraName = "simulated",
    polariser: Annotated[str | None, typer.Option(metavar="NAME", help="Driver of the polariser's mount.")] = None,
    option: InstrumentOptions = None,
    wavelength: TableWavelength = "532nm",
    distance: TableDistance = "20mm",
    lens: TableLens = None,
    seed: TableSeed = 0,
    faults: TableFaults = "some",
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="HDF5 file of the results (.h5); a .npz file of earlier versions is read.",
            show_default="calibration.h5 in the folder",
        ),
    ] = None,
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Calibrate a table; see :mod:`odak.cli.calibrate`."""
    with _messages():
        from odak.cli import calibrate as calibrating

        lengths = _lengths_of_table(wavelength, distance, lens, _given(context))
        names = {"modulator": modulator, "camera": camera, "polariser": polariser}
        twin = {**lengths, **calibrating.faults_of(step, _checked_faults(faults))}
        table = calibrating.open_table(names, option or (), seed, twin)
        report = calibrating.run(step, table, output, **lengths, results=results, notices=_notices(again, quiet))
    if not quiet:
        for name, value in report["found"].items():
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            typer.echo(f"{name}: {text} {report['units'][name]}")
        typer.echo(f"{report['figure']}, report.json in {output}; results in {report['results']}")


def _checked_faults(faults: str) -> str:
    if faults not in ("some", "all"):
        raise InputError(f"--faults must be some or all, got {faults!r}")
    return faults


def _lengths_of_table(wavelength: str, distance: str, lens: str | None, given: set[str]) -> dict[str, Any]:
    """Return the wavelength and the distance of a table in metres, or its lens; InputError for what is out of range."""
    lengths: dict[str, Any] = {}
    for name, text, largest in (("wavelength", wavelength, 1e-3), ("distance", distance, 10.0)):
        try:
            lengths[name] = parse_length(text)
        except ValueError as error:
            raise InputError(f"--{name}: {error}") from None
        if not 0 < lengths[name] <= largest:
            raise InputError(f"--{name} must be above 0 and at most {largest:g} metres, with a unit; got {text!r}")
    if lens is not None:
        from odak.cli.calibrate import parse_lens

        if "distance" in given:
            raise InputError("--distance has no effect with --lens, which has its distances in before= and after=")
        lengths["distance"] = parse_lens(lens)
    return lengths


@app.command(
    help="Show a pattern on the modulator, and capture what it forms on the camera.\n\n"
    "Instruments are chosen as in `odak calibrate`; without names, the simulated table of the seed. Writes "
    "capture_NAME.png (the capture beside its prediction by the calibration, and their difference), captures.h5 and "
    "report.json."
)
def capture(
    context: typer.Context,
    pattern: Annotated[
        Path, typer.Argument(metavar="PATTERN", help="Grey picture of the levels, or folder of `odak hologram`.")
    ],
    output: Output = Path("capture"),
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Results of `odak calibrate`, which the prediction takes its values from.",
            show_default="nominal values",
        ),
    ] = None,
    captures: Annotated[int, typer.Option(metavar="COUNT", help="Number of captures of each pattern.", min=1)] = 4,
    modulator: ModulatorName = "simulated",
    camera: CameraName = "simulated",
    option: InstrumentOptions = None,
    wavelength: TableWavelength = "532nm",
    distance: TableDistance = "20mm",
    lens: TableLens = None,
    seed: TableSeed = 0,
    faults: TableFaults = "some",
    quiet: Quiet = False,
    again: Again = False,
) -> None:
    """Capture patterns; see :mod:`odak.cli.capture`."""
    with _messages():
        from odak.cli import calibrate as calibrating
        from odak.cli import capture as capturing

        lengths = _lengths_of_table(wavelength, distance, lens, _given(context))
        twin = {**lengths, **calibrating.faults_of("capture", _checked_faults(faults))}
        table = calibrating.open_table({"modulator": modulator, "camera": camera}, option or (), seed, twin)
        there = (pattern, table, output, lengths["wavelength"], lengths["distance"])
        notices = _notices(again, quiet)
        report = capturing.run(*there, calibration=calibration, captures=captures, notices=notices)
    if not quiet:
        for result in report["patterns"]:
            noise = "" if result["noise_share"] is None else f", of which noise {result['noise_share']:.1%}"
            typer.echo(
                f"{result['figure']}: correlation with the prediction {result['correlation']:.4f}, error "
                f"{result['relative_error']:.1%}{noise}"
            )
        typer.echo(f"{report['captures']}, report.json in {output}")


@app.command(
    help="Open an interactive page of a result: a folder of any command, a picture, a field in .npy or .pt, or a "
    "lens.\n\n"
    "The page holds all it needs and uses no network."
)
def show(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="Folder, picture, .npy, .pt, .json, .zmx, .seq, .len or sample lens.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="HTML file to write.", show_default="one among the temporary files"),
    ] = None,
    browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
) -> None:
    """Show a result; see :func:`odak.cli.show.run`."""
    import tempfile

    with _messages():
        from odak.cli import show as pages

        page = output or Path(tempfile.mkdtemp(prefix="odak-show-")) / "page.html"
        pages.run(file, page.expanduser().absolute())
    typer.echo(str(page))
    if browser:
        typer.launch(str(page))


@app.command(help="Print versions, devices, threads and FFT libraries.")
def info() -> None:
    """Print versions and devices."""
    from odak.cli.report import describe_machine

    rows = describe_machine()
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        typer.echo(f"{name:<{width}}  {value}")


def _notices(again: bool, quiet: bool) -> "files.Notices":
    """Return what to do about results of earlier runs: kept and said so, or replaced after a question or a line."""
    from odak.cli import files

    def kept(folder: Path) -> None:
        if not quiet:
            typer.echo(f"{folder} already holds the result of this run; use --again to compute it again")

    def replaces(folder: Path, names: list[str]) -> None:
        text = f"{folder} holds {', '.join(names)} of another run"
        if again or quiet:
            return
        if not sys.stdin.isatty():
            typer.echo(f"odak: {text}, which will be replaced", err=True)
        elif not typer.confirm(f"{text}. Replace?"):
            raise InputError("nothing was computed; --output names another folder")

    return files.Notices(again, kept, replaces)


@contextmanager
def _messages() -> Iterator[None]:
    """Print warnings as one line each, and turn errors into one line and an exit code."""
    try:
        from odak.cli.report import collected_warnings

        with collected_warnings(lambda text: typer.echo(f"odak: warning: {text}", err=True)):
            yield
    except InputError as error:
        raise typer.Exit(_fail(str(error), BAD_INPUT)) from None
    except (OSError, FloatingPointError) as error:
        raise typer.Exit(_fail(str(error) or type(error).__name__, FAILURE)) from None
    except (MemoryError, RuntimeError) as error:
        # PyTorch has an exception of its own for the memory of a GPU; the processor's memory is named in the text.
        lacking = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
        if not lacking and "DefaultCPUAllocator" not in str(error):
            raise
        text = "not enough memory for this size; use fewer pixels (odak hologram: a smaller --resolution, or --tiles)"
        raise typer.Exit(_fail(text, FAILURE)) from None


def _given(context: typer.Context) -> set[str]:
    """Return the names of the parameters that are given on the command line."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"}


def _many(images: list[str], values: dict, spread: dict, watch: bool) -> int:
    """Compute many pictures, print the outcome of each that failed and their numbers, and return the exit code."""
    from odak.cli.cluster import run, watched

    code = 0
    notices = _notices(spread["again"], values["quiet"])
    for summary in watched(images, values, spread) if watch else [run(images, values, **spread, notices=notices)]:
        for name, reason in summary["failed"].items():
            _fail(f"{name}: {reason}", FAILURE)
        if not values["quiet"]:
            counts = ", ".join(f"{len(summary[what])} {what}" for what in ("computed", "skipped", "failed"))
            workers = f"{summary['workers']} worker{'s' * (summary['workers'] != 1)}"
            typer.echo(f"{counts} in {summary['seconds']:.1f} s by {workers}; one folder each in {values['output']}")
        code = FAILURE if summary["failed"] else code
    return code


def _summarise(job: Job, report: dict) -> None:
    psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
    ssim = "" if report["ssim"] is None else f"SSIM {report['ssim']:.4f}, "
    typer.echo(f"PSNR {psnr}, {ssim}efficiency {report['efficiency']:.1%} (saved patterns)")
    if report["seconds_per_iteration"] is not None:
        typer.echo(f"{report['seconds_per_iteration']:.3g} s per iteration on {report['device']}")
    others = [*(["focal_stack.png"] if job.planes > 1 else []), "report.json"]
    if ssim:
        others = ["reconstruction.png", "comparison.png", *others]
    typer.echo(f"{', '.join([*report['pattern']['files'], *others])} in {job.output}")
    if ssim:
        typer.echo(
            f"{job.output / 'comparison.png'} shows the picture, the image that the saved pattern forms "
            f"{job.distance:g} m behind the modulator (computed), their difference and the pattern"
        )


def _usage_of(error: Exception) -> str:
    """Return how an option of two values is written, or where a missing argument is explained, in such an error."""
    found = getattr(error, "param", None)
    name, context = getattr(error, "option_name", None), getattr(error, "ctx", None)
    if type(error).__name__ == "MissingParameter" and context is not None:
        return f" `{context.command_path} --help` explains it."
    if found is None and name and context is not None:
        found = next((item for item in context.command.params if name in item.opts), None)
    if found is None or found.nargs != 2:
        return ""
    return f" Give two values: {found.opts[0]} {found.metavar}, with a space between."


def _fail(message: str, code: int) -> int:
    """Print in one line on stderr what is wrong, and return the exit code."""
    typer.echo("odak: " + " ".join(message.split()), err=True)
    return code
