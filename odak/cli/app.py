"""Commands of the command line, their messages and their exit codes.

Exit codes: 0 success, 1 unexpected failure, 2 the command line or a file that it names cannot be used, 130 interrupted
by Ctrl-C.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from odak.cli import options
from odak.cli.job import GREY_WAVELENGTH, InputError, Job, find_preset

if TYPE_CHECKING:
    from odak.cli import files

BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after the program's name; those of the process by default.

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
    command = typer.main.get_command(app)
    try:
        code = command.main(args=arguments, prog_name="odak", standalone_mode=False)
    except typer.Abort:
        return _fail("interrupted", INTERRUPTED)
    except Exception as error:
        # typer carries its own copy of click in some releases and not in others: errors of either have this method.
        if not hasattr(error, "format_message"):
            raise
        return _fail(error.format_message() + _usage_of(error), BAD_INPUT)
    if code == INTERRUPTED:
        # Releases of typer differ: some return this code where others raise Abort.
        return _fail("interrupted", INTERRUPTED)
    return code if isinstance(code, int) else 0


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
    "are kept; those of other options are listed before they are replaced."
)
def hologram(
    context: typer.Context,
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
    optimizer: options.Optimizer = Job.optimizer,
    scale: options.Scale = Job.scale,
    initial_phase: options.InitialPhase = Job.initial_phase,
    seed: options.Seed = Job.seed,
    grating: options.Grating = Job.grating,
    bits: options.Bits = Job.bits,
    fill_factor: options.FillFactor = Job.fill_factor,
    preset: options.Preset = Job.preset,
    device: options.Device = Job.device,
    quiet: options.Quiet = Job.quiet,
    again: options.Again = False,
    watch: options.Watch = False,
    tiles: options.Tiles = Job.tiles,
    cluster: options.Cluster = None,
    workers: options.Workers = None,
    retries: options.Retries = 1,
    timeout: options.Timeout = 60.0,
    tls_ca_file: options.CaFile = None,
    tls_cert: options.Cert = None,
    tls_key: options.Key = None,
    trusted_network: options.TrustedNetwork = False,
) -> None:
    """Compute the holograms of pictures; the parameters are those of :class:`odak.cli.job.Job`."""
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
    address: options.Address,
    workers: options.Workers = None,
    threads: options.Threads = None,
    memory_limit: options.MemoryLimit = None,
    name: options.Name = None,
    timeout: options.Timeout = 60.0,
    tls_ca_file: options.CaFile = None,
    tls_cert: options.Cert = None,
    tls_key: options.Key = None,
    trusted_network: options.TrustedNetwork = False,
    quiet: options.Quiet = False,
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
    "Away from the gaze its details are displaced; its local statistics are those of the picture. Writes metamer.png, "
    "pooling_map.png (the width of the pooling regions of the eye, on a logarithmic scale), comparison.png and "
    "report.json."
)
def metamer(
    image: options.MetamerImage = "photo",
    output: options.Output = Path("metamer"),
    gaze: options.Gaze = (0.5, 0.5),
    width: options.Width = 0.6,
    distance: options.ViewingDistance = 0.7,
    alpha: options.Alpha = 0.2,
    mode: options.PoolingMode = "quadratic",
    levels: options.Levels = 5,
    orientations: options.Orientations = 2,
    iterations: options.Refinements = 40,
    joint: options.Joint = False,
    nominal_width: options.NominalWidth = False,
    seed: options.NoiseSeed = 0,
    device: options.Device = "auto",
    quiet: options.Quiet = False,
    again: options.Again = False,
) -> None:
    """Make a metamer; the parameters are those of :class:`odak.cli.metamer.MetamerJob`."""
    values = dict(locals())
    notices = _notices(values.pop("again"), quiet)
    with _messages():
        from odak.cli.metamer import MetamerJob, run

        report = run(MetamerJob(**values), notices)
    if not quiet:
        psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
        typer.echo(
            f"PSNR {psnr}, metameric loss {report['loss']:.3g}, that of white noise of the same PSNR "
            f"{report['noise_loss']:.3g}, largest pooling region {report['largest_pooling']:.3g} px"
        )
        typer.echo(f"metamer.png, pooling_map.png, comparison.png, report.json in {output}")


@app.command(
    help="Compute a hologram that shows an eye its picture at several places of the pupil.\n\n"
    "Several pictures, one for each place in reading order, give parallax. Writes a pattern for each frame, views.png "
    "with what an eye sees from each place, by exact propagation of the saved patterns, and report.json."
)
def eyebox(
    images: options.EyeboxImages = None,
    output: options.Output = Path("eyebox"),
    wavelength: options.OneWavelength = GREY_WAVELENGTH,
    pixel_pitch: options.PixelPitch = 8e-6,
    distance: options.PupilDistance = 0.1,
    resolution: options.Resolution = (512, 512),
    places: options.Places = (1, 3),
    spacing: options.Spacing = 2e-3,
    pupil: options.Pupil = 2e-3,
    frames: options.EyeboxFrames = 2,
    iterations: options.Iterations = 60,
    learning_rate: options.LearningRate = 0.2,
    seed: options.Seed = 0,
    bits: options.Bits = 8,
    device: options.Device = "auto",
    quiet: options.Quiet = False,
    again: options.Again = False,
) -> None:
    """Compute a hologram for an eyebox; the parameters are those of :class:`odak.cli.eyebox_views.EyeboxJob`."""
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
    "triplet_f28), a .json file written by odak, or a Zemax .zmx file.\n\n"
    "Writes figures of all analyses (layout, spots, fans, transfer, through focus, wavefront, field, image, footprint, "
    "polarisation, Seidel coefficients), report.html with all of them, the prescription and the "
    "aberrations, and report.json with first-order properties, spot sizes and the number of rays that were lost."
)
def trace(
    system: Annotated[str, typer.Argument(metavar="SYSTEM", help="Name of a sample, or a .json or .zmx file.")],
    output: options.Output = Path("trace"),
    rings: Annotated[int, typer.Option(metavar="COUNT", help="Number of rings of rays in the pupil, 1 to 100.")] = 6,
    aim: Annotated[
        str,
        typer.Option(metavar="paraxial|real", help="Pupil that the rays are aimed at: the paraxial or the real one."),
    ] = "paraxial",
    glasses: options.Glasses = None,
    figures: Annotated[str, typer.Option(metavar="png|svg|pdf", help="File format of the figures.")] = "png",
    quiet: options.Quiet = False,
    again: options.Again = False,
) -> None:
    """Trace a system; see :mod:`odak.cli.trace`."""
    with _messages():
        from odak.cli.trace import run

        report = run(system, output, rings, aim, glasses or (), figures, _notices(again, quiet))
    if quiet:
        return
    unit, found = report["system"]["unit"], report["first_order"]
    if found["focal_length"] is None:
        typer.echo("afocal: no focal length")
    else:
        typer.echo(f"focal length {found['focal_length']:.6g} {unit}, F/{found['f_number']:.3g}")
    for field in report["fields"]:
        spot = "no rays" if field["rms_spot"] is None else f"RMS spot {field['rms_spot']:.3g} {unit}"
        typer.echo(f"field {field['field'][0]:g}, {field['field'][1]:g}: {spot}")
    for line in report["ignored"]:
        typer.echo(f"ignored: {line}", err=True)
    typer.echo(f"{', '.join(report['figures'])}, report.html, report.json in {output}")


@app.command(
    help="Design a lens: improve one that is there (a sample, a .json or a .zmx file) or, without one, make one from "
    "flat plates for --focal-length, --f-number, --field and --elements.\n\n"
    "Curvatures, thicknesses, the focus and what aspheres there are vary, so that the spots of all fields become small "
    "under limits of distortion, edges and lengths; focal length, f-number and field are those asked for, or those of "
    "the SYSTEM. Writes lens.json, layout.png and report.json. The same seed gives the same lens."
)
def design(
    system: Annotated[
        str | None, typer.Argument(metavar="[SYSTEM]", help="Name of a sample, or a .json or .zmx file.")
    ] = None,
    output: options.Output = Path("design"),
    focal_length: options.FocalLength = None,
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
    track: options.Track = None,
    back: options.Back = None,
    distortion: Annotated[
        float | None,
        typer.Option(metavar="RATIO", help="Largest distortion.", show_default="0.02, or that of the SYSTEM if larger"),
    ] = None,
    chief_ray_angle: Annotated[
        float | None, typer.Option(metavar="DEGREES", help="Largest angle of chief rays in the image.")
    ] = None,
    aim: Annotated[
        str, typer.Option(metavar="paraxial|real", help="Pupil that rays are aimed at; the real one with a SYSTEM.")
    ] = "paraxial",
    starts: Annotated[
        int | None, typer.Option(metavar="COUNT", help="Random starts.", show_default="16; with a SYSTEM 1")
    ] = None,
    iterations: Annotated[
        int | None, typer.Option(metavar="COUNT", help="Steps of each run.", show_default="15; with a SYSTEM 40")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="NUMBER", help="Seed of the random starts.")] = 0,
    glasses: options.Glasses = None,
    substitute: Annotated[
        str | None,
        typer.Option(metavar="MAKERS", help="Vary the glasses, then take the nearest of these makers: schott,ohara."),
    ] = None,
    zmx: Annotated[bool, typer.Option("--zmx", help="Write lens.zmx, a Zemax file, too.")] = False,
    quiet: options.Quiet = False,
    again: options.Again = False,
) -> None:
    """Design a lens; the parameters are those of :class:`odak.cli.lens_design.DesignJob`."""
    values = dict(locals()) | {"glasses": glasses or ()}
    notices = _notices(values.pop("again"), quiet)
    with _messages():
        from odak.cli.lens_design import DesignJob, run

        report = run(DesignJob(**values), notices)
    if quiet:
        return
    unit, found = report["unit"], report["first_order"]
    for line in report["did"]:
        typer.echo(line)
    typer.echo(f"focal length {found['focal_length']:.6g} {unit}, F/{found['f_number']:.3g}")
    for place in report["fields"]:
        before, after = (
            "rays lost" if value is None else f"{value:.3g} {unit}"
            for value in (place["rms_spot_at_start"], place["rms_spot"])
        )
        typer.echo(f"field {place['field'][0]:g}, {place['field'][1]:g}: RMS spot {before} -> {after}")
    typer.echo(f"{', '.join(report['files'])} in {output}; `odak trace {output / 'lens.json'}` analyses the lens")


@app.command(
    help="Pass light through an optical bench that a TOML or JSON file describes: sources, apertures, lenses, "
    "modulators, propagations.\n\n"
    "Writes, for each record in the file, the field (NAME.npy) and its pictures (NAME.png), and report.json, which "
    "repeats the whole file with powers and peaks."
)
def simulate(
    config: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="TOML or JSON file of the bench.")] = None,
    output: options.Output = Path("bench"),
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of the file.")] = False,
    quiet: options.Quiet = False,
    again: options.Again = False,
) -> None:
    """Simulate a bench; see :mod:`odak.cli.simulate`."""
    with _messages():
        from odak.cli import simulate as bench

        if schema:
            import json

            typer.echo(json.dumps(bench.schema(), indent=2))
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
    "calibration.npz, which each step takes as known and adds to, STEP.png and report.json."
)
def calibrate(
    step: Annotated[str, typer.Argument(metavar="STEP", help="What to measure.")],
    output: options.Output = Path("calibration"),
    modulator: Annotated[str, typer.Option(metavar="NAME", help="Driver of the modulator.")] = "simulated",
    camera: Annotated[str, typer.Option(metavar="NAME", help="Driver of the camera.")] = "simulated",
    polariser: Annotated[str | None, typer.Option(metavar="NAME", help="Driver of the polariser's mount.")] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            metavar="INSTRUMENT.NAME=VALUE",
            help="Option of a driver, such as camera.source=0 or simulated.shape=[96,96]; may be repeated.",
        ),
    ] = None,
    wavelength: Annotated[str, typer.Option(metavar="LENGTH", help="Vacuum wavelength.")] = "532nm",
    distance: Annotated[
        str, typer.Option(metavar="LENGTH", help="Distance from the modulator to the camera.")
    ] = "20mm",
    seed: Annotated[int, typer.Option(metavar="NUMBER", help="Seed of the simulated table.")] = 0,
    faults: Annotated[str, typer.Option(metavar="some|all", help="Faults of the simulated table.")] = "some",
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="File that holds the calibration results, .npz or .h5.", show_default="in the folder"
        ),
    ] = None,
    quiet: options.Quiet = False,
    again: options.Again = False,
) -> None:
    """Calibrate a table; see :mod:`odak.cli.calibrate`."""
    with _messages():
        from odak.cli import calibrate as calibrating
        from odak.cli.job import parse_length

        if faults not in ("some", "all"):
            raise InputError(f"--faults must be some or all, got {faults!r}")
        lengths = {}
        for name, text in (("wavelength", wavelength), ("distance", distance)):
            try:
                lengths[name] = parse_length(text)
            except ValueError as error:
                raise InputError(f"--{name}: {error}") from None
            largest = 1e-3 if name == "wavelength" else 10.0
            if not 0 < lengths[name] <= largest:
                raise InputError(f"--{name} must be above 0 and at most {largest:g} metres, with a unit; got {text!r}")
        names = {"modulator": modulator, "camera": camera, "polariser": polariser}
        twin = {**lengths, **calibrating.faults_of(step, faults)}
        table = calibrating.open_table(names, option or (), seed, twin)
        report = calibrating.run(step, table, output, **lengths, results=results, notices=_notices(again, quiet))
    if not quiet:
        for name, value in report["found"].items():
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            typer.echo(f"{name}: {text} {report['units'][name]}")
        typer.echo(f"{report['figure']}, report.json in {output}; results in {report['results']}")


@app.command(
    help="Open an interactive page of a result: a folder of any command, a picture, a field in .npy or .pt, or a "
    "lens.\n\n"
    "The page holds all it needs and uses no network."
)
def show(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="Folder, picture, .npy, .pt, .json, .zmx or sample lens.")
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
        # PyTorch has an exception of its own for the memory of a GPU; for that of the processor the text names it.
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
