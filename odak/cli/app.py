"""The commands, and what they say and return when something is wrong.

Exit codes: 0 all is well, 1 unexpected failure, 2 the command line or what it names will not do.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from odak.cli import cluster_options, metamer_options, options
from odak.cli.errors import InputError
from odak.cli.job import Job

BAD_INPUT, FAILURE = 2, 1

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after the program's name; those of the process by default.

    Returns
    -------
    int
        Exit code: 0 all is well, 1 unexpected failure, 2 bad command line or input.
    """
    if arguments is not None:
        if isinstance(arguments, str) or not isinstance(arguments, Sequence):
            raise TypeError(f"arguments must be a sequence of strings, got {arguments!r:.80}")
        arguments = list(arguments)
    command = typer.main.get_command(app)
    try:
        code = command.main(args=arguments, prog_name="odak", standalone_mode=False)
    except typer.Abort:
        return _fail("interrupted", FAILURE)
    except Exception as error:
        # typer carries its own copy of click in some releases and not in others: errors of either have this method.
        if not hasattr(error, "format_message"):
            raise
        return _fail(error.format_message(), BAD_INPUT)
    return code if isinstance(code, int) else 0


@app.callback(invoke_without_command=True)
def _start(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
) -> None:
    """Optics: wave optics and computer-generated holography."""
    if version:
        from odak import __version__

        typer.echo(__version__)
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command(
    help="Compute phase-only holograms of a picture, save them as PNG, and report how well the saved files show it.\n\n"
    "Writes hologram_<nm>nm.png (one per wavelength; phase = grey * 2 pi / 256, or / 65536 for 16-bit files) or, with "
    "multi-color, hologram_frame<k>.png; reconstruction.png, comparison.png and report.json; with planes also "
    "focal_stack.png.\n\n"
    "Several pictures, or folders of them, are computed one after another or, with --cluster, side by side. Each gets "
    "a folder of its name in the output folder, and what is there already from the same options is skipped."
)
def hologram(
    images: options.Images = None,
    output: options.Output = Job.output,
    wavelength: options.Wavelengths = None,
    grey: options.Grey = Job.grey,
    pixel_pitch: options.PixelPitch = Job.pixel_pitch,
    resolution: options.Resolution = Job.resolution,
    distance: options.Distance = Job.distance,
    planes: options.Planes = Job.planes,
    depth_map: options.DepthMap = Job.depth_map,
    volume_depth: options.VolumeDepth = Job.volume_depth,
    frames: options.Frames = Job.frames,
    method: options.Method = Job.method,
    propagation_type: options.PropagationType = Job.propagation_type,
    iterations: options.Iterations = Job.iterations,
    learning_rate: options.LearningRate = Job.learning_rate,
    scale: options.Scale = Job.scale,
    initial_phase: options.InitialPhase = Job.initial_phase,
    seed: options.Seed = Job.seed,
    grating: options.Grating = Job.grating,
    bits: options.Bits = Job.bits,
    device: options.Device = Job.device,
    quiet: options.Quiet = Job.quiet,
    cluster: cluster_options.Cluster = None,
    workers: cluster_options.Workers = None,
    retries: cluster_options.Retries = 1,
    again: cluster_options.Again = False,
    timeout: cluster_options.Timeout = 60.0,
) -> None:
    """Compute the holograms of pictures; the parameters are those of :class:`odak.cli.job.Job`."""
    values = dict(locals())
    images = values.pop("images") or [Job.image]
    spread = {name: values.pop(name) for name in ("cluster", "workers", "retries", "again", "timeout")}
    values["wavelengths"] = tuple(values.pop("wavelength") or ())
    if cluster is not None or len(images) > 1 or os.path.isdir(os.path.expanduser(images[0])):
        raise typer.Exit(_many(images, values, spread))
    try:
        job = Job(**values, image=images[0])
        from odak.cli.run import run

        report = run(job)
    except InputError as error:
        raise typer.Exit(_fail(str(error), BAD_INPUT)) from None
    except (OSError, FloatingPointError) as error:
        raise typer.Exit(_fail(str(error), FAILURE)) from None
    if not quiet:
        _summarise(job, report)


@app.command(
    help="Let this machine's cores and GPUs work for a Dask scheduler: one worker per GPU, or one per core where there "
    "is none, until the scheduler ends or Ctrl-C.\n\n"
    "Whoever reaches the scheduler runs code on this machine. Join only one that machines you trust can reach, or use "
    "certificates. A scheduler is started with `dask scheduler --host ADDRESS`."
)
def worker(
    address: cluster_options.Address,
    workers: cluster_options.Workers = None,
    threads: cluster_options.Threads = None,
    memory_limit: cluster_options.MemoryLimit = None,
    name: cluster_options.Name = None,
    timeout: cluster_options.Timeout = 60.0,
    tls_ca_file: cluster_options.CaFile = None,
    tls_cert: cluster_options.Cert = None,
    tls_key: cluster_options.Key = None,
    quiet: options.Quiet = False,
) -> None:
    """Join a cluster; see :mod:`odak.cli.worker`."""
    try:
        from odak.cli.worker import Certificates, run, share

        divided = share(workers, threads, memory_limit, name)
        run(address, divided, Certificates(tls_ca_file, tls_cert, tls_key), timeout, _silent if quiet else typer.echo)
    except InputError as error:
        raise typer.Exit(_fail(str(error), BAD_INPUT)) from None
    except OSError as error:
        raise typer.Exit(_fail(str(error) or type(error).__name__, FAILURE)) from None


