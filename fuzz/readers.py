"""The readers that take files from elsewhere: the calls, the words of each format, the memory they may take."""

import contextlib
import io
import itertools
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fuzz import archive_seeds, guard, mutations, seed_files

IMAGE_MEGABYTES = 1800


@dataclass(frozen=True)
class Reader:
    """A reader, or several of one format.

    Attributes
    ----------
    seeds : callable
        ``seeds(folder)`` returns valid files as pairs of extension and content.
    call : callable
        ``call(path)`` reads a file in every way there is.
    tokens : sequence of bytes
        Words of the format.
    structure : callable, optional
        Changes a file as one of its format.
    named : bool
        Whether a refusal must name the file.
    megabytes : float
        Memory that a case may take.
    seconds : float
        Processor time that a case may take.
    """

    seeds: Callable
    call: Callable
    tokens: Sequence[bytes] = ()
    structure: Callable | None = None
    named: bool = True
    megabytes: float = 256
    seconds: float = guard.SECONDS


def every(*calls: Callable) -> Callable:
    """Return a call that makes several, and raises a refusal if all refuse; any other error at once."""

    def call(path):
        refusals = []
        for each in calls:
            try:
                each(path)
            except (ValueError, TypeError, OSError) as error:
                _must_name(error, path)
                refusals.append(error)
        if len(refusals) == len(calls):
            raise refusals[0]

    return call


def _must_name(error, path):
    base = os.path.basename(path)
    if base not in f"{error} {getattr(error, 'filename', '')}":
        raise error


def _image(path):
    from odak.tools import load_image

    load_image(path)


def _torch_image(path):
    from odak.learn.tools import load_image

    load_image(path, torch_style=True)


def _inset(path):
    from odak.visualize.plotly import field_figures

    field_figures._inset(path)


def _mesh(path):
    from odak.tools import read_PLY

    read_PLY(path)


def _points(path):
    from odak.tools.asset import read_PLY_point_cloud

    read_PLY_point_cloud(path)


def _triangle_mesh(path):
    from odak.learn.raytracing import triangle_mesh

    triangle_mesh.read_PLY(path)


def _dictionary(path):
    from odak.tools import load_dictionary

    load_dictionary(path)


def _mapping(path):
    from odak.learn.wave.models import _read_mapping

    _read_mapping(path)


def _materials(path):
    from odak.catalog.materials import read_materials

    read_materials(path)


def _system(path):
    from odak.learn.raytracing.system import load_system

    load_system(path)


def _zmx(path):
    from odak.learn.raytracing.system import read_zmx

    read_zmx(path)


def _seq(path):
    from odak.learn.raytracing.system import read_seq

    read_seq(path)


def _len(path):
    from odak.learn.raytracing.system import read_len

    read_len(path)


def _ome(path):
    from odak.tools import load_ome_tiff

    load_ome_tiff(path)


def _splats(path):
    from odak.learn.wave import load_splats

    load_splats(path)


def _tensor(path):
    import torch

    from odak.learn.tools import torch_load

    def touched(value):
        if isinstance(value, torch.Tensor) and value.numel() < 10**6 and not value.is_quantized:
            value.clone()
        elif isinstance(value, dict):
            [touched(inner) for inner in value.values()]
        elif isinstance(value, (list, tuple)):
            [touched(inner) for inner in value]

    touched(torch_load(path))


def _weights(path):
    from odak.learn.models import load_weights

    load_weights(archive_seeds.net(), path)


def _gaussians(path):
    from argparse import Namespace

    from odak.learn.wave.gaussians import complex_3d_gaussians

    complex_3d_gaussians("gaussians", "cpu", load_path=path, args_prop=Namespace(num_planes=2))


def _checkpoint(path):
    # A run that takes up a file writes it anew: what came is put back, for the other kinds of run.
    before = archive_seeds.content(path)

    def renewed(run):
        def call(path):
            with open(path, "wb") as stream:
                stream.write(before)
            run(path)

        return call

    every(*map(renewed, archive_seeds.RUNS.values()))(path)


