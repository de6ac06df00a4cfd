"""Seconds to given qualities of a hologram: odak's defaults beside Adam written with torch alone, step by step in turn.

By areas: `optimise` for a display of real pixels and a registered camera, beside Adam on the same images, whose means
over pixels are taken in the spectrum of the intensity. At samples: `stochastic_gradient_descent`, beside Adam on the
padded angular spectrum. Adam gets the best of several starts and steps. The qualities by areas are those of
`Display.judge`, those at samples those of the loss, whose end an independent propagation in complex128 confirms. Starts
are part of the time, judging is not; on the CPU it is processor time. `TIME_TO_QUALITY_SIDE=1080x1920` or `2160x3840`
sets the size; on more than 1440 rows the first of each two qualities is the last, and Adam starts from the quadratic
phase alone.
"""

import dataclasses
import math
import os
import threading
import time
from collections.abc import Callable, Iterator

import torch
from time_to_quality import PITCH, WAVELENGTH, distance_of, judged, photograph, psnr

from odak.learn.wave import (
    Descent,
    Display,
    Modulator,
    Observer,
    Problem,
    Run,
    optimise,
    stochastic_gradient_descent,
)

AREAS, SAMPLES = (25.0, 30.0), (35.0, 40.0)
LARGE = 1440
# Iterations after which one that has not come there ends; the other may take so many times its time.
MOST, PATIENCE = 200, float(os.environ.get("TIME_TO_QUALITY_PATIENCE", "2.5"))
# Starts and steps in radians of Adam: the best of flat, random and quadratic starts with 0.05 … 0.6 at 135 × 240 and
# 270 × 480.
ADAMS = (("random", 0.3), ("quadratic", 0.3))


def shape_of_race() -> tuple[int, int]:
    """Return the rows and columns that the environment asks for."""
    sides = [int(side) for side in os.environ.get("TIME_TO_QUALITY_SIDE", "270x480").split("x")]
    return sides[0], sides[-1]


