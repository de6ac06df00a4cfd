"""Perception benchmarks: the metameric loss against its bare convolutions, the blur against its bare MIP chain, colour.

Bare convolutions are one conv2d per filter and level, forward and back, with nothing between them: no mirrored borders,
no squares, no pooling, no statistics, no colours. A memory pass reads a tensor and writes a new one. Measures of
quality and L*a*b* are held against their formulas written down and against piq, kornia and torchmetrics if installed.
"""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial

import torch
from measure import interleave
from torch.nn import functional
from wave_optics import row

from odak.learn import perception
from odak.learn.perception.foveation import level_map

SIDES = (512, 1024)
LEVELS, ORIENTATIONS = 5, 2
SMALL, LOW = 5, 13
# What the implementation that this one replaces took for 512 × 512 on two cores, in seconds.
EARLIER, FASTER = 1.5, 5.0
PICTURE = (1, 3, 1080, 1920)
GEOMETRY = (0.2, 0.2, 0.7, (0.5, 0.5), "quadratic", False)


def metameric_loss(device: str) -> Iterator[dict]:
    """Yield the loss and its gradient for a target seen before, against bare convolutions."""
    for side in SIDES:
        image, target = (torch.rand(1, 3, side, side, device=device) for _ in range(2))
        image.requires_grad_()
        loss, filters = perception.MetamericLoss(device=device), _filters(device)
        tasks = {
            "bare": partial(_bare_convolutions, image, filters),
            "ours": lambda: torch.autograd.grad(loss(image, target), image),  # noqa: B023
        }
        timings = interleave(tasks, 7, device)
        ours, floor = timings["ours"].best, timings["bare"].best
        count = 2 * (2 + (LEVELS - 1) * (ORIENTATIONS + 1))
        yield row(f"metameric loss {side}², forward and back", ours, floor, f"{count} conv2d", 8.0)
        if side == SIDES[0]:
            floor = EARLIER / FASTER
            yield row(f"metameric loss {side}², a fifth of the earlier one", ours, floor, "set", 1.0)


def kept_target(device: str) -> Iterator[dict]:
    """Yield calls with a target seen before against the first, one with a new target and one with a new gaze."""
    side = SIDES[0]
    image, target = (torch.rand(1, 3, side, side, device=device) for _ in range(2))
    image.requires_grad_()
    # One loss for each task: what one keeps must not be lost to another.
    kept, renewed, moved = (perception.MetamericLoss(device=device) for _ in range(3))
    trusting, other = perception.MetamericLoss(device=device, trust_target=True), torch.rand_like(target)
    pair = iter([target, other] * 1000)
    places = iter(range(1000))

    def call(loss, target, gaze=(0.5, 0.5)):
        torch.autograd.grad(loss(image, target, gaze), image)

    timings = interleave(
        {
            "again": lambda: call(kept, target),
            "first": lambda: call(perception.MetamericLoss(device=device), target),
            "trusted": lambda: call(trusting, target),
            "target": lambda: call(renewed, next(pair)),
            "gaze": lambda: call(moved, target, (next(places) / 1000, 0.5)),
        },
        7,
        device,
    )
    again = timings["again"].best
    yield row("metameric loss, same target again", again, timings["trusted"].best, "trusted target", None)
    yield row("metameric loss, same target again", again, timings["first"].best, "first call", 1 / 1.6)
    yield row("metameric loss, same target again", again, timings["target"].best, "new target", None)
    yield row("metameric loss, same target again", again, timings["gaze"].best, "new gaze", None)


def blur(device: str) -> Iterator[dict]:
    """Yield the blur, forward and with its gradient, against a bare MIP chain of the levels that it needs."""
    for side in SIDES:
        image = torch.rand(1, 3, side, side, device=device)
        module = perception.RadiallyVaryingBlur()
        levels = int(level_map((side, side), *GEOMETRY).max()) + 1
        follows = image.clone().requires_grad_()

        def chain(picture, levels=levels, side=side):
            total = picture
            for _ in range(levels):
                picture = functional.avg_pool2d(picture, 2)
                total = total + functional.interpolate(picture, (side, side), mode="bilinear", align_corners=False)
            return total

        tasks = {"bare": partial(chain, image), "ours": partial(module.blur, image)}
        timings = interleave(tasks, 7, device)
        yield row(f"blur {side}²", timings["ours"].best, timings["bare"].best, f"{levels} levels", 2.0)
        tasks = {"bare": partial(_there_and_back, chain, follows), "ours": partial(_there_and_back, module, follows)}
        timings = interleave(tasks, 7, device)
        yield row(
            f"blur {side}², forward and back", timings["ours"].best, timings["bare"].best, f"{levels} levels", 2.0
        )