def _text(path):
    from odak.tools import latex, markdown, read_text_file

    for read in (read_text_file, latex, markdown):
        made = read(path)
        if not isinstance(made, list):
            made.get_line_count()


def _spectra(path):
    from odak.learn.perception import read_spectra

    read_spectra(path)


def _gaze(path):
    from odak.learn.perception import Viewing, read_gaze

    read_gaze(path, Viewing(0.7, 0.7, (108, 192)), pixels=True)


def _cube(path):
    import torch

    from odak.learn.perception import ColorTable

    ColorTable.read(path)(torch.zeros(1, 3, 2, 2))


def _in_scene(data, chance):
    text, mark, arrays = data.partition(seed_files.MARK)
    if chance.random() < 0.5:
        return mutations.in_json(text, chance) + mark + arrays
    return text + mark + mutations.in_archive(arrays, chance)


def _scene(path):
    from odak.visualize.blender import scene

    text, _, arrays = archive_seeds.content(path).partition(seed_files.MARK)
    target = path.removesuffix(".scene") + ".json"
    for name, content in ((target, text), (os.path.join(os.path.dirname(path), "seed.npz"), arrays)):
        with open(name, "wb") as stream:
            stream.write(content)
    try:
        scene.load(target)
    finally:
        os.unlink(target)


def _calibration(path):
    from odak.instruments import load_calibration

    load_calibration(path)


def _captures(path):
    from odak.instruments import load_captures

    load_captures(path)


def _correction(path):
    from odak.instruments import load_correction

    load_correction(path, cycle=256)


def _look_up_table(path):
    from odak.instruments import load_look_up_table

    load_look_up_table(path)


def _command(path):
    from odak.tools import large_language_model
    from odak.visualize.blender import server

    content = archive_seeds.content(path)
    text = content.decode("utf-8", "surrogateescape")
    for name in server.COMMANDS:
        server.parse_function_call_safely(text, name)
    large_language_model._answer(content)


_SMALL = {
    "hologram": "--resolution 32 48 --iterations 1 --device cpu --quiet --scale",
    "metamer": "--device cpu --quiet",
    "trace": "--quiet",
}


def _line(path):
    from odak.cli import main

    arguments = archive_seeds.content(path).decode("utf-8", "surrogateescape").split("\n")
    folder = os.path.join(os.path.dirname(path), "out")
    many = any(name == "--planes" and len(count) > 2 for name, count in itertools.pairwise(arguments))
    large = many or (arguments[0] == "metamer" and "photo" in arguments)
    if arguments[0] == "worker" or "--cluster" in arguments or large:
        # A worker waits for its scheduler by design; many planes, and a metamer of a photograph, take their time.
        arguments.append("--no-such-option")
    if arguments[0] in _SMALL:
        arguments += [*_SMALL[arguments[0]].split(), "--output", folder]
    # Several pictures are computed in temporary folders.
    former, tempfile.tempdir = tempfile.tempdir, os.path.dirname(path)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = main(arguments)
    finally:
        tempfile.tempdir = former
    if code not in (0, 1, 2):
        raise AssertionError(f"exit code {code!r}")


