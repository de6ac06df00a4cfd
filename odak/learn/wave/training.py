"""The loop that every hologram optimizer runs: steps, progress, the best so far, interruption and checkpoints."""

import hashlib
import logging
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from tqdm import tqdm

from odak import _validate
from odak.learn.tools._checkpoints import (
    own_randomness,
    randomness,
    read_checkpoint,
    set_randomness,
    taking_up,
    write_checkpoint,
)
from odak.learn.tools._memory import advising_on_memory
from odak.learn.wave.solvers import make_solver

_log = logging.getLogger("odak")

_LESS_MEMORY = (
    "use fewer planes, frames or colours, a smaller resolution, complex64, the propagator's memory_budget, "
    "or device='cpu'; a checkpoint written so far can be taken up"
)
_PARTS = ("done", "parameters", "best", "best_loss", "solver", "randomness")


@dataclass(frozen=True)
class Options:
    """How an optimization is run, whatever it optimizes.

    Attributes
    ----------
    progress : bool
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int
        Iterations between two writings of that file; it is written at the end and on an interruption too.
    seed : int, optional
        Seed of all that the loss draws; otherwise drawn from torch's generator.
    """

    progress: bool = True
    callback: Callable | None = None
    checkpoint: str | os.PathLike | None = None
    checkpoint_every: int = 50
    seed: int | None = None

    def __post_init__(self):
        _validate.flag("progress", self.progress)
        _validate.function_or_none("callback", self.callback)
        _validate.integer("checkpoint_every", self.checkpoint_every, minimum=1)
        if self.seed is not None:
            _validate.integer("seed", self.seed)
        if self.checkpoint is not None and not isinstance(self.checkpoint, (str, os.PathLike)):
            raise TypeError(f"checkpoint must be a path, got {type(self.checkpoint).__name__}")
        if "\0" in os.fspath(self.checkpoint or ""):
            raise ValueError(f"checkpoint must not hold a null byte, got {self.checkpoint!r}")


def minimise(
    parameters: dict[str, torch.Tensor],
    gradient: Callable[[int], torch.Tensor],
    iterations: int,
    learning_rate: Callable[[int], float],
    options: Options,
    *,
    solver: str = "adam",
    description: str = "hologram",
    about: dict[str, Any] | None = None,
) -> bool:
    """Minimise a loss over some tensors, in place.

    Parameters
    ----------
    parameters : dict of torch.Tensor
        Leaf tensors that require grad, by name.
    gradient : callable
        ``gradient(iteration)`` fills the parameters' ``grad`` (which is None before) and returns the loss, detached.
    iterations : int
        Number of iterations.
    learning_rate : callable
        ``learning_rate(iteration)``.
    options : Options
        Progress, callback, checkpoint and seed.
    solver : str
        "adam" or "lbfgs".
    description : str
        Name of the progress bar.
    about : dict, optional
        Numbers and words that a checkpoint must agree with to be taken up.

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
    run = _Run(parameters, make_solver(solver, list(parameters.values())), iterations, options, about or {})
    with own_randomness(options.seed, run.device):
        run.resume()
        with advising_on_memory(_LESS_MEMORY):
            return run.go(gradient, learning_rate, description)


class _Run:
    """One optimization: the parameters, where it is, and the best it has seen."""

    def __init__(self, parameters, solver, iterations, options, about):
        self.parameters, self.solver, self.options = parameters, solver, options
        self.iterations = iterations
        self.about = {"iterations": iterations, **about}
        self.device = next(iter(parameters.values())).device
        self.done = 0
        self.best = {name: parameter.detach().clone() for name, parameter in parameters.items()}
        self.best_loss = torch.full((), math.inf, dtype=torch.float64, device=self.device)
        self.randomness = randomness(self.device)
        self.torn = False

    def go(self, gradient, learning_rate, description) -> bool:
        bar = tqdm(
            total=self.iterations, initial=self.done, desc=description, disable=not self.options.progress, leave=False
        )
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
        return True

    def _step(self, gradient, learning_rate):
        self.randomness = randomness(self.device)

        def evaluate():
            self.torn = False
            for parameter in self.parameters.values():
                parameter.grad = None
            with torch.enable_grad():
                loss = gradient(self.done)
            self._remember(loss)
            self.torn = True
            return loss

        loss = self.solver.step(evaluate, learning_rate(self.done))
        self.torn = False
        self.done += 1
        self.randomness = randomness(self.device)
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
        bar.update()
        if self.options.progress and self.done % max(1, self.iterations // 20) == 0:
            bar.set_postfix(loss=f"{float(loss):.3g}", refresh=False)

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
        set_randomness(state["randomness"], self.device)


def fingerprint(*tensors: torch.Tensor) -> str:
    """Return a short text that other tensors do not have, for what a checkpoint is of."""
    digest = hashlib.sha256()
    for tensor in tensors:
        array = tensor.detach().resolve_conj().resolve_neg().cpu().contiguous().numpy()
        digest.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()[:16]


def constant(rate: float) -> Callable[[int], float]:
    """Return a learning rate that stays."""
    return lambda iteration: rate


def cosine(rate: float, lowest: float, iterations: int) -> Callable[[int], float]:
    """Return a learning rate that falls from `rate` to `lowest` along half a cosine (Loshchilov and Hutter, 2017)."""
    return lambda iteration: lowest + (rate - lowest) * (1 + math.cos(math.pi * iteration / iterations)) / 2


def linear(rate: float, lowest: float, iterations: int) -> Callable[[int], float]:
    """Return a learning rate that falls evenly from `rate` to `lowest`."""
    return lambda iteration: rate + (lowest - rate) * iteration / iterations
