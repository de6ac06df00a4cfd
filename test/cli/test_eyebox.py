"""`odak eyebox`, and `odak hologram` of scenes that eyes look at, whose views an independent propagation judges."""

import json
import math

import numpy as np
import pytest
import torch
from command import invoke
from PIL import Image

from odak.cli import light_field, main
from odak.cli.job import Job
from odak.cli.light_field import load_light_field
from odak.learn.raytracing import triangle_mesh
from odak.learn.wave import (
    Display,
    Eyes,
    LightField,
    Modulator,
    Placement,
    Splats,
    save_splats,
    views_of_mesh,
    views_of_splats,
)

N, PITCH, DISTANCE, WAVELENGTH = 33, 8e-6, 0.03, 532e-9
SMALL = ["--resolution", str(N), str(N), "--distance", "3cm", "--pupil", "1mm", "--spacing", "0.9mm", "--device", "cpu"]


def run(*arguments):
    result = invoke("eyebox", *arguments, *SMALL)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result


def decibels(light, target):
    return -10 * math.log10(((light - target) ** 2).mean())


@pytest.fixture
def views(tmp_path):
    """Write two pictures, a bar to each side."""
    paths = []
    for name, columns in (("left", slice(4, 14)), ("right", slice(18, 28))):
        values = np.zeros((N, N), np.uint8)
        values[6:26, columns] = 255
        paths.append(tmp_path / f"{name}.png")
        Image.fromarray(values).save(paths[-1])
    return paths


