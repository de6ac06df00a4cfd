"""Images of a display by another computation than its own, which judges holograms.

It imports no path of light and shares no arithmetic with one: of a display it asks for the panels, lengths and stops,
and for the image that it states its difference from. Of a traced eyepiece, both have the rays of its system: the judge
traces others, and samples the light and the pupil in another way.
"""

import collections
import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch

from odak import _array, _validate
from odak.instruments import Lens
from odak.learn.wave.displays.observers import REGISTERED, Observer, fine_intensity, pixels_of, resolved
from odak.learn.wave.displays.panels import Expander, Iris, orders_through
from odak.learn.wave.displays.parts import Part
from odak.learn.wave.eyes import Eyepiece, Eyes, Sight
from odak.learn.wave.propagation import propagate_beam
from odak.wave.sampling import sampling_report
from odak.wave.transfer_functions import divided_pitch

# Pixels that a grid has along each axis at least.
_LEAST = 512
# Standard deviation of the fall at the rim of a round stop, in samples of a grid.
_RIM = 0.75
# Widths of the image of a point by a pupil, λ/diameter, over which it is followed at least.
_AIRY = 64
# Pixels beyond each rim of a panel from which light reaches an eyepiece of traced rays, and pixels at least in a
# period behind the stop, which is that of four panels otherwise.
_RIM_BY_RAYS, _PERIOD_BY_RAYS = 32, 2048
# Points of a panel and of a pupil along an axis between which rays are traced.
_RAYS_OF_PANEL, _RAYS_OF_PUPIL = 9, 15
# Rows of a spectrum that are multiplied at a time.
_ROWS = 64
_Factor = Callable[[slice], torch.Tensor]


class Judgement(tuple[torch.Tensor, torch.Tensor]):
    """What is seen of patterns: a pair of images, how far off they may be, and how they compare with a target.

    Attributes
    ----------
    areas, points : torch.Tensor
        Means over the areas of pixels, and intensities at their middles, ``[D, C, rows, columns]``: the pair.
    error : torch.Tensor
        Root mean square of the difference of `areas` from the image by :meth:`odak.learn.wave.Display.forward`, divided
        by that of `areas`, ``[D, C]``. The two computations share no arithmetic, so that this is about the error of the
        worse of them; behind a traced eyepiece both believe its rays, whose own error it does not show. NaN where the
        image by the display has other orders, or distances that are drawn.
    compared : torch.Tensor
        What an observer sees compared with a target, ``[D, C, places, 3]``; see :meth:`Observer.compared`.
    sharp : torch.Tensor
        The same of the image of each colour that is put together of the parts in focus, ``[1, C, places, 3]``.
    """

    error: torch.Tensor
    compared: torch.Tensor
    sharp: torch.Tensor

    def __new__(cls, images: tuple[torch.Tensor, torch.Tensor], **found: torch.Tensor) -> "Judgement":
        """Return a judgement of a pair of images, with its other attributes by name."""
        made = super().__new__(cls, images)
        vars(made).update(found)
        return made

    @property
    def areas(self) -> torch.Tensor:
        """Means over the areas of pixels."""
        return self[0]

    @property
    def points(self) -> torch.Tensor:
        """Intensities at the middles of pixels."""
        return self[1]

    def __repr__(self) -> str:
        return f"Judgement: images {list(self.areas.shape)}, error up to {float(self.error.max()):.1e}"


