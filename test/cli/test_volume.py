"""`odak hologram` with planes and with colours that share frames."""

import numpy as np
import pytest
import torch
from command import SMALL, angular_spectrum_intensity, pixels, read_report, run
from PIL import Image

from odak.cli import main
from odak.learn.wave import Display, Modulator

pytestmark = pytest.mark.usefixtures("small_judge")

ROWS, COLUMNS = 48, 72
VOLUME = ["--resolution", ROWS, COLUMNS, "--distance", "5e-3", "--volume-depth", "2e-3", "--device", "cpu", "--quiet"]
VOLUME += ["--linear"]
DEEP = ["--grating", "--bits", "10"]
WAVELENGTHS = (638e-9, 520e-9, 450e-9)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A colour picture and its depth: the left half near, the right half far."""
    folder = tmp_path_factory.mktemp("scene")
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    waves = [0.5 + 0.4 * np.sin((x + 5 * c) / (6 + c)) * np.cos(y / (5 + c)) for c in range(3)]
    Image.fromarray(np.round(255 * np.stack(waves, -1)).astype(np.uint8)).save(folder / "picture.png")
    Image.fromarray(np.where(x < COLUMNS // 2, 0, 255).astype(np.uint8)).save(folder / "depth.png")
    return folder / "picture.png", folder / "depth.png"


def psnr(image, target, mask=True):
    return 10 * np.log10(1 / np.mean(((image - target) ** 2)[np.broadcast_to(mask, target.shape)]))


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("multiplane", DEEP),
        pytest.param("multi-color", [], marks=pytest.mark.slow),
        pytest.param("multi-color", DEEP, marks=pytest.mark.slow),
        ("network", []),
    ],
)
@pytest.mark.usefixtures("sheets")
def test_report_states_what_the_saved_patterns_show(method, options, files, tmp_path):
    picture, depth = files
    iterations = [] if method == "network" else ["--iterations", 12]
    distance, planes = ("3e-3", [2.5e-3, 3.5e-3]) if method == "network" else ("5e-3", [4e-3, 6e-3])
    volume = ["--distance", distance, "--volume-depth", planes[1] - planes[0]]
    run(picture, "--planes", 2, "--depth-map", depth, "--method", method, *iterations, *options, "--fill-factor", 0,
        "--output", tmp_path, *VOLUME, *volume)  # fmt: skip
    report = read_report(tmp_path)
    target = pixels(picture) / 255
    near = np.arange(COLUMNS)[None, :] < COLUMNS // 2
    turn = 2 * np.pi / (65536 if options else 256)
    grating = np.pi * (np.arange(COLUMNS) % 2 == 0) if options else 0
    phases = [pixels(tmp_path / name) * turn - grating for name in report["pattern"]["files"]]
    powers = np.array([frame["source_amplitudes"] for frame in report["frames"]])
    assert powers.shape == (3, 3)
    assert [plane["distance"] for plane in report["planes"]] == pytest.approx(planes)
    assert powers.max() == pytest.approx(1)
    light = []
    for c, wavelength in enumerate(WAVELENGTHS):
        stack = [
            sum(
                power**2 * angular_spectrum_intensity(phase, wavelength, 8e-6, plane["distance"])
                for power, phase in zip(powers[:, c], phases, strict=True)
            )
            / np.sum(powers[:, c] ** 2)
            for plane in report["planes"]
        ]
        sharp = np.where(near, *stack)
        light.append(np.sum(powers[:, c] ** 2) * sharp)
        scale = report["brightness"] * np.sum(powers[:, c] ** 2)
        channel = report["channels"][c]
        assert channel["scale"] == pytest.approx(scale, rel=2e-3)
        assert channel["psnr_db"] == pytest.approx(psnr(scale * sharp, target[..., c]), abs=0.02)
        assert channel["efficiency"] == pytest.approx(sharp.mean(), rel=2e-3)
        for plane, image, mask in zip(report["planes"], stack, (near, ~near), strict=True):
            assert plane["share_in_focus"] == 0.5
            in_focus = psnr(scale * image, target[..., c], mask)
            assert plane["channels"][c]["psnr_in_focus_db"] == pytest.approx(in_focus, abs=0.02)
            assert in_focus > 13
    # One brightness for all colours.
    light = np.stack(light, -1)
    scale = np.sum(light * target) / np.sum(light**2)
    assert report["brightness"] == pytest.approx(scale, rel=2e-3)
    assert report["psnr_db"] == pytest.approx(psnr(scale * light, target), abs=0.02)
    shown = pixels(tmp_path / "reconstruction.png") / 255
    assert np.abs(shown - np.clip(scale * light, 0, 1)).max() < 3e-3
    assert report["psnr_db"] > 14
    assert {path.name for path in tmp_path.iterdir()} == {
        *report["pattern"]["files"], "reconstruction.png", "comparison.png", "focal_stack.png", "report.json",
    }  # fmt: skip
    assert pixels(tmp_path / "focal_stack.png").shape[1] > 2 * COLUMNS


@pytest.mark.slow
@pytest.mark.parametrize("method", ["multiplane", "multi-color"])
def test_areas_are_optimised_and_stated_on_all_planes(method, files, tmp_path):
    picture, depth = files
    options = ["--planes", 2, "--depth-map", depth, "--method", method, "--iterations", 15, *VOLUME]
    run(picture, *options, "--output", tmp_path / "areas")
    run(picture, *options, "--fill-factor", 0, "--output", tmp_path / "points")
    areas, points = (read_report(tmp_path / name) for name in ("areas", "points"))
    powers = torch.tensor([frame["source_amplitudes"] for frame in areas["frames"]]).square()
    phases = [pixels(tmp_path / "areas" / name) * (2 * np.pi / 256) for name in areas["pattern"]["files"]]
    display = Display(Modulator((ROWS, COLUMNS), 8e-6), WAVELENGTHS, [4e-3, 6e-3], 3, powers)
    images, _ = display.judge(torch.from_numpy(np.stack(phases)))
    light = powers.sum(0).numpy()[:, None, None] * np.where(np.arange(COLUMNS) < COLUMNS // 2, *images.numpy())
    target = pixels(picture).transpose(2, 0, 1) / 255
    shown = light * (light * target).sum() / (light**2).sum()
    for c, channel in enumerate(areas["channels"]):
        assert channel["psnr_area_db"] == pytest.approx(psnr(shown[c], target[c]), abs=0.15)
    assert areas["psnr_db"] > np.mean([channel["psnr_area_db"] for channel in points["channels"]]) + 1.5
    assert np.mean([channel["psnr_points_db"] for channel in areas["channels"]]) < areas["psnr_db"] - 1.5


def test_planes_choose_the_method_and_the_scene_its_depth(tmp_path):
    run("scene", "--planes", 3, "--iterations", 2, "--output", tmp_path, *VOLUME)
    report = read_report(tmp_path)
    assert report["parameters"]["method"] == "multiplane"
    assert report["parameters"]["depth_map"] == "scene"
    assert report["parameters"]["initial_phase"] == "gs" and report["parameters"]["optimizer"] == "lbfgs"
    assert np.linalg.matrix_rank(np.array([frame["source_amplitudes"] for frame in report["frames"]])) == 3
    shares = [plane["share_in_focus"] for plane in report["planes"]]
    assert sum(shares) == pytest.approx(1)
    assert min(shares) > 0.1


@pytest.mark.parametrize("frames", [None, pytest.param(2, marks=pytest.mark.slow)])
def test_colours_share_frames_on_one_plane(frames, files, tmp_path):
    options = [] if frames is None else ["--frames", frames]
    volume = [part for part in VOLUME if part not in ("--volume-depth", "2e-3")]
    run(files[0], "--method", "multi-color", "--iterations", 10, *options, "--output", tmp_path, *volume)
    report = read_report(tmp_path)
    count = frames or 3
    assert report["pattern"]["files"] == [f"hologram_frame{k + 1}.png" for k in range(count)]
    assert np.shape([frame["source_amplitudes"] for frame in report["frames"]]) == (count, 3)
    assert report["psnr_db"] > 12
    assert not (tmp_path / "focal_stack.png").exists()
    first = pixels(tmp_path / "hologram_frame1.png")
    run(files[0], "--method", "multi-color", "--iterations", 10, *options, "--output", tmp_path / "b", *volume)
    assert np.array_equal(first, pixels(tmp_path / "b" / "hologram_frame1.png"))


@pytest.mark.slow
def test_saturated_colours_keep_their_sources_low(files, tmp_path):
    """A red picture needs no blue light: the sources are not driven at full power."""
    with Image.open(files[0]) as picture:
        red = np.asarray(picture) * np.array([1.0, 0.2, 0.05])
    Image.fromarray(np.round(red).astype(np.uint8)).save(tmp_path / "red.png")
    volume = [part for part in VOLUME if part not in ("--volume-depth", "2e-3")]
    run(tmp_path / "red.png", "--method", "multi-color", "--iterations", 60, "--output", tmp_path / "out", *volume)
    report = read_report(tmp_path / "out")
    amplitudes = np.array([frame["source_amplitudes"] for frame in report["frames"]])
    assert (amplitudes[:, 2] ** 2).sum() < 0.2 * (amplitudes[:, 0] ** 2).sum()
    assert report["psnr_db"] > 20


def test_a_grey_picture_and_a_larger_depth_map(files, tmp_path):
    with Image.open(files[1]) as depth:
        depth.resize((COLUMNS * 3, ROWS * 3)).save(tmp_path / "large.png")
    run(files[0], "--grey", "--planes", 2, "--depth-map", tmp_path / "large.png", "--iterations", 3,
        "--output", tmp_path / "out", *VOLUME)  # fmt: skip
    report = read_report(tmp_path / "out")
    assert report["pattern"]["files"] == ["hologram_532nm.png"]
    assert [plane["share_in_focus"] for plane in report["planes"]] == [0.5, 0.5]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--planes", "0"], "--planes must be at least 1"),
        (["--planes", "2"], "--planes 2 needs --depth-map"),
        (["--depth-map", "{depth}"], "--depth-map needs --planes"),
        (["--planes", "2", "--depth-map", "nowhere.png"], "--depth-map not found"),
        (["--planes", "2", "--depth-map", "{flat}"], "--depth-map must have at least two depths"),
        (["--planes", "2", "--depth-map", "{narrow}"], "--depth-map must have the picture's shape"),
        (
            ["--planes", "2", "--depth-map", "{depth}", "--method", "sgd"],
            "needs --method multiplane, multi-color or network",
        ),
        (["--planes", "2", "--depth-map", "{depth}", "--volume-depth", "1"], "--volume-depth must be less than"),
        (["--volume-depth", "0"], "--volume-depth must be positive"),
        (["--frames", "0"], "--frames must be at least 1"),
        (["--frames", "2", "--method", "gs"], "--frames needs --method sgd or multi-color"),
    ],
)
def test_bad_input_is_one_line_and_code_2(options, message, files, tmp_path, capsys):
    Image.new("L", (COLUMNS, ROWS), 7).save(tmp_path / "flat.png")
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(tmp_path / "narrow.png")
    names = {"depth": files[1], "flat": tmp_path / "flat.png", "narrow": tmp_path / "narrow.png"}
    arguments = [str(option).format(**names) for option in options]
    small = [str(word) for word in SMALL]
    assert main(["hologram", str(files[0]), *small, *arguments, "--output", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr().err
    assert message in captured
    assert captured.count("\n") == 1
    assert not (tmp_path / "out" / "report.json").exists()


@pytest.mark.slow
def test_planes_and_colours_reach_their_quality(tmp_path):
    torch.manual_seed(0)
    size = ["--resolution", 135, 240, "--distance", "0.02", "--iterations", 15, "--device", "cpu", "--quiet"]
    for method, whole, each in (("multiplane", 21.5, 21.0), ("multi-color", 19.0, 17.0)):
        run("scene", "--planes", 3, "--method", method, "--output", tmp_path / method, *size)
        report = read_report(tmp_path / method)
        assert report["psnr_db"] > whole
        for plane in report["planes"]:
            for channel in plane["channels"]:
                assert channel["psnr_in_focus_db"] > each
