"""Valid seed files of every format that a reader accepts, and hand-written malicious ones."""

import io
import json
import os

import numpy as np

from fuzz.archive_seeds import content


def image_seeds(folder):
    """Yield pictures: each format, depth and compression."""
    from PIL import Image

    chance = np.random.default_rng(1)
    grey, colour = chance.integers(0, 256, (6, 9), np.uint8), chance.integers(0, 256, (6, 9, 3), np.uint8)
    deep = chance.integers(0, 65536, (6, 9), np.uint16)
    alpha = chance.integers(0, 256, (6, 9, 4), np.uint8)
    pictures = [
        (".png", Image.fromarray(grey), {}),
        (".png", Image.fromarray(colour), {}),
        (".png", Image.fromarray(alpha), {}),
        (".png", Image.fromarray(deep), {}),
        (".png", Image.fromarray(colour).convert("P"), {"transparency": 3}),
        (".png", Image.fromarray(alpha).convert("LA"), {}),
        (".png", Image.fromarray(grey > 99), {}),
        (".jpg", Image.fromarray(colour), {}),
        (".jpg", Image.fromarray(grey), {"progressive": True}),
        (".jpg", Image.fromarray(colour).convert("CMYK"), {}),
        (".bmp", Image.fromarray(colour), {}),
        (".bmp", Image.fromarray(colour).convert("P"), {}),
        (".tif", Image.fromarray(deep), {}),
        (".tif", Image.fromarray(colour), {"compression": "tiff_lzw"}),
        (".tif", Image.fromarray(colour), {"compression": "tiff_adobe_deflate"}),
        (".tif", Image.fromarray(colour), {"compression": "jpeg"}),
        (".tif", Image.fromarray(grey > 99), {"compression": "group4"}),
        (".tif", Image.fromarray(grey.astype("f4")), {}),
        (".gif", Image.fromarray(grey), {}),
        (".gif", Image.fromarray(colour).convert("P"), {"interlace": 1}),
        (".webp", Image.fromarray(alpha), {}),
        (".webp", Image.fromarray(colour), {"lossless": True}),
        (".pgm", Image.fromarray(grey), {}),
        (".ppm", Image.fromarray(colour), {}),
        (".pbm", Image.fromarray(grey > 99), {}),
    ]
    forms = {".png": "PNG", ".jpg": "JPEG", ".bmp": "BMP", ".tif": "TIFF", ".gif": "GIF", ".webp": "WEBP"}
    for extension, picture, options in pictures:
        stream = io.BytesIO()
        picture.save(stream, format=forms.get(extension, "PPM"), **options)
        yield extension, stream.getvalue()
    from odak.tools import save_image

    for extension, levels in ((".png", np.dstack([deep] * 3)), (".png", np.dstack([deep] * 4))):
        path = os.path.join(folder, "seed" + extension)
        save_image(path, levels, 0, 65535, color_depth=16)
        yield extension, content(path)
    radiances = np.random.default_rng(3).integers(0, 256, (3, 9, 4), np.uint8).tobytes()
    yield ".hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3 +X 9\n" + radiances
    yield ".ppm", b"P3\n2 2\n255\n1 2 3 4 5 6 7 8 9 10 11 12\n"
    yield ".ppm", b"P6\n2 2\n65535\n" + bytes(range(24))
    yield ".ras", np.array([0x59A66A95, 4, 2, 8, 8, 1, 0, 0], ">u4").tobytes() + bytes(range(8))
    yield ".png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n%%EOF\n"


def ply_seeds(folder):
    """Yield meshes and points, as text and binary."""
    from odak.tools import asset

    triangles = np.random.default_rng(2).random((3, 3, 3))
    path = os.path.join(folder, "seed.ply")
    asset.write_PLY(triangles, path)
    yield ".ply", content(path)
    from odak.tools.asset import write_mesh

    write_mesh(path, triangles.reshape(-1, 3), np.arange(9).reshape(3, 3))
    yield ".ply", content(path)
    header = "ply\nformat {} 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    yield ".ply", (header.format("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n4 0 1 2 3\n").encode()
    points = np.arange(12).astype(">f4").tobytes()
    faces = b"\x03" + np.array([0, 1, 2], ">i4").tobytes() + b"\x04" + np.array([0, 1, 2, 3], ">i4").tobytes()
    yield ".ply", header.format("binary_big_endian").encode() + points + faces
    yield (
        ".ply",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n"
        b"end_header\n1 2 3\n",
    )


