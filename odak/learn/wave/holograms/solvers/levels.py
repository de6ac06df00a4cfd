"""Search over the few levels of a panel. Touches a problem by the loss of what the panel does to the light."""

import math
import os
from dataclasses import dataclass, replace
from typing import Any

import torch

from odak import _validate
from odak.learn.tools.iterations import Loop, Run
from odak.learn.wave.fields import intensity
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.holograms.solvers.descent import Descent
from odak.learn.wave.training import fingerprint, seeded_loss

# Bits up to which each level of each pixel is tried; and up to which "auto" takes the search.
MOST_BITS, FEW_BITS = 6, 4
# Share of the iterations that finds phases without levels, from which the search starts.
_DESCENT = 1 / 3
# Pixels of which a change is looked at in an iteration, and the share of all that changes at first and at most.
_LOOKED_AT, _CHANGED, _MOST_CHANGED = 0.5, 0.2, 0.3
# Factors of the share of pixels that change after a step that is taken and after one that is not.
_MORE, _FEWER = 1.3, 0.7
# Relative rise of the loss that is taken once in e times at the initial temperature.
_RISE = 5e-3
# Memory of the estimated curvature.
_MEMORY = 0.9
# Pixels from which the share that changes is estimated.
_SAMPLE = 1 << 16