def colour(device: str) -> Iterator[dict]:
    """Yield conversions against a memory pass; those that need powers against one power of each value as well."""
    image = torch.rand(PICTURE, device=device)
    lab, hsv = perception.srgb_to_lab(image), perception.rgb_to_hsv(image)
    linear = {
        "RGB to Y′CrCb": partial(perception.rgb_2_ycrcb, image),
        "Y′CrCb to RGB": partial(perception.ycrcb_2_rgb, image),
        "RGB to XYZ": partial(perception.linear_rgb_to_xyz, image),
        "BT.709 to BT.2020": partial(perception.change_primaries, image),
    }
    curved = {
        "RGB to HSV": partial(perception.rgb_to_hsv, image),
        "HSV to RGB": partial(perception.hsv_to_rgb, hsv),
        "sRGB to light": partial(perception.rgb_to_linear_rgb, image),
        "light to sRGB": partial(perception.linear_rgb_to_rgb, image),
        "sRGB to L*a*b*": partial(perception.srgb_to_lab, image),
        "L*a*b* to sRGB": partial(perception.lab_to_srgb, lab),
    }
    others = {"pass": lambda: image * 1.5, "power": lambda: image**2.4}
    timings = interleave({**others, **linear, **curved}, 7, device)
    floors = {name: timings[name].best for name in others}
    for name in linear:
        yield row(f"{name}, 1080p", timings[name].best, floors["pass"], "1 pass", 3.0)
    for name in curved:
        yield row(f"{name}, 1080p", timings[name].best, floors["pass"], "1 pass", None)
        if "HSV" not in name:
            yield row(f"{name}, 1080p", timings[name].best, floors["power"], "1 power", None)


def measures(device: str) -> Iterator[dict]:
    """Yield SSIM, MS-SSIM and L*a*b*, alone and with their gradient, against the formulas and other libraries."""
    one = torch.rand(PICTURE, device=device)
    two = (one + torch.rand_like(one)) / 2
    window = _window(one)
    tasks: dict[str, dict[str, Callable]] = {
        "SSIM": {"ours": perception.SSIM(), "formula": lambda a, b: _ssim(a, b, window)[0].mean()},
        "MS-SSIM": {"ours": perception.MSSSIM(), "formula": lambda a, b: _ms_ssim(a, b, window)},
        "sRGB to L*a*b*": {"ours": lambda a, _: perception.srgb_to_lab(a), "formula": lambda a, _: _lab(a)},
    }
    if _installed("piq"):
        import piq

        tasks["SSIM"]["piq"] = partial(piq.ssim, downsample=False)
        tasks["MS-SSIM"]["piq"] = piq.multi_scale_ssim
    if _installed("kornia"):
        import kornia

        tasks["SSIM"]["kornia"] = lambda a, b: kornia.metrics.ssim(a, b, 11).mean()
        tasks["sRGB to L*a*b*"]["kornia"] = lambda a, _: kornia.color.rgb_to_lab(a)
    if _installed("torchmetrics"):
        from torchmetrics.functional import image

        tasks["SSIM"]["torchmetrics"] = partial(image.structural_similarity_index_measure, data_range=1.0)
        tasks["MS-SSIM"]["torchmetrics"] = partial(image.multiscale_structural_similarity_index_measure, data_range=1.0)
    followed = one.clone().requires_grad_()
    for name, ways in tasks.items():
        for kind in ("", ", forward and back"):

            def call(way, back=bool(kind)):
                result = way(followed if back else one, two)
                if back:
                    torch.autograd.grad(result, followed, torch.ones_like(result))

            timings = interleave({peer: partial(call, way) for peer, way in ways.items()}, 5, device)
            for peer in list(ways)[1:]:
                yield row(f"{name}{kind}, 1080p", timings["ours"].best, timings[peer].best, peer, 1.0)


def _installed(library: str) -> bool:
    return importlib.util.find_spec(library) is not None


def _window(like: torch.Tensor) -> torch.Tensor:
    line = torch.exp(-(torch.arange(-5.0, 6.0, device=like.device) ** 2) / (2 * 1.5**2))
    window = line[:, None] * line / line.sum() ** 2
    return window.expand(like.shape[1], 1, 11, 11)


