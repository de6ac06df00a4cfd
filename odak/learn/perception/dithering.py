"""Dither: pictures for screens of few levels, by blue noise, diffusion of errors or frames shown in turn."""

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch.nn import functional

from odak import _array, _validate
from odak.learn._tensors import as_pictures, check_values, in_float64
from odak.learn.perception.color import srgb_decoded

METHODS = ("blue noise", "error diffusion", "white noise", "none")
MOST_BITS, MOST_FRAMES = 16, 256
# Side of the mask, standard deviation in pixels of the neighbourhood that void and cluster weighs (Ulichney 1993).
SIDE, SPREAD = 64, 1.5
# Fractions whose multiples are spread evenly over a square: powers of the plastic number.
_APART = 0.7548776662466927, 0.5698402909980532
_DECODED: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {"sRGB": srgb_decoded, "linear": lambda stored: stored}


def dither(
    image: torch.Tensor,
    bits: int | Sequence[int] = 1,
    method: str = "blue noise",
    *,
    frames: int | None = None,
    encoding: str | Callable[[torch.Tensor], torch.Tensor] = "sRGB",
    seed: int = 0,
) -> torch.Tensor:
    """Return pictures on the few levels of a screen whose light, averaged over pixels and frames, is that wanted.

    Parameters
    ----------
    image : torch.Tensor
        Stored values ``[..., C, H, W]``, 0 to 1; those outside are taken as the nearest.
    bits : int or sequence of int
        Of the screen, 1 to 16, which shows 2^bits equally spaced stored values; or those of each channel.
    method : {"blue noise", "error diffusion", "white noise", "none"}
        How a pixel gets one of the two levels around its light. By a threshold: from a tiled mask of 64 × 64 pixels
        whose neighbours differ, drawn for each pixel, or in the middle ("none"). Or the nearest, after which the
        neighbours on the right and below make up for the error.
    frames : int, optional
        Frames that are shown in turn, 1 to 256, so that pixels also reach levels between those of the screen.
    encoding : {"sRGB", "linear"} or callable
        Light of the stored values of the screen; or a rising function that returns it.
    seed : int
        Of the masks and the noise.

    Returns
    -------
    torch.Tensor
        Stored values ``[..., C, H, W]``, or with `frames` ``[..., F, C, H, W]``, of the dtype of the image, without a
        gradient; with a batch axis where the image has three axes. The levels themselves are
        ``(values * (2**bits - 1)).round()``.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range, or the function does not rise.

    Notes
    -----
    The share of a level is that of its light between the two levels around, since an eye adds light, not stored values.
    Mask: Ulichney, Proc. SPIE 1913, 332 (1993), void and cluster. Diffusion: Floyd and Steinberg, Proc. Soc. Inf.
    Disp. 17, 75 (1976), in rows from left to right, where the edges of the picture pass the whole error on. Frames: the
    picture is first put on levels that are as many times finer; a pixel that is to be brighter in a part of the frames
    is so in those that a second mask says, each time as many.
    The visibility of what is left is measured by :class:`CSFLoss`, :class:`VisibilityLoss` and :class:`FlickerLoss`.

    Examples
    --------
    A grey that emits a quarter of the light of white, on a screen of one bit:

    >>> import torch
    >>> from odak.learn.perception import dither
    >>> grey = torch.full((1, 1, 64, 64), 0.25)
    >>> [dither(grey, 1, method, encoding="linear").mean().item() for method in ("blue noise", "none")]
    [0.25, 0.0]
    >>> dither(grey, 1, frames=4, encoding="linear").mean(1).unique().tolist()
    [0.25]
    """
    pictures = as_pictures("image", image, None)
    _validate.image("image", pictures, axes=4)
    check_values(image=image)
    method = _validate.one_of("method", method, METHODS)
    count = 1 if frames is None else _validate.integer("frames", frames, minimum=1, most=MOST_FRAMES)
    decode = _DECODED[_validate.one_of("encoding", encoding, _DECODED)] if isinstance(encoding, str) else encoding
    _validate.function("encoding", decode)
    channels, seed = pictures.shape[-3], _validate.integer("seed", seed)
    depths = list(bits) if isinstance(bits, (tuple, list)) else [bits] * channels
    if len(depths) != channels:
        raise ValueError(f"bits must be one number or one for each of {channels} channels, got {bits!r}")
    shown = []
    with torch.no_grad():
        for channel, depth in enumerate(depths):
            depth = _validate.integer("bits", depth, minimum=1, most=MOST_BITS)
            masks = [_thresholds(method, pictures, seed, 2 * channel + second) for second in (0, 1)]
            shown.append(_shown(in_float64(pictures[..., channel, :, :]), depth, method, count, decode, masks))
        values = torch.stack(shown, -3).to(image.dtype)
    return values if frames is not None else values.squeeze(-4)