class Race:
    """Runs that take turns: each makes one step, then waits for the other, so that both see the same machine.

    Parameters
    ----------
    wanted : sequence of float
        Qualities in decibels, rising.
    clock : callable
        Returns seconds.
    """

    def __init__(self, wanted, clock):
        self.wanted, self.clock = wanted, clock
        self.turn, self.running, self.change = 0, set(), threading.Condition()
        self.times: dict[str, list[tuple[float, int]]] = {}
        self.spent: dict[str, float] = {}

    def run(self, contestants: dict[str, Callable]) -> dict[str, list[tuple[float, int]]]:
        """Return seconds and steps to each quality reached, by name; ``contestant(step)`` calls step after each step.

        ``step(decibels, judge)`` takes the quality by the loss, judges where that reaches the next one, and returns
        True when all are reached or time is up.
        """
        names, errors = list(contestants), []
        self.running = set(range(len(names)))
        self.times, self.spent = {name: [] for name in names}, dict.fromkeys(names, 0.0)

        def go(number, name):
            try:
                self._wait(number)
                contestants[name](Steps(self, number, name))
            except BaseException as error:
                errors.append(error)
            finally:
                with self.change:
                    self.running.discard(number)
                    self._pass_on(number)

        threads = [threading.Thread(target=go, args=(number, name)) for number, name in enumerate(names)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if errors:
            raise errors[0]
        return self.times

    def _wait(self, number):
        with self.change:
            self.change.wait_for(lambda: self.turn == number or not self.running)

    def _pass_on(self, number):
        others = sorted(self.running, key=lambda other: (other <= number, other))
        self.turn = others[0] if others else -1
        self.change.notify_all()

    def hand_over(self, number):
        """Let the next one make a step, and wait for the next turn."""
        with self.change:
            self._pass_on(number)
        self._wait(number)

    def late(self, name) -> bool:
        """Say whether a run has had several times what the others took to all qualities."""
        done = [times[-1][0] for other, times in self.times.items() if other != name and len(times) == len(self.wanted)]
        return bool(done) and self.spent[name] > PATIENCE * max(done)


class Steps:
    """The clock of one run, which stands while others run and while it is judged."""

    def __init__(self, race: Race, number: int, name: str):
        self.race, self.number, self.name, self.count = race, number, name, 0
        self.start = race.clock()

    def __call__(self, decibels: float, judge: Callable[[], float]) -> bool:
        """Note a step that began with a quality, and return whether the run is done."""
        race, times = self.race, self.race.times[self.name]
        race.spent[self.name] += race.clock() - self.start
        while len(times) < len(race.wanted) and decibels >= race.wanted[len(times)] <= judge():
            times.append((race.spent[self.name], self.count))
        self.count += 1
        done = len(times) == len(race.wanted) or race.late(self.name)
        if not done:
            race.hand_over(self.number)
        self.start = race.clock()
        return done


def transfer(shape, device) -> torch.Tensor:
    """Return the transfer function of free space on a grid of twice the shape."""
    fy, fx = (torch.fft.fftfreq(2 * n, PITCH, dtype=torch.float64, device=device) for n in shape)
    turns = distance_of(shape) * torch.sqrt(1 / WAVELENGTH**2 - fy[:, None] ** 2 - fx**2)
    return torch.polar(torch.ones_like(turns), 2 * math.pi * torch.remainder(turns, 1)).to(torch.complex64)


def at_samples(target) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a function of the phase: the intensity at the samples, by two padded transforms."""
    (rows, columns), kernel = target.shape, transfer(target.shape, target.device)

    def image(phase):
        spectrum = torch.fft.fft2(torch.polar(torch.ones_like(phase), phase), (2 * rows, 2 * columns))
        return torch.fft.ifft2(spectrum * kernel)[:rows, :columns].abs().square()

    return image


def over_areas(target, fill: float = 0.9) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a function of the phase: the mean intensity over the area of each pixel, for pixels of some fill.

    The field is computed at half steps, and the mean is a product of the spectrum of its intensity.
    """
    (rows, columns), kernel = target.shape, transfer(target.shape, target.device)
    cycles = [torch.fft.fftfreq(2 * n, device=target.device) for n in target.shape]
    emitted = [torch.sinc(math.sqrt(fill) * f) for f in cycles]
    kernel = kernel * emitted[0][:, None] * emitted[1]
    means = [torch.sinc(2 * torch.fft.fftfreq(2 * n, device=target.device)) for n in target.shape]
    mean = means[0][:, None] * means[1][: columns + 1]

    def image(phase):
        spectrum = torch.fft.fft2(torch.polar(torch.ones_like(phase), phase), (2 * rows, 2 * columns)) * kernel
        finer = torch.fft.fftshift(spectrum)
        finer = torch.nn.functional.pad(finer, (columns, columns, rows, rows))
        shown = 4 * torch.fft.ifft2(torch.fft.ifftshift(finer))[: 2 * rows, : 2 * columns]
        return torch.fft.irfft2(torch.fft.rfft2(shown.abs().square()) * mean, (2 * rows, 2 * columns))[::2, ::2]

    return image


def plain(target, model: Callable, judge: Callable, start: str, rate: float) -> Callable:
    """Return a contestant: Adam of torch over a phase that begins flat, at random or with a quadratic."""

    def run(step):
        image, generator = model(target), torch.Generator().manual_seed(0)
        if start == "quadratic":
            bends = [math.pi / (4 * n) * (torch.arange(n) - n // 2) ** 2 for n in target.shape]
            phase = (bends[0][:, None] + bends[1]).float().to(target.device)
        else:
            reach = {"flat": 0.0, "random": 1.0}[start]
            phase = (reach * (torch.rand(target.shape, generator=generator) - 0.5)).to(target.device)
        phase.requires_grad_()
        adam = torch.optim.Adam([phase], lr=rate)
        for _ in range(MOST):
            adam.zero_grad()
            shown = image(phase)
            scale = ((shown * target).sum() / shown.square().sum()).detach()
            loss = (scale * shown - target).square().mean()
            loss.backward()
            if step(-10 * math.log10(loss.item()), lambda: judge(phase.detach())):
                break
            adam.step()

    return run


@dataclasses.dataclass(frozen=True)
class Watched(Problem):
    """A problem that keeps the phases whose loss was computed last."""

    latest: list = dataclasses.field(default_factory=list)

    def loss_of(self, phases, *others):
        """Return the loss of patterns, and keep their phases."""
        self.latest[:] = [phases]
        return super().loss_of(phases, *others)


class Watching:
    """The default solver, whose phases are in `latest` meanwhile."""

    def __init__(self):
        self.latest = []

    def solve(self, problem):
        """Return the phases of a problem."""
        given = {field.name: getattr(problem, field.name) for field in dataclasses.fields(problem)}
        return Descent().solve(Watched(**given, latest=self.latest))


def default_by_areas(target, display, judge) -> Callable:
    """Return a contestant: `optimise` with its default solver and start, for a registered camera."""

    def run(step):
        solver = Watching()

        def watch(iteration, loss):
            # The loss is that before the step and the phase that after it: a step late rather than early.
            return step(-10 * math.log10(float(loss)), lambda: judge(solver.latest[0].detach()))

        settings = Run(iterations=MOST, progress=False, callback=watch)
        optimise(display, target, solver=solver, run=settings, observer=Observer.camera(registered=True))

    return run


def default_at_samples(target, ends: list) -> Callable:
    """Return a contestant: `stochastic_gradient_descent` from its best start; a list gets the quality of its end."""

    def run(step):
        hologram, _ = stochastic_gradient_descent(
            target, WAVELENGTH, distance_of(target.shape), PITCH, n_iteration=MOST, optimizer="lbfgs",
            initial_phase="gs", scale=True, seed=0, progress=False,
            callback=lambda iteration, loss: step(-10 * math.log10(float(loss)), lambda: math.inf),
        )  # fmt: skip
        ends.append(judged(hologram, target))

    return run


def races(device: str) -> Iterator[dict]:
    """Yield the time of the default to each quality, over that of the better Adam of torch."""
    shape, clock = shape_of_race(), time.process_time if device == "cpu" else time.perf_counter
    target = photograph(shape).to(device)
    display = Display(Modulator(shape, PITCH), WAVELENGTH, distance_of(shape)).to(device)

    def areas(phase):
        image, _ = display.judge(display.modulator.shown(phase.reshape(1, *shape)))
        return psnr(image[0, 0], target)

    ends: list[float] = []
    fields = {
        "by areas": (AREAS, default_by_areas(target, display, areas), over_areas, areas),
        "at samples": (SAMPLES, default_at_samples(target, ends), at_samples, lambda phase: math.inf),
    }
    for kind, (wanted, ours, model, judge) in fields.items():
        others = {f"{start}, step {rate}": plain(target, model, judge, start, rate) for start, rate in ADAMS}
        # What the first call loads and builds is no part of a step.
        for first in (ours, next(iter(others.values()))):
            first(lambda decibels, judge: True)
        if shape[0] > LARGE:
            wanted, others = wanted[:1], dict(list(others.items())[-1:])
        race = Race(wanted, clock)
        times = race.run({"odak": ours, **others})
        for number, decibels in enumerate(wanted):
            reached = {name: found[number] for name, found in times.items() if len(found) > number}
            if not reached:
                continue
            seconds, count = reached.get("odak", (math.inf, MOST))
            name = min((name for name in reached if name != "odak"), key=lambda name: reached[name], default=None)
            # One that did not come there took at least what it had.
            floor = reached[name][0] if name else max(race.spent[other] for other in others)
            how = f"Adam {name}: {reached[name][1]} steps" if name else f"no Adam in {floor / seconds:.0f} times that"
            yield {
                "task": f"{shape[0]} × {shape[1]}, {decibels:.0f} dB {kind}: {count} iterations",
                "ours_s": seconds,
                "floor_s": floor,
                "floor": how,
                "ratio": seconds / floor,
                "bound": 1.0,
            }
    print(f"end at samples, in double precision: {ends[-1]:.1f} dB")


ALL = (races,)
