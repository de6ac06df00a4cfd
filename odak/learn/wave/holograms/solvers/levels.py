"""Search over the few levels of a panel. Touches a problem by the loss of what the panel does to the light."""

import functools
import itertools
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch

from odak import _validate
from odak.learn.tools.iterations import Loop, Run
from odak.learn.wave.displays.parts import Shares, beside, with_frames
from odak.learn.wave.fields import intensity
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.holograms.solvers.descent import Descent
from odak.learn.wave.holograms.solvers.sweeps import Sweeps, affordable
from odak.learn.wave.training import fingerprint, seeded_loss

# Bits up to which each level of each pixel is tried; and up to which "auto" takes the search.
MOST_BITS, FEW_BITS = 6, 4
# Share of the iterations that finds phases without levels, from which the search starts, by bits: the less rounding
# costs, the more they are worth.
_DESCENT = {1: 0.3, 2: 0.4, 3: 0.5, 4: 0.5, 5: 0.75, 6: 0.85}
# Share of the iterations, the last ones, that are sweeps where these are affordable, and of the pixels that one visits.
_SWEPT, _VISITED = 0.15, 0.05
# Pixels of which a change is looked at in an iteration, and the share of all that changes at first and at most.
_LOOKED_AT, _CHANGED, _MOST_CHANGED = 0.5, 0.2, 0.3
# Factors of the share of pixels that change after a step that is taken and after one that is not.
_MORE, _FEWER = 1.3, 0.7
# Relative rise of the loss that is taken once in e times at the initial temperature.
_RISE = 5e-3
# Memory of the estimated curvature, pixels along each axis that share one, and the share of the mean in each. Without
# pixels that share one, panels that are too far away for sweeps lose 0.4 to 1.4 dB, and others -0.1 to 0.4 dB.
_MEMORY, _AROUND, _MEAN = 0.9, 9, 0.1
# Pixels from which the share that changes is estimated.
_SAMPLE = 1 << 16
# Frames that change together, more of which find less in as many iterations; bytes for each pixel of a frame in each
# plane and colour, and those that these may take.
_TOGETHER, _BYTES, _MOST_BYTES = 2, 400, 1 << 31
# How often each block of frames changes without levels, and among them.
_ROUNDS = 2, 3


