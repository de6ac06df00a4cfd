"""Computation of metamers for `odak metamer`: pictures that look the same as another to a fixed gaze."""

import math
from typing import Any

import torch
from tqdm import tqdm

from odak.cli import files, report
from odak.cli.job import image_path
from odak.cli.options import refusing
from odak.cli.report import about, decibels, find_device
from odak.cli.settings import MetamerSettings
from odak.cli.target import read_picture

STAGES = 3
# Side of the patches whose texture is compared, levels of their pyramid, and the least size of pooling within them.
PATCH, PATCH_LEVELS, PATCH_POOLING = 128, 4, 2.0
NAMES = ("metamer.png", "pooling_map.png", "comparison.png")


@files.claiming
def run(job: MetamerSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Make the metamer of a picture; write metamer.png, pooling_map.png, comparison.png and report.json.

    Parameters
    ----------
    job : MetamerSettings
        Settings of the run.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report: "psnr_db" of the metamer, "largest_pooling" in pixels, "loss": the metameric loss of the metamer as
        saved, over the whole picture, and "noise_loss": the loss of the picture with white noise of the same squared
        error; "texture_distance" and "noise_texture_distance": the same by the statistics of textures.

    Raises
    ------
    InputError
        If the picture, the device or the output folder cannot be used.
    """
    device = find_device(job.device)
    path = image_path(job.image)
    picture = read_picture(path)[None].to(device)
    folder = files.writable_folder(job.output)
    parameters = job.values("image")
    mark = files.fingerprint({"command": "metamer", **parameters, "device": None}, [path])
    if (kept := files.kept_report(folder, mark, notices)) is not None:
        return kept
    files.announce(folder, [*NAMES, files.REPORT], notices)
    from odak.learn.perception import MetamericLoss, MetamerMSELoss, Viewing, make_pooling_size_map_pixels
    from odak.learn.perception.metamers import metamer_stages

    view: dict[str, Any] = {
        "alpha": job.alpha,
        "mode": job.mode,
        "viewing": Viewing(job.width, job.distance, gaze=job.gaze),
    }
    bands: dict[str, Any] = {
        "n_pyramid_levels": job.levels,
        "n_orientations": job.orientations,
        "joint": job.joint,
        "nominal_width": job.nominal_width,
    }
    evaluations = sum(count for _, count in metamer_stages(job.iterations, job.joint))
    with tqdm(total=STAGES + evaluations, desc="metamer", unit="step", disable=job.quiet) as bar:
        pooling = make_pooling_size_map_pixels(None, picture.shape[-2:], **view)
        bar.update()
        rows, columns = picture.shape[-2:]
        told = (
            f"IMAGE of {rows} x {columns} pixels is too small for --levels {job.levels}: each level halves the size, "
            "and the last one must be larger than a neighbourhood of its statistics; use fewer levels"
        )
        with refusing(lambda _: told, ValueError):
            maker = MetamerMSELoss(device, **view, **bands)
            metamer = maker.gen_metamer(picture, None, job.seed, job.iterations, bar.update)
        bar.update()
        metamer = torch.round(metamer.clamp(0, 1) * 255) / 255
        error = float(((metamer - picture).double() ** 2).mean())
        noise = torch.randn(picture.shape, generator=torch.Generator().manual_seed(job.seed)).to(picture)
        loss = MetamericLoss(device, **view, **bands, use_l2_foveal_loss=False)
        with torch.no_grad():
            spoilt = picture + math.sqrt(error) * noise
            value, of_noise = (float(loss(shown, picture)) for shown in (metamer, spoilt))
            textures = [_texture_distance(shown, picture, pooling) for shown in (metamer, spoilt)]
        _write(folder, picture, metamer, pooling, job.width)
        bar.update()
    found = {"psnr_db": decibels(error), "largest_pooling": float(pooling.max()), "loss": value, "noise_loss": of_noise}
    found |= dict(zip(("texture_distance", "noise_texture_distance"), textures, strict=True))
    given = {"command": "metamer", "picture": str(path), "parameters": parameters}
    return files.write_report(folder, {**found, **given, **about("metamer")}, mark, NAMES)


def _texture_distance(shown, picture, pooling):
    """Return the mean squared difference of the texture of two pictures in squares where no pixel is resolved."""
    from odak.learn.perception import texture_statistics

    corners = [range(0, side - PATCH + 1, PATCH) for side in picture.shape[-2:]]
    squares = [(slice(top, top + PATCH), slice(left, left + PATCH)) for top in corners[0] for left in corners[1]]
    squares = [(..., *square) for square in squares if pooling[square].min() >= PATCH_POOLING]
    if not squares:
        return None
    one, two = (
        texture_statistics(torch.cat([whole.mean(1, keepdim=True)[square] for square in squares]), PATCH_LEVELS)
        for whole in (shown.clamp(0, 1), picture)
    )
    return sum(float((one[name] - two[name]).square().mean()) for name in one)


def _write(folder, picture, metamer, pooling, width) -> None:
    # A map of doublings: black is one pixel, white the largest region.
    levels = torch.log2(pooling.clamp_min(1))[None]
    shade = levels / levels.max().clamp_min(1e-6)
    files.write_png(folder / NAMES[0], report.to_image(metamer[0]))
    files.write_png(folder / NAMES[1], report.to_image(shade))
    panels = [
        report.picture_panel("Picture", picture[0].cpu()),
        report.picture_panel("Metamer", metamer[0].cpu()),
        report.picture_panel(f"Pooling, 1 (black) to {float(pooling.max()):.3g} px", shade.cpu()),
    ]
    files.write_png(folder / NAMES[2], report.sheet([panels], width))