@dataclass(frozen=True)
class LevelSearch:
    """Search for the levels of a panel that has few, by annealed simultaneous changes.

    Use it for panels of one to four bits, where phases that are found without levels and rounded lose most of the
    quality. A third of the iterations finds such phases by :class:`Descent`. In each further iteration, a gradient with
    respect to the light of every pixel and a curvature, estimated from the steps before, predict what each level of
    each pixel changes; the most promising ones change together, and the step is taken if it lowers the loss, or by
    chance. Random numbers added to the predictions, and that chance, fall to zero on the way (simulated annealing).
    The best levels that were met are returned, so that the loss is at most that of the rounded phases.

    Parameters
    ----------
    temperature : float
        Scale of the random numbers at the beginning, in units of the mean change that the best level of a pixel is
        predicted to bring.

    Notes
    -----
    Kirkpatrick, Gelatt and Vecchi, Science 220, 671 (1983), for annealing; random numbers of Gumbel's distribution make
    the least of the sums a draw from Boltzmann's (Maddison, Tarlow and Minka, NeurIPS 2014). The change of one pixel's
    light by d changes the loss by Re(g*·d) and a term that grows with |d|²: changes of many pixels add up as long as
    they are few or agree, which the share of pixels that change in a step adapts to. An iteration takes as long as one
    of :class:`Descent`, whatever the size of a pixel's diffraction pattern.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, LevelSearch, Modulator, Run, optimise
    >>> target = torch.zeros(32, 32)
    >>> target[8:24, 8:24] = 1.0
    >>> display = Display(Modulator((32, 32), 8e-6, bits=1), 532e-9, 2e-3, frames=2)
    >>> hologram = optimise(display, target, solver=LevelSearch(), run=Run(iterations=90, progress=False))
    >>> hologram.levels().unique().tolist(), bool(hologram.psnr > 15)
    ([0, 1], True)
    """

    temperature: float = 0.5

    def __post_init__(self) -> None:
        _validate.real("temperature", self.temperature, positive=True)

    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, those of levels, ``[F, rows, columns]``."""
        panel, run = problem.display.modulator, problem.run
        if panel.bits is None or panel.bits > MOST_BITS or panel.lit_through is not None:
            got = "a panel lit through another" if panel.lit_through is not None else f"bits={panel.bits}"
            raise ValueError(
                f"a search over levels needs one panel of 1 to {MOST_BITS} bits, got {got}: use the solver 'lbfgs'"
            )
        found: Any = Descent().solve(replace(problem, run=_first_part(run, self.first(run.iterations))))
        return self.search(problem, found)

    def first(self, iterations: int) -> int:
        """Return how many of some `iterations` find phases without levels."""
        return math.ceil(_DESCENT * iterations)

    def search(self, problem: Problem, phases: torch.Tensor) -> torch.Tensor:
        """Return the phases of the levels that the rest of the iterations finds.

        Parameters
        ----------
        problem : Problem
            The problem.
        phases : torch.Tensor
            Phases ``[F, rows, columns]`` to begin with, such as those of a descent along the gradient. They are rounded
            to levels.
        """
        run, first = problem.run, self.first(problem.run.iterations)
        loss, drawn_from = seeded_loss(problem.loss, run.seed, problem.start.device)
        search = _Search(replace(problem, loss=loss), phases, self.temperature, max(run.iterations - first, 1))
        about: dict[str, Any] = {}
        if run.checkpoint is not None:
            target = fingerprint(problem.target, problem.start)
            about = {"solver": repr(self), "display": problem.display.fingerprint(), "target": target}
            about["iterations"] = run.iterations
        loop = Loop(
            _later_part(run, first),
            lambda: {"levels": search.levels},
            about,
            {"search": (lambda: search.numbers, search.load)},
            [search.generator, *drawn_from],
            "a search over levels",
        )
        if loop.done == 0:
            loop.keep(search.loss)

        def iterate():
            found = search.step()
            loop.keep(found)
            loop.bar.update()
            return found

        loop.go(search.steps if run.iterations > first else 0, iterate, desc="levels")
        loop.restore()
        return search.phases()


class _Search:
    """The state of a search: levels, the gradient of their loss, and what the next step takes from those before."""

    def __init__(self, problem: Problem, phases: torch.Tensor, temperature: float, steps: int):
        self.problem, self.temperature, self.steps = problem, temperature, steps
        self.generator = torch.Generator(phases.device).manual_seed(problem.run.seed)
        self.levels = problem.display.modulator.levels(phases).long()
        self.numbers = {"done": 0.0, "share": _CHANGED, "curvature": 0.0, "scale": 0.0}
        self.begin()

    def begin(self) -> None:
        """Take the loss of the levels and its gradient."""
        self.loss, self._light, self._slope = self._evaluated(self.levels)

    def load(self, numbers: dict[str, float]) -> None:
        """Go on from the numbers of a checkpoint, whose levels are in place."""
        self.numbers.update({name: float(numbers[name]) for name in self.numbers})
        self.begin()

    def phases(self) -> torch.Tensor:
        """Return the phases of the levels ``[F, rows, columns]``."""
        return self.problem.display.modulator.phases_of(self.levels, self.problem.start.dtype)

    def step(self) -> torch.Tensor:
        """Change the levels of many pixels if the loss falls, or by chance; return the loss."""
        numbers = self.numbers
        cold = (1 - numbers["done"] / self.steps) ** 2
        levels = self._proposed(self.temperature * cold)
        loss, light, slope = self._evaluated(levels)
        change = light - self._light
        predicted, squares = float(_product(self._slope, change).sum()), float(intensity(change).sum())
        rise = float(loss - self.loss)
        if squares > 0:
            # What the step changed beyond the gradient's prediction, for each unit of change of the light.
            found = max(rise - predicted, 0.0) / squares
            before = numbers["curvature"]
            numbers["curvature"] = _MEMORY * before + (1 - _MEMORY) * found if before else found
        drawn = float(torch.rand((), generator=self.generator, device=levels.device))
        if rise < 0 or drawn < math.exp(-rise / (float(self.loss) * (_RISE * cold + 1e-9))):
            self.levels.copy_(levels)
            self.loss, self._light, self._slope = loss, light, slope
            numbers["share"] = min(_MORE * numbers["share"], _MOST_CHANGED)
        else:
            numbers["share"] = max(_FEWER * numbers["share"], 1 / levels.numel())
        numbers["done"] += 1
        return self.loss

    def _proposed(self, temperature: float) -> torch.Tensor:
        """Return levels of which the most promising have changed."""
        panel, numbers = self.problem.display.modulator, self.numbers
        best = torch.full(self.levels.shape, math.inf, dtype=self.problem.start.dtype, device=self.levels.device)
        least, chosen = best.clone(), self.levels.clone()
        for level in range(2 ** _validate.integer("bits", panel.bits)):
            light = self.problem.display._lights(panel.phases_of(torch.full_like(self.levels, level), best.dtype))[-1]
            change = light - self._light
            predicted = _product(self._slope, change) + numbers["curvature"] * intensity(change)
            if predicted.ndim > best.ndim:  # the colours of a panel with a phase scale
                predicted = predicted.sum(0)
            predicted = torch.where(self.levels == level, math.inf, predicted)
            least = torch.minimum(least, predicted)
            uniform = torch.rand(best.shape, generator=self.generator, dtype=best.dtype, device=best.device)
            noise = uniform.clamp(1e-9, 1 - 1e-7).log().neg_().log_()
            predicted = predicted + temperature * numbers["scale"] * noise
            chosen = torch.where(predicted < best, level, chosen)
            best = torch.minimum(best, predicted)
        numbers["scale"] = float(least.abs().mean())
        looked_at = torch.rand(best.shape, generator=self.generator, device=best.device) < _LOOKED_AT
        gain = torch.where(looked_at, -best, 0.0)
        sample = gain.flatten()[:: max(1, gain.numel() // _SAMPLE)]
        threshold = sample.topk(max(1, round(numbers["share"] * len(sample)))).values[-1].clamp_min(1e-30)
        return torch.where(gain >= threshold, chosen, self.levels)

    def _evaluated(self, levels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the loss of levels, the light of their pixels, and the gradient with respect to it."""
        display = self.problem.display
        *others, light = display._lights(display.modulator.phases_of(levels, self.problem.start.dtype))
        with torch.enable_grad():
            light = light.detach().requires_grad_()
            loss = self.problem.loss_of_lights((*others, light))
            (slope,) = torch.autograd.grad(loss, light)
        return loss.detach(), light.detach(), slope


def _product(slope: torch.Tensor, change: torch.Tensor) -> torch.Tensor:
    """Return what a loss changes with the light, to first order: the real part of the conjugate gradient times it."""
    return slope.real * change.real + slope.imag * change.imag


def _first_part(run: Run, iterations: int) -> Run:
    """Return the run of the descent, with a checkpoint of its own."""
    if run.checkpoint is None:
        return replace(run, iterations=iterations)
    stem, end = os.path.splitext(os.fspath(run.checkpoint))
    return replace(run, iterations=iterations, checkpoint=f"{stem}_phases{end}")


def _later_part(run: Run, iterations: int) -> Run:
    """Return the run of the search, whose callback counts on from the iterations of the descent."""
    if run.callback is None:
        return run
    callback = run.callback
    return replace(run, callback=lambda iteration, loss: callback(iteration + iterations, loss))