@dataclass(frozen=True)
class LevelSearch:
    """Search for the levels of a panel that has few, by annealed simultaneous changes.

    Use it for panels of one to four bits, where phases that are found without levels and rounded lose most of the
    quality. Of the iterations, 30, 40, 50 and 50 % for 1, 2, 3 and 4 bits find such phases by :class:`Descent`. In each
    further one, a gradient with respect to the light of every pixel and a curvature about it, estimated from the steps
    before, predict what each level of each pixel changes; the most promising ones change together, and the step is
    taken if it lowers the loss, or by chance. Of a step that is not taken, the next one tries those changes alone that
    lowered it. Random numbers added to the predictions, and that chance, fall to zero on the way (simulated annealing).
    The last 15 % are sweeps: the 5 % of pixels that promise most take their best levels, one after the other, by the
    exact change of the mean squared error; when these have them, all pixels do, and the search ends where no single one
    has a better level. The best levels that were met are returned, so that the loss is at most that of the rounded
    phases.

    Parameters
    ----------
    temperature : float
        Scale of the random numbers at the beginning, in units of the mean change that the best level of a pixel is
        predicted to bring. Panels of few pixels, where chance averages nothing out, need more.

    Notes
    -----
    Kirkpatrick, Gelatt and Vecchi, Science 220, 671 (1983), for annealing; random numbers of Gumbel's distribution make
    the least of the sums a draw from Boltzmann's (Maddison, Tarlow and Minka, NeurIPS 2014). The change of one pixel's
    light by d changes the loss by Re(g*·d) and a term that grows with |d|²: changes of many pixels add up as long as
    they are few or agree, which the share of pixels that change in a step adapts to. Of a loss that is quadratic, the
    mean of the gradients before and after a step, times the change of a pixel, is that pixel's part of what the step
    changed; half of the difference of the two gradients is its curvature. An iteration of annealing takes as long as
    one of :class:`Descent`, whatever the size of a pixel's diffraction pattern. A sweep follows the field of a pixel as
    far as 99 % of its light reach along each axis, and takes a time that grows with that area: sweeps take place in
    free space without crosstalk or jitter, for the mean squared error seen by a camera along rows and columns, where a
    search with them takes up to about three times as long. This is where a pixel reaches 64 pixels along each axis, to
    4.8 mm for pixels of 8 µm and green light, and frames, planes and colours have 512 × 512 pixels together on a CPU,
    and 128 × 128 elsewhere. Where there are no sweeps, of more than two frames two change at a time beside the images
    of the others, in turn and several times each, which are kept as a sum: memory grows by about 20 bytes for each
    pixel of a frame. One frame at a time changes where a frame takes more than 1 GiB, or half of the `memory_budget` of
    the run.

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

    def solve(self, problem: Problem) -> tuple[torch.Tensor | None, ...]:
        """Return the phases of a problem, those of levels, ``[F, rows, columns]``, twice None, and their gain.

        It is in decibels of the loss, over the phases without levels that the search begins with, rounded.
        """
        panel, run = problem.display.modulator, problem.run
        if panel.bits is None or panel.bits > MOST_BITS or panel.lit_through is not None:
            got = "a panel lit through another" if panel.lit_through is not None else f"bits={panel.bits}"
            raise ValueError(
                f"a search over levels needs one panel of 1 to {MOST_BITS} bits, got {got}: use the solver 'lbfgs'"
            )
        first = math.ceil(_DESCENT[panel.bits] * run.iterations)
        blocks = _blocks(problem)
        if len(blocks) > 1 and not affordable(problem):
            return _InBlocks(self, problem, blocks).solve(first)
        done = first

        def count(iteration, loss):
            nonlocal done
            done = iteration + 1
            return run.callback is not None and run.callback(iteration, loss)

        phases: Any = Descent().solve(replace(problem, run=_first_part(replace(run, callback=count), first)))
        if done < first:
            # Ended on the way: a checkpoint of the search would go on from phases that are not those of the descent.
            return self._search(replace(problem, run=replace(run, checkpoint=None)), phases, first, 0)
        return self._search(problem, phases, first, run.iterations - first)

    def _search(
        self, problem: Problem, phases: torch.Tensor, first: int, steps: int
    ) -> tuple[torch.Tensor | None, ...]:
        """Return the phases of levels that some steps find from rounded ones, and the gain, as :meth:`solve` does."""
        run = problem.run
        loss, drawn_from = seeded_loss(problem.loss, run.seed, problem.start.device)
        search = _Search(replace(problem, loss=loss), phases, self.temperature, max(run.iterations - first, 1))
        rounded = search.loss
        loop = Loop(
            _later_part(run, first),
            lambda: {"levels": search.levels},
            self._about(problem),
            {"search": (search.state, search.load)},
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

        loop.go(steps, iterate, desc="levels")
        loop.restore()
        return search.phases(), None, None, _gain(rounded, loop.best_loss)

    def _about(self, problem: Problem) -> dict[str, Any]:
        """Return what a checkpoint must agree with; nothing where there is none."""
        if problem.run.checkpoint is None:
            return {}
        target = fingerprint(problem.target, problem.start)
        about = {"solver": repr(self), "display": problem.display.fingerprint(), "target": target}
        return about | {"iterations": problem.run.iterations}


class _Search:
    """The state of a search: levels, the gradient of their loss, and what the next step takes from those before."""

    def __init__(self, problem: Problem, phases: torch.Tensor, temperature: float, steps: int):
        self.problem, self.temperature = problem, temperature
        self.swept = round(_SWEPT * problem.run.iterations) if affordable(problem) else 0
        self.steps = max(steps - self.swept, 1)
        self.generator = torch.Generator(phases.device).manual_seed(problem.run.seed)
        self.levels = problem.display.modulator.levels(phases).long()
        self.numbers = {"done": 0.0, "share": _CHANGED, "scale": 0.0, "visited": _VISITED}
        self.begin()
        # Sums of curvatures and of the squared changes that they are known from, and the levels to try next, if any.
        self.bends, self.squares = (torch.zeros_like(self._light.real) for _ in range(2))
        self.next: list[torch.Tensor] = []

    def begin(self) -> None:
        """Take the loss of the levels and its gradient."""
        self.loss, self._light, self._slope = self._evaluated(self.levels)

    def state(self) -> dict[str, Any]:
        """Return what the next step depends on besides the levels."""
        return {"numbers": self.numbers, "bends": self.bends, "squares": self.squares, "next": self.next}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint, whose levels are in place."""
        self._take(state)
        self.next = [levels.to(self.levels) for levels in state["next"]]
        self.begin()

    def _take(self, state: dict[str, Any]) -> None:
        self.numbers.update({name: float(state["numbers"][name]) for name in self.numbers})
        self.bends, self.squares = (state[name].to(self.bends) for name in ("bends", "squares"))

    def best_of(self, count: int, known: dict[str, Any] | None, watch: Callable[..., Any]) -> torch.Tensor:
        """Return the phases of the lowest loss that is met in some steps, which begin with what is known of others."""
        if known is not None and known["bends"].shape == self.bends.shape:
            self._take(known)
        best, least = self.levels.clone(), self.loss
        for step in range(count):
            if self.step() < least:
                best, least = self.levels.clone(), self.loss
            if watch(step, self.loss):
                break
        self.levels, self.next = best, []
        return self.phases()

    def phases(self) -> torch.Tensor:
        """Return the phases of the levels ``[F, rows, columns]``."""
        return self.problem.display.modulator.phases_of(self.levels, self.problem.start.dtype)

    def step(self) -> torch.Tensor:
        """Change the levels of many pixels if the loss falls, or by chance, and at last one by one; return the loss."""
        if self.swept and self.numbers["done"] >= self.steps:
            return self._sweep()
        numbers, again = self.numbers, bool(self.next)
        cold = (1 - numbers["done"] / self.steps) ** 2
        levels = self.next.pop() if again else self._proposed(self.temperature * cold)
        loss, light, slope = self._evaluated(levels)
        change, rise = light - self._light, float(loss - self.loss)
        if not again:
            for known, found in (
                (self.bends, _product(slope - self._slope, change) / 2),
                (self.squares, intensity(change)),
            ):
                known.lerp_(_about(found), 1 - _MEMORY)
        drawn = float(torch.rand((), generator=self.generator, device=levels.device))
        if rise < 0 or drawn < math.exp(-rise / (float(self.loss) * (_RISE * cold + 1e-9))):
            self.levels.copy_(levels)
            self.loss, self._light, self._slope = loss, light, slope
            if not again:
                numbers["share"] = min(_MORE * numbers["share"], _MOST_CHANGED)
        else:
            numbers["share"] = max(_FEWER * numbers["share"], 1 / levels.numel())
            if not again:
                # Without these second attempts, panels that are too far away for sweeps lose 0.2 to 0.6 dB.
                lowered = self._of_pixels(_product(self._slope + slope, change)) < 0
                self.next.append(torch.where(lowered, levels, self.levels))
        numbers["done"] += 1
        return self.loss

    def _sweep(self) -> torch.Tensor:
        """Give the pixels that promise most their best levels, or all if these have them; return the loss."""
        numbers = self.numbers
        if numbers["visited"]:
            least = functools.reduce(torch.minimum, (predicted for _, predicted in self._predictions()))
            order = least.flatten().argsort()[: math.ceil(numbers["visited"] * least.numel())]
            levels = self.sweeps.sweep(self.levels, order)
            loss, light, slope = self._evaluated(levels)
            if loss < self.loss:
                self.levels.copy_(levels)
                self.loss, self._light, self._slope, numbers["visited"] = loss, light, slope, _VISITED
            else:
                # Where none of all pixels has a better level there is nothing more to do.
                numbers["visited"] = 1.0 if numbers["visited"] < 1 else 0.0
        return self.loss

    @functools.cached_property
    def sweeps(self) -> Sweeps:
        """What gives each pixel its best level."""
        return Sweeps(self.problem)

    def _of_pixels(self, values: torch.Tensor) -> torch.Tensor:
        """Return the sum over the colours of a panel with a phase scale, ``[F, rows, columns]``."""
        return values.sum(0) if values.ndim > self.levels.ndim else values

    def _predictions(self) -> Iterator[tuple[int, torch.Tensor]]:
        """Yield each level and what it is predicted to change the loss by, for each pixel that has another one."""
        panel, mean = self.problem.display.modulator, self.squares.mean()
        bend = self.bends.mean() / mean.clamp_min(torch.finfo(mean.dtype).tiny)
        curvature = (self.bends + _MEAN * mean * bend) / (self.squares + _MEAN * mean).clamp_min(1e-30)
        curvature.clamp_min_(0)
        dtype = self.problem.start.dtype
        for level in range(2 ** _validate.integer("bits", panel.bits)):
            light = self.problem.display._lights(panel.phases_of(torch.full_like(self.levels, level), dtype))[-1]
            change = light - self._light
            predicted = self._of_pixels(_product(self._slope, change) + curvature * intensity(change))
            yield level, torch.where(self.levels == level, math.inf, predicted)

    def _proposed(self, temperature: float) -> torch.Tensor:
        """Return levels of which the most promising have changed."""
        numbers, chosen = self.numbers, self.levels.clone()
        best = torch.full(self.levels.shape, math.inf, dtype=self.problem.start.dtype, device=self.levels.device)
        least = best.clone()
        for level, predicted in self._predictions():
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