def _shown(stored, bits, method, frames, decode, masks):
    """Return what one channel [..., H, W] shows in each frame [..., F, H, W]."""
    top = 2**bits - 1
    light = decode(torch.linspace(0, 1, top + 1, dtype=stored.dtype, device=stored.device))
    if not isinstance(light, torch.Tensor) or light.shape != (top + 1,):
        raise TypeError(f"encoding must return a tensor of the shape of its argument, got {light!r:.80}")
    if _array.is_readable(light) and not bool((light.diff() > 0).all()):
        raise ValueError("encoding must be a rising function of values from 0 to 1")
    # Means over the frames, of which some show a level and the others the next.
    between = torch.arange(frames, dtype=stored.dtype, device=stored.device) / frames
    levels = torch.cat([(light[:-1, None] + light.diff()[:, None] * between).flatten(), light[-1:]])
    wanted = decode(stored.clamp(0, 1))
    if method == "error diffusion":
        index = _diffused(wanted, levels)
    else:
        below = (torch.searchsorted(levels, wanted.contiguous(), right=True) - 1).clamp(0, len(levels) - 2)
        index = below + ((wanted - levels[below]) / (levels[below + 1] - levels[below]) > masks[0])
    # In the order of reversed bits, what is lit in some of the frames is so in frames far apart, which flickers least;
    # pixels whose thresholds are near one another are lit in frames far apart too.
    order = sorted(range(frames), key=lambda frame: int(f"{frame:08b}"[::-1], 2))
    turns = torch.tensor([order.index(frame) for frame in range(frames)], device=stored.device)
    start = turns[(frames * masks[1]).long()]
    phase = turns[(start + torch.arange(frames, device=stored.device)[:, None, None]) % frames]
    index = index.unsqueeze(-3)
    return (index // frames + (phase < index % frames)).to(stored.dtype) / top


def _thresholds(method, pictures, seed, number):
    """Return thresholds between 0 and 1 of all pixels [H, W]: each number those of another part of the mask."""
    rows, columns = pictures.shape[-2:]
    if method == "none" and number % 2 == 0:
        found = np.full((rows, columns), 0.5)
    elif method == "white noise":
        found = np.random.default_rng([seed, number]).random((rows, columns))
    else:
        mask = np.roll(blue_noise_ranks(seed), [int(SIDE * number * part) for part in _APART], (0, 1))
        tiles = np.tile(mask, (math.ceil(rows / SIDE), math.ceil(columns / SIDE)))
        found = (tiles[:rows, :columns] + 0.5) / SIDE**2
    return in_float64(torch.from_numpy(found).to(pictures.device))


@functools.lru_cache(maxsize=8)
def blue_noise_ranks(seed: int) -> np.ndarray:
    """Return a mask of blue noise: the numbers from 0 to SIDE² − 1, of which the first n are spread evenly for each n.

    Void and cluster: the densest of some random points moves to the largest gap until it stays. Then points are
    taken from the densest places one by one, which numbers them, and others put into the largest gaps. Densities are
    sums of whole numbers, so that all processors make the same mask.
    """
    count, points, away = SIDE**2, SIDE**2 // 10, np.minimum(np.arange(SIDE), SIDE - np.arange(SIDE)) ** 2
    bell = np.rint(2**30 * np.exp(-(away[:, None] + away) / (2 * SPREAD**2))).astype(np.int64)
    tiled = np.tile(bell, (2, 2))

    def put(places, density, one, change):
        row, column = divmod(one, SIDE)
        places[one] = change > 0
        density += change * tiled[SIDE - row : 2 * SIDE - row, SIDE - column : 2 * SIDE - column].ravel()

    def densest(places, density):
        return np.where(places, density, -1).argmax()

    def emptiest(places, density):
        return np.where(places, np.iinfo(np.int64).max, density).argmin()

    places, density = np.zeros(count, bool), np.zeros(count, np.int64)
    for one in np.random.default_rng(seed).permutation(count)[:points]:
        put(places, density, one, 1)
    moved, gap = -1, -2
    while moved != gap:
        moved = densest(places, density)
        put(places, density, moved, -1)
        gap = emptiest(places, density)
        put(places, density, gap, 1)
    ranks, left, thinner = np.empty(count, np.int64), places.copy(), density.copy()
    for rank in range(points - 1, -1, -1):
        one = densest(left, thinner)
        put(left, thinner, one, -1)
        ranks[one] = rank
    for rank in range(points, count):
        one = emptiest(places, density)
        put(places, density, one, 1)
        ranks[one] = rank
    ranks.flags.writeable = False
    return ranks.reshape(SIDE, SIDE)


def _diffused(wanted, levels):
    """Return the index of the level of each pixel [..., H, W], whose error the pixels after it make up for.

    Pixels on one of the lines x + 2·y = const do not depend on one another and are computed together. In rows that are
    longer by two pixels they are `columns` apart.
    """
    rows, columns = wanted.shape[-2:]
    width = columns + 2
    light = functional.pad(wanted, (0, 2, 0, 1)).reshape(-1, (rows + 1) * width)
    index = torch.zeros_like(light, dtype=torch.long)
    right, left, across = (wanted.new_full((rows, width), share / 16) for share in (7, 3, 1))
    right[-1], left[-1], across[-1] = 1, 0, 0
    left[:, 0], right[:, columns - 1], across[:, columns - 1] = 0, 0, 0
    down = 1 - right - left - across
    shares = [(1, right), (width - 1, left), (width, down), (width + 1, across)]
    shares = [(offset, share.flatten()) for offset, share in shares]
    middles = (levels[1:] + levels[:-1]) / 2
    for line in range(columns + 2 * rows - 2):
        first, last = max(0, (line - columns) // 2 + 1), min(rows - 1, line // 2)
        begin, end = first * columns + line, last * columns + line + 1
        values = light[:, begin:end:columns].contiguous()
        nearest = torch.bucketize(values, middles)
        index[:, begin:end:columns] = nearest
        error = values - levels[nearest]
        for offset, share in shares:
            light[:, begin + offset : end + offset : columns] += share[begin:end:columns] * error
    return index.reshape(*wanted.shape[:-2], rows + 1, width)[..., :rows, :columns]