def seen(phase, x, y=0.0):
    """Return means of the light on the retina: Fresnel's integral from square pixels to the pupil, and back."""
    here = (np.arange(N) - N // 2) * PITCH
    fine = np.arange(-0.55e-3, 0.55e-3, 8e-6)
    aside, above = fine + x, fine + y

    def lines(pupil, places, width=0.0):
        away = pupil[:, None] - places
        wave = np.exp(1j * np.pi / (WAVELENGTH * DISTANCE) * away**2)
        return wave * np.sinc(width * away / (WAVELENGTH * DISTANCE))

    width = 0.9**0.5 * PITCH
    there = lines(above, here, width) @ np.exp(1j * phase) @ lines(aside, here, width).T
    there = there * (fine[:, None] ** 2 + fine**2 < 0.5e-3**2)
    points = (here[:, None] + (np.arange(4) - 1.5) / 4 * PITCH).reshape(-1)
    light = abs(lines(above, points).conj().T @ there @ lines(aside, points).conj()) ** 2
    return light.reshape(N, 4, N, 4).mean((1, 3))


def test_each_place_sees_its_picture(views, tmp_path):
    out = tmp_path / "out"
    result = run(*views, "--output", out, "--places", 1, 2, "--frames", 3, "--iterations", 60)
    report = json.loads((out / "report.json").read_text())
    names = [f"hologram_frame{k}.png" for k in (1, 2, 3)]
    assert sorted(path.name for path in out.iterdir()) == [*names, "report.json", "views.png"]
    assert "pupil at 0, -0.45 mm: PSNR" in result.stdout
    phases = [np.asarray(Image.open(out / name)) * (2 * np.pi / 256) for name in names]
    lights = np.stack([np.mean([seen(phase, x) for phase in phases], 0) for x in (-0.45e-3, 0.45e-3)])
    targets = np.stack([np.asarray(Image.open(path)) / 255 for path in views])
    lights *= (lights * targets).sum() / (lights**2).sum()
    for view, light, target in zip(report["views"], lights, targets, strict=True):
        assert abs(view["psnr_db"] - decibels(light, target)) < 0.3
        assert decibels(light, target) > decibels(light, targets[::-1].sum(0) - target) + 3


def test_a_picture_for_all_places_and_what_was_meant(tmp_path, capsys, views):
    quiet = run(
        views[0], "--output", tmp_path / "a", "--places", 2, 1, "--iterations", 1, "--learning-rate", 0.2, "--quiet"
    )
    assert quiet.output == ""
    report = json.loads((tmp_path / "a" / "report.json").read_text())
    assert [view["place"] for view in report["views"]] == [pytest.approx([y, 0]) for y in (-4.5e-4, 4.5e-4)]
    for arguments, named in (
        (["--places", "3", "3"], "reach beyond the light of the pixels, 2 x 2 mm at --distance 0.03"),
        ([str(views[0])] * 2, "IMAGE must be given once, or 3 times for --places 1 3, got 2 pictures"),
        (["--bits", "17"], "--bits must be from 1 to 16, got 17"),
    ):
        assert main(["eyebox", *SMALL, *arguments, "-o", str(tmp_path / "b")]) == 2
        assert named in capsys.readouterr().err
        assert not (tmp_path / "b").exists()


@pytest.mark.usefixtures("sheets")
def test_stored_values_are_decoded_to_light(tmp_path):
    """The middle of the stored values is 0.2140 of the light of white, by IEC 61966-2-1."""
    from odak.cli.eyebox_views import _target
    from odak.cli.settings import EyeboxSettings

    path = tmp_path / "grey.png"
    Image.fromarray(np.full((N, N), 128, np.uint8)).save(path)
    decoded, stored = (
        _target(path, EyeboxSettings(images=(str(path),), resolution=(N, N), linear=linear)) for linear in (False, True)
    )
    light = ((128 / 255 + 0.055) / 1.055) ** 2.4
    assert np.allclose(decoded.numpy(), light, atol=1e-4) and np.allclose(stored.numpy(), 128 / 255, atol=1e-6)
    run(path, "--output", tmp_path / "out", "--places", 1, 1, "--frames", 1, "--iterations", 1, "--quiet")
    # The picture, enlarged, as it is on a screen.
    sheet = np.asarray(Image.open(tmp_path / "out" / "views.png").convert("L"))
    assert (sheet == 128).sum() > 9 * N * N


# --- Scenes of `odak hologram`

EYES = ["--resolution", N, N, "--distance", "3cm", "--pupil", "1mm", "--device", "cpu", "--quiet"]


def field_of(**given):
    """Return views of a poster behind the panel from a grid of places: shifted by their parallax."""
    side = torch.linspace(-1e-3, 1e-3, 5, dtype=torch.float64)
    places = torch.cartesian_prod(side, side)
    views = torch.zeros(len(places), N, N)
    for view, (y, x) in zip(views, (places * (1 - DISTANCE / 0.034) / PITCH).round().long().tolist(), strict=True):
        view[10 + y : 24 + y, 12 + x : 20 + x] = 1.0
    return LightField(views, places, **given)


def on_eyes(places, wavelengths=WAVELENGTH):
    return Display(Modulator((N, N), PITCH), wavelengths, Eyes(DISTANCE, places, 1e-3))


def hologram(*arguments):
    result = invoke("hologram", *EYES, *arguments)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return json.loads((arguments[arguments.index("-o") + 1] / "report.json").read_text())


def test_views_are_seen_from_pupils_that_were_optimised_and_from_others(tmp_path):
    field, out = field_of(), tmp_path / "out"
    field.save(tmp_path / "views")
    options = "--linear", "--eyebox", "0.6mm", "--pupils", 4, "--observer", "registered", "--iterations", 12, "-o", out
    report = hologram("--views", tmp_path / "views", *options)
    (channel,) = report["channels"]
    phase = np.asarray(Image.open(out / channel["file"])) * (2 * np.pi / 256)
    judged = channel["pupils"]["judged"]
    places = [tuple(one["place"]) for one in judged]
    assert places == [pytest.approx((y, x)) for y in (-3e-4, 0, 3e-4) for x in (-3e-4, 0, 3e-4)]
    wanted = field.images(on_eyes(places))[:, 0].numpy()
    lights = np.stack([seen(phase, x, y) for y, x in places])
    lights *= (lights * wanted).sum() / (lights**2).sum()
    for one, light, target in zip(judged, lights, wanted, strict=True):
        assert abs(one["psnr_db"] - decibels(light, target)) < 0.3
    assert channel["pupils"]["optimised"][0]["place"] == [0.0, 0.0] and len(channel["pupils"]["optimised"]) == 4
    assert report["psnr_db"] == pytest.approx(min(one["psnr_db"][0] for one in channel["pupils"]["optimised"]))
    assert report["psnr_unseen_db"] == pytest.approx(min(one["psnr_db"] for one in channel["pupils"]["judged"]))
    # The left pupil sees what the right one does not.
    assert decibels(lights[3], wanted[3]) > decibels(lights[3], wanted[5]) + 2
    assert sorted(path.name for path in out.iterdir()) == sorted(
        [channel["file"], "comparison.png", "reconstruction.png", "report.json", "views.png"]
    )
    again = hologram("--views", tmp_path / "views" / "views.csv", *options[:-1], tmp_path / "again")
    assert again["psnr_unseen_db"] == report["psnr_unseen_db"]


def test_a_changed_view_is_another_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(light_field, "_JUDGED", 1)
    field, out = field_of(), tmp_path / "out"
    field.save(tmp_path / "views")
    table = tmp_path / "views" / "views.csv"
    options = "--linear", "--pupils", 1, "--iterations", 1, "-o", out
    first = hologram("--views", table, *options)
    assert hologram("--views", table, *options) == first
    Image.fromarray(np.full((N, N), 200, np.uint8)).save(tmp_path / "views" / "view_12.png")
    assert hologram("--views", table, *options, "--again")["fingerprint"] != first["fingerprint"]


def test_a_mesh_and_splats_stand_in_the_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(light_field, "_JUDGED", 1)
    base = [[-1.0, -1, 0], [1, -1, 0], [1, 1, 0.4], [-1, 1, 0.4]]
    corners = torch.tensor([*base, [0.3, 0.3, 1], [0.9, 0.3, 1], [0.9, 0.9, 1]])
    mesh = triangle_mesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6]]))
    mesh.write_PLY(str(tmp_path / "mesh.ply"))
    splats = Splats(corners, torch.ones(7, 4), torch.full((7, 3), -2.0), torch.ones(7), torch.randn(7, 1, 3))
    save_splats(str(tmp_path / "splats.ply"), splats)
    written = (tmp_path / "splats.ply").read_bytes()
    (tmp_path / "splats.ply").write_bytes(written.replace(b"end_header", b"comment antialiased 1\nend_header", 1))
    options = "--pupils", 1, "--sides", 3, "--eyebox", "0.4mm,0.2mm", "--turned", 0, 20, 0, "--plane", "31mm"
    options = *options, "--iterations", 1, "-o"
    for kind, wavelengths in (("mesh", (WAVELENGTH,)), ("splats", (638e-9, 520e-9, 450e-9))):
        out = tmp_path / kind
        report = hologram(f"--{kind}", tmp_path / f"{kind}.ply", *options, out)
        assert [channel["wavelength"] for channel in report["channels"]] == list(wavelengths)
        given = {kind: str(tmp_path / f"{kind}.ply"), "eyebox": (0.4e-3, 0.2e-3), "sides": 3, "pupils": 1}
        given |= {"turned": (0.0, 20.0, 0.0), "plane": 0.031, "resolution": (N, N), "distance": DISTANCE}
        job = Job(**given, pupil=1e-3)
        assert {name: report["parameters"][name] for name in ("plane", "sides", kind)} == {
            name: given[name] for name in ("plane", "sides", kind)
        }
        target = load_light_field(job)
        display = on_eyes([(0.0, 0.0)], wavelengths)
        sides = [torch.linspace(-1, 1, 3, dtype=torch.float64) * (1.3 * side + 1e-3) / 2 for side in (0.4e-3, 0.2e-3)]
        places = torch.cartesian_prod(*sides)
        stands = Placement.fitting(corners, display, 0.031, (0.0, 20.0, 0.0), 1.0 if kind == "mesh" else 0.96)
        if kind == "mesh":
            field = views_of_mesh(mesh, display, places, stands)
        else:
            field = views_of_splats(splats, display, places, stands, antialiased=True)
        found = field.images(display)[0]
        torch.testing.assert_close(target.intensity, found.float(), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--views", "none"], "--views must exist, got"),
        (["--views", ".", "--mesh", "."], "--views and --mesh are scenes: give one of them"),
        (["photo", "--mesh", "."], "IMAGE has no effect with --mesh, which is the picture"),
        (["--eyebox", "3mm"], "--eyebox has no effect without --views, --mesh or --splats"),
        (["--views", ".", "--sides", "3"], "--sides has no effect without --mesh or --splats"),
        (["--mesh", ".", "--method", "gs"], "--method gs cannot be used with --mesh"),
        (["--mesh", ".", "--fill-factor", "0"], "--fill-factor 0 cannot be used with --mesh"),
        (["--eyebox", "1mm,2mm,3mm", "--mesh", "."], "must be a length, or two with a comma"),
        (["--views", "."], "must be a table of views"),
        (["--mesh", "here.ply"], "--mesh"),
        (["--splats", "here.ply"], "--splats"),
    ],
)
def test_what_eyes_do_not_see_is_refused(tmp_path, capsys, monkeypatch, arguments, named):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here.ply").write_text("ply\n")
    assert main(["hologram", *arguments, "-o", str(tmp_path / "out")]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
