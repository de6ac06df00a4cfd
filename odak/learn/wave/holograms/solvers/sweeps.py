"""Sweeps over the pixels of a panel, each of which takes its best level. Touches a path of free space by its kernels.

What a level changes is computed exactly: the error is of fourth order in the field, and both follow each change.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.paths.free import FreePath
from odak.learn.wave.fields import intensity
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.training import brightness_of

# Share of the light of a pixel that lies beyond its window on an image.
_BEYOND = 1e-2
# Share of the error by which a change must lower it, above rounding.
_LEAST = 1e-7
# Points of the field that a pixel reaches, and pixels of all frames and images, on a CPU and elsewhere, up to which
# sweeps are affordable: with them a search takes at most about three times as long.
_MOST_POINTS, _MOST_PIXELS, _MOST_ELSEWHERE = 1 << 14, 1 << 18, 1 << 14
# Pixels beside the first order of a pixel that its light is taken to reach along each axis.
_EDGES = 24


def affordable(problem: Problem) -> bool:
    """Return whether sweeps are possible and take a time like that of the other iterations."""
    display, path = problem.display, problem.display.path
    if not isinstance(path, FreePath) or path.jitter or display._lines or display.shares is not None:
        return False
    if problem.observer._blurs or problem.loss is not torch.nn.functional.mse_loss:
        return False
    pixels = math.prod(path.sizes) * len(path.distances) * sum(map(len, display.lit_frames))
    if pixels > (_MOST_PIXELS if problem.start.is_cpu else _MOST_ELSEWHERE):
        return False
    longest = max(path.wavelengths) / path.medium * max(map(abs, path.distances))
    reached = (min(n + 2 * REACH, _EDGES + longest / p**2) for n, p in zip(path.sizes, path.pitches, strict=True))
    return path.samples**2 * math.prod(reached) <= _MOST_POINTS and _separate(problem)


def _separate(problem: Problem) -> bool:
    """Return whether the light of a pixel depends on its own level alone, without crosstalk."""
    display, start = problem.display, problem.start
    levels = torch.zeros(start.shape, dtype=torch.long, device=start.device)
    levels[..., ::2, ::2] = 1
    both, zeros, ones = (
        display._lights(display.modulator.phases_of(one, start.dtype))[-1]
        for one in (levels, torch.zeros_like(levels), torch.ones_like(levels))
    )
    return bool((both - torch.where(levels == 1, ones, zeros)).abs().max() < 1e-5)


@dataclass(frozen=True)
class _Window:
    """What a pixel reaches along an axis: points of the field, of the kernel, what is recorded of them, and how."""

    points: slice
    kernel: slice
    seen: slice
    weights: np.ndarray


class Sweeps:
    """Coordinate descent over the levels of all pixels of all frames.

    Parameters
    ----------
    problem : Problem
        One that :func:`affordable` accepts.
    """

    def __init__(self, problem: Problem):
        self.problem, display = problem, problem.display
        planes, colours, *sizes = display.shape
        self.shares = (display.powers / display.powers.sum(0)).double().to("cpu").numpy()
        self.lights = self._lights()
        samples, pitches = display.samples, display.path.image_pitches(0)
        seen = [self._seen(axis, (n + 2 * REACH) * samples, pitches) for axis, n in enumerate(sizes)]
        self.kernels, self.windows = {}, {}
        for image in np.ndindex(planes, colours):
            self.kernels[image], reaches = self._kernel(*image)
            self.windows[image] = [
                [_window(place, reach, samples, weights) for place in range(n)]
                for n, reach, weights in zip(sizes, reaches, seen, strict=True)
            ]

    def sweep(self, levels: torch.Tensor, order: torch.Tensor) -> torch.Tensor:
        """Return levels ``[F, rows, columns]`` after each pixel has taken its best one, in some order of all."""
        self._begin(levels)
        for f, y, x in zip(*np.unravel_index(order.to("cpu").numpy(), levels.shape), strict=True):
            self._visit(int(f), int(y), int(x))
        return torch.from_numpy(self.levels).to(levels)

    def _lights(self) -> list[np.ndarray]:
        """Return the light of each level of each pixel in each colour, ``[levels, F, rows, columns]``."""
        display, start = self.problem.display, self.problem.start
        of_levels = []
        for level in range(2 ** (display.modulator.bits or 0)):
            whole = torch.full(start.shape, level, device=start.device)
            lights = display._lights(display.modulator.phases_of(whole, start.dtype))
            of_levels.append([display._lit_by_source(lights, c)[-1] for c in range(display.shape[1])])
        return [torch.stack(own).to("cpu").numpy() for own in zip(*of_levels, strict=True)]

    def _kernel(self, plane: int, colour: int) -> tuple[np.ndarray, list[int]]:
        """Return the field of a pixel at the points about it, and how many pixels it reaches along each axis."""
        display, path, start = self.problem.display, self.problem.display.path, self.problem.start
        samples = path.samples
        spectrum = path.kernels(display._kept, colour, start.dtype.to_complex(), (plane,))  # type: ignore[attr-defined]
        field = torch.fft.fftshift(torch.fft.ifft2(spectrum), (-2, -1)).unflatten(0, (samples, samples))
        middle, reaches = [n // 2 for n in field.shape[-2:]], []
        for axis, (n, half) in enumerate(zip(path.sizes, middle, strict=True)):
            line = intensity(field).sum((0, 1, 3 - axis))
            lags = (torch.arange(len(line), device=line.device) - half).abs()
            within = torch.stack([line[lags <= k].sum() for k in range(n + REACH)]) / line.sum()
            reaches.append(min(half, n - 1 + REACH, int((within < 1 - _BEYOND).sum())))
        y, x = (slice(half - reach, half + reach + 1) for half, reach in zip(middle, reaches, strict=True))
        return field[:, :, y, x].permute(2, 0, 3, 1).flatten(2, 3).flatten(0, 1).to("cpu").numpy(), reaches

    def _seen(self, axis: int, count: int, pitches: tuple[float, float]) -> np.ndarray:
        """Return the weights of the points along an axis in what is recorded along it, ``[recorded, points]``."""
        samples, observer, few = self.problem.display.samples, self.problem.observer, 2 * REACH + 1
        unit = torch.eye(count, dtype=self.problem.start.dtype).reshape(count, -1, samples)
        lines = unit[:, None, :, :, None].expand(-1, samples, -1, -1, few).permute(0, 3, 1, 2, 4)
        points = lines if axis == 0 else lines.transpose(1, 2).mT
        seen = observer.recorded(points, pitches, REACH)
        beside = seen[[0] if observer.grids == 1 else [0, 2 - axis]]
        return beside.flatten(2).permute(2, 0, 1).flatten(0, 1).numpy()

    def _begin(self, levels: torch.Tensor) -> None:
        """Compute what follows each change: fields, what is recorded of them, its errors, and sums over them."""
        problem, display = self.problem, self.problem.display
        self.levels = levels.to("cpu").numpy().copy()
        lights = display._lights(display.modulator.phases_of(levels, problem.start.dtype))
        self.fields = {}
        for plane, colour in self.kernels:
            points = display.path.points(display._kept, display._lit_by_source(lights, colour), colour, (plane,))
            points = points.unflatten(-3, (display.samples, display.samples)).permute(0, 3, 1, 4, 2)
            self.fields[plane, colour] = points.flatten(3, 4).flatten(1, 2).to("cpu").numpy()
        images = display._recorded_of(problem.observer, lights)
        scale = brightness_of(images, problem.wanted) if problem.free else torch.ones_like(images[0, 0, :, :1, :1])
        self.scale, self.images = scale.flatten().double().to("cpu").numpy(), _interleaved(images)
        self.errors = _interleaved(scale * images - problem.wanted)
        products = [(self.errors * self.images), self.images**2]
        self.products, self.squares = (part.sum((0, 2, 3), dtype=np.float64) for part in products)
        self.least = _LEAST * float((self.errors**2).sum())

    def _visit(self, frame: int, row: int, column: int) -> None:
        """Give a pixel of a frame the level of the least error."""
        place, parts, news = (frame, row, column), {}, {}
        rise = np.zeros(len(self.lights[0]))
        for colour, share in enumerate(self.shares[frame]):
            if not share:
                continue
            gram = np.zeros((3, 5))
            for image in self.kernels:
                if image[1] == colour:
                    parts[image] = self._parts(image, place, share)
                    gram += self._gram(image, place, parts[image])
            light = self.lights[colour][:, frame, row, column].astype(complex)
            change = light - light[self.levels[place]]
            sizes = np.stack([change.real, change.imag, abs(change) ** 2], 1)
            # First and second order of the error in what is recorded, at a brightness that stays as it is.
            scale, product, square = self.scale[colour], self.products[colour], self.squares[colour]
            (with_error, with_image), moved = (sizes @ gram[:, 3:]).T, ((sizes @ gram[:, :3]) * sizes).sum(1)
            rise = rise + 2 * scale * with_error + scale**2 * moved
            new = product + with_error + scale * (with_image + moved), square + 2 * with_image + moved
            if self.problem.free:
                # And what the best brightness lowers it by.
                rise = rise - new[0] ** 2 / new[1] + product**2 / square
            news[colour] = change, sizes, *new
        level = int(np.argmin(rise))
        if rise[level] > -self.least:
            return
        self.levels[place] = level
        for image, part in parts.items():
            self._move(image, place, news[image[1]][0][level], part, news[image[1]][1][level])
        for colour, (*_, product, square) in news.items():
            self.products[colour], self.squares[colour] = product[level], square[level]

    def _about(self, image: tuple[int, int], place: tuple[int, int, int]) -> tuple[_Window, _Window]:
        down, across = self.windows[image]
        return down[place[1]], across[place[2]]

    def _parts(self, image: tuple[int, int], place: tuple[int, int, int], share: float) -> np.ndarray:
        """Return what is recorded of a pixel's light: of its interference, real and imaginary, and of it alone."""
        y, x = self._about(image, place)
        kernel = self.kernels[image][y.kernel, x.kernel]
        crossed = self.fields[image][place[0], y.points, x.points].conj() * (2 * kernel)
        points = np.stack([crossed.real, -crossed.imag, kernel.real**2 + kernel.imag**2])
        return y.weights @ points @ (x.weights.T * points.dtype.type(share))

    def _gram(self, image: tuple[int, int], place: tuple[int, int, int], parts: np.ndarray) -> np.ndarray:
        """Return the products of the parts with each other, with the errors and with what is recorded, ``[3, 5]``."""
        y, x = self._about(image, place)
        there = *image, y.seen, x.seen
        both = np.concatenate([parts, self.errors[there][None], self.images[there][None]])
        return parts.reshape(3, -1) @ both.reshape(5, -1).T

    def _move(self, image, place, change: complex, parts: np.ndarray, sizes: np.ndarray) -> None:
        """Let the field, what is recorded and the errors follow a change of a pixel's light."""
        y, x = self._about(image, place)
        field = self.fields[image]
        field[place[0], y.points, x.points] += field.dtype.type(change) * self.kernels[image][y.kernel, x.kernel]
        moved, there = np.tensordot(sizes.astype(parts.dtype), parts, 1), (*image, y.seen, x.seen)
        self.images[there] += moved
        self.errors[there] += moved.dtype.type(self.scale[image[1]]) * moved


def _window(place: int, reach: int, samples: int, weights: np.ndarray) -> _Window:
    """Return what a pixel at some place along an axis reaches."""
    count = weights.shape[1]
    first = (place + REACH - reach) * samples
    low, high = max(first, 0), min(first + (2 * reach + 1) * samples, count)
    recorded = np.flatnonzero(weights[:, low:high].any(1))
    seen = slice(int(recorded[0]), int(recorded[-1]) + 1)
    return _Window(slice(low, high), slice(low - first, high - first), seen, weights[seen, low:high].copy())


def _interleaved(images: torch.Tensor) -> np.ndarray:
    """Return images ``[grids, D, C, rows, columns]`` with the places of all grids along the axes of one."""
    side = 1 if len(images) == 1 else 2
    whole = images.unflatten(0, (side, side)).permute(2, 3, 4, 0, 5, 1)
    return whole.flatten(4, 5).flatten(2, 3).to("cpu").numpy().copy()
