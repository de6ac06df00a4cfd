"""Interactive pages of results, for `odak show`: folders of runs, pictures, fields and lenses."""

import base64
import html
import io
import os
from collections.abc import Callable, Sequence
from importlib import resources
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from odak import _validate
from odak._call_forms import did_you_mean
from odak.cli.files import FINGERPRINT, REPORT, load_pattern, read_report, stored_bits, writable_folder
from odak.cli.options import InputError, refusing
from odak.tools.file import read_levels, white_level
from odak.tools.paths import replacing
from odak.wave.transfer_functions import pitches

PICTURES = (".bmp", ".gif", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
LENSES = (".json", ".zmx", ".seq", ".len")
LARGEST_SIDE = 1024
RESPONSIVE = {"responsive": True}
# What the files of a run hold, by the beginnings of their names, in the order in which a page shows them.
CAPTIONS = {
    "reconstruction": "intensity that a camera would record in the plane of the image, computed from the saved pattern",
    "metamer": "the picture that looks the same to an eye that fixates the gaze position",
    "layout": "section through the lens with rays of its fields",
    "comparison": "the results side by side",
    "focal_stack": "intensity in each of the planes",
    "pooling_map": "width of the regions over which the eye pools, on a logarithmic scale: white is the largest",
    "spots": "where the rays of each field meet the image plane",
    "fans": "errors and path differences of rays over the pupil",
    "transfer": "modulation transfer functions and encircled energy",
    "field": "field curvature, distortion and lateral colour",
    "hologram_": "phase pattern for the modulator; its grey levels stand for phases from 0 to 2π",
}
# Names of numbers as they are written elsewhere.
WRITTEN = {"psnr": "PSNR", "ssim": "SSIM", "db": "(dB)", "rms": "RMS", "mtf": "MTF"}


def run(path: str, page: Path) -> Path:
    """Write an interactive page of a result.

    Parameters
    ----------
    path : str
        A folder that `odak hologram`, `metamer`, `trace` or `simulate` wrote, or its report.json, a picture, a field
        or an image in ``.npy`` or ``.pt``, a lens (``.json``, ``.zmx``, ``.seq``, ``.len``), or the name of a
        sample lens.
    page : Path
        HTML file to write; it needs nothing else, and no network.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If there is nothing at the path that can be drawn, or the page is no HTML file; of a folder also if a picture
        or a field in it cannot be read, a link or the report names a file outside of it, or the report is none.
    """
    if page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--output must be an HTML file, such as page.html; got {str(page)!r}")
    if page.is_dir():
        raise InputError(f"--output must be a file, but {str(page)!r} is a folder")
    source = Path(os.path.expanduser(path))
    title = source.name or str(source)
    if source.name == REPORT and source.is_file():
        source = source.parent
    if source.is_dir():
        title, body = _folder(source)
    elif source.suffix.lower() in PICTURES and source.is_file():
        from odak.cli.target import read_picture

        picture = read_picture(source, "FILE").double()
        body = _live(lambda: [_field_figure(picture.mean(0).numpy(), source.name)], alone=True)
    elif source.suffix.lower() in (".npy", ".pt") and source.is_file():
        field = _load(source)
        body = _live(lambda: [_field_figure(field, source.name)], alone=True)
    elif source.suffix.lower() in LENSES or not source.suffix:
        from odak.cli.trace import read_system
        from odak.learn.raytracing.system import sample_systems

        if not source.suffix and path not in sample_systems():
            raise InputError(f"FILE not found: {path!r}.{did_you_mean(path, sample_systems())}")
        lens = read_system(path, "FILE")[0]
        title = lens.name or title
        body = f'<div class="drawn">{lens._repr_html_()}</div>{_live(lambda: [_system_figure(lens)])}'
    elif not source.is_file():
        raise InputError(f"FILE not found: {str(source)!r}")
    else:
        accepted = ", ".join([*PICTURES, ".npy", ".pt", *LENSES])
        raise InputError(f"FILE must be a folder of results, or end in {accepted}; got {str(source)!r}")
    template = resources.files("odak").joinpath("assets/page.html").read_text(encoding="utf-8")
    text = template.format(title=html.escape(title), body=body)
    writable_folder(page.parent)
    with replacing(str(page)) as stream:
        # Names of files may hold bytes that are no UTF-8, and texts of reports halves of characters.
        stream.write(text.encode("utf-8", "backslashreplace"))
    return page


def _folder(folder: Path) -> tuple[str, str]:
    """Return title and body of the page of a run: pictures, figures and numbers, and what it was made of, folded."""
    names = sorted(path.name for path in folder.iterdir())
    pictures = [_inside(folder, name) for name in names if Path(name).suffix.lower() in PICTURES]
    fields = [_inside(folder, name) for name in names if Path(name).suffix.lower() == ".npy"]
    report = _checked(_inside(folder, REPORT)) if REPORT in names else {}
    if not pictures and not fields:
        raise InputError(f"FILE must be a folder with pictures or fields, got {str(folder)!r}, which has neither")
    parts = [f'<p role="note">Warning: {html.escape(text)}</p>' for text in report.get("warnings", [])]
    settings = report.get("bench") or report.get("parameters") or {}
    pitch, wavelength = settings.get("pixel_pitch"), settings.get("wavelength")
    named = report.get("pattern", {}).get("files", [])
    patterns = [path for path in (_inside(folder, name, missing=True) for name in named) if path.is_file()]
    pictures.sort(key=lambda path: _rank(path.name))
    drawn = [_pictured(path, number == 0) for number, path in enumerate(pictures) if path.name not in named]
    kept = [_pictured(path) for path in pictures if path.name in named]
    parts = [*drawn[:1], *parts, *drawn[1:]]
    arrays = [(_load(path), path.name) for path in fields]
    phases = [(np.exp(1j * _phase(path)), path.name) for path in patterns]
    live = _live(
        lambda: _together(arrays, pitch, wavelength) + _together(phases, pitch, quantities=["phase"]),
        alone=not pictures,
    )
    parts += [live, _numbers(report)]
    parts += [f"<details><summary>Patterns</summary>{''.join(kept)}</details>"] if kept else []
    made_of = settings.get("image")
    title = f"{Path(made_of).stem}, {folder.name}" if isinstance(made_of, str) and made_of else folder.name
    return title, "\n".join(parts)


def _rank(name: str) -> int:
    """Return the place of a picture on a page."""
    return next((place for place, start in enumerate(CAPTIONS) if name.startswith(start)), len(CAPTIONS))


def _pictured(path: Path, first: bool = False) -> str:
    """Return a picture of a run as a part of its page."""
    kind = "first" if first else "sheet" if path.name.startswith("comparison") else "picture"
    return (
        f'<figure class="{kind}"><img alt="{html.escape(path.name)}" src="data:{_encoded(path)}">'
        f"<figcaption>{html.escape(_caption(path.name))}</figcaption></figure>"
    )


def _together(fields: list, pitch, wavelength=None, quantities: Sequence[str] | None = None) -> list:
    """Return figures of fields; fields of one shape and kind share a figure with a slider."""
    groups: dict[Any, list] = {}
    for values, name in fields:
        groups.setdefault((values.shape, values.dtype) if values.ndim == 2 else name, []).append((values, name))
    found = []
    for group in groups.values():
        values, names = zip(*group, strict=True)
        same = sum(1 for _ in takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False)))
        labels = [Path(name).stem[same:] or name for name in names] if len(group) > 1 else ()
        stack = np.stack(values) if len(group) > 1 else values[0]
        found.append(_field_figure(stack, ", ".join(names), pitch, wavelength, quantities, labels))
    return found


