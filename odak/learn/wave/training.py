"""The training loop of all hologram optimizers: Adam and L-BFGS, progress, best state, checkpoints."""

import functools
import hashlib
import inspect
import logging
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tqdm import tqdm

from odak import _validate
from odak._warnings import ArgumentWarning, ConvergenceWarning, warn
from odak.learn._tensors import advising_on_memory, floating, kind_of, trainable
from odak.learn.tools.file import read_checkpoint, taking_up, write_checkpoint

_log = logging.getLogger("odak")

_LESS_MEMORY = (
    "use fewer planes, frames or colours, a smaller resolution, complex64, the propagator's memory_budget, "
    "or device='cpu'; a checkpoint written so far can be taken up"
)
# A loss that ends this much above its lowest value has risen by more than the noise of a camera.
_RISEN = 1.1
_PARTS = ("done", "parameters", "best", "best_loss", "solver", "randomness")


@dataclass(frozen=True)
class Run:
    """How an optimization runs: how long, what it shows, and where its state is kept.

    Parameters
    ----------
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int
        Iterations between two writings of that file; it is written at the end and on an interruption too.
    iterations : int
        Number of iterations.
    seed : int
        Makes what is drawn at random reproducible.

    Examples
    --------
    >>> from odak.learn.wave import Run
    >>> Run(iterations=20, progress=False).iterations
    20
    """

    progress: bool = True
    callback: Callable[..., Any] | None = None
    checkpoint: str | os.PathLike[str] | None = None
    checkpoint_every: int = 50
    iterations: int = 60
    seed: int = 0

    def __post_init__(self):
        _validate.flag("progress", self.progress)
        _validate.function_or_none("callback", self.callback)
        _validate.integer("checkpoint_every", self.checkpoint_every, minimum=1)
        if self.checkpoint is not None and not isinstance(self.checkpoint, (str, os.PathLike)):
            raise TypeError(f"checkpoint must be a path, got {type(self.checkpoint).__name__}")
        if "\0" in os.fspath(self.checkpoint or ""):
            raise ValueError(f"checkpoint must not hold a null byte, got {self.checkpoint!r}")
        _validate.integer("iterations", self.iterations, minimum=1)
        _validate.integer("seed", self.seed)


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
    keep_best: bool = False,
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
    keep_best : bool
        Leave the parameters of the lowest loss rather than the last, with a ConvergenceWarning if the loss has risen
        since: for losses whose gradient is known roughly.

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
    chosen = {"adam": Adam, "lbfgs": LBFGS}[solver](list(parameters.values()))
    state = _State(parameters, chosen, run, about() if run.checkpoint is not None else {}, generators)
    state.resume()
    with advising_on_memory(_LESS_MEMORY):
        rate = learning_rate if callable(learning_rate) else lambda iteration: learning_rate
        return state.go(loss, rate, description, keep_best)