def _ssim(one: torch.Tensor, two: torch.Tensor, window: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return SSIM and the structure term of each channel, by five windowed means."""

    def mean(picture):
        return functional.conv2d(picture, window, groups=len(window))

    a, b = mean(one), mean(two)
    variance_a, variance_b, covariance = mean(one * one) - a * a, mean(two * two) - b * b, mean(one * two) - a * b
    structure = (2 * covariance + 0.03**2) / (variance_a + variance_b + 0.03**2)
    whole = (2 * a * b + 0.01**2) / (a * a + b * b + 0.01**2) * structure
    return whole.mean((-2, -1)), structure.mean((-2, -1))


def _ms_ssim(one: torch.Tensor, two: torch.Tensor, window: torch.Tensor) -> torch.Tensor:
    whole, structure = _ssim(one, two, window)
    result = structure.relu() ** 0.0448
    for weight in (0.2856, 0.3001, 0.2363, 0.1333):
        one, two = functional.avg_pool2d(one, 2), functional.avg_pool2d(two, 2)
        whole, structure = _ssim(one, two, window)
        result = result * (whole if weight == 0.1333 else structure).relu() ** weight
    return result.mean()


def _lab(image: torch.Tensor) -> torch.Tensor:
    """Return L*a*b* of sRGB in the precision of the input."""
    light = torch.where(image > 0.04045, ((image + 0.055) / 1.055) ** 2.4, image / 12.92)
    to_xyz = [[0.4339, 0.3762, 0.1899], [0.2127, 0.7152, 0.0721], [0.0178, 0.1095, 0.8727]]
    relative = torch.einsum("ij,bjhw->bihw", torch.tensor(to_xyz, device=image.device), light)
    x, y, z = torch.where(relative > 0.008856, relative ** (1 / 3), 7.787 * relative + 4 / 29).unbind(1)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], 1)


def memory(device: str) -> Iterator[dict]:
    """Yield the peak memory of the loss and its gradient, above what a process holds after import, in pictures."""
    for side in SIDES:
        code = (
            "import json, sys; sys.path.insert(0, 'benchmarks'); import torch; from measure import peak_memory; "
            "from odak.learn.perception import MetamericLoss, get_steerable_pyramid_filters; "
            f"device = {device!r}; loss = MetamericLoss(device=device); "
            f"get_steerable_pyramid_filters(5, {ORIENTATIONS}, 'cropped'); "
            "small = torch.rand(1, 3, 64, 64, device=device, requires_grad=True); "
            "loss(small, small.detach()).backward(); "
            f"image, target = (torch.rand(1, 3, {side}, {side}, device=device) for _ in range(2)); "
            "image.requires_grad_(); before = peak_memory(device); "
            "[loss(image, target).backward() for _ in range(3)]; print(json.dumps(peak_memory(device) - before))"
        )
        output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        pictures = json.loads(output) / (3 * side * side * 4)
        yield {
            "task": f"metameric loss {side}², peak memory",
            "ours_arrays": pictures,
            "floor": "float32 pictures",
            "bound": None,
            "ratio": pictures,
        }


def _filters(device: str) -> list[tuple[int, torch.Tensor, int]]:
    """Return, for each convolution of a pyramid of three channels: its level, its filter and its stride."""
    bank = perception.get_steerable_pyramid_filters(SMALL, ORIENTATIONS, "cropped", device=device)
    wide = {name: bank[name].repeat(3, 1, 1, 1) for name in ("h0", "l0", "l")}
    filters = [(0, wide["h0"], 1), (0, wide["l0"], 1)]
    for level in range(LEVELS - 1):
        filters += [(level, band.repeat(3, 1, 1, 1), 1) for band in bank["b"]]
        filters.append((level, wide["l"], 2))
    return filters


def _bare_convolutions(image: torch.Tensor, filters: list[tuple[int, torch.Tensor, int]]) -> None:
    side = image.shape[-1]
    planes = [image.detach()[..., : side >> level, : side >> level].contiguous() for level in range(LEVELS)]
    for level, taps, stride in filters:
        plane = planes[level].requires_grad_()
        result = functional.conv2d(plane, taps, stride=stride, padding=taps.shape[-1] // 2, groups=3)
        torch.autograd.grad(result, plane, result.detach())


def _there_and_back(function: Callable, image: torch.Tensor) -> None:
    result = function(image)
    torch.autograd.grad(result, image, result.detach())


# Memory first: a process inherits the peak of the one that starts it.
ALL = (memory, metameric_loss, kept_target, blur, colour, measures)
