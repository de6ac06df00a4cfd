"""Objects in notebooks: their pages hold their numbers with units, their names as text, and what endangers them."""

import base64
import functools
import html.parser
import importlib.util
import io
import math
import re
import runpy
import sys
import types
import warnings
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import structure
import torch
from PIL import Image

import odak
from odak import _show
from odak.instruments import Calibration, SimulatedTable
from odak.learn.raytracing.system import (
    configurations,
    first_order,
    launch,
    layout_figure,
    load_system,
    optical_system,
    pupil_samples,
    spot_diagram,
    surface,
    trace,
)
from odak.learn.wave import Display, Modulator, Run, optimise, propagator, spatial_light_modulator
from odak.learn.wave.displays.sections import section
from odak.raytracing.interfaces import IdealLens
from odak.wave import CircularAperture, FreeSpace, Mask, ThinLens, optical_bench

NAME = """Lens <script>alert("&1")</script> $x_{^$ 'a'"""


class Page(html.parser.HTMLParser):
    """Title, rows, notes, tags and images of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.rows, self.notes, self.images, self.title = [], [], [], [], ""
        self.inside = ""
        self.feed(text)
        self.close()
        assert self.inside == ""

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append(tag)
        assert not any(name.startswith("on") for name in given)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
        elif tag == "img":
            self.images.append((given["alt"], given["src"]))
        elif given.get("role") == "note":
            self.notes.append("")
        self.inside = "note" if given.get("role") == "note" else tag if tag in ("td", "th", "b") else self.inside

    def handle_endtag(self, tag):
        self.inside = ""

    def handle_data(self, data):
        if self.inside in ("td", "th"):
            self.rows[-1][-1] += data
        elif self.inside == "note":
            self.notes[-1] += data
        elif self.inside == "b":
            self.title += data

    def __getitem__(self, name):
        (row,) = (row for row in self.rows if row[0] == name)
        return row[1] if len(row) == 2 else row[1:]

    def drawn(self, place):
        """Return the root of the tree of an SVG picture, or the pixels of another."""
        kind, _, content = self.images[place][1].partition(";base64,")
        content = base64.b64decode(content)
        if kind == "data:image/svg+xml":
            return ElementTree.fromstring(content)
        return np.asarray(Image.open(io.BytesIO(content)))


def page_of(shown, bytes_at_most=150_000):
    text = shown._repr_html_()
    assert len(text.encode()) < bytes_at_most
    page = Page(text)
    assert not {"script", "style", "iframe", "svg", "a"} & set(page.tags)
    return page


@pytest.fixture(scope="module")
def plano_convex():
    # f = R/(n − 1), and the back focal distance is less by t/n behind the curved side.
    return optical_system([surface(50.0, thickness=6.0, material=1.5), surface(thickness=96.0)], 10.0, name=NAME)


def test_a_lens_shows_layout_and_first_order(plano_convex):
    page = page_of(plano_convex)
    assert page["focal length"] == "100 mm" and page["f number"] == "10"
    assert page["back focal distance"] == "96 mm"
    assert page["surface 0 (stop)"][:2] == ["50", "6"] and page["surface 1"][:2] == ["∞", "96"]
    assert page.title.startswith(NAME) and "entrance pupil of 10 mm" in page.title and "587.6 nm" in page.title
    assert page.notes == [] and "".join(page.drawn(0).itertext()).count(NAME) == 1


def test_what_cannot_be_drawn_is_named():
    # A stop in the rear focal plane has its entrance pupil at infinity.
    item = surface(phase=IdealLens(20.0), thickness=20.0)
    lens = optical_system([item, surface(thickness=10.0, stop=True)], 5.0, object_distance=40.0)
    page = page_of(lens)
    assert page.images == [] and len(page.notes) == 2 and all("infinity" in note for note in page.notes)


def test_a_figure_of_a_lens_is_an_image(plano_convex):
    (alt, _), *others = (page := Page(layout_figure(plano_convex)._repr_html_())).images
    assert others == [] and alt and page.drawn(0).tag.endswith("svg")


def test_configurations_show_a_column_for_each():
    # 1/f = 1/f₁ + 1/f₂ − d/(f₁f₂).
    items = [surface(phase=IdealLens(50.0), thickness=30.0), surface(phase=IdealLens(-30.0), thickness=60.0)]
    page = page_of(configurations(optical_system(items, 10.0), [("thickness", 0, [30.0, 35.0])]))
    assert page["focal length"] == ["150 mm", "100 mm"] and len(page.images) == 2


def test_a_prescription_shows_a_row_for_each_surface(plano_convex):
    page = page_of(plano_convex.prescription())
    assert page["0"] == ["50", "0", "6", "1.5"] and page["1"] == ["∞", "0", "96", "1"]


def test_spots_show_their_sizes_and_lost_rays():
    lens = load_system("cooke_triplet")
    lens.surfaces[0].semi_diameter = 5.0
    found = spot_diagram(lens)
    page = page_of(found)
    assert [float(page[str(i)][2]) for i in range(3)] == pytest.approx(found.rms.tolist(), rel=1e-5)
    lost = int((found.status[:, 2] != 0).sum())
    assert lost and page["2"][-1] == f"{lost} of {found.status[:, 2].numel()}"


def test_a_bench_shows_its_ray_matrix():
    page = page_of(optical_bench([CircularAperture(4e-4), ThinLens(0.1), FreeSpace(0.3, window_dx=2e-6)], 532e-9))
    # A lens and three times its focal length: A = 1 − 3, B = 0.3 m.
    assert page["ray matrix"] == "A = -2, B = 0.3 m, C = -10 1/m, D = 1"
    assert page["focal length"] == "100 mm" and "532 nm" in page.title and "300 mm" in page.title
    assert page.drawn(0).std() > 0


def test_a_display_shows_its_angles():
    display = Display(Modulator((32, 48), 8e-6), [639e-9, 473e-9], [2e-3, 3e-3])
    page = page_of(display)
    assert page["size of panel and images"] == "0.256 mm × 0.384 mm" and page["plane 1"] == "3 mm"
    assert page["largest angle at 639 nm"] == f"{math.degrees(math.asin(639e-9 / 16e-6)):.4g}°"
    assert page.drawn(0).tag.endswith("svg")
    cones = section(display).axes[0].patches
    assert len(cones) == 4
    tip, end, *_ = cones[1].get_xy()
    assert (end - tip)[1] / (end - tip)[0] == pytest.approx(math.tan(math.asin(639e-9 / 16e-6)))


def test_a_calibration_shows_what_is_uncertain():
    table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    found = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    page = page_of(found)
    assert page["light path"][0] == "20 mm" and page.notes == [] and page.drawn(0).min() == 255
    doubtful = replace(found, phases=found.phases / 2, uncertainty={"phases": 0.2, "distance": 1e-4})
    page = page_of(doubtful)
    assert page["light path"] == ["20 mm", "± 0.0001 m"]
    assert "phases by 0.2 rad" in page.notes[0] and "increase the range" in page.notes[1] and len(page.notes) == 2


def test_warnings_of_a_view_are_part_of_the_page():
    def view(shown):
        for _ in range(2):
            odak._warnings.warn("the sampling is <too> coarse", odak.SamplingWarning)
        warnings.warn("of another package", UserWarning, stacklevel=2)
        return _show.View(shown, table=[("a",), (np.float64(0.25),)])

    page = Page(_show.page("title", view))
    assert page.notes == ["Warning: the sampling is <too> coarse"] and page.rows == [["a"], ["0.25"]]


@functools.cache
def shown_objects():
    lens = load_system("cooke_triplet")
    table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    bench = optical_bench([ThinLens(0.1), Mask(np.ones((64, 64)))], 532e-9)
    return [
        *(spot_diagram(lens), lens.prescription(), first_order(lens), trace(lens, launch(lens, pupil_samples("y", 5)))),
        *(table, table.modulator, table.camera, table.laser, table.stage, table.polariser),
        *(bench, bench.planes(np.ones((64, 64), complex), 8e-6)[-1]),
        Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3),
        *(
            propagator([16, 16], [532e-9], 8e-6, aperture_size=9),
            spatial_light_modulator(),
            odak.learn.raytracing.detector(),
        ),
    ]


@pytest.mark.parametrize("place", range(16))
def test_other_objects_describe_themselves_in_a_line(place):
    text = repr(shown_objects()[place])
    assert 16 < len(text) < 700 and "\n" not in text and "0x" not in text and not text.endswith("()")


def test_lines_show_numbers_of_short_and_shapes_of_long_arrays():
    found = spot_diagram(load_system("cooke_triplet"))
    sizes = ", ".join(f"{size:.6g}" for size in found.rms.tolist())
    assert f"rms=[{sizes}]" in repr(found) and f"x=float64{list(found.x.shape)}" in repr(found)
    seen = torch.func.vmap(lambda x: (repr(found._replace(rms=x)), x)[1])(torch.ones(2, 3))
    assert seen.shape == (2, 3)


def test_a_hologram_shows_its_quality():
    display = Display(Modulator((40, 48), 8e-6), 532e-9, 2e-3)
    found = optimise(display, torch.rand(40, 48), run=Run(iterations=2, progress=False))
    page = page_of(found)
    assert page["2 mm"][:2] == ["532 nm", f"{float(found.psnr):.1f} dB"]
    assert [name for name, _ in page.images] == ["target", "image", "pattern"]
    assert (page.drawn(2) == np.round(found.phases[0].numpy() * 255 / (2 * np.pi))).all()


def test_a_hologram_of_several_planes_shows_each():
    display = Display(Modulator((40, 48), 8e-6), 532e-9, [2e-3, 4e-3])
    found = optimise(display, torch.rand(2, 1, 40, 48), run=Run(iterations=2, progress=False))
    page = page_of(found)
    assert [name for name, _ in page.images] == [
        "target, 2 mm",
        "image, 2 mm",
        "target, 4 mm",
        "image, 4 mm",
        "pattern",
    ]
    for plane in (0, 1):
        assert (page.drawn(2 * plane + 1)[..., 0] == np.round(255 * found.pictures(plane)[0].numpy())).all()
    assert (page.drawn(1) != page.drawn(3)).any()


def test_numbers_of_first_order_reports_and_panels_are_tables():
    found = first_order(load_system("cooke_triplet"))
    page = page_of(found)
    assert page["f number"] == "4.00008" and len(page.rows) == 1 + len(found._fields)
    page = page_of(Modulator((32, 48), (8e-6, 9e-6)))
    assert "32 × 48" in page.title and page["pitch"] == "(8e-06, 9e-06)" and page["fill"] == "0.9"
    sharp = page_of(odak.wave.sampling_report([64, 64], 8e-6, 532e-9, 1e-3))
    assert sharp["recommended"][1:-1] in sharp.title and sharp["distance"] == "0.001" and sharp.notes == []
    poor = page_of(odak.wave.sampling_report([64, 64], 8e-6, 532e-9, 1e-3, tolerance=1e-14))
    assert len(poor.notes) == 1 and "more than the tolerance of 1.0e-14" in poor.notes[0]


@pytest.mark.parametrize("widgets", [True, False])
def test_progress_bars_are_widgets_where_these_can_be_shown(monkeypatch, widgets):
    import tqdm
    import tqdm.auto

    monkeypatch.setitem(sys.modules, "ipykernel", types.ModuleType("ipykernel"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object() if widgets else None)
    monkeypatch.setattr(tqdm.auto, "tqdm", widget := type("widget", (tqdm.tqdm,), {}))
    found = runpy.run_path(str(Path(odak.__file__).parent / "_bars.py"))["tqdm"]
    assert found is (widget if widgets else tqdm.tqdm)


def test_matplotlib_is_loaded_when_something_is_drawn():
    """It takes as long to load as all else but torch: only modules that draw have it at their top."""
    drawing = {"odak._drawn", "odak.learn.raytracing.system.drawing", "odak.learn.wave.displays.sections"}
    for module, path in structure.modules().items():
        if module not in drawing and not module.startswith("odak.cli."):
            loaded = set(re.findall(r"^(?:from|import) ([\w.]+)", path.read_text(encoding="utf-8"), re.MULTILINE))
            assert not loaded & drawing and not any(name.startswith("matplotlib") for name in loaded), module


def test_small_pictures_are_enlarged_and_keep_their_shape():
    pictures = [("tall", _show.png(np.zeros((60, 20)))), ("wide", _show.png(np.zeros((30, 240))))]
    page = _show.to_html(_show.View("two", pictures))
    assert page.count("pixelated") == 1 and "width:80px;image-rendering:pixelated" in page