def json_seeds(folder):
    """Yield JSON texts."""
    yield ".json", b'{"a": [1, 2.5, null, true], "b": {"c": "\\u00e9"}, "d": 1e300}'
    yield ".json", b'[1, {"x": []}]'
    yield ".json", json.dumps({part: {"a": "b", "c": "d"} for part in PARTS}).encode()


PARTS = ("sv_kernel_generation_key_mapping", "light_prop_key_mapping")


def material_seeds(folder):
    """Yield catalogues of materials."""
    yield (
        ".json",
        json.dumps(
            {
                "materials": {
                    "G1": {
                        "formula": "Sellmeier",
                        "B": [1.03961212, 0.231792344, 1.01046945],
                        "C": [0.00600069867, 0.0200179144, 103.560653],
                        "range": [0.3, 2.5],
                        "source": "test",
                    },
                    "G2": {
                        "formula": "Cauchy",
                        "A": 1.5,
                        "B": [0.004],
                        "range": [0.4, 0.7],
                        "source": "x",
                        "relative_to": "vacuum",
                    },
                },
                "aliases": {"glass": "G1"},
            }
        ).encode(),
    )
    from odak.catalog import materials

    whole = json.loads(content(materials._DATA))
    for name, entry in list(whole["materials"].items())[:40:4]:
        yield ".json", json.dumps({"materials": {name + "x": entry}}).encode()


def system_seeds(folder):
    """Yield systems of lenses."""
    from odak.learn.raytracing.system import load_system, system_files

    for name in ("singlet", "double_gauss"):
        path = os.path.join(folder, "seed.json")
        system_files.save_system(load_system(name), path)
        yield ".json", json.dumps(json.loads(content(path))).encode()


def zmx_seeds(folder):
    """Yield Zemax texts."""
    from odak.learn.raytracing.system import load_system, zemax

    for name in ("singlet", "cooke_triplet"):
        path = os.path.join(folder, "seed.zmx")
        zemax.write_zmx(load_system(name), path)
        yield ".zmx", content(path)
        yield ".zmx", content(path).decode().encode("utf-16")
    yield ".zmx", ASPHERE


def _lenses(name, extension):
    """Return the texts of two systems as a writer of another format makes them."""

    def seeds(folder):
        from odak.learn.raytracing import system

        path = os.path.join(folder, f"seed{extension}")
        for lens in ("singlet", "cooke_triplet"):
            getattr(system, name)(system.load_system(lens), path)
            yield extension, content(path)

    return seeds


seq_seeds, len_seeds = _lenses("write_seq", ".seq"), _lenses("write_len", ".len")


def ome_seeds(folder):
    """Yield OME-TIFF files: a picture, planes of complex samples, colours and frames."""
    from odak.tools import save_ome_tiff

    path = os.path.join(folder, "seed.tif")
    for shape, kind in (((4, 6), "u1"), ((3, 4, 6), "c8"), ((2, 2, 3, 4, 6), "u2")):
        save_ome_tiff(path, np.ones(shape, kind), 8e-6)
        yield ".tif", content(path)


def splat_seeds(folder):
    """Yield files of splats with and without harmonics above degree 0."""
    import torch

    from odak.learn.wave import Splats, save_splats

    path = os.path.join(folder, "seed.ply")
    for terms in (1, 4):
        made = (torch.zeros(2, 3), torch.ones(2, 4), torch.zeros(2, 3), torch.zeros(2), torch.zeros(2, terms, 3))
        save_splats(path, Splats(*made))
        yield ".ply", content(path)