@app.command(
    help="Make a picture that looks the same as another to an eye that looks at one place of it.\n\n"
    "Away from the gaze it is noise with the picture's local statistics. Writes metamer.png, pooling_map.png (how wide "
    "the regions are that the eye pools, on a scale of doublings) and comparison.png."
)
def metamer(
    image: metamer_options.Image = "photo",
    output: metamer_options.Output = Path("output"),
    gaze: metamer_options.Gaze = (0.5, 0.5),
    width: metamer_options.Width = 0.6,
    distance: metamer_options.Distance = 0.7,
    alpha: metamer_options.Alpha = 0.2,
    mode: metamer_options.Mode = "quadratic",
    levels: metamer_options.Levels = 5,
    orientations: metamer_options.Orientations = 2,
    iterations: metamer_options.Iterations = 0,
    seed: metamer_options.Seed = 0,
    device: metamer_options.Device = "auto",
    quiet: metamer_options.Quiet = False,
) -> None:
    """Make a metamer; the parameters are those of :class:`odak.cli.metamer.MetamerJob`."""
    values = dict(locals())
    try:
        from odak.cli.metamer import MetamerJob, run

        report = run(MetamerJob(**values))
    except InputError as error:
        raise typer.Exit(_fail(str(error), BAD_INPUT)) from None
    except OSError as error:
        raise typer.Exit(_fail(str(error), FAILURE)) from None
    if not quiet:
        psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
        typer.echo(
            f"PSNR {psnr}, metameric loss {report['loss']:.3g}, pooling up to {report['largest_pooling']:.3g} px"
        )
        typer.echo(f"metamer.png, pooling_map.png, comparison.png in {output}")


@app.command(
    help="Trace rays through a lens: a sample (singlet, cooke_triplet, double_gauss), a .json file written by odak, or "
    "a Zemax .zmx file.\n\n"
    "Writes layout.png, spots.png and report.json with first-order properties, spot sizes and what became of the rays."
)
def trace(
    system: Annotated[str, typer.Argument(metavar="SYSTEM", help="Name of a sample, or a .json or .zmx file.")],
    output: options.Output = Path("trace"),
    rings: Annotated[int, typer.Option(metavar="COUNT", help="Rings of rays in the pupil, 1 to 100.")] = 6,
    aim: Annotated[str, typer.Option(metavar="paraxial|real", help="Which pupil rays are aimed at.")] = "paraxial",
    quiet: options.Quiet = False,
) -> None:
    """Trace a system; see :mod:`odak.cli.trace`."""
    try:
        from odak.cli.trace import run

        report = run(system, output, rings, aim)
    except InputError as error:
        raise typer.Exit(_fail(str(error), BAD_INPUT)) from None
    except OSError as error:
        raise typer.Exit(_fail(str(error), FAILURE)) from None
    if quiet:
        return
    unit, found = report["system"]["unit"], report["first_order"]
    typer.echo(f"focal length {found['focal_length']:.6g} {unit}, F/{found['f_number']:.3g}")
    for field in report["fields"]:
        spot = "no rays" if field["rms_spot"] is None else f"RMS spot {field['rms_spot']:.3g} {unit}"
        typer.echo(f"field {field['field'][0]:g}, {field['field'][1]:g}: {spot}")
    for line in report["ignored"]:
        typer.echo(f"ignored: {line}", err=True)
    typer.echo(f"layout.png, spots.png, report.json in {output}")


@app.command(help="Print versions, devices, threads and FFT libraries.")
def info() -> None:
    """Print what odak runs on."""
    from odak.cli.info import describe

    rows = describe()
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        typer.echo(f"{name:<{width}}  {value}")


def _many(images: list[str], values: dict, spread: dict) -> int:
    """Compute many pictures, say what became of them, and return the exit code."""
    try:
        from odak.cli.cluster import run

        summary = run(images, values, **spread)
    except InputError as error:
        return _fail(str(error), BAD_INPUT)
    except OSError as error:
        return _fail(str(error), FAILURE)
    for name, reason in summary["failed"].items():
        _fail(f"{name}: {reason}", FAILURE)
    if not values["quiet"]:
        counts = ", ".join(f"{len(summary[what])} {what}" for what in ("computed", "skipped", "failed"))
        workers = f"{summary['workers']} worker{'s' * (summary['workers'] != 1)}"
        typer.echo(f"{counts} in {summary['seconds']:.1f} s by {workers}; one folder each in {values['output']}")
    return FAILURE if summary["failed"] else 0


def _silent(_: str) -> None:
    pass


def _summarise(job: Job, report: dict) -> None:
    psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
    typer.echo(f"PSNR {psnr}, SSIM {report['ssim']:.4f}, efficiency {report['efficiency']:.1%} (saved patterns)")
    if report["seconds_per_iteration"] is not None:
        typer.echo(f"{report['seconds_per_iteration']:.3g} s per iteration on {report['device']}")
    others = ["comparison.png", *(["focal_stack.png"] if job.planes > 1 else []), "report.json"]
    typer.echo(f"{', '.join([*report['pattern']['files'], *others])} in {job.output}")


def _fail(message: str, code: int) -> int:
    """Say in one line on stderr what is wrong, and return the exit code."""
    typer.echo("odak: " + " ".join(message.split()), err=True)
    return code
