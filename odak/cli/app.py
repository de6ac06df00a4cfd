"""Commands of the command line, their messages and their exit codes; their options are those of their settings.

Exit codes: 0 success, 1 unexpected failure, 2 the command line or a file that it names cannot be used, 130 interrupted
by Ctrl-C.
"""

import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from odak.cli.job import Job
from odak.cli.options import InputError, RunSettings, Settings, option_name, parameters_of, refusing
from odak.cli.settings import (
    CalibrateSettings,
    CaptureSettings,
    CertificateSettings,
    DesignSettings,
    ExamplesSettings,
    EyeboxSettings,
    InstrumentsSettings,
    MetamerSettings,
    ShowSettings,
    SimulateSettings,
    SpreadSettings,
    ToleranceSettings,
    TraceSettings,
    WorkerSettings,
)

if TYPE_CHECKING:
    from odak.cli import files

BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130

app: typer.Typer = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)


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


@functools.cache  # made from the settings of all commands, which takes longer than to read a command line
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


def command(*kinds: type[Settings]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that makes a command of a function of settings, whose docstring is the help.

    Parameters
    ----------
    *kinds : type
        Classes of settings, of each of which the function is given one; of a class that is `deferred`, the values by
        name, for settings that depend on other ones.
    """
    parameters = [parameters_of(kind) for kind in kinds]

    def made(function: Callable[..., None]) -> Callable[..., None]:
        def run(context: typer.Context, **values: Any) -> None:
            sources = {name: context.get_parameter_source(name) for name in values}
            given = frozenset(name for name, source in sources.items() if source and source.name == "COMMANDLINE")
            known = {n: tuple(v) if isinstance(v, list) else v for n, v in values.items() if v is not None}
            with _messages():
                parts: list[dict[str, Any]] = [
                    {item.name: known[item.name] for item in own if item.name in known} | {"given": given}
                    for own in parameters
                ]
                given_to = (part if kind.deferred else kind(**part) for kind, part in zip(kinds, parts, strict=True))
                function(*given_to)

        context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
        run.__signature__ = inspect.Signature([context, *(item for own in parameters for item in own)])  # type: ignore
        text, _, examples = (inspect.getdoc(function) or "").partition("Examples::\n\n")
        # A line of \b keeps the lines below it apart.
        app.command(function.__name__, help=text, epilog=f"\b\nExamples:\n{examples}")(run)
        return function

    return made


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


@command(Job, SpreadSettings)
def hologram(values: dict[str, Any], spread: SpreadSettings) -> None:
    """Compute phase-only holograms of a picture.

    A report states how well the saved files reproduce it.

    Writes hologram_<nm>nm.png (one per wavelength; phase = grey * 2 pi / 256, or / 65536 for 16-bit files), with
    --frames hologram_<nm>nm_frame<k>.png or, with multi-color, hologram_frame<k>.png; reconstruction.png,
    comparison.png and report.json; with planes also focal_stack.png.

    Several pictures, or folders of them, are computed one after another or, with --cluster, in parallel. The results
    of each are written to a folder of its name in the output folder. Results of the same options that exist already
    are kept; results of other options are listed before they are replaced.

    Views of a scene from places of the pupil (--views), a mesh (--mesh) or Gaussian splats (--splats) are computed for
    eyes in an eyebox at --distance; views.png has what pupils see for which the hologram was not optimised.

    Films (.mp4, .mov, .avi, .mkv, .webm) are computed frame by frame, each from the patterns of the one before; their
    folders, frame_00001 and so on, and summary.json with the quality and the flicker are written to the output folder.

    Examples::

        odak hologram photo --grey --output output
        odak hologram photo.png --quality good --frames 4
    """
    from odak.cli.files import completed
    from odak.cli.job import is_film

    images, tiles, given = spread.images, values.get("tiles", False), values["given"]
    if tiles and (len(images) > 1 or spread.watch or (spread.cluster or "local") != "local"):
        raise InputError("--tiles takes one IMAGE and no --watch, and --cluster must be local or left out")
    values = completed(values)
    if tiles and "resolution" not in given and "preset" not in given:
        from odak.cli.tiles import picture_size

        values["resolution"] = picture_size(images[0])
    many = not tiles and (
        spread.cluster is not None or spread.watch or len(images) > 1 or os.path.isdir(os.path.expanduser(images[0]))
    )
    for name in sorted(given & {"cluster", "workers", "retries", "timeout", "trusted_network", *spread.TLS}):
        if tiles and spread.cluster is not None and name in ("cluster", "workers"):
            continue
        if not many or (spread.cluster is None and name not in ("cluster", "retries", "workers")):
            raise InputError(f"{option_name(name)} has no effect without --cluster")
    if many:
        raise typer.Exit(_many(spread, values))
    if is_film(images[0]):
        raise typer.Exit(_film(images[0], values))
    job = Job(**values, image=images[0])
    report = _single(job, None if spread.cluster is None else spread.workers or os.cpu_count())
    if not job.quiet:
        _summarise(job, report)
    if report.get("interrupted"):
        typer.echo(f"odak: {report['reached']}: the best patterns so far are in {job.output}", err=True)
        raise typer.Exit(INTERRUPTED)


def _film(film: str, values: dict[str, Any]) -> int:
    """Compute the holograms of a film, print the quality of each frame, and return the exit code."""
    from odak.cli.film import run

    settings = RunSettings(**{name: values[name] for name in ("output", "quiet", "again")})

    def told(number: int, count: int, report: dict[str, Any]) -> None:
        if not settings.quiet:
            typer.echo(f"frame {number} of {count}: PSNR {report['psnr_db']:.2f} dB")

    summary = run(film, values, _notices(settings), told)
    if summary["flicker"] is not None and not settings.quiet:
        typer.echo(f"flicker {summary['flicker']:.3g}, in squared multiples of what is just visible")
    return INTERRUPTED if summary["interrupted"] else 0


def _single(job: Job, workers: int | None) -> dict[str, Any]:
    from odak.cli import files

    notices = _notices(job)
    # Before the modules of the computation are imported, which takes seconds.
    report = files.kept_report(job.output, files.fingerprint_of(job), notices)
    if report is not None:
        return report
    if job.tiles:
        from odak.cli import tiles

        return tiles.run(job, notices, workers)
    from odak.cli import hologram

    return hologram.run(job, notices)


def _many(spread: SpreadSettings, values: dict[str, Any]) -> int:
    """Compute many pictures, print the outcome of each that failed and their numbers, and return the exit code."""
    from odak.cli.cluster import run, watched

    code, run_settings = 0, RunSettings(**{name: values[name] for name in ("output", "quiet", "again")})
    rounds = watched(spread, values) if spread.watch else [run(spread, values, _notices(run_settings))]
    for summary in rounds:
        for name, reason in summary["failed"].items():
            _fail(f"{name}: {reason}", FAILURE)
        if not run_settings.quiet:
            counts = ", ".join(f"{len(summary[what])} {what}" for what in ("computed", "skipped", "failed"))
            workers = f"{summary['workers']} worker{'s' * (summary['workers'] != 1)}"
            output = run_settings.output
            typer.echo(f"{counts} in {summary['seconds']:.1f} s by {workers}; one folder each in {output}")
        code = FAILURE if summary["failed"] else code
    return code


def _summarise(job: Job, report: dict[str, Any]) -> None:
    psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
    ssim = "" if report["ssim"] is None else f"SSIM {report['ssim']:.4f}, "
    seen = "".join(f" for {words}" for words in [report["verification"].get("observer")] if words)
    if (area := report.get("psnr_area_db")) is not None and "any place" in seen:
        seen += f" ({area:.2f} dB if its pixels coincide with the image's)"
    typer.echo(f"PSNR {psnr}{seen}, {ssim}efficiency {report['efficiency']:.1%} (saved patterns)")
    if report["seconds_per_iteration"] is not None:
        typer.echo(f"{report['seconds_per_iteration']:.3g} s per iteration on {report['device']}")
    others = [*(["focal_stack.png"] if job.planes > 1 else []), "report.json"]
    if job.scene is not None:
        typer.echo(f"PSNR at least {report['psnr_unseen_db']:.2f} dB at pupils that it was not optimised for")
        others.insert(0, "views.png")
    if ssim:
        others = ["reconstruction.png", "comparison.png", *others]
    typer.echo(f"{', '.join([*report['pattern']['files'], *others])} in {job.output}")
    if ssim:
        typer.echo(
            f"{job.output / 'comparison.png'} shows the picture, the image that the saved pattern forms "
            f"{f'{job.distance:g} m behind the modulator' if job.scene is None else 'in an eye in the middle'} "
            "(computed), their difference and the pattern"
        )


@command(MetamerSettings)
def metamer(settings: MetamerSettings) -> None:
    """Make a picture that looks like another at a fixed gaze.

    Away from the gaze its details are displaced; its local statistics are the same as the picture's. Writes
    metamer.png, pooling_map.png (the width of the pooling regions of the eye, on a logarithmic scale), comparison.png
    and report.json.

    Examples::

        odak metamer photo
        odak metamer photo.png --gaze 0.5 0.5 --width 60cm
    """
    from odak.cli.metamer import run

    report = run(settings, _notices(settings))
    psnr = "exact" if report["psnr_db"] is None else f"{report['psnr_db']:.2f} dB"
    lines = [
        f"PSNR {psnr}, metameric loss {report['loss']:.3g}, loss of white noise of the same PSNR "
        f"{report['noise_loss']:.3g}, largest pooling region {report['largest_pooling']:.3g} px"
    ]
    if report["texture_distance"] is not None:
        lines.append(
            f"distance by statistics of textures {report['texture_distance']:.3g}, distance of the noise "
            f"{report['noise_texture_distance']:.3g}"
        )
    _say(settings, *lines, f"metamer.png, pooling_map.png, comparison.png, report.json in {settings.output}")


@command(EyeboxSettings)
def eyebox(settings: EyeboxSettings) -> None:
    """Compute a hologram seen from several places of the pupil.

    Several pictures, one for each place in reading order, give parallax. Writes a pattern for each frame, views.png
    with what an eye sees from each place, by exact propagation of the saved patterns, and report.json.

    Examples::

        odak eyebox photo
        odak eyebox photo --places 1 3 --spacing 2mm --pupil 2mm
    """
    from odak.cli.eyebox_views import run

    report = run(settings, _notices(settings))
    for view in report["views"]:
        y, x = (f"{1e3 * value:.3g}" for value in view["place"])
        _say(settings, f"pupil at {y}, {x} mm: PSNR {view['psnr_db']:.2f} dB, {view['share']:.1%} of the light")
    _say(settings, f"{', '.join(report['files'])}, views.png, report.json in {settings.output}")


@command(TraceSettings)
def trace(settings: TraceSettings) -> None:
    """Trace rays through a lens.

    The lens is a sample, a file of odak, or one of Zemax, CODE V or OSLO.

    Samples are singlet, cooke_triplet, double_gauss, double_gauss_f28, triplet_f28 and phone_f2; files end in .json
    (odak), .zmx (Zemax), .seq (CODE V) or .len (OSLO).

    Writes figures of all analyses (layout, spots, fans, transfer, through focus, wavefront, field, image, performance
    over the field, pupil, footprint, polarisation, Seidel coefficients), report.html with all of them, the
    prescription and the aberrations, and report.json with first-order properties, spot sizes, wavefronts, Strehl
    ratios, modulation and vignetting; with --solids the lenses as closed meshes or as STEP.

    Examples::

        odak trace cooke_triplet
        odak trace cooke_triplet --focus best --temperature 60 --mount 23.6e-6
    """
    from odak.cli.trace import run, summary

    report = run(settings, _notices(settings))
    _say(settings, *summary(report))
    for line in () if settings.quiet else report["ignored"]:
        typer.echo(f"ignored: {line}", err=True)
    written = [*report["figures"], *report["solids"], "report.html", "report.json"]
    _say(settings, f"{', '.join(written)} in {settings.output}")


@command(ToleranceSettings)
def tolerance(settings: ToleranceSettings) -> None:
    """Tolerance a lens by tracing many with random deviations.

    The deviations are those by ISO 10110-11 for drawings without any, or as large as a --yield allows. Each lens is
    refocused. Writes figures of the yield, with histograms, and of the sensitivities, report.html and report.json. The
    same seed gives the same lenses.

    Examples::

        odak tolerance cooke_triplet
        odak tolerance double_gauss --samples 1000 --yield 0.9
    """
    from odak.cli.trace import run_tolerance

    report = run_tolerance(settings, _notices(settings))
    unit, median = report["system"]["unit"], report["rms_quantiles"].get("0.5")
    _say(
        settings,
        f"RMS spot {report['rms_as_drawn']:.3g} {unit} as drawn, median of {settings.samples} lenses {median:.3g} "
        f"{unit}",
        f"yield {report['yield']:.0%} within {report['limit']:.3g} {unit}",
        f"{', '.join(report['figures'])}, report.html, report.json in {settings.output}",
    )


@command(DesignSettings)
def design(settings: DesignSettings) -> None:
    """Design a lens, from one that is there or from flat plates.

    A lens that is there is a sample, a .json or a .zmx file; one from flat plates needs --focal-length, --f-number,
    --field and --elements.

    Curvatures, thicknesses, the focus and what aspheres there are vary, so that the spots of all fields become small
    under limits of distortion, edges and lengths; focal length, f-number and field are as asked for, or as in the
    SYSTEM. Writes lens.json, layout.png and report.json. The same seed gives the same lens.

    Examples::

        odak design cooke_triplet --focal-length 35mm --field 18
        odak design --elements 3 --focal-length 50mm --f-number 4 --field 14
    """
    from odak.cli.lens_design import MICROMETRES, run

    report = run(settings, _notices(settings))
    unit, found = report["unit"], report["first_order"]
    _say(settings, *report["did"], f"focal length {found['focal_length']:.6g} {unit}, F/{found['f_number']:.3g}")
    rows = [(f"field {place['label']}", place) for place in report["fields"]]
    rows += [(f"{place['temperature']:g} °C", place) for place in report["temperatures"]]
    for name, place in rows:
        before, after = (
            "rays lost" if value is None else f"{value * MICROMETRES[unit]:.3g} µm"
            for value in (place["rms_spot_at_start"], place["rms_spot"])
        )
        _say(settings, f"{name}: RMS spot {before} -> {after}")
    for item in report["elements"]:
        sizes = " ".join(f"{name} {item[name]:.3g} {unit}" for name in ("diameter", "center", "edge"))
        _say(settings, f"element of {item['material']}: {sizes}")
    for item in report["limits"]:
        value = "rays lost" if item["value"] is None else f"{item['value']:.3g}"
        met = "met" if item["met"] else "NOT MET"
        _say(settings, f"limit of {item['name']}: {item['kind']} {item['limit']:.3g}, the lens has {value}: {met}")
    lens = settings.output / "lens.json"
    _say(settings, f"{', '.join(report['files'])} in {settings.output}; `odak trace {lens}` analyses the lens")


@command(SimulateSettings)
def simulate(settings: SimulateSettings) -> None:
    """Pass light through a bench described by a TOML or JSON file.

    A bench has sources, apertures, lenses, modulators and propagations. Writes, for each record in the file, the field
    (NAME.npy) and its pictures (NAME.png), and report.json, which repeats the whole file with powers and peaks.

    Examples::

        odak simulate bench.toml
        odak simulate --schema
    """
    from odak.cli import simulate as bench

    if settings.schema:
        typer.echo(bench.schema())
        return
    report = bench.run(settings, _notices(settings))
    for step in report["steps"]:
        share = "" if step["share_of_source"] is None else f"{step['share_of_source']:.4g} of the source's power"
        peak = f", peak {step['peak']:.4g} in {step['name']}.npy and .png" if step["kind"] == "record" else ""
        _say(settings, f"{step['kind']:<20}{share}{peak}")
    _say(settings, f"report.json in {settings.output}")


@command(CalibrateSettings)
def calibrate(settings: CalibrateSettings) -> None:
    """Calibrate an optical table by one step.

    Steps are exposure, settling, polarisation, phase, registration, wavefront, distance, illumination, regions, or all
    (phase to illumination).

    Instruments are named by the entry points of their drivers (screen, video, file-modulator, file-camera and those of
    installed packages); without names, a simulated table is calibrated, whose faults a seed draws. Writes
    calibration.h5 (HDF5 with units and uncertainties), which each step takes as known and adds to, STEP.png and
    report.json.

    Examples::

        odak calibrate all
        odak calibrate phase --modulator simulated --camera simulated
    """
    from odak.cli.calibrate import run

    report = run(settings, _notices(settings))
    for name, value in report["found"].items():
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
        _say(settings, f"{name}: {text} {report['units'][name]}")
    _say(settings, f"{report['figure']}, report.json in {settings.output}; results in {report['results']}")


@command(CaptureSettings)
def capture(settings: CaptureSettings) -> None:
    """Show a pattern on the modulator, and capture its image.

    Instruments are chosen as in `odak calibrate`; without names, the simulated table of the seed. Writes
    capture_NAME.png (the capture beside its prediction by the calibration, and their difference), captures.h5 and
    report.json.

    Examples::

        odak capture output
        odak capture output --calibration calibration/calibration.h5
    """
    from odak.cli.capture import run

    report = run(settings, _notices(settings))
    for result in report["patterns"]:
        noise = "" if result["noise_share"] is None else f", of which noise {result['noise_share']:.1%}"
        _say(
            settings,
            f"{result['figure']}: correlation with the prediction {result['correlation']:.4f}, error "
            f"{result['relative_error']:.1%}{noise}",
        )
    _say(settings, f"{report['captures']}, report.json in {settings.output}")


@command(InstrumentsSettings)
def instruments(settings: InstrumentsSettings) -> None:
    """Test the driver of a camera or a modulator.

    Drivers are named as in `odak calibrate`. A camera must see steady light that it can saturate; with --beside, the
    light of that modulator. Prints what is wrong with the remedy, and writes report.json. The exit code is 1 if
    anything is wrong.

    Examples::

        odak instruments test simulated --captures 50
        odak instruments test video --option driver.source=0 --option driver.pitch=3e-6
    """
    from odak.cli.calibrate import check_driver

    report = check_driver(settings, _notices(settings))
    for check in report["checks"]:
        state = {True: "passed", False: "FAILED", None: "-"}[check["passed"]]
        _say(settings, f"{state:<8}{check['check']:<14}{check['found']}")
        if check["remedy"]:
            _say(settings, f"{'':<22}remedy: {check['remedy']}")
    _say(settings, f"report.json in {settings.output}")
    if not report["passed"]:
        raise typer.Exit(FAILURE)


@command(ShowSettings)
def show(settings: ShowSettings) -> None:
    """Open an interactive page of a result.

    A result is a folder of any command, a picture, a field in .npy or .pt, or a lens. The page holds all it needs and
    uses no network.

    Examples::

        odak show output
        odak show double_gauss --no-open
    """
    import tempfile
    import webbrowser

    from odak.cli import show as pages

    page = settings.output or Path(tempfile.mkdtemp(prefix="odak-show-")) / "page.html"
    pages.run(settings.file, page.expanduser().absolute())
    typer.echo(str(page))
    if not settings.browser:
        return
    try:
        webbrowser.get()
    except webbrowser.Error:
        typer.echo("There is no browser here: open the page on another machine; it needs no other file.", err=True)
    else:
        typer.launch(str(page))


@command(ExamplesSettings)
def examples(settings: ExamplesSettings) -> None:
    """List the scripts of the gallery, or copy some to a folder.

    Each makes its figure as it stands: copy one, run it with Python, and change it.

    Examples::

        odak examples
        odak examples double_gauss propagation --output scripts
    """
    from odak.cli import examples as gallery

    for line in (
        gallery.copied(settings.names, settings.output, settings.again) if settings.names else gallery.listing()
    ):
        typer.echo(line)


@command(WorkerSettings)
def worker(settings: WorkerSettings) -> None:
    """Start workers on this machine for a Dask scheduler.

    There is one worker per GPU, or one per core if there is no GPU.

    They run until the scheduler ends or Ctrl-C is pressed. Everybody who can connect to the scheduler can run code on
    this machine. A scheduler on another machine must use certificates, which `odak certificates` makes, unless
    --trusted-network is given. A scheduler is started with `dask scheduler --protocol tls --host ADDRESS
    --tls-ca-file ... --tls-cert ... --tls-key ...`.

    Examples::

        odak worker tcp://127.0.0.1:8786
        odak worker tls://10.0.0.2:8786 --tls-ca-file ca.pem --tls-cert cert.pem --tls-key key.pem
    """
    from odak.cli.cluster import join

    join(settings, (lambda _: None) if settings.quiet else typer.echo)


@command(CertificateSettings)
def certificates(settings: CertificateSettings) -> None:
    """Make TLS certificates for a cluster.

    The files are ca.pem, cert.pem and key.pem.

    Copy the folder to each machine; only those who have it can run code on the cluster.

    Examples::

        odak certificates certificates
        odak certificates certificates --days 30
    """
    from odak.manager import make_certificates

    with refusing("", ImportError, TypeError, ValueError):
        made = make_certificates(settings.folder, settings.days)
    typer.echo(f"ca.pem, cert.pem, key.pem in {made}; keep key.pem secret")


@app.command(help="Print versions, devices, threads and FFT libraries.")
def info() -> None:
    """Print versions and devices."""
    from odak.cli.report import describe_machine

    rows = describe_machine()
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        typer.echo(f"{name:<{width}}  {value}")


def _say(settings: Any, *lines: str) -> None:
    """Print lines about a result, unless the command is quiet."""
    for line in () if settings.quiet else lines:
        typer.echo(line)


def _notices(settings: RunSettings) -> "files.Notices":
    """Return what to do about results of earlier runs: kept and said so, or replaced after a question or a line."""
    from odak.cli import files

    def kept(folder: Path) -> None:
        _say(settings, f"{folder} already holds the result of this run; use --again to compute it again")

    def replaces(folder: Path, names: list[str]) -> None:
        text = f"{folder} holds {', '.join(names)} of another run"
        if settings.again or settings.quiet:
            return
        if not sys.stdin.isatty():
            typer.echo(f"odak: {text}, which will be replaced", err=True)
        elif not typer.confirm(f"{text}. Replace?"):
            raise InputError("nothing was computed; --output names another folder")

    return files.Notices(settings.again, kept, replaces)


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
