"""Options and arguments of the commands, with their help and their completion in shells."""

from pathlib import Path
from typing import Annotated

import typer

from odak.cli.job import (
    COLOUR_WAVELENGTHS,
    GREY_WAVELENGTH,
    INITIAL_PHASES,
    METHODS,
    PRESETS,
    SHIPPED_IMAGES,
    parse_length,
)

LENGTH = "LENGTH"


def length(text: str | float) -> float:
    """Parse a length; typer wants its own kind of error."""
    try:
        return parse_length(text)
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
        help="Picture file, folder of them, or the name of a shipped picture: "
        + ", ".join(sorted(SHIPPED_IMAGES))
        + ". Its stored "
        "values, 0 to 1, are taken as the intensity, without undoing any display gamma. It is resized to the "
        "largest size that fits the resolution, black around it.",
        show_default="photo",
    ),
]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; made if need be.")]
Wavelengths = Annotated[
    list[float] | None,
    typer.Option(
        "--wavelength",
        "-w",
        parser=length,
        metavar=LENGTH,
        help="Wavelength, in metres or with a unit (532nm); give it three times for red, green and blue. Given once, "
        "or with --grey, a colour "
        "picture becomes one hologram of its brightness.",
        show_default=f"{GREY_WAVELENGTH * 1e9:g}nm; colour pictures: {_COLOURS}",
    ),
]
Grey = Annotated[bool, typer.Option("--grey", help="Make one hologram of a colour picture's brightness.")]
PixelPitch = Annotated[
    float,
    typer.Option(
        parser=length,
        metavar=LENGTH,
        help="Pixel pitch of the modulator, in metres or with a unit (8um).",
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
        help="Take pixel pitch, resolution and bits of a modulator that is sold, where these are not given: "
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
        help="Read, compute and judge in chunks on disk, for pictures larger than memory: TIFF, .npy and Zarr, one "
        "pixel of the modulator for each of theirs unless --resolution is given. An interrupted run goes on. With "
        "--cluster local, worker processes write to disk what does not fit in memory.",
    ),
]
Planes = Annotated[int, typer.Option(metavar="COUNT", help="Planes that the picture is spread over, by its depth map.")]
DepthMap = Annotated[
    str | None,
    typer.Option(
        metavar="PICTURE",
        help="Grey picture of the depth: 0 (black) is the first plane, nearest to the modulator, 1 the last.",
        show_default="its own for the shipped picture 'scene'",
    ),
]
VolumeDepth = Annotated[
    float,
    typer.Option(
        parser=length,
        metavar=LENGTH,
        help="Distance from the first plane to the last, about --distance.",
        show_default="4mm",
    ),
]
Frames = Annotated[
    int | None,
    typer.Option(
        metavar="COUNT",
        help="Patterns shown one after another, faster than the eye: for each colour (sgd), for all (multi-color).",
        show_default="sgd: 1; multi-color: one for each colour",
    ),
]
Method = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(METHODS),
        autocompletion=_complete(METHODS),
        help="sgd: gradient descent; gs: Gerchberg-Saxton; double-phase: no iterations, verified through the half-band "
        "Fourier filter that such holograms need; network: one pass of a trained network, where light spreads to 5 to "
        "75 pixels; multiplane: one pattern for each colour, all planes together; multi-color: patterns that are "
        "each lit by all colours, at powers that are found too.",
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
    int, typer.Option(metavar="COUNT", help="Number of iterations (all but double-phase and network).")
]
LearningRate = Annotated[
    float, typer.Option(metavar="RADIANS", help="Step size in radians (sgd, multiplane, multi-color).")
]
Scale = Annotated[
    bool,
    typer.Option(
        help="Leave the picture's brightness free (methods with a step size) rather than ask for the stored values as "
        "they are: 10 dB better on the shipped photo, as less light has to be thrown away."
    ),
]
InitialPhase = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(INITIAL_PHASES),
        autocompletion=_complete(INITIAL_PHASES),
        help="Phase to start from: zero, normal noise of 0.3 rad, a lens of twice the distance, normal noise of 1 rad, "
        "noise uniform over 2 pi. Of the hologram; with the method double-phase, of the picture. With sgd also the "
        "double phase of the picture, or 20 iterations of Gerchberg-Saxton (gs).",
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
        metavar="SHARE",
        help="Share of the area of a square pixel that emits. The holograms are computed for such pixels behind a stop "
        "that passes one order, and pictures and report are means over the areas of pixels.",
        show_default="pixels are points, and pictures their middles",
    ),
]
Device = Annotated[str, typer.Option(help="auto (the GPU where there is one), cpu, cuda, cuda:1, ...")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress and no summary; warnings and errors still go to stderr.")
]

# --- Clusters
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="local|ADDRESS",
        help="Compute the pictures on worker processes of this machine (local), or on those of a Dask scheduler, such "
        "as tls://10.0.0.1:8786. Each picture gets a folder of its own name in the output folder.",
        show_default="one picture after another in this process",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(metavar="COUNT", help="Worker processes.", show_default="one per GPU; without, one per core"),
]
Retries = Annotated[int, typer.Option(metavar="COUNT", help="How often a picture that failed is tried again.")]
Again = Annotated[
    bool,
    typer.Option("--again", help="Compute also what is there already, and replace other results without a question."),
]
Address = Annotated[str, typer.Argument(metavar="ADDRESS", help="Address of a scheduler, such as tls://10.0.0.1:8786.")]
Threads = Annotated[
    int | None, typer.Option(metavar="COUNT", help="Threads of each worker.", show_default="the cores shared evenly")
]
MemoryLimit = Annotated[
    float | None,
    typer.Option(
        metavar="GIB",
        help="Memory that a worker may take before it is started anew.",
        show_default="the memory shared evenly",
    ),
]
Name = Annotated[str | None, typer.Option(metavar="NAME", help="Name of the workers; a number is added to it.")]
Timeout = Annotated[float, typer.Option(metavar="SECONDS", help="How long to wait for scheduler and workers.")]
CaFile = Annotated[str | None, typer.Option("--tls-ca-file", metavar="FILE", help="Certificate of the authority.")]
Cert = Annotated[str | None, typer.Option("--tls-cert", metavar="FILE", help="This machine's certificate.")]
Key = Annotated[str | None, typer.Option("--tls-key", metavar="FILE", help="Key of this machine's certificate.")]
TrustedNetwork = Annotated[
    bool,
    typer.Option(
        "--trusted-network",
        help="Accept plain TCP beyond this machine: everybody on that network can then run code here.",
    ),
]

# --- Metamers
MetamerImage = Annotated[
    str,
    typer.Argument(
        metavar="[IMAGE]",
        help="Picture file, or the name of a shipped picture: " + ", ".join(sorted(SHIPPED_IMAGES)) + ".",
    ),
]
Gaze = Annotated[
    tuple[float, float],
    typer.Option(metavar="X Y", help="Point of gaze: 0 to 1 from the left and from the top; may lie outside."),
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
Levels = Annotated[int, typer.Option(metavar="COUNT", help="Levels of the pyramid, 2 or more.")]
Orientations = Annotated[int, typer.Option(metavar="COUNT", help="Orientations of the pyramid's bands, 1 or more.")]
Refinements = Annotated[
    int,
    typer.Option(
        metavar="COUNT", help="Evaluations of the metameric loss by which the metamer is made; 0 for matched noise."
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