@dataclasses.dataclass(frozen=True)
class Comparison:
    """What images are held against: an observer, a target, and the parts of images in focus.

    Attributes
    ----------
    observer : Observer
        Who looks.
    target : torch.Tensor
        Intensities ``[D, C, rows, columns]``.
    masks : torch.Tensor, optional
        Share of each pixel that is in focus on each plane, of the shape of the target; all by default.
    """

    observer: Observer
    target: torch.Tensor
    masks: torch.Tensor | None = None

    def of(self, lights: Iterable[tuple[torch.Tensor, int]], pitches: Sequence[float], colour: int) -> torch.Tensor:
        """Return the comparison of each plane of a colour and, last, of the parts in focus, ``[D + 1, places, 3]``.

        `lights` are the intensity around the image of each plane and its samples per pixel.
        """
        found: list[torch.Tensor] = []
        sharp: Any = 0.0
        whole: Any = 0.0
        for d, (light, samples) in enumerate(lights):
            target = self.target[d, colour]
            image = self.observer.image(light, samples, target.shape, pitches)
            wanted = self.observer.picture(target, pitches)
            found.append(self.observer.compared(image, wanted, pitches))
            share: Any = 1.0
            if self.masks is not None:
                share = self.observer.picture(self.masks[d, colour].to(target), pitches)
            sharp, whole = sharp + share * image, whole + share * wanted
        # Without masks there is one plane, or none is in focus before the others.
        last = found[0] if self.masks is None else self.observer.compared(sharp, whole, pitches)
        return torch.stack([*found, last])


@torch.no_grad()
def judged(
    display: Any,
    phases: torch.Tensor,
    amplitudes: torch.Tensor | None = None,
    held: Comparison | None = None,
    orders: int | None = None,
) -> Judgement:
    """Return what is seen of patterns on a display; see :meth:`odak.learn.wave.Display.judge`.

    Without a comparison, `compared` and `sharp` are empty.
    """
    orders = _orders(display.path, orders)
    lights, at = display._lights(phases, amplitudes), display.path
    given = display._lit_by_source(lights, 0)[-1].shape
    if len(given) > 3:
        raise ValueError(f"phases must be without a batch, [frames, rows, columns], got {list(given)}")
    planes, colours = display.shape[:2]
    images: list[list[torch.Tensor]] = [[], []]
    errors: list[torch.Tensor] = []
    # Else the image by the display itself is another one.
    alike = orders == _orders(at, None) and not at.jitter

    def on_planes(c):
        power = display.powers[:, c] / display.powers[:, c].sum()
        for d in range(planes):
            light: Any = 0.0
            other: Any = 0.0 if alike else math.nan
            for f in display.lit_frames[c]:
                # One frame at a time, which takes less memory.
                own = display._lit_by_source(tuple(one[..., f : f + 1, :, :] for one in lights), c)
                emitted = [(way, share, [one[0] for one in lit]) for way, share, lit in display._emitted(own, c)]
                least = 1
                if len({way.wavelengths for way, *_ in emitted}) > 1:
                    # Of the light of all wavelengths, as many samples as the shortest needs.
                    least = max(_field_at(way, lit, c, d, orders)[1] for way, _, lit in emitted)
                for way, share, lit in emitted:
                    shown, finer = _field_at(way, lit, c, d, orders, least)
                    light = light + power[f] * share[f] * fine_intensity(shown, [2 * n * finer for n in at.sizes])
                if alike:
                    other = other + display._images_of(Part(c, (d,), (f,)), REGISTERED, lights, display.powers)[0, 0]
            samples = 2 * finer
            images[0].append(resolved(light, samples, at.sizes, (1.0, 1.0), 1))
            errors.append((images[0][-1] - other).norm() / images[0][-1].norm())
            images[1].append(light[pixels_of(light, samples, at.sizes)])
            yield light, samples

    found = []
    for c in range(colours):
        if held is None:
            # For the images alone.
            collections.deque(on_planes(c), maxlen=0)
        else:
            found.append(held.of(on_planes(c), at.image_pitches(c), c))
    areas, points, error = (
        torch.stack(each).unflatten(0, (colours, planes)).transpose(0, 1) for each in (*images, errors)
    )
    compared = torch.stack(found, 1) if found else areas.new_empty(planes + 1, colours, 0, 3, dtype=torch.float64)
    return Judgement((areas, points), error=error, compared=compared[:-1], sharp=compared[-1:])


def _orders(at, orders: int | None) -> int:
    """Return how many orders along each axis are computed: those asked for, where no stop or lens decides."""
    if orders is None:
        return orders_through(at.iris, at.wavelengths, at.pitches)
    if at.iris is not None or at.first is not None or isinstance(at.ends, (Eyes, Lens)):
        raise ValueError(
            "orders must be None but for one panel without a stop in free space: a stop, a lens, a pupil or a second "
            f"panel decides how many pass, got {orders!r:.80}"
        )
    return _validate.integer("orders", orders, minimum=1)