def _inside(folder: Path, name: str, missing: bool = False) -> Path:
    """Return the path of a regular file in a folder; raise InputError for all else, such as links that lead out."""
    path = folder / name
    try:
        real = path.resolve(strict=not missing)
        lies_in = real.is_relative_to(folder.resolve())
        regular = real.is_file() or (missing and (real.is_dir() or not real.exists()))
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a loop, up to Python 3.12
        raise InputError(f"FILE {str(path)!r} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not lies_in:
        raise InputError(f"FILE {str(folder)!r} must hold its files itself, but {name!r} leads to {str(real)!r}")
    if not regular:
        raise InputError(f"FILE {str(path)!r} must be a regular file")
    return path


def _checked(path: Path) -> dict[str, Any]:
    """Return the report of a run after checking what is read of it; raise InputError naming what cannot be used."""
    with refusing(f"FILE {str(path)!r} is not the report of a run: ", OSError, TypeError, ValueError, OverflowError):
        report = read_report(path)
        for name in ("bench", "parameters", "pattern", "definitions"):
            if not isinstance(report.get(name, {}), dict):
                raise TypeError(f"{name} must be an object, got {report[name]!r:.80}")
        _validate.texts("warnings", report.get("warnings", []))
        _validate.texts("pattern.files", report.get("pattern", {}).get("files", []))
        _validate.texts("definitions", report.get("definitions", {}).values())
        for name in ("bench", "parameters"):
            values = report.get(name, {})
            for pitch in pitches(values.get("pixel_pitch"), f"{name}.pixel_pitch"):
                if pitch is not None:
                    _validate.number(f"{name}.pixel_pitch", pitch, positive=True)
            if values.get("wavelength") is not None:
                _validate.number(f"{name}.wavelength", values["wavelength"], positive=True)
    return report


def _caption(name: str) -> str:
    """Return the name of a file, with what it holds where that is known."""
    told = next((text for start, text in CAPTIONS.items() if name.startswith(start)), "")
    return f"{name}: {told}" if told else name


def _numbers(report: dict[str, Any]) -> str:
    """Return the numbers that a report defines as rows, and folded: the definitions, parameters and versions."""
    shown = {name: value for name, value in report.items() if isinstance(value, (int, float, str))}
    shown.pop(FINGERPRINT, None)
    notes = report.get("definitions", {})
    results = {name: value for name, value in shown.items() if name in notes and not name.startswith("seconds")}
    results = results or {name: value for name, value in shown.items() if not isinstance(value, str)}
    others = {name: value for name, value in shown.items() if name not in results}
    for part in ("parameters", "bench", "versions"):
        found = report.get(part, {})
        others |= {n: v for n, v in (found.items() if isinstance(found, dict) else ()) if v is not None}
    defined = "".join(
        f"<p><b>{_written(n)}</b><small>{html.escape(notes[n])}</small></p>" for n in results if n in notes
    )
    parts = [_rows(results)] if results else []
    parts += [f"<details><summary>Definitions</summary>{defined}</details>"] if defined else []
    parts += [f"<details><summary>Parameters</summary>{_rows(others)}</details>"] if others else []
    return "\n".join(parts)


def _rows(values: dict[str, Any]) -> str:
    """Return names and values as a table."""
    cells = ((name, f"{value:.6g}" if type(value) is float else str(value)) for name, value in values.items())
    return f"<table>{''.join(f'<tr><td>{_written(n)}</td><td>{html.escape(v)}</td></tr>' for n, v in cells)}</table>"


def _written(name: str) -> str:
    """Return the name of a number as a reader expects it, escaped."""
    return html.escape(" ".join(WRITTEN.get(word, word) for word in name.split("_")))


def _encoded(path: Path) -> str:
    """Return the type and the bytes of a picture as a data URL has them, once its pixels have been decoded."""
    from PIL import Image

    levels, content = _levels(path), path.read_bytes()
    with Image.open(io.BytesIO(content)) as image:
        kind = Image.MIME[str(image.format)]
    if kind == "image/tiff":
        # Browsers do not draw it.
        stream = io.BytesIO()
        shares = np.clip(levels / white_level(levels), 0, 1)
        Image.fromarray(np.round(255 * shares).astype(np.uint8)).save(stream, "PNG")
        kind, content = "image/png", stream.getvalue()
    return f"{kind};base64,{base64.b64encode(content).decode()}"


def _levels(path: Path) -> np.ndarray:
    """Return the levels of a picture; raise InputError if it cannot be decoded to its end."""
    with refusing("FILE: ", ValueError):
        return read_levels(path)


def _phase(path: Path) -> np.ndarray:
    """Return the phase of a pattern that a report names."""
    if _levels(path).ndim != 2:
        raise InputError(f"FILE {str(path)!r} is no pattern: it must be a grey picture")
    return load_pattern(path, stored_bits(path)).numpy()


def _load(path: Path) -> np.ndarray:
    """Return an array of two axes from a file; nothing in it is run."""
    with refusing(f"FILE {str(path)!r} cannot be drawn: ", OSError, ValueError, TypeError, EOFError, OverflowError):
        if path.suffix.lower() == ".npy":
            # Mapped: a header may name more samples than the file holds, and more than any memory does.
            values = np.load(path, mmap_mode="r", allow_pickle=False)
        else:
            from odak.learn.tools import torch_load

            values = torch_load(str(path), weights_only=True)
            if not isinstance(values, torch.Tensor):
                raise ValueError(f"it contains a {type(values).__name__}, not a tensor")
            values = values.detach().cpu().numpy()
    values = np.squeeze(values)
    if values.ndim < 2 or values.ndim > 3 or 0 in values.shape or not np.issubdtype(values.dtype, np.number):
        raise InputError(f"FILE {str(path)!r} must contain a field or a stack of fields, got shape {values.shape}")
    # Plotly does not write NumPy's extended precision.
    plain = {np.dtype(np.longdouble): np.float64, np.dtype(np.clongdouble): np.complex128}
    return values.astype(plain.get(values.dtype, values.dtype), copy=False)


def _field_figure(
    values: np.ndarray,
    title: str,
    pitch: float | Sequence[float] | None = None,
    wavelength: float | None = None,
    quantities: Sequence[str] | None = None,
    labels: Sequence[str] = (),
) -> tuple[Any, str]:
    """Return a figure of a field and its caption; of one too large for a page its middle, of a picture means."""
    from odak.visualize.plotly import field_show

    step = -(-max(values.shape[-2:]) // LARGEST_SIDE)
    rows, columns = values.shape[-2:]
    if step > 1 and np.iscomplexobj(values):
        # Every second sample of a phase would show patterns that are not there.
        first, second = (max(0, (count - LARGEST_SIDE) // 2) for count in (rows, columns))
        values = values[..., first : first + LARGEST_SIDE, second : second + LARGEST_SIDE]
        title = f"{title}, its middle of {values.shape[-2]} × {values.shape[-1]} samples"
    elif step > 1:
        values = _block_means(values, step)
        pitch = None if pitch is None else [value * step for value in pitches(pitch)]
        title = f"{title}, means over {step} × {step} samples"
    chosen: dict[str, Any] = {} if quantities is None else {"quantities": quantities}
    chosen |= {"labels": labels, "layout": "slider"} if labels else {}
    figure = field_show(values, pitch, wavelength, title=title, show=False, **chosen)
    return figure.fig, "; ".join([title, *figure._notes])


def _block_means(values: np.ndarray, step: int) -> np.ndarray:
    """Return the means over squares of `step` samples a side of the last two axes."""
    rows, columns = (max(1, count // step) for count in values.shape[-2:])
    kept = values[..., : rows * step, : columns * step]
    return kept.reshape(*kept.shape[:-2], rows, -1, columns, kept.shape[-1] // columns).mean((-3, -1))


def _system_figure(lens) -> tuple[Any, str]:
    from odak.visualize.plotly import system_show

    return system_show(lens, show=False).fig, ""


def _live(make: Callable[[], list], alone: bool = False) -> str:
    """Return interactive figures, or without plotly a note, beside other pictures, that they need it."""
    try:
        return _figures(make())
    except ImportError as error:
        if alone:
            raise InputError(str(error)) from None
        return f"<p><small>Without interactive figures: {html.escape(str(error))}</small></p>"


def _figures(figures: list[tuple[Any, str]]) -> str:
    """Return figures and their captions as parts of a page, the first of which brings the library along."""
    return "\n".join(
        f"<figure>{figure.to_html(full_html=False, include_plotlyjs=number == 0, config=RESPONSIVE)}"
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        for number, (figure, caption) in enumerate(figures)
    )
