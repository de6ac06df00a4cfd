"""The options of `odak worker`, and those of `odak hologram` for many pictures, with their help."""

from typing import Annotated

import typer

Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="local|ADDRESS",
        help="Compute the pictures on worker processes of this machine (local), or on those of a Dask scheduler, such "
        "as tcp://10.0.0.1:8786. Each picture gets a folder of its own name in the output folder.",
        show_default="one picture after another in this process",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(metavar="COUNT", help="Worker processes.", show_default="one per GPU; without, one per core"),
]
Retries = Annotated[int, typer.Option(metavar="COUNT", help="How often a picture that failed is tried again.")]
Again = Annotated[
    bool, typer.Option("--again", help="Compute also what is there already from a run with these options.")
]
Address = Annotated[str, typer.Argument(metavar="ADDRESS", help="Address of a scheduler, such as tcp://10.0.0.1:8786.")]
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