class _State:
    """State of an optimization: the parameters, the iteration and the best state so far."""

    def __init__(self, parameters, solver, run, about, generators):
        self.parameters, self.solver, self.options = parameters, solver, run
        self.generators = list(generators)
        self.iterations = run.iterations
        self.about = {"iterations": run.iterations, **about}
        self.device = next(iter(parameters.values())).device
        self.done = 0
        self.best = {name: parameter.detach().clone() for name, parameter in parameters.items()}
        self.best_loss = torch.full((), math.inf, dtype=torch.float64, device=self.device)
        self.randomness = self._randomness()
        self.torn = False

    def go(self, gradient, learning_rate, description, keep_best) -> bool:
        bar = tqdm(total=self.iterations, initial=self.done, desc=description, disable=not self.options.progress)
        loss = None
        try:
            with bar:
                while self.done < self.iterations:
                    loss = self._step(gradient, learning_rate)
                    self._show(bar, loss)
                    if self.options.callback is not None and self.options.callback(self.done - 1, loss) is True:
                        break
        except KeyboardInterrupt:
            self._save()
            for name, parameter in self.parameters.items():
                parameter.data.copy_(self.best[name])
            _log.warning(
                "interrupted after %d of %d iterations: the best hologram so far is returned",
                self.done,
                self.iterations,
            )
            return False
        if loss is not None and not math.isfinite(loss):
            raise FloatingPointError(f"the loss is {float(loss)} after {self.done} iterations: lower the learning rate")
        self._save()
        if keep_best and loss is not None:
            if float(loss) > _RISEN * float(self.best_loss):
                warn(
                    f"the loss rose from {float(self.best_loss):.3g} to {float(loss):.3g}, so that the best state is "
                    "returned: the gradient of the model does not lead to the image that is captured; register the "
                    "image, or put the fault into the model",
                    ConvergenceWarning,
                )
            for name, parameter in self.parameters.items():
                parameter.data.copy_(self.best[name])
        return True

    def _randomness(self):
        return [generator.get_state() for generator in self.generators]

    def _step(self, gradient, learning_rate):
        self.randomness = self._randomness()

        def evaluate():
            self.torn = False
            for parameter in self.parameters.values():
                parameter.grad = None
            with torch.enable_grad():
                loss = gradient(self.done)
                if loss.requires_grad:
                    loss.backward()
                    loss = loss.detach()
            self._remember(loss)
            self.torn = True
            return loss

        loss = self.solver.step(evaluate, learning_rate(self.done))
        self.torn = False
        self.done += 1
        self.randomness = self._randomness()
        if self.options.checkpoint is not None and self.done % self.options.checkpoint_every == 0:
            self._save()
        return loss

    def _remember(self, loss):
        """Keep the parameters if their loss is the lowest so far, without reading it from a GPU."""
        better = loss.detach() < self.best_loss
        for name, parameter in self.parameters.items():
            if self.device.type != "cpu":
                self.best[name].copy_(torch.where(better, parameter.detach(), self.best[name]))
            elif better:
                self.best[name].copy_(parameter.detach())
        self.best_loss.copy_(torch.where(better, loss.detach(), self.best_loss))

    def _show(self, bar, loss):
        if self.options.progress and (self.done % max(1, self.iterations // 20) == 0 or self.done == self.iterations):
            bar.set_postfix(loss=f"{float(loss):.3g}", refresh=False)
        bar.update()

    def _save(self):
        """Write the checkpoint, unless parameters are half-way between two iterations."""
        if self.options.checkpoint is None or self.torn:
            return
        state = {
            "about": self.about,
            "done": self.done,
            "parameters": {name: parameter.detach() for name, parameter in self.parameters.items()},
            "best": self.best,
            "best_loss": self.best_loss,
            "solver": self.solver.state(),
            "randomness": self.randomness,
        }
        write_checkpoint(self.options.checkpoint, state)

    def resume(self):
        """Take up the checkpoint, if there is one."""
        path = self.options.checkpoint
        if path is None or not os.path.exists(path):
            return
        state = read_checkpoint(path, self.device, _PARTS, self.about, "an optimization")
        with taking_up(path):
            self._take_up(state, path)

    def _take_up(self, state, path):
        shapes = [{name: tuple(t.shape) for name, t in d.items()} for d in (state["parameters"], self.parameters)]
        if shapes[0] != shapes[1]:
            raise ValueError(f"checkpoint {os.fspath(path)!r} holds {shapes[0]}, but this run has {shapes[1]}")
        for name, parameter in self.parameters.items():
            parameter.data.copy_(state["parameters"][name])
            self.best[name].copy_(state["best"][name])
        self.best_loss.copy_(state["best_loss"])
        self.solver.load(state["solver"])
        self.done = _validate.integer("done", state["done"])
        for generator, drawn in zip(self.generators, state["randomness"], strict=True):
            generator.set_state(drawn.cpu())


def generator_from(seed: int | None, device: torch.device | str = "cpu") -> torch.Generator:
    """Return a new generator with a seed; without one, with a seed drawn from torch's own generator."""
    seed = int(torch.randint(2**62, ())) if seed is None else _validate.integer("seed", seed)
    return torch.Generator(device).manual_seed(seed)


def parameters_of(loss: Callable) -> dict[str, inspect.Parameter]:
    """Return the parameters of a loss by name; none where they are not known, as for functions of torch in C++."""
    try:
        return dict(inspect.signature(loss.forward if isinstance(loss, torch.nn.Module) else loss).parameters)
    except ValueError:
        return {}


def seeded_loss(
    loss: Callable | None, seed: int | None, device: torch.device
) -> tuple[Callable, list[torch.Generator]]:
    """Return a loss whose random numbers a seed reaches, and the generators whose state belongs to a checkpoint.

    Parameters
    ----------
    loss : callable or None
        The user's loss, by default the mean squared error; one that takes a `generator`, which is not bound to one
        yet, is given one.
    seed : int or None
        Seed of the run.
    device : torch.device
        Where the loss draws.
    """
    if loss is None:
        return torch.nn.functional.mse_loss, []
    own = getattr(loss, "generator", None)
    kept, found = [own] if isinstance(own, torch.Generator) else [], parameters_of(loss).get("generator")
    if found is not None and (found.default is None or found.default is found.empty):
        # Not the generator of the start, whose numbers the noise would repeat.
        kept.insert(0, generator_from(None if seed is None else (seed + 1) % 2**62, device))
        loss = functools.partial(loss, generator=kept[0])
    return loss, kept


def check_brightness(name: str, targets: torch.Tensor, reachable: float | torch.Tensor, remedy: str = "") -> None:
    """Issue a warning if a mean intensity exceeds what phase-only holograms, which conserve energy, can reach.

    Parameters
    ----------
    name : str
        Name of the targets in the warning.
    targets : torch.Tensor
        Intensities ``[..., rows, columns]``.
    reachable : float or torch.Tensor
        Mean intensity of the light on the modulator, that of its frames added up; fits ``[...]``. Infinite where the
        scale of the targets is free: those of 0 … 255 are still named.
    remedy : str
        What else may be done, after "or".
    """
    means = targets.mean((-2, -1))
    limits = torch.as_tensor(reachable, dtype=means.dtype, device=means.device).expand_as(means)
    if bool((means > limits * (1 + 1e-5)).any()):
        place = (means - limits).argmax()
        most, mean = (values.flatten()[place].item() for values in (limits, means))
        warn(
            f"{name} must have a mean intensity of at most {most:.4g}, that of the light on the modulator, "
            f"got {mean:.4g}: give intensities of 0 … 1 (8-bit values divided by 255)"
            + (f", or {remedy}" if remedy else ""),
            ArgumentWarning,
        )
    else:
        _validate.check_values(name, targets, "give intensities of 0 … 1 (8-bit values divided by 255)")


def checked_intensities(name: str, values: torch.Tensor) -> torch.Tensor:
    """Return a target in single or double precision after checking that it is finite and not negative."""
    if not isinstance(values, torch.Tensor) or values.is_complex():
        raise TypeError(f"{name} must be a torch.Tensor of real intensities, got {kind_of(values)}")
    values = values.detach() if values.dtype in (torch.float32, torch.float64) else values.detach().float()
    if not bool(values.isfinite().all()) or bool((values < 0).any()):
        raise ValueError(f"{name} must be finite intensities of at least 0, got NaN, infinite or negative values")
    return trainable(values)


def started(name: str, given, shapes: Sequence[tuple], like: torch.Tensor, draw: Callable, names: Sequence[str] = ()):
    """Return phases to start from: drawn as the first of some shapes, or given in one of them, as a copy.

    `draw(shape, dtype=)` draws them on the CPU, so that a seed gives the same start on every device.
    """
    if given is None:
        return draw(shapes[0], dtype=like.dtype).to(like.device)
    phase = floating(name, given).detach()
    _validate.real(name, phase.cpu())
    if tuple(phase.shape) not in shapes:
        accepted = " or ".join(str(list(shape)) for shape in dict.fromkeys(shapes))
        named = f", or one of {', '.join(map(repr, names))}" if names else ""
        raise ValueError(f"{name} must be {accepted}, which fits the target (targets){named}; got {list(phase.shape)}")
    return phase.to(like, copy=True)


def fingerprint(*tensors: torch.Tensor) -> str:
    """Return a short text that identifies tensors, by which a checkpoint is recognised."""
    digest = hashlib.sha256()
    for tensor in tensors:
        array = tensor.detach().resolve_conj().resolve_neg().cpu().contiguous().numpy()
        digest.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()[:16]


def cosine(rate: float, lowest: float, iterations: int) -> Callable[[int], float]:
    """Return a learning rate that falls from `rate` to `lowest` along half a cosine (Loshchilov and Hutter, 2017)."""
    return lambda iteration: lowest + (rate - lowest) * (1 + math.cos(math.pi * iteration / iterations)) / 2


def linear(rate: float, lowest: float, iterations: int) -> Callable[[int], float]:
    """Return a learning rate that falls linearly from `rate` to `lowest`."""
    return lambda iteration: rate + (lowest - rate) * iteration / iterations


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

    def __init__(self, parameters: Sequence[torch.Tensor], betas=(0.9, 0.999), epsilon: float = 1e-8):
        self.parameters, self.betas, self.epsilon = list(parameters), betas, epsilon
        self.means = [torch.zeros_like(parameter, requires_grad=False) for parameter in self.parameters]
        self.squares = [torch.zeros_like(mean) for mean in self.means]
        self.count = 0

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

    def state(self) -> dict:
        """Return what the next step depends on besides the parameters."""
        return {"means": self.means, "squares": self.squares, "count": self.count}

    def load(self, state: dict) -> None:
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

    def __init__(self, parameters: Sequence[torch.Tensor]):
        self.parameters = list(parameters)
        # Changes of the parameters and of the gradient, and the product of the two.
        self.pairs: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
        # At the present place; a step ends with the evaluation that the next one begins with.
        self.loss: torch.Tensor | None = None
        self.slope: torch.Tensor | None = None

    @torch.no_grad()
    def step(self, gradient: Callable[[], torch.Tensor], learning_rate: float) -> torch.Tensor:
        """Take one step and return the loss before it; the learning rate does not matter."""
        if self.loss is None or self.slope is None:
            self.loss, self.slope = self._evaluate(gradient)
        loss, slope = self.loss, self.slope
        start, direction = torch.cat([parameter.reshape(-1) for parameter in self.parameters]), self._direction(slope)
        descent, size = float(direction @ slope), 1.0
        # Of the loss: differences below are rounding.
        rounding = torch.finfo(loss.dtype).eps * abs(float(loss))
        for _ in range(self._TRIALS):
            change = size * direction
            self._put(start + change)
            found, there = self._evaluate(gradient)
            rise = float(found - loss)
            if rise <= 1e-4 * size * descent + rounding:
                break
            # To the minimum of the parabola through what is known, within limits that hold for NaN too.
            share = -descent * size / (2 * (rise - descent * size))
            size *= 0.1 if share < 0.1 else share if share < 0.5 else 0.5
        else:
            self._put(start)
            self.pairs.clear()
            return loss
        bend = there - slope
        if float(curvature := change @ bend) > 0:
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

    def state(self) -> dict:
        """Return what the next step depends on besides the parameters."""
        return {"pairs": self.pairs, "loss": self.loss, "slope": self.slope}

    def load(self, state: dict) -> None:
        """Take over a state that :meth:`state` returned."""
        self.pairs = [tuple(pair) for pair in state["pairs"]]
        self.loss, self.slope = state["loss"], state["slope"]
