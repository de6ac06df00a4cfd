"""Iterations: one loop for optimizers of holograms and trainings of networks, with their progress and checkpoints."""

import logging
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch

from odak import _validate
from odak._bars import tqdm
from odak._torch_private import in_own_precision
from odak._warnings import ConvergenceWarning, warn
from odak.learn._tensors import advising_on_memory
from odak.learn.tools.file import first_line, read_torch_file
from odak.tools.paths import replacing

_log = logging.getLogger("odak")

_LESS_MEMORY = (
    "use fewer planes, frames or colours, a smaller resolution, complex64, the propagator's memory_budget, "
    "or device='cpu'; a checkpoint written so far can be taken up"
)
# A loss that ends this much above its lowest value has risen by more than the noise of a camera.
_RISEN = 1.1
_PARTS = ("done", "parameters", "best", "best_loss", "randomness")


@dataclass(frozen=True)
class Run:
    """How an optimization runs: how long, what it shows, and where its state is kept.

    Parameters
    ----------
    iterations : int
        Number of iterations.
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int
        Iterations between two writings of that file; it is written at the end and on an interruption too.
    seed : int
        Seed of the random numbers, for reproducible results.
    memory_budget : int, optional
        Bytes that the fields of a display may take at once in :func:`odak.learn.wave.optimise` by gradient descent.
        With it frames, planes and colours are computed in parts, and again for the gradient; transfer functions that
        would take more than it are built anew for each part. Other runs have no use for it.

    Examples
    --------
    >>> from odak.learn.wave import Run
    >>> Run(20, progress=False).iterations
    20
    """

    iterations: int = 60
    progress: bool = True
    callback: Callable[..., Any] | None = None
    checkpoint: str | os.PathLike[str] | None = None
    checkpoint_every: int = 50
    seed: int = 0
    memory_budget: int | None = None

    def __post_init__(self) -> None:
        _validate.flag("progress", self.progress)
        _validate.function_or_none("callback", self.callback)
        _validate.integer("checkpoint_every", self.checkpoint_every, minimum=1)
        _validate.instance("checkpoint", self.checkpoint, (str, os.PathLike, type(None)), "a path")
        if "\0" in os.fspath(self.checkpoint or ""):
            raise ValueError(f"checkpoint must not hold a null byte, got {self.checkpoint!r}")
        _validate.integer("iterations", self.iterations, minimum=1)
        _validate.integer("seed", self.seed)
        if self.memory_budget is not None:
            _validate.integer("memory_budget", self.memory_budget, minimum=1)


