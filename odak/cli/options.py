"""The options of `odak hologram`, with their help."""

from pathlib import Path
from typing import Annotated

import typer

from odak.cli.job import COLOUR_WAVELENGTHS, GREY_WAVELENGTH, INITIAL_PHASES, METHODS, SHIPPED_IMAGES

_COLOURS = ", ".join(f"{value:g}" for value in COLOUR_WAVELENGTHS)

Images = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[IMAGE]...",
        help="Picture file, folder of them, or the name of a shipped picture: "
        + ", ".join(sorted(SHIPPED_IMAGES))
        + ". Its stored "
        "values, 0 to 1, are taken as the intensity to show, without undoing any display gamma. It is resized to the "
        "largest size that fits the resolution, black around it.",
        show_default="photo",
    ),
]
Output = Annotated[Path, typer.Option(help="Folder to write to; made if need be.")]
Wavelengths = Annotated[
    list[float] | None,
    typer.Option(
        "--wavelength",
        metavar="METRES",
        help="Wavelength in metres; give it three times for red, green and blue. Given once, or with --grey, a colour "
        "picture becomes one hologram of its brightness.",
        show_default=f"{GREY_WAVELENGTH:g}; colour pictures: {_COLOURS}",
    ),
]
Grey = Annotated[bool, typer.Option("--grey", help="Make one hologram of a colour picture's brightness.")]
PixelPitch = Annotated[float, typer.Option(metavar="METRES", help="Pixel pitch of the modulator in metres.")]
Resolution = Annotated[
    tuple[int, int], typer.Option(metavar="ROWS COLUMNS", help="Resolution of the modulator in pixels.")
]
Distance = Annotated[float, typer.Option(metavar="METRES", help="Distance from modulator to picture in metres.")]
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
    float, typer.Option(metavar="METRES", help="Distance from the first plane to the last, about --distance.")
]
Frames = Annotated[
    int | None,
    typer.Option(
        metavar="COUNT",
        help="Patterns shown one after another (multi-color).",
        show_default="one for each colour",
    ),
]
Method = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(METHODS),
        help="sgd: gradient descent; gs: Gerchberg-Saxton; double-phase: no iterations, verified through the half-band "
        "Fourier filter that such holograms need; multiplane: one pattern for each colour, all planes together; "
        "multi-color: patterns that are each lit by all colours, at powers that are found too.",
        show_default="sgd; multiplane for more than one plane",
    ),
]
PropagationType = Annotated[
    str, typer.Option(metavar="NAME", help="How light is propagated while the hologram is computed, or 'auto'.")
]
Iterations = Annotated[int, typer.Option(metavar="COUNT", help="Number of iterations (all but double-phase).")]
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
        help="Phase to start from: zero, normal noise of 0.3 rad, a lens of twice the distance, normal noise of 1 rad, "
        "noise uniform over 2 pi. Of the hologram; with double-phase, of the picture.",
        show_default="flat with sgd and double-phase, uniform with gs, otherwise slight",
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the random initial phases.")]
Grating = Annotated[
    bool, typer.Option(help="Add a binary grating (pi on every second column) to the pattern that is saved.")
]
Bits = Annotated[int, typer.Option(help="Bits per pixel of the modulator, 1 to 16; above 8 the file is a 16-bit PNG.")]
Device = Annotated[str, typer.Option(help="auto (the GPU where there is one), cpu, cuda, cuda:1, ...")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress and no summary; warnings and errors still go to stderr.")
]
