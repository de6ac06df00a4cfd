"""`odak metamer`: from a picture to one that looks the same to an eye that looks elsewhere."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from tqdm import tqdm

from odak import _validate
from odak.cli import files, pictures
from odak.cli.errors import InputError
from odak.cli.job import image_path
from odak.cli.run import find_device

STAGES = 3
LEARNING_RATE = 0.01


@dataclass(frozen=True)
class MetamerJob:
    """Parameters of one run of `odak metamer`.

    Attributes
    ----------
    image : str
        Path of the picture, or the name of a shipped one: "photo", "chart".
    output : Path
        Folder to write to.
    gaze : tuple of float
        (x, y), 0 to 1 from the top-left corner.
    width, distance : float
        Width of the picture as shown and distance of the eye from it, in metres.
    alpha : float
        Growth of the pooling regions with eccentricity.
    mode : str
        "quadratic" or "linear".
    levels, orientations : int
        Of the pyramid.
    iterations : int
        Steps of gradient descent on the metameric loss.
    seed : int
        Seed of the noise.
    device : str
        "auto", "cpu", "cuda", "cuda:1", …
    quiet : bool
        Show no progress and no summary.
    """

    image: str = "photo"
    output: Path = Path("output")
    gaze: tuple[float, float] = (0.5, 0.5)
    width: float = 0.6
    distance: float = 0.7
    alpha: float = 0.2
    mode: str = "quadratic"
    levels: int = 5
    orientations: int = 2
    iterations: int = 0
    seed: int = 0
    device: str = "auto"
    quiet: bool = False

    def __post_init__(self) -> None:
        """Check every parameter; the messages name the option of the command line."""
        try:
            for value in self.gaze:
                _validate.real("--gaze", value)
            for name in ("width", "distance", "alpha"):
                _validate.real(f"--{name}", getattr(self, name), positive=True)
            _validate.integer("--levels", self.levels, minimum=2)
            _validate.integer("--orientations", self.orientations, minimum=1)
            _validate.integer("--iterations", self.iterations)
            _validate.integer("--seed", self.seed)
            object.__setattr__(self, "mode", _validate.one_of("--mode", self.mode, ("quadratic", "linear")))
        except (TypeError, ValueError) as error:
            raise InputError(str(error)) from None


def run(job: MetamerJob) -> dict:
    """Make the metamer of a picture; write metamer.png, pooling_map.png and comparison.png.

    Parameters
    ----------
    job : MetamerJob
        What was asked for.

    Returns
    -------
    dict
        "psnr_db" of the metamer, "largest_pooling" in pixels, and "loss": the metameric loss of the metamer as saved.

    Raises
    ------
    InputError
        If the picture, the device or the output folder will not do.
    """
    device = find_device(job.device)
    picture = _load(image_path(job.image)).to(device)
    folder = files.writable_folder(job.output)
    from odak.learn.perception import MetamericLoss, make_pooling_size_map_pixels

    geometry = {"real_image_width": job.width, "real_viewing_distance": job.distance}
    with tqdm(total=STAGES + job.iterations, desc="metamer", unit="step", disable=job.quiet) as bar:
        pooling = make_pooling_size_map_pixels(job.gaze, picture.shape[-2:], job.alpha, mode=job.mode, **geometry)
        bar.update()
        loss = MetamericLoss(
            device, job.alpha, n_pyramid_levels=job.levels, mode=job.mode, n_orientations=job.orientations, **geometry
        )
        metamer = _matched(job, picture, geometry)
        bar.update()
        metamer = _quantised(_refined(job, metamer, picture, loss, bar))
        with torch.no_grad():
            value = float(loss(metamer, picture, job.gaze))
        _write(folder, picture, metamer, pooling)
        bar.update()
    error = float(((metamer - picture).double() ** 2).mean())
    psnr = -10 * math.log10(error) if error else None
    return {"psnr_db": psnr, "largest_pooling": float(pooling.max()), "loss": value}


def _matched(job, picture, geometry):
    from odak.learn.perception import MetamerMSELoss

    maker = MetamerMSELoss(
        picture.device,
        job.alpha,
        mode=job.mode,
        n_pyramid_levels=job.levels,
        n_orientations=job.orientations,
        **geometry,
    )
    try:
        return maker.gen_metamer(picture, job.gaze, job.seed).clamp(0, 1)
    except ValueError as error:
        raise InputError(f"IMAGE is too small for --levels {job.levels}: {error}") from None


def _refined(job, metamer, picture, loss, bar):
    """Return the metamer after gradient descent on the metameric loss."""
    if not job.iterations:
        return metamer
    image = metamer.clone().requires_grad_()
    optimizer = torch.optim.Adam([image], lr=LEARNING_RATE)
    for _ in range(job.iterations):
        optimizer.zero_grad()
        loss(image, picture, job.gaze).backward()
        optimizer.step()
        with torch.no_grad():
            image.clamp_(0, 1)
        bar.update()
    return image.detach()


def _quantised(picture):
    """Return what an 8-bit file keeps of a picture."""
    return torch.round(picture * 255) / 255


def _write(folder, picture, metamer, pooling) -> None:
    # A map of doublings: black is one pixel, white the largest region.
    levels = torch.log2(pooling.clamp_min(1))[None]
    shade = levels / levels.max().clamp_min(1e-6)
    files.write_png(folder / "metamer.png", pictures.to_image(metamer[0]))
    files.write_png(folder / "pooling_map.png", pictures.to_image(shade))
    panels = [
        ("Picture", picture[0].cpu()),
        ("Metamer", metamer[0].cpu()),
        (f"Pooling, 1 (black) to {float(pooling.max()):.3g} px", shade.cpu()),
    ]
    files.write_png(folder / "comparison.png", pictures.side_by_side(panels))


def _load(path: Path) -> torch.Tensor:
    """Return a picture as ``[1, 1 or 3, rows, columns]``; transparent parts are black."""
    from odak.learn.tools import load_image

    try:
        picture = load_image(str(path), normalizeby=None).float()
    except (OSError, ValueError, TypeError) as error:
        raise InputError(" ".join(str(error).split())) from None
    picture = picture[None] if picture.ndim == 2 else picture.movedim(-1, 0)
    if len(picture) in (2, 4):
        picture = picture[:-1] * picture[-1:]
    if not bool(((picture >= 0) & (picture <= 1)).all()):
        raise InputError(f"IMAGE must hold values from 0 to 1, those of {str(path)!r} go beyond")
    return picture[None]
