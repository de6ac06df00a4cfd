"""`odak eyebox` from pictures to patterns whose views an independent propagation judges."""

import json
import math

import numpy as np
import pytest
from command import invoke
from PIL import Image

from odak.cli import main

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


def seen(phase, x):
    """Return means of the light on the retina: Fresnel's integral from square pixels to the pupil, and back."""
    here = (np.arange(N) - N // 2) * PITCH
    fine = np.arange(-0.55e-3, 0.55e-3, 8e-6)
    aside = fine + x

    def lines(pupil, places, width=0.0):
        away = pupil[:, None] - places
        wave = np.exp(1j * np.pi / (WAVELENGTH * DISTANCE) * away**2)
        return wave * np.sinc(width * away / (WAVELENGTH * DISTANCE))

    width = 0.9**0.5 * PITCH
    there = lines(fine, here, width) @ np.exp(1j * phase) @ lines(aside, here, width).T
    there = there * (fine[:, None] ** 2 + fine**2 < 0.5e-3**2)
    points = (here[:, None] + (np.arange(4) - 1.5) / 4 * PITCH).reshape(-1)
    light = abs(lines(fine, points).conj().T @ there @ lines(aside, points).conj()) ** 2
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
