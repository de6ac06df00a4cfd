"""castleCSF, the contrast sensitivity that ColorVideoVDP uses, from the tables of that package."""

import functools
import importlib.util
import json
from pathlib import Path

import torch

from odak import _validate
from odak.learn.perception.csf import _numbers

PACKAGE, MODULE = "cvvdp", "pycvvdp"
TABLES = ("vvdp_data", "csf_lut_weber_fixed_size.json")
CHANNELS = ("achromatic", "red-green", "violet-yellow")
FLICKERS = (0, 5)


def castle_contrast_sensitivity(
    frequency: torch.Tensor | float,
    luminance: torch.Tensor | float = 100.0,
    channel: str = "achromatic",
    temporal_frequency: int = 0,
) -> torch.Tensor:
    """Return how sensitive the eye is to gratings of brightness or colour.

    Parameters
    ----------
    frequency : torch.Tensor or float
        In cycles per degree, positive; taken as 0.1 below that and as 64 above.
    luminance : torch.Tensor or float
        Mean of the grating, in cd/m²; taken as 0.005 below that and as 10 000 above.
    channel : {"achromatic", "red-green", "violet-yellow"}
        Direction in which the grating varies; flicker is known for the first alone.
    temporal_frequency : {0, 5}
        In hertz.

    Returns
    -------
    torch.Tensor
        Sensitivity of the broadcast shape, float64 of plain numbers: one over the contrast, as ColorVideoVDP defines
        it, that can just be seen in a patch of 1.5° radius. Differentiable in frequency and luminance.

    Raises
    ------
    ImportError
        If the package with the tables is missing; the message says what to install.
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Ashraf, Mantiuk, Chapiro and Wuerger, J. Vis. 24, 5 (2024). Logarithms are interpolated linearly between 32
    frequencies and 32 luminances. :func:`odak.learn.perception.contrast_sensitivity` needs no table.
    """
    channel = _validate.one_of("channel", channel, CHANNELS)
    if temporal_frequency not in FLICKERS or (temporal_frequency and channel != CHANNELS[0]):
        raise ValueError(
            f"temporal_frequency must be 0, or 5 for the achromatic channel, got {temporal_frequency!r} for {channel!r}"
        )
    frequency, luminance = _numbers(frequency=frequency, luminance=luminance)
    frequency, luminance = torch.broadcast_tensors(frequency, luminance)
    tables = _tables()
    values = tables[f"o{temporal_frequency}_c{CHANNELS.index(channel) + 1}"].to(frequency)
    rows, down = _place(luminance.log10(), tables["L_bkg"].log10().to(frequency))
    columns, across = _place(frequency.log10(), tables["rho"].log10().to(frequency))
    near, far = (torch.lerp(values[rows + step, columns], values[rows + step, columns + 1], across) for step in (0, 1))
    return 10 ** torch.lerp(near, far, down)


def _place(value, knots):
    """Return between which knots values lie, and how far from the lower one, 0 to 1."""
    value = value.clamp(knots[0], knots[-1])
    index = (torch.searchsorted(knots, value.detach().contiguous(), right=True) - 1).clamp(0, len(knots) - 2)
    return index, (value - knots[index]) / (knots[index + 1] - knots[index])


def _tables():
    # Found without importing the package, which takes seconds and needs much else.
    spec = importlib.util.find_spec(MODULE)
    if spec is None or not spec.submodule_search_locations:
        raise ImportError(
            f"castle_contrast_sensitivity needs the tables of the package {PACKAGE}: pip install {PACKAGE}"
        )
    return _read(Path(next(iter(spec.submodule_search_locations))).joinpath(*TABLES))


@functools.lru_cache(maxsize=2)
def _read(path):
    tables = json.loads(path.read_text(encoding="utf-8"))
    with torch.inference_mode(False):
        return {
            name: torch.tensor(value, dtype=torch.float64) for name, value in tables.items() if isinstance(value, list)
        }