@in_own_precision
def minimise(
    parameters: dict[str, torch.Tensor],
    loss: Callable[[int], torch.Tensor],
    learning_rate: float | Callable[[int], float],
    run: Run,
    *,
    solver: str = "adam",
    description: str = "hologram",
    about: Callable[[], dict[str, Any]] = dict,
    generators: Sequence[torch.Generator] = (),
    rising: str | None = None,
) -> bool:
    """Minimise a loss over some tensors, in place.

    Parameters
    ----------
    parameters : dict of torch.Tensor
        Leaf tensors that require grad, by name.
    loss : callable
        ``loss(iteration)`` returns the loss; one that is detached has filled the parameters' ``grad``, which is None
        before.
    learning_rate : float or callable
        Step, or ``learning_rate(iteration)``.
    run : Run
        Iterations, progress, callback and checkpoint.
    solver : str
        "adam" or "lbfgs".
    description : str
        Name of the progress bar.
    about : callable, optional
        ``about()`` returns numbers and words that a checkpoint must agree with to be taken up.
    generators : sequence of torch.Generator
        What the loss draws its random numbers from. A checkpoint holds their states, so that a run that is taken up
        draws what an uninterrupted one would have drawn.
    rising : str, optional
        Leave the parameters of the lowest loss rather than the last: for losses whose gradient is known roughly. If the
        loss has risen since, a ConvergenceWarning gives these words as its reason, unless they are empty.

    Returns
    -------
    bool
        Whether the run came to its end. After a KeyboardInterrupt it did not, and the parameters are the best so far.

    Raises
    ------
    ValueError
        If the checkpoint is not of this run.
    FloatingPointError
        If the loss is not finite in the end.
    """
    values = list(parameters.values())
    chosen = {"adam": Adam, "lbfgs": LBFGS}[solver](values)
    known = {"iterations": run.iterations, **about()} if run.checkpoint is not None else {}
    loop = Loop(
        run,
        lambda: {name: value.detach() for name, value in parameters.items()},
        known,
        {"solver": (chosen.state, chosen.load)},
        generators,
        "an optimization",
    )

    begun: list[torch.Tensor] = []

    def evaluate():
        loop.torn = False
        for value in values:
            value.grad = None
        with torch.enable_grad():
            found = loss(loop.done)
            if found.requires_grad:
                found.backward(inputs=values)
            elif all(value.grad is None for value in values):
                raise ValueError("loss must depend on what is optimised, got a value without a gradient")
        found = found.detach()
        if not begun:
            begun.append(found.clone())
        loop.keep(found)
        loop.torn = True
        return found

    def iterate():
        found = chosen.step(evaluate, learning_rate(loop.done) if callable(learning_rate) else learning_rate)
        shown = loop.done + 1
        if run.progress and (shown % max(1, run.iterations // 20) == 0 or shown == run.iterations):
            loop.bar.set_postfix(loss=f"{float(found):.3g}", refresh=False)
        loop.bar.update()
        return found

    with advising_on_memory(_LESS_MEMORY):
        ended = loop.go(run.iterations, iterate, desc=description)
    if not ended:
        _log.warning(
            "interrupted after %d of %d iterations: the best hologram so far is returned", loop.done, run.iterations
        )
        return False
    stays = begun and 0 < float(begun[0]) == float(loop.best_loss)
    if stays and not any(value.grad is not None and value.grad.any() for value in values):
        text = f"no descent leaves the start: its gradient is zero, and the loss stays {float(begun[0]):.3g}"
        warn(f"{text}; take another start", ConvergenceWarning)
    if rising is not None and loop.loss is not None:
        best, last = float(loop.best_loss), float(loop.loss)
        if rising and last > _RISEN * best:
            text = f"the loss rose from {best:.3g} to {last:.3g}, so that the best state is returned: {rising}"
            warn(text, ConvergenceWarning)
        loop.restore()
    return True


class Loop:
    """Iterations that keep the best values, write checkpoints, and end in order when they are interrupted.

    Parameters
    ----------
    run : Run
        Progress, callback and checkpoint.
    values : callable
        ``values()`` returns the tensors that change, by name.
    about : dict
        What a checkpoint must agree with to be taken up.
    parts : dict
        Pairs of functions that return and take over further parts of the state, by name.
    generators : sequence of torch.Generator
        Generators whose states belong to it.
    kind : str
        What such a run is, with its article, for messages.

    Attributes
    ----------
    done : int
        Iterations that are complete.
    torn : bool
        Set this while values are half-way between two iterations, which is not to be written.
    loss : torch.Tensor or float
        Loss of the last iteration, None before the first.
    bar : tqdm.tqdm
        The progress bar.
    """

    bar: Any
    loss: Any

    def __init__(
        self,
        run: Run,
        values: Callable[[], dict[str, torch.Tensor]],
        about: dict[str, Any],
        parts: dict[str, tuple[Callable[..., Any], Callable[..., Any]]],
        generators: Sequence[torch.Generator],
        kind: str,
    ) -> None:
        self.run: Run = run
        self.values: Callable[[], dict[str, torch.Tensor]] = values
        self.about: dict[str, Any] = about
        self.parts: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = parts
        self.generators: Sequence[torch.Generator] = generators
        self.done: int = 0
        self.saved: int = -1
        self.torn: bool = False
        self.stopped: bool = False
        self.loss = None
        self.best: dict[str, torch.Tensor] = {name: value.clone() for name, value in values().items()}
        self.device: torch.device = next(iter(self.best.values())).device
        self.best_loss: torch.Tensor = torch.full((), math.inf, dtype=torch.float64, device=self.device)
        if run.checkpoint is not None and os.path.exists(run.checkpoint):
            state = read_checkpoint(run.checkpoint, about, kind)
            with naming_checkpoint(run.checkpoint):
                self._take_up(state)
        self._remember_randomness()

    def go(self, iterations: int, iterate: Callable[[], Any], steps: int | None = 1, **bar: Any) -> bool:
        """Call a function once an iteration, which returns the loss; return whether the run came to its end.

        Parameters
        ----------
        iterations : int
            Number of iterations, including those that a checkpoint has done.
        iterate : callable
            ``iterate()`` takes an iteration and returns the loss.
        steps : int, optional
            Steps of the progress bar in an iteration, which `iterate` shows; None where they are not known.
        **bar
            Options of the progress bar.
        """
        bar |= {"total": None if steps is None else iterations * steps, "initial": self.done * (steps or 0)}
        try:
            with tqdm(disable=not self.run.progress, **bar) as self.bar:
                while self.done < iterations and not self.stopped:
                    self.loss = iterate()
                    self.done, self.torn = self.done + 1, False
                    self._remember_randomness()
                    if self.run.callback is not None:
                        self.stopped = self.run.callback(self.done - 1, self.loss) is True
                        self._remember_randomness()
                    if self.done % self.run.checkpoint_every == 0:
                        self._save()
        except KeyboardInterrupt:
            self._save()
            self.restore()
            return False
        if self.loss is not None and not math.isfinite(self.loss):
            value = float(self.loss)
            raise FloatingPointError(f"the loss is {value} after {self.done} iterations: lower the learning rate")
        self._save()
        return True

    def keep(self, loss: torch.Tensor) -> None:
        """Keep the values if their loss is the lowest so far, without reading it from a GPU."""
        better = loss < self.best_loss
        for name, value in self.values().items():
            if self.device.type != "cpu":
                self.best[name].copy_(torch.where(better, value, self.best[name]))
            elif better:
                self.best[name].copy_(value)
        self.best_loss.copy_(torch.where(better, loss, self.best_loss))

    def restore(self) -> None:
        """Put the values of the lowest loss in place."""
        for name, value in self.values().items():
            value.copy_(self.best[name])

    def _remember_randomness(self):
        self.randomness: list[torch.Tensor] = [generator.get_state() for generator in self.generators]

    def _save(self):
        """Write the checkpoint, unless values are half-way between two iterations or it is written."""
        if self.run.checkpoint is None or self.torn or self.saved == self.done:
            return
        known = self.about, self.done, self.values(), self.best, self.best_loss, self.randomness
        state = dict(zip(("about", *_PARTS), known, strict=True))
        write_checkpoint(self.run.checkpoint, state | {name: take() for name, (take, _) in self.parts.items()})
        self.saved = self.done

    def _take_up(self, state):
        shapes = [{name: tuple(t.shape) for name, t in d.items()} for d in (state["parameters"], self.best)]
        if shapes[0] != shapes[1]:
            name = os.fspath(self.run.checkpoint)  # type: ignore[arg-type]
            raise ValueError(f"checkpoint {name!r} holds {shapes[0]}, but this run has {shapes[1]}")
        for values, taken in ((self.values(), state["parameters"]), (self.best, state["best"])):
            for name, value in values.items():
                value.copy_(taken[name])
        self.best_loss.copy_(state["best_loss"])
        for name, (_, put) in self.parts.items():
            put(state[name])
        self.done = self.saved = _validate.integer("done", state["done"])
        for generator, drawn in zip(self.generators, state["randomness"], strict=True):
            generator.set_state(drawn)


def write_checkpoint(path: str | os.PathLike[str], state: dict[str, Any]) -> None:
    """Write the state of a run, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    state : dict
        Tensors, numbers, words, and lists and dictionaries of them; ``state["about"]`` identifies the run.
    """
    with replacing(os.fspath(path)) as stream:
        torch.save(state, stream)


def read_checkpoint(path: str | os.PathLike[str], about: dict[str, Any], kind: str) -> dict[str, Any]:
    """Read the state of a run, its tensors on the CPU, without running code.

    Parameters
    ----------
    path : str or os.PathLike
        File of :func:`write_checkpoint`.
    about : dict
        Values that the state must agree with.
    kind : str
        What such a run is, with its article, for messages.

    Returns
    -------
    dict
        The state.

    Raises
    ------
    ValueError
        If the file is broken, would run code, or is not of such a run.
    """
    name = repr(os.fspath(path))
    with _validate.refusing(lambda text: f"checkpoint {name} cannot be read: {text.splitlines()[0]}", Exception):
        state = read_torch_file(path, torch.device("cpu"))
    if not isinstance(state, dict) or not {"about", *_PARTS} <= set(state):
        raise ValueError(f"checkpoint {name} is not one of {kind}")
    before = state["about"]
    if not isinstance(before, dict):
        raise ValueError(f"checkpoint {name} is not one of {kind}: it does not state to which run it belongs")
    if before != about:
        differing = sorted(key for key in {*before, *about} if before.get(key) != about.get(key))
        raise ValueError(f"checkpoint {name} is of another run: its {', '.join(differing)} differ")
    return state


@contextmanager
def naming_checkpoint(path: str | os.PathLike[str]) -> Iterator[None]:
    """Convert errors while a state is restored to a ValueError that names its file.

    Parameters
    ----------
    path : str or os.PathLike
        File of :func:`write_checkpoint`, perhaps broken or from elsewhere.

    Raises
    ------
    ValueError
        In place of any other error.
    """
    try:
        yield
    except Exception as error:
        if os.fspath(path) in str(error):
            raise
        reason = f"{type(error).__name__}: {first_line(error)}"
        raise ValueError(f"checkpoint {os.fspath(path)!r} cannot be taken up ({reason})") from error


@contextmanager
def own_randomness(seed: int | None, device: torch.device) -> Iterator[None]:
    """Seed torch's generators within a block and restore their states at its end.

    Parameters
    ----------
    seed : int, optional
        Seed; drawn from torch's generator by default.
    device : torch.device
        A GPU whose generator is taken too.
    """
    if seed is None:
        seed = int(torch.randint(2**31, ()))
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(_validate.integer("seed", seed))
        yield


SOLVERS = ("adam", "lbfgs")


class Adam:
    """Adam (Kingma and Ba, 2015, algorithm 1).

    ``torch.optim.Adam`` does the same, but its constructor loads the compiler: two seconds and 80 MB, as much as
    twenty iterations at full size and more memory than the hologram's padded field. Weights do not decay: a phase is
    no better for being near zero.

    Parameters
    ----------
    parameters : sequence of torch.Tensor
        Leaf tensors that require grad.
    betas : tuple of float
        Memory of the mean and of the square of the gradient.
    epsilon : float
        Added to the root of the square.
    """

    means: list[torch.Tensor]

    def __init__(self, parameters: Sequence[torch.Tensor], betas: Any = (0.9, 0.999), epsilon: float = 1e-8) -> None:
        self.parameters: list[torch.Tensor] = list(parameters)
        self.betas: tuple[float, float] = betas
        self.epsilon: float = epsilon
        self.means = [torch.zeros_like(parameter, requires_grad=False) for parameter in self.parameters]
        self.squares: list[torch.Tensor] = [torch.zeros_like(mean) for mean in self.means]
        self.count: int = 0

    @torch.no_grad()
    def step(self, gradient: Callable[[], torch.Tensor], learning_rate: float) -> torch.Tensor:
        """Take one step and return the loss before it; `gradient()` returns that and fills the parameters' ``grad``."""
        loss = gradient()
        count = self.count + 1
        mean_bias, square_bias = (1 - beta**count for beta in self.betas)
        for parameter, mean, square in zip(self.parameters, self.means, self.squares, strict=True):
            slope = parameter.grad
            if slope is None:
                continue
            mean.lerp_(slope, 1 - self.betas[0])
            square.mul_(self.betas[1]).addcmul_(slope, slope, value=1 - self.betas[1])
            # The gradient is no longer needed, so that the denominator takes its memory.
            denominator = torch.sqrt(square, out=slope).div_(square_bias**0.5).add_(self.epsilon)
            parameter.addcdiv_(mean, denominator, value=-learning_rate / mean_bias)
        self.count = count
        return loss

    def state(self) -> dict[Any, Any]:
        """Return what the next step depends on besides the parameters."""
        return {"means": self.means, "squares": self.squares, "count": self.count}

    def load(self, state: dict[Any, Any]) -> None:
        """Take over a state that :meth:`state` returned."""
        for have, given in zip((*self.means, *self.squares), (*state["means"], *state["squares"]), strict=True):
            have.copy_(given)
        self.count = state["count"]


class LBFGS:
    """L-BFGS with a backtracking line search, one iteration a step (Nocedal and Wright, 2006, algorithms 7.5 and 3.1).

    ``torch.optim.LBFGS`` loads the compiler, as :class:`Adam` says. One iteration at a time it evaluates the loss
    twice, keeps 200 arrays, and forgets a step whose y·s is below 1e-10, which the mean over a million pixels makes it.

    Parameters
    ----------
    parameters : sequence of torch.Tensor
        Leaf tensors that require grad, in radians.
    """

    # More brought 0.1 dB in 120 iterations and take a pass over memory each.
    _PAIRS = 10
    # Mean change of the first step, in radians, and how often a step may be shortened.
    _FIRST, _TRIALS = 0.1, 25

    def __init__(self, parameters: Sequence[torch.Tensor]) -> None:
        self.parameters: list[torch.Tensor] = list(parameters)
        # Changes of the parameters and of the gradient, and the product of the two.
        self.pairs: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
        # At the present place; a step ends with the evaluation that the next one begins with.
        self.loss: torch.Tensor | None = None
        self.slope: torch.Tensor | None = None

    @torch.no_grad()
    def step(self, gradient: Callable[[], torch.Tensor], learning_rate: float) -> torch.Tensor:
        """Take one step and return the loss before it; the learning rate does not matter."""
        loss, slope = self._evaluate(gradient) if self.loss is None or self.slope is None else (self.loss, self.slope)
        start, direction = torch.cat([parameter.reshape(-1) for parameter in self.parameters]), self._direction(slope)
        along, size = direction @ slope, 1.0
        for _ in range(self._TRIALS):
            change = size * direction
            try:
                self._put(start + change)
                found, there = self._evaluate(gradient)
            except BaseException:
                # An interrupted step has not been taken.
                self._put(start)
                raise
            bend = there - slope
            # Read at once, for which a GPU waits once.
            curvature = change @ bend
            rise, descent, before, bent = torch.stack([found - loss, along, loss, curvature]).tolist()
            # Differences of the loss below are rounding.
            if rise <= 1e-4 * size * descent + torch.finfo(loss.dtype).eps * abs(before):
                break
            # To the minimum of the parabola through what is known, within limits that hold for NaN too.
            share = -descent * size / (2 * (rise - descent * size))
            size *= 0.1 if share < 0.1 else share if share < 0.5 else 0.5
        else:
            self._put(start)
            self.pairs.clear()
            self.loss, self.slope = loss, slope
            return loss
        if bent > 0:
            self.pairs = [*self.pairs[1 - self._PAIRS :], (change, bend, curvature)]
        self.loss, self.slope = found, there
        return loss

    def _evaluate(self, gradient):
        loss = gradient()
        slopes = [
            parameter.new_zeros(parameter.shape) if parameter.grad is None else parameter.grad
            for parameter in self.parameters
        ]
        return loss, torch.cat([slope.reshape(-1) for slope in slopes])

    def _put(self, place):
        sizes = [parameter.numel() for parameter in self.parameters]
        for parameter, part in zip(self.parameters, place.split(sizes), strict=True):
            parameter.copy_(part.view_as(parameter))

    def _direction(self, slope):
        """Return the direction of the next step, by the two loops over the pairs."""
        direction, weights = -slope, []
        for change, bend, curvature in reversed(self.pairs):
            weights.append((change @ direction) / curvature)
            direction.addcmul_(bend, weights[-1], value=-1)
        if not self.pairs:
            return direction * (self._FIRST / direction.abs().mean().clamp_min(torch.finfo(slope.dtype).tiny))
        _, bend, curvature = self.pairs[-1]
        direction *= curvature / (bend @ bend)
        for (change, bend, curvature), weight in zip(self.pairs, reversed(weights), strict=True):
            direction.addcmul_(change, weight - (bend @ direction) / curvature)
        return direction

    def state(self) -> dict[Any, Any]:
        """Return what the next step depends on besides the parameters."""
        return {"pairs": self.pairs, "loss": self.loss, "slope": self.slope}

    def load(self, state: dict[Any, Any]) -> None:
        """Take over a state that :meth:`state` returned."""
        there = self.parameters[0].device
        self.pairs = [tuple(part.to(there) for part in pair) for pair in state["pairs"]]
        self.loss, self.slope = (None if part is None else part.to(there) for part in (state["loss"], state["slope"]))