ASPHERE = b"""VERS 140124 258 36214
MODE SEQ
NAME asphere
UNIT MM X W X CM MR CPMM
ENPD 10
GCAT SCHOTT
FTYP 0 0 2 2 0 0 0
XFLN 0 0
YFLN 0 5
WAVM 1 0.4861 1
WAVM 2 0.5876 1
PWAV 2
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  TYPE EVENASPH
  CURV 0.02 0 0 0 0
  CONI -1
  PARM 1 0
  PARM 2 1e-6
  DISZ 5
  GLAS N-BK7 0 0 1.5168 64.17 0
  DIAM 6 1 0 0 1
  FLAP 0 6
SURF 2
  TYPE STANDARD
  CURV -0.01
  DISZ 95
  CLAP 0 6
SURF 3
  TYPE STANDARD
  CURV 0
  DISZ 0
"""


ZMX_WORDS = (
    b"SURF 1",
    b"TYPE EVENASPH",
    b"TYPE STANDARD",
    b"  PARM 8 1",
    b"GLAS MIRROR 0 0",
    b"GLAS ___BLANK 1 0 1.5 60",
    b"STOP",
    b"FLOA",
    b"FNUM 4 0",
    b"OBNA 0.1",
    b"UNIT IN",
    b"UNIT",
    b"FTYP 1 0 3 3",
    b"FTYP",
    b"WAVL 0.5 0.6",
    b"PWAV 9",
    b"XFLN 1 2 3",
    b"MODE NSC",
    b"COORDBRK",
    b"INFINITY",
    b"-INFINITY",
    b"CLAP 1 2",
    b"DISZ",
    b"CURV",
    b"CONI",
)


def text_seeds(folder):
    """Yield LaTeX, Markdown and plain texts."""
    yield (
        ".tex",
        rb"""\documentclass{article}
% a comment
\begin{document}
Some text with $x^2$.
\begin{equation} E = mc^2 \end{equation}

\begin{figure}
\includegraphics{a.png}
\end{figure}
\end{document}
""",
    )
    yield ".md", b"# Title\n\nText `code` [link](x)\n\n```python\nprint(1)\n```\n\n| a | b |\n|---|---|\n- item\n"
    yield ".txt", "Zeile mit Ümläuten\n\tnext\n".encode()


def spectra_seeds(folder):
    """Yield tables of spectra."""
    yield ".csv", b"nm,red,green\n400,0.1,0.2\n500,1,2\n600.5,3,4e-3\n"
    yield ".txt", b"400\t0.1\n410\t0.2\n"
    yield ".csv", '\ufeff"nm";"a"\n400;1\n401;2\n'.encode()


def gaze_seeds(folder):
    """Yield tables of eye trackers."""
    yield ".csv", b"time,x,y,pupil\n0,96,54,3\n0.1,NaN,,3\n0.2,100,60,3\n"
    yield ".tsv", b"time\tx\ty\n0\t1\t2\n1\t3\t4\n"
    yield ".csv", "\ufeffx;y;time\n1;2;0\n3;4;1\n".encode()


def cube_seeds(folder):
    """Yield tables of colours."""
    yield ".cube", b"TITLE a\nLUT_1D_SIZE 2\nDOMAIN_MAX 1 2 1\n0 0 0\n1 1 1\n"
    corners = "\n".join(f"{r} {g} {b}" for b in (0, 1) for g in (0, 1) for r in (0, 1))
    yield ".cube", f"# by hand\nLUT_3D_SIZE 2\n{corners}\n".encode()


def scene_seeds(folder):
    """Yield scenes."""
    from odak.visualize.blender import scene

    made = scene()
    made.add_mesh(np.random.default_rng(1).random((3, 3)), [[0, 1, 2]])
    path = os.path.join(folder, "seed.json")
    made.save(path)
    # The two files of a scene as one: the text, a mark, the arrays.
    yield ".scene", content(path) + MARK + content(os.path.join(folder, "seed.npz"))
    text = json.loads(content(path))
    # Without it, so that broken arrays are looked at at all.
    del text["arrays_sha256"]
    yield ".scene", json.dumps(text).encode() + MARK + content(os.path.join(folder, "seed.npz"))


