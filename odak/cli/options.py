"""Options and arguments of the commands, with their help and their completion in shells."""

from pathlib import Path
from typing import Annotated, Any

import typer

from odak.cli.job import (
    COLOUR_WAVELENGTHS,
    GREY_WAVELENGTH,
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
        help="Pixel pitch of the modulator, in metres or with a unit (8um); two of them, with a comma, where that of "
        "rows differs from that of columns (8um,6.4um).",
        show_default="8um",
    ),
]
Resolution = Annotated[
    tuple[int, int], typer.Option(metavar="ROWS COLUMNS", help="Resolution of the modulator in pixels.")
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
        "pixels and an aperture that passes one diffraction order; images and report are averages over pixel areas.",
        show_default="pixels are points, and images are sampled at points",
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
        help="Compute the pictures on worker processes of this machine (local), or on those of a Dask scheduler, such "
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
    int, typer.Option(metavar="COUNT", help="Number of orientations of the pyramid's bands, 1 or more.")
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