@torch.no_grad()
def light_beyond(
    display: Any, phases: torch.Tensor, amplitudes: torch.Tensor | None = None, orders: int | None = None
) -> torch.Tensor:
    """Return the share of the light of each colour ``[C]`` in orders beyond those that are computed.

    See :meth:`odak.learn.wave.Display.light_beyond`.
    """
    at, count = display.path, _orders(display.path, orders)
    if at.expander is not None or display.source is not None:
        raise ValueError("modulator and profile must be without an expander or a Source, which leave no orders")
    lights = display._lights(phases, amplitudes)
    shares = []
    for c, power in enumerate(display.powers.double().unbind(1)):
        spectrum = torch.fft.fft2(display._lit_by_source(lights, c)[-1], s=[2 * n for n in at.sizes]).abs() ** 2
        spectrum = (power[:, None, None] * spectrum).sum(-3)
        # The spectrum of pixels is periodic, and that of a square on all periods sums to one over its side.
        down, across = (_share_within(count, math.sqrt(at.fill), n).to(spectrum) for n in at.sizes)
        shares.append(1 - (down[:, None] * across * spectrum).sum() / spectrum.sum())
    return torch.stack(shares).clamp_min(0.0)


def _share_within(orders: int, side: float, n: int) -> torch.Tensor:
    """Return the share of light in some orders of pixels of a side, at 2n frequencies of n pixels along an axis.

    It has kinks between orders. The light, of n pixels, sees its first n Fourier coefficients, from a finer grid.
    """
    finer = 16
    cycles = torch.fft.fftfreq(2 * n * finer * orders, 1 / orders, dtype=torch.float64)
    share = (side * torch.sinc(side * cycles) ** 2).unflatten(0, (orders, -1)).sum(0)
    return torch.fft.irfft(torch.fft.rfft(share)[: n + 1], 2 * n) / finer


def _field_at(at, lights, colour: int, image: int, orders: int, least: int = 1) -> tuple[torch.Tensor, int]:
    """Return the field on the plane of an image over twice the extent of the panel or more, and its samples per pixel.

    `at` are the numbers of a display: its panels, stops, and the distances, the lens or the eyes where its images are;
    `orders` how many are computed along each axis in free space, and `least` how many samples eyes get at least.
    """
    if isinstance(at.ends, Eyes):
        axes = at.sizes, at.pitches
        sight = Sight(at.ends, image, *axes, at.wavelengths[colour], math.sqrt(at.fill), at.iris == "order")
        return _on_retina(lights[0], sight, at.expander, least)
    if isinstance(at.ends, Lens):
        return _spread(at, lights[0], colour), 2
    way = at.wavelengths[colour] / at.medium, at.distances[image]
    if at.first is not None:
        finer = 2 + orders_through(at.first.iris, at.wavelengths, at.pitches)
        wide = _wide(at)
        field = _both(at, lights[0], lights[1], colour, finer, wide)
    else:
        finer, wide = orders, _wide(at)
        # Without a round stop the grid has no frequencies but those that pass.
        stops = [_stop(at, finer, colour, at.iris, lights[0].device, wide)] if isinstance(at.iris, Iris) else []
        if at.mask is not None:
            stops.append(torch.fft.ifftshift(at.mask).to(lights[0].device).__getitem__)
        field = _sampled(at, lights[0], finer, at.fill, stops, wide)
    return _spread_freely(at, field, *way, finer, wide), finer