MARK = b"\n--arrays--\n"


def _table():
    from odak.instruments import SimulatedTable

    return SimulatedTable(seed=1, shape=(6, 8), camera_shape=(5, 7))


def calibration_seeds(folder):
    """Yield calibrations, HDF5 and archives, with and without regions."""
    import dataclasses

    from odak.instruments import Calibration, save_calibration

    table = _table()
    found = Calibration.nominal(table.modulator, table.camera, 532e-9, 2e-2)
    found = dataclasses.replace(found, phases=found.phases[:8], uncertainty={"distance": 1e-6})
    regional = dataclasses.replace(found, regional_phases=np.ones((2, 2, 1)) * found.phases)
    for name in ("seed.h5", "seed.npz"):
        for calibration in (found, regional):
            path = os.path.join(folder, name)
            save_calibration(path, calibration)
            yield os.path.splitext(name)[1], content(path)


def capture_seeds(folder):
    """Yield captures."""
    from odak.instruments import record_captures, save_captures

    table, path = _table(), os.path.join(folder, "seed.h5")
    levels = np.random.default_rng(0).integers(256, size=(3, 6, 8))
    for dark in (0.0, np.ones((5, 7))):
        save_captures(path, record_captures(table.modulator, table.camera, levels, 532e-9, dark=dark))
        yield ".h5", content(path)


def maker_seeds(folder):
    """Yield corrections and look-up tables of makers of modulators."""
    from PIL import Image

    yield ".csv", b"Y/X,0,1,2\n0,0,128,256\n1,512,64,0\n"
    yield ".lut", b"0 2047\n1 1983\n2 1920\n"
    yield ".txt", "\ufeff0;1;2;\n3;4;5;\n".encode()
    image = io.BytesIO()
    Image.fromarray(np.arange(12, dtype=np.uint8).reshape(3, 4)).save(image, "BMP")
    yield ".bmp", image.getvalue()


def command_seeds(folder):
    """Yield commands as texts, and an answer of a language model."""
    yield ".txt", b"render('picture.png', exit=True)"
    yield ".txt", b"cylinder_between([0,0,0], (1, 2, 3), 0.1)"
    yield ".txt", b"import_ply('a.ply', {'x': -1.5})"
    yield ".txt", b"__import__('os').system('touch pwned')"
    yield ".txt", b"render(open('pwned','w'))"
    yield ".txt", b'{"message": {"content": " hello "}}'


def line_seeds(folder):
    """Yield command lines, one word a line."""
    for line in (
        "trace singlet --rings 2 --aim real", "trace no.zmx", "trace double_gauss --rings 1",
        "hologram photo --distance 3e-3 --wavelength 532e-9 --bits 8", "hologram photo --method double-phase --grating",
        "hologram no.png --seed 3 --learning-rate 0.1", "hologram scene --planes 2 --volume-depth 1e-3 --grey",
        "metamer no.png --gaze 0.5 0.5 --width 0.6", "metamer photo --alpha nan", "--version", "--help",
        "worker tcp://127.0.0.1:1 --workers 0",
    ):  # fmt: skip
        yield ".args", "\n".join(line.split()).encode()


OPTIONS = (
    b"--rings\n0",
    b"--aim\nx",
    b"--distance\n-1",
    b"--distance\nnan",
    b"--wavelength\n1e400",
    b"--bits\n99",
    b"--planes\n0",
    b"--planes\n2",
    b"--frames\n2",
    b"--method\nmulti-color",
    b"--method\n?",
    b"--seed\n-1",
    b"--grey",
    b"--gaze\n9\n9",
    b"--pixel-pitch\n0",
    b"--propagation-type\nx",
    b"--depth-map\n../../x",
    b"--initial-phase\nrandom",
    b"--device\ncuda:99",
    b"--device\n$(id)",
    b"--mode\nx",
    b"--",
    b"-x",
    b"--retries\n-1",
    b"--learning-rate\ninf",
    b"--bits\n1",
)