READERS = {
    "image": Reader(
        seed_files.image_seeds,
        every(_image, _torch_image, _inset),
        (b"IHDR", b"IDAT", b"PLTE", b"tRNS", b"acTL", b"\xff\xd8\xff", b"II*\0"),
        mutations.in_png,
        megabytes=IMAGE_MEGABYTES,
    ),
    "ply": Reader(
        seed_files.ply_seeds,
        every(_mesh, _points, _triangle_mesh),
        (
            b"element vertex 1000000000",
            b"element face 4294967295",
            b"property list uint int vertex_indices",
            b"property float x",
            b"property list uchar double vertex_index",
            b"element x 1000000000",
            b"format ascii 1.0",
            b"format binary_little_endian 1.0",
            b"end_header\n",
            b"ply\n",
            b"comment",
            b"obj_info",
        ),
    ),
    "json": Reader(
        seed_files.json_seeds,
        every(_dictionary, _mapping),
        (b"NaN", b"-Infinity", b"1e999", b"\\ud800", b"\\u0000"),
        mutations.in_json,
    ),
    "materials": Reader(
        seed_files.material_seeds,
        _materials,
        (b'"nd"', b'"vd"', b'"Sellmeier"', b'"Cauchy"', b'"vacuum"'),
        mutations.in_json,
    ),
    "system": Reader(
        seed_files.system_seeds, _system, (b'"NA"', b'"EPD"', b'"mirror"', b"1e999", b'"N-BK7"'), mutations.in_json
    ),
    "zmx": Reader(seed_files.zmx_seeds, _zmx, seed_files.ZMX_WORDS),
    "seq": Reader(seed_files.seq_seeds, _seq, (b"RDM", b"GL1", b"ASP", b"S 0 0", b"STO", b"ZOO", b"1e999", b"&", b"!")),
    "len": Reader(seed_files.len_seeds, _len, (b"NXT", b"GLA", b"AST", b"PK CV", b"EBR", b"1e999", b"CV nan")),
    "ome": Reader(
        seed_files.ome_seeds,
        _ome,
        (
            b'SizeZ="1000000000"',
            b'PlaneCount="1000000000"',
            b'<UUID FileName="../a.tif">urn:uuid:1</UUID>',
            b'IFD="4000000000"',
            b"<BinaryOnly/>",
            b"II*\0",
        ),
    ),
    "splats": Reader(seed_files.splat_seeds, _splats, (b"element vertex 1000000000", b"property float f_rest_0")),
    "tensor": Reader(
        archive_seeds.tensor_seeds,
        every(_tensor, _weights, _gaussians),
        (b"cos\nsystem\n", b"c__builtin__\neval\n", b"R", b"Q."),
        mutations.in_archive,
    ),
    "checkpoint": Reader(archive_seeds.checkpoint_seeds, _checkpoint, (), mutations.in_archive),
    "text": Reader(seed_files.text_seeds, _text, (rb"\begin{equation}", rb"\end{figure}", b"```", b"|", b"\t")),
    "spectra": Reader(seed_files.spectra_seeds, _spectra, (b'"', b";", b",,", b"\t", b"\x00", b"400,1\n")),
    "gaze": Reader(seed_files.gaze_seeds, _gaze, (b";", b"\t", b"nan", b"1e999", b"time", b"\x00", b'"', b"0.1,1,2\n")),
    "cube": Reader(seed_files.cube_seeds, _cube, (b"LUT_3D_SIZE 256\n", b"LUT_1D_SIZE", b"nan", b"DOMAIN_MIN 1 1 1\n")),
    "scene": Reader(
        seed_files.scene_seeds,
        _scene,
        (b'"arrays": "../x.npz"', b"<f4", b"|O", b"fortran_order"),
        _in_scene,
        named=True,
    ),
    "calibration": Reader(
        seed_files.calibration_seeds,
        _calibration,
        (b"<f8", b"|O", b"fortran_order", b"(1000000000, 1000)", b"TREE", b"SNOD", b"HEAP", b"OHDR", b"FRHP"),
        mutations.in_hdf5,
    ),
    "captures": Reader(
        seed_files.capture_seeds, _captures, (b"TREE", b"SNOD", b"HEAP", b"OHDR", b"FRHP"), mutations.in_hdf5
    ),
    "maker": Reader(
        seed_files.maker_seeds,
        every(_correction, _look_up_table),
        (b";", b",,", b"\t", b"#", b"nan", b"1e999", b"Y/X,0,1\n", b"BM"),
        megabytes=IMAGE_MEGABYTES,
    ),
    "command": Reader(
        seed_files.command_seeds,
        _command,
        (b"render(", b"quit()", b"**{}", b"lambda:0", b"(" * 300, b"-" * 3000),
        mutations.in_json,
        named=False,
    ),
    # A line may trace a lens and draw its figures.
    "line": Reader(seed_files.line_seeds, _line, seed_files.OPTIONS, named=False, megabytes=600, seconds=30),
}