def _spread(at, light, colour):
    """Return the field behind the lens at twice as many points as an image has, over twice its extent."""
    sizes, wavelength, (a, b) = at.sizes, at.wavelengths[colour], at.ends.ray_matrix
    y, x = ((torch.arange(n, dtype=torch.float64) - n // 2) * p for n, p in zip(sizes, at.pitches, strict=True))
    # The curvature that the lens leaves at a plane beside its focus.
    turn = _array.phasor_of_cycles(a * at.medium / (2 * wavelength * b) * (y[:, None] ** 2 + x**2))
    light = light * turn.to(light.device, light.dtype)
    # In the order of the transform, whose period is one order.
    field = torch.fft.fft2(light, s=[2 * n for n in sizes]).tile(2, 2) / math.sqrt(math.prod(sizes))
    frequencies = [(torch.arange(4 * n, dtype=torch.float64) - 2 * n) / (2 * n) for n in sizes]
    # The panel begins at the first sample, its axis is pixel n // 2.
    moved = [f * (n // 2) for f, n in zip(frequencies, sizes, strict=True)]
    turn = _array.phasor_of_cycles(moved[0][:, None] + moved[1])
    # Square pixels, the block on the axis, and the iris.
    radius = torch.hypot(frequencies[0][:, None] / at.pitches[0], frequencies[1] / at.pitches[1])
    passed = torch.outer(*(torch.sinc(math.sqrt(at.fill) * f) for f in frequencies))
    passed = passed * (wavelength / at.medium * abs(b) * radius >= at.ends.block)
    passed = passed * (radius <= at.iris.cutoff(wavelength)) if isinstance(at.iris, Iris) else passed
    return torch.fft.fftshift(field) * (passed * turn).to(light.device, light.dtype)


def _on_retina(light, sight: Sight, expander: Expander | None, least: int):
    """Return the field that an eye sees, over an area of twice the extent of the panel, and its samples per pixel.

    Along each axis the light of square pixels, or of the cells of a mask on them, passes the stop, and is transformed
    to the plane of the pupil with the curvature that the path gives it, and back.
    """
    boxes = [sight.box(axis) for axis in (0, 1)]
    axes = list(zip((-2, -1), sight.sizes, sight.pitches, boxes, *sight.pupil(), strict=True))
    # Zeros around the panel bring the points of the pupil nearer to each other, and keep what its rim spreads apart.
    wide = 1 + max(math.ceil(_AIRY * box / (n * half)) for _, n, _, box, _, half in axes)
    to_pupil = _by_rays if isinstance(sight.eyes.distance, Eyepiece) else _by_fresnel
    light, places = to_pupil(light, sight, expander, axes, wide)
    halves = sight.pupil()[1]
    spacing = [box / (2 * n * wide * half) for _, n, _, box, _, half in axes]
    down, across = places[0][:, None], places[1]
    blur = sight.defocus() / (2 * sight.wavelength) * ((halves[0] * down) ** 2 + (halves[1] * across) ** 2)
    light = light * (_in_circle(down, across, spacing) * _array.phasor_of_cycles(blur)).to(light.dtype)
    # Tilts of the light as a whole have no effect on the image.
    finer = max(least, *(math.ceil(len(p) / (2 * n * wide)) for p, (_, n, *_) in zip(places, axes, strict=True)))
    for axis, n, *_ in axes:
        size = 2 * n * finer * wide
        more = size - light.shape[axis]
        around = (more // 2, more - more // 2)
        light = torch.nn.functional.pad(light, (0, 0, *around) if axis == -2 else around)
        shown = torch.fft.ifft(torch.fft.ifftshift(light, axis), dim=axis) * finer
        light = torch.fft.fftshift(shown, axis)
        light = light.narrow(axis, (size - 2 * n * finer) // 2, 2 * n * finer)
    return light, finer


def _by_fresnel(light, sight: Sight, expander: Expander | None, axes, wide: int):
    """Return light in the plane of a pupil, without 1/(λB), and its places from the pupil's middle in half widths."""
    cells = 1 if expander is None else expander.cells_of(sight.sizes)
    light = light if expander is None else expander.behind(light, cells)
    kind: dict[str, Any] = {"dtype": torch.float64, "device": light.device}
    (a, b, _), places = sight.ray_matrix(), []
    for axis, n, pitch, box, middle, half in axes:
        # All orders that reach the pupil, from the rim of the panel too.
        finer = math.ceil(2 * (abs(middle) + half) / box + 1)
        count, step = 2 * n * finer * wide, pitch / finer
        f = torch.fft.fftfreq(count, step, **kind)
        spectrum: Any = 0.0
        for cell in range(cells):
            comb = light.new_zeros(*(count if k == axis else light.shape[k] for k in (-2, -1)))
            own = comb.narrow(axis, count // 2 - n // 2 * finer, n * finer).unfold(axis, finer, finer)[..., 0]
            own.copy_(light.unflatten(axis, (n, cells)).select(axis, cell))
            rims = cell / cells - 0.5, (cell + 1) / cells - 0.5
            ends = [min(max(rim, -sight.width / 2), sight.width / 2) for rim in rims]
            wide_of, aside = ends[1] - ends[0], sum(ends) / 2
            passed = torch.sinc(wide_of * pitch * f) * (wide_of / sight.width)
            if sight.one_order:
                # Half of the last frequency, which is rounded.
                passed = passed * sum(0.5 * (f.abs() < (0.5 + shift) / pitch) for shift in (-1e-6, 1e-6))
            passed = (passed * _array.phasor_of_cycles(-aside * pitch * f)).to(light.dtype)
            passed = passed[:, None] if axis == -2 else passed
            spectrum = spectrum + torch.fft.fft(torch.fft.ifftshift(comb, axis), dim=axis) * passed
        x = (torch.arange(count, **kind) - count // 2) * step
        bent = torch.fft.ifftshift(_array.phasor_of_cycles(a / (2 * sight.wavelength * b) * x**2))
        bent = bent.to(light.dtype)[:, None] if axis == -2 else bent.to(light.dtype)
        there = torch.fft.fft(torch.fft.ifft(spectrum, dim=axis) * bent, dim=axis)
        u = f * sight.wavelength * b - middle
        inside = torch.nonzero(u.abs() < half + sight.wavelength * abs(b) / (count * step))[:, 0]
        inside = inside[f[inside].argsort()]
        light = there.index_select(axis, inside)
        places.append(u[inside] / half)
    return light, places


def _by_rays(light, sight: Sight, expander: Expander | None, axes, wide: int):
    """Return what :func:`_by_fresnel` does, of an eyepiece whose rays are traced.

    The field behind the stop is sampled twice in each pixel.
    """
    for axis, n, pitch, *_ in axes:
        # A period of so many pixels that what a sharp stop spreads hardly meets itself.
        count = max(_PERIOD_BY_RAYS, 4 * n)
        comb = light.new_zeros(*(2 * count if k == axis else light.shape[k] for k in (-2, -1)))
        comb.narrow(axis, count - n // 2 * 2, 2 * n).unfold(axis, 2, 2)[..., 0].copy_(light)
        f = torch.fft.fftfreq(2 * count, pitch / 2, dtype=torch.float64, device=light.device)
        passed = sum(0.5 * (f.abs() < (0.5 + shift) / pitch) for shift in (-1e-6, 1e-6))
        passed = (passed * torch.sinc(sight.width * pitch * f) * 2).to(light.real.dtype)
        comb = torch.fft.ifft(torch.fft.fft(comb, dim=axis) * (passed if axis == -1 else passed[:, None]), dim=axis)
        side = n + 2 * _RIM_BY_RAYS
        light = comb.narrow(axis, count - side, 2 * side)
    (a, b, d), inside = sight.ray_matrix(), []
    sides: list[int] = []
    window: dict[str, tuple[Any, ...]] = {"output_dx": (), "output_shape": (), "output_center": ()}
    for _, n, pitch, box, middle, half in axes:
        step = box / (2 * n * wide)
        count = math.ceil(half / step) + 2
        inside.append(step * torch.arange(-count, count + 1, dtype=torch.float64, device=light.device))
        # The order of no pixel reaches further, even if the lens bends its light a quarter more than in first order.
        reach = 1.25 * (box / 2 + abs(a) * (n / 2 + _RIM_BY_RAYS) * pitch)
        first = min(2 * count, max(0, math.ceil((-reach - middle) / step) + count))
        last = max(first + 1, min(2 * count + 1, math.floor((reach - middle) / step) + count + 1))
        sides = [first, 2 * count + 1 - last, *sides]
        there = step, last - first, middle + step * (first + (last - first) // 2 - count)
        window = {name: (*kept, value) for (name, kept), value in zip(window.items(), there, strict=True)}
    element: Any = sight.eyes.distance
    more = {"grid": (_RAYS_OF_PANEL,) * 2, "points": _RAYS_OF_PUPIL}
    finer = dataclasses.replace(element, **more, **window, tolerance=element.tolerance / 10)
    light = finer.passage(light.shape, [pitch / 2 for _, _, pitch, *_ in axes], sight.wavelength)(light)
    light = torch.nn.functional.pad(light, sides)
    down, across = (u + middle for u, (*_, middle, _) in zip(inside, axes, strict=True))
    # Sums over pixels have no 1/(λB), and the eye sees light without the curvature that the first order gives it.
    turn = _array.phasor_of_cycles(-d / (2 * sight.wavelength * b) * (down[:, None] ** 2 + across**2))
    light = light * turn.to(light.dtype) * (sight.wavelength * abs(b) / math.prod(sight.pitches))
    return light, [u / half for u, (*_, half) in zip(inside, axes, strict=True)]


def _wide(at) -> list[int]:
    """Return how many times twice the panel's extent a grid has along each axis, on which light is followed.

    What a stop cuts off sharply spreads far, and what leaves the grid comes back on its other side.
    """
    if at.mask is not None:
        return [1, 1]
    return [math.ceil(max(_LEAST, 4 * n) / (2 * n)) for n in at.sizes]


def _sampled(at, light, samples, fill, stops: Sequence[_Factor] = (), wide: Sequence[int] = (1, 1)):
    """Return the field of square pixels on a grid of so many times twice its extent, with several samples in a pixel.

    `stops` return what each passes of the frequencies of some rows of the grid.
    """
    sizes = at.sizes
    comb = light.new_zeros([2 * n * k * samples for n, k in zip(sizes, wide, strict=True)])
    # The middle of the panel, its pixel n // 2, lies on the middle of the finer grid.
    first = [(n * k - n // 2) * samples for n, k in zip(sizes, wide, strict=True)]
    comb[tuple(slice(a, a + n * samples, samples) for a, n in zip(first, sizes, strict=True))] = light
    down, across = (
        torch.sinc(math.sqrt(fill) * p * f) * samples
        for p, f in zip(at.pitches, _frequencies(at, samples, light.device, wide), strict=True)
    )

    def passed(rows: slice) -> torch.Tensor:
        return math.prod((stop(rows) for stop in stops), start=down[rows, None] * across)

    return torch.fft.ifft2(_times(torch.fft.fft2(comb), passed))


def _times(spectrum: torch.Tensor, factor: _Factor) -> torch.Tensor:
    """Return a spectrum after it was multiplied in place, some rows at a time, which takes less memory."""
    for first in range(0, len(spectrum), _ROWS):
        rows = slice(first, first + _ROWS)
        spectrum[rows] *= factor(rows).to(spectrum.dtype)
    return spectrum


def _frequencies(at, samples, device, wide: Sequence[int] = (1, 1)) -> list[torch.Tensor]:
    """Return the frequencies along rows and columns of a grid of so many times twice the extent of the panel."""
    return [
        torch.fft.fftfreq(2 * n * k * samples, p, dtype=torch.float64, device=device)
        for n, k, p in zip(at.sizes, wide, divided_pitch(at.pitches, samples), strict=True)
    ]


def _stop(at, samples, colour, iris, device, wide: Sequence[int] = (1, 1)) -> _Factor:
    """Return a function of rows that gives what a stop passes of their frequencies on a grid."""
    down, across = _frequencies(at, samples, device, wide)
    if isinstance(iris, Iris):
        cutoff = iris.cutoff(at.wavelengths[colour])
        steps = down[1] / cutoff, across[1] / cutoff
        return lambda rows: _in_circle(down[rows, None] / cutoff, across / cutoff, steps)
    # Half of the last frequency itself, which is rounded, on either side.
    half = [0.5 * orders_through(iris, at.wavelengths, at.pitches) / p for p in at.pitches]
    inside, along = (
        0.5 * (f.abs() < (1 - 1e-6) * h) + 0.5 * (f.abs() < (1 + 1e-6) * h)
        for f, h in zip((down, across), half, strict=True)
    )
    return lambda rows: inside[rows, None] * along


def _in_circle(down, across, steps):
    """Return what a circle of radius one passes at places of a grid of some steps: a smooth rim of the same integral.

    The fall is that of a normal distribution whose second and fourth moments are taken away.
    """
    angle = torch.atan2(across, down)
    step = torch.hypot(steps[0] * angle.cos(), steps[1] * angle.sin())
    x = (1 - torch.hypot(down, across)) / (_RIM * step)
    normal = torch.exp(-(x**2) / 2) / math.sqrt(2 * math.pi)
    return torch.special.ndtr(x) + x * (7 - x**2) / 8 * normal


def _both(at, amplitudes, light, colour, samples, wide):
    """Return the field behind the second of two panels, as far as the iris of the display passes it."""
    first, wavelength = at.first, at.wavelengths[colour]
    stops = [_stop(at, samples, colour, iris, light.device, wide) for iris in (first.iris, at.iris)]
    there = _sampled(at, amplitudes, samples, first.fill, stops[:1], wide)
    there = _spread_freely(at, there, wavelength, first.distance, samples, wide, cut=False)
    there *= _sampled(at, light, samples, at.fill, wide=wide)
    there = torch.fft.fft2(there)
    return torch.fft.ifft2(_times(there, stops[1]))


def _spread_freely(at, field, wavelength, distance, samples, wide, cut=True):
    """Return a field with several samples in each pixel after it has travelled a distance.

    Light is propagated without wrap-around, of a smaller part of the grid where it may be `cut`. Of a large panel that
    would cut off too much. There, and where all of the grid is wanted, light that stays on it is a sum of plane waves,
    each with its phase: what a stop spreads beyond the grid, which comes back, is little beside it.
    """
    if distance == 0:
        return field
    pitch = divided_pitch(at.pitches, samples)
    if (
        at.mask is None
        and (min(at.sizes) > _LEAST // 2 or not cut)
        and all(
            4 * reach * (1 + reach / n) <= 2 * n * k
            for reach, n, k in zip(_reach(at, wavelength, distance, samples), at.sizes, wide, strict=True)
        )
    ):
        return _turned(field, wavelength, distance, pitch)
    if cut:
        field = _middle(field, [2 * n * samples * max(1, math.ceil(_LEAST / (2 * n))) for n in at.sizes])
    with_padding = sampling_report(tuple(field.shape), pitch, wavelength, distance, zero_padding=True)
    return propagate_beam(
        field, None, distance, pitch, wavelength, with_padding.recommended, zero_padding=[True, False, True]
    )


def _reach(at, wavelength, distance, samples) -> list[float]:
    """Return how many pixels along each axis the light of the last frequency of a grid goes aside."""
    sines = [min(0.99, wavelength * samples / (2 * pitch)) for pitch in at.pitches]
    ways = (abs(distance) * sine / math.sqrt(1 - sine**2) for sine in sines)
    return [way / pitch for way, pitch in zip(ways, at.pitches, strict=True)]


def _turned(field, wavelength, distance, pitch):
    """Return a periodic field after each of its plane waves has travelled a distance, or has faded."""
    down, across = (
        torch.fft.fftfreq(n, p, dtype=torch.float64, device=field.device)
        for n, p in zip(field.shape, pitch, strict=True)
    )

    def turned(rows: slice) -> torch.Tensor:
        axial = (wavelength**-2 - down[rows, None] ** 2 - across**2).to(torch.complex128).sqrt()
        ahead = torch.exp(2j * math.pi * abs(distance) * (axial - 1 / wavelength))
        return ahead.conj() if distance < 0 else ahead

    return torch.fft.ifft2(_times(torch.fft.fft2(field), turned))


def _middle(values: torch.Tensor, shape: Sequence[int]) -> torch.Tensor:
    """Return the rows and columns in the middle of an array, all of them where it has fewer."""
    rows, columns = (slice(max(0, (m - n) // 2), (m + n) // 2) for m, n in zip(values.shape, shape, strict=True))
    return values[rows, columns]