class _InBlocks:
    """A search that changes some frames at a time, beside the images of the others, by the loss of all together."""

    def __init__(self, solver: LevelSearch, problem: Problem, blocks: list[list[int]]):
        self.solver, self.problem, self.blocks = solver, problem, blocks
        self.phases, self.images = problem.start.clone(), self._seen(problem.start)
        # Steps of all blocks, the loss of all frames rounded, and what the last search knew.
        self.steps = 0
        self.rounded: torch.Tensor | None = None
        self.known: dict[str, Any] | None = None

    def state(self) -> dict[str, Any]:
        """Return what the next block depends on besides the phases."""
        return {name: getattr(self, name) for name in ("images", "steps", "rounded", "known")}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint, whose phases are in place."""
        self.images, self.steps, self.rounded = state["images"].to(self.images), state["steps"], state["rounded"]
        self.known = state["known"]

    def solve(self, first: int) -> tuple[torch.Tensor | None, ...]:
        """Return what :meth:`LevelSearch.solve` does, the first iterations being those without levels."""
        run = self.problem.run
        visits = [
            (searching, block, count)
            for searching, whole in ((False, first), (True, run.iterations - first))
            for count in _divided(whole, _ROUNDS[searching])
            for block in self.blocks
        ]
        total, about = (run.iterations - first) * len(self.blocks), self.solver._about(self.problem)
        quiet = replace(run, callback=None, checkpoint_every=1)
        loop = Loop(
            quiet, lambda: {"phases": self.phases}, about, {"blocks": (self.state, self.load)}, [], "a search by blocks"
        )

        def visit():
            searching, block, count = visits[loop.done]
            if searching and self.rounded is None:
                self._round(loop)
            whole = self._changed(block, count, loop.done, max(total, 1) if searching else 0)
            loss = self.problem.loss_of_recorded(self.images)
            loop.keep(loss)
            if not whole:
                # Ended on the way, which a checkpoint must not hold.
                loop.torn = True
                raise KeyboardInterrupt
            loop.bar.update()
            return loss

        loop.go(len(visits), visit, desc="frames")
        loop.restore()
        rounded = self._round(loop) if self.rounded is None else self.rounded
        return self.phases, None, None, _gain(rounded, loop.best_loss)

    def _round(self, loop: Loop) -> torch.Tensor:
        """Round all phases to levels, with which the search begins, and return their loss."""
        self.phases.copy_(self.problem.display.modulator.shown(self.phases))
        self.images = self._seen(self.phases)
        self.rounded = rounded = self.problem.loss_of_recorded(self.images)
        loop.best_loss.fill_(math.inf)
        loop.keep(rounded)
        return rounded

    @torch.no_grad()
    def _seen(self, phases: torch.Tensor) -> torch.Tensor:
        """Return what the observer sees of all frames."""
        parts = (self._part(*with_frames(self.problem.display, block), phases[block]) for block in self.blocks)
        return functools.reduce(torch.add, parts)

    @torch.no_grad()
    def _part(self, display: Any, shares: torch.Tensor, phases: torch.Tensor) -> torch.Tensor:
        return shares[:, None, None] * display._recorded_of(self.problem.observer, display._lights(phases))

    def _changed(self, block: list[int], count: int, visit: int, steps: int) -> bool:
        """Change the frames of a block in some iterations, among levels if there are steps of a search.

        Return whether these came to their end.
        """
        run, done, start = self.problem.run, 0, self.phases[block]

        def counted(iteration, loss):
            nonlocal done
            done, self.steps = iteration + 1, self.steps + 1
            whole, part = divmod(self.steps, len(self.blocks))
            return part == 0 and run.callback is not None and run.callback(whole - 1, loss) is True

        some, shares = with_frames(self.problem.display, block)
        others = self.images - self._part(some, shares, start)
        own = Run(count, False, counted, seed=run.seed + visit)
        problem = replace(self.problem, display=beside(some, others, shares), start=start, run=own)
        if steps:
            loss, _ = seeded_loss(problem.loss, run.seed, start.device)
            search = _Search(replace(problem, loss=loss), start, self.solver.temperature, steps)
            found: Any = search.best_of(count, self.known, counted)
            self.known = search.state()
        else:
            found = Descent().solve(problem)
        self.phases[block] = found
        self.images = others + self._part(some, shares, found)
        return done == count


def _blocks(problem: Problem) -> list[list[int]]:
    """Return the frames that change together: all of them, or as many as the memory allows that light all colours."""
    display, budget = problem.display, problem.run.memory_budget or _MOST_BYTES
    planes, _, rows, columns = display.shape
    frames = list(range(display.frames))
    lit = sum(map(len, display.lit_frames)) / len(frames)
    most = min(_TOGETHER, max(1, int(budget / (_BYTES * planes * lit * rows * columns))))
    if isinstance(display.shares, Shares):
        return [frames]
    for count in range(-(-len(frames) // most), 1, -1):
        blocks = [frames[len(frames) * i // count : len(frames) * (i + 1) // count] for i in range(count)]
        if all(set(block) & set(own) for block in blocks for own in display.lit_frames):
            return blocks
    return [frames]


def _divided(iterations: int, parts: int) -> list[int]:
    """Return nearly equal numbers of iterations, none of them zero, that add up."""
    ends = [iterations * i // parts for i in range(parts + 1)]
    return [count for count in (b - a for a, b in itertools.pairwise(ends)) if count]


def _gain(rounded: torch.Tensor, found: torch.Tensor) -> torch.Tensor:
    """Return by how many decibels a loss is below that of rounded phases."""
    least = torch.finfo(rounded.dtype).tiny
    return 10 * torch.log10(rounded.clamp_min(least) / found.to(rounded).clamp_min(least))


def _product(slope: torch.Tensor, change: torch.Tensor) -> torch.Tensor:
    """Return what a loss changes with the light, to first order: the real part of the conjugate gradient times it."""
    return slope.real * change.real + slope.imag * change.imag


def _about(values: torch.Tensor) -> torch.Tensor:
    """Return the means of values over the pixels about each, ``[..., F, rows, columns]``."""
    planes = values.flatten(0, -3)
    return torch.nn.functional.avg_pool2d(planes, _AROUND, 1, _AROUND // 2).reshape(values.shape)


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
