"""The options of `odak metamer`, with their help."""

from pathlib import Path
from typing import Annotated

import typer

from odak.cli.job import SHIPPED_IMAGES

Image = Annotated[
    str,
    typer.Argument(
        metavar="[IMAGE]",
        help="Picture file, or the name of a shipped picture: " + ", ".join(sorted(SHIPPED_IMAGES)) + ".",
    ),
]
Output = Annotated[Path, typer.Option(help="Folder to write to; made if need be.")]
Gaze = Annotated[
    tuple[float, float],
    typer.Option(metavar="X Y", help="Where the eye looks: 0 to 1 from the left and from the top; may lie outside."),
]
Width = Annotated[float, typer.Option(metavar="LENGTH", help="Width of the picture as shown, in metres.")]
Distance = Annotated[float, typer.Option(metavar="LENGTH", help="Distance of the eye from the picture, in metres.")]
Alpha = Annotated[float, typer.Option(metavar="RATIO", help="Growth of the eye's pooling regions with eccentricity.")]
Mode = Annotated[
    str,
    typer.Option(metavar="quadratic|linear", help="How pooling regions grow with eccentricity in radians."),
]
Levels = Annotated[int, typer.Option(metavar="COUNT", help="Levels of the pyramid, 2 or more.")]
Orientations = Annotated[int, typer.Option(metavar="COUNT", help="Orientations of the pyramid's bands, 1 or more.")]
Iterations = Annotated[
    int,
    typer.Option(
        metavar="COUNT", help="Steps of gradient descent on the metameric loss after the noise is matched; 0 for none."
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the noise.")]
Device = Annotated[str, typer.Option(help="auto (the GPU where there is one), cpu, cuda, cuda:1, ...")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress and no summary; warnings and errors still go to stderr.")
]
