"""Training of networks: batches, validation, the best weights, early stopping, interruption and checkpoints.

Files of weights are read without execution of code, and checked before their weights are loaded.
"""

import itertools
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak._torch_private import differentiates
from odak._validate import texts
from odak._warnings import ConvergenceWarning, warn
from odak.learn._tensors import advising_on_memory, checked_device
from odak.learn.tools.file import first_line, read_torch_file
from odak.learn.tools.iterations import Loop, Run, own_randomness
from odak.tools.paths import replacing, validate_path


@dataclass
class TrainingHistory:
    """Losses of the epochs of a training.

    Attributes
    ----------
    training : list of float
        Mean loss of the training batches in each epoch, taken while the weights change.
    validation : list of float
        Mean loss of the validation batches after each epoch; empty without such batches.
    best_epoch : int
        Epoch with the lowest validation loss, or training loss without validation. Epochs count from 1; 0 means that
        none was completed.
    best_loss : float
        Loss of that epoch.
    finished : bool
        True if the training was completed; False after a KeyboardInterrupt.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models.training import train
    >>> line, x = torch.nn.Linear(1, 1), torch.linspace(-1, 1, 64)[:, None]
    >>> def squared_error(model, batch):
    ...     return torch.nn.functional.mse_loss(model(batch), 2 * batch)
    >>> history = train(line, squared_error, [x], 5, progress=False)
    >>> len(history.training), history.best_epoch, history.finished
    (5, 5, True)
    """

    training: list[float] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    best_epoch: int = 0
    best_loss: float = math.inf
    finished: bool = False


_LESS_MEMORY = "use smaller batches, mixed_precision=True or device='cpu'; the training continues from its checkpoint"


@differentiates
def train(
    model: nn.Module,
    loss: Callable[[Any, Any], torch.Tensor],
    batches: Iterable[Any],
    epochs: int = 100,
    *,
    validation: Iterable[Any] | None = None,
    optimizer: torch.optim.Optimizer | Callable[..., Any] | None = None,
    learning_rate: float = 1e-3,
    scheduler: Callable[..., Any] | None = None,
    max_norm: float | None = None,
    patience: int | None = None,
    seed: int | None = None,
    device: torch.device | str | None = None,
    mixed_precision: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: int = 1,
    callback: Callable[[int, TrainingHistory], bool | None] | None = None,
    progress: bool = True,
    description: str = "training",
) -> TrainingHistory:
    """Train a module in place, and put it in evaluation mode.

    With `validation` or `patience` it ends with the weights of its best epoch, otherwise with the last ones.

    Parameters
    ----------
    model : torch.nn.Module
        Module to train.
    loss : callable
        ``loss(model, batch)`` is a tensor with one number. For validation it is called with the model in evaluation
        mode and without gradients.
    batches : iterable
        Training batches, iterated once per epoch: a list or a ``torch.utils.data.DataLoader``. Tensors in tuples,
        lists and dictionaries are moved to the device.
    epochs : int
        Number of epochs. A training may be continued from a checkpoint with more of them.
    validation : iterable, optional
        Batches whose mean loss determines the best epoch; by default the training loss does.
    optimizer : torch.optim.Optimizer or callable, optional
        The optimizer, or ``optimizer(parameters)`` that makes it; Adam by default.
    learning_rate : float
        Adam's step size.
    scheduler : callable, optional
        ``scheduler(optimizer)`` makes a learning rate scheduler, which steps once an epoch.
    max_norm : float, optional
        Largest norm of the gradient; a longer one is shortened to it.
    patience : int, optional
        Stop after this number of consecutive epochs without improvement.
    seed : int, optional
        Seed of what torch draws during the training: the order of a DataLoader, dropout, noise. By default it is drawn
        from torch's generator, whose state is otherwise restored at the end. Trainings in several threads of one
        process share that generator and do not repeat.
    device : torch.device or str, optional
        Device to move the model to; by default it stays where its parameters are.
    mixed_precision : bool
        Compute the loss in half precision where that is safe, with scaled gradients. On CUDA only; elsewhere it has no
        effect.
    checkpoint : path, optional
        File of the state of the training (``.pt``, ``.pth``). If it exists the training continues from it, to the same
        result bit for bit on a CPU. On a GPU some of torch's operations add in an order that varies from run to run.
    checkpoint_every : int
        Epochs between two writings of that file; it is also written at the end. After an interruption within an epoch
        the training continues from the last one written.
    callback : callable, optional
        ``callback(epoch, history)`` after each epoch, the first being 1; returning True stops.
    progress : bool
        Show a progress bar.
    description : str
        Name of the progress bar.

    Returns
    -------
    TrainingHistory
        Losses of the epochs and the best epoch. After a KeyboardInterrupt its ``finished`` is False and the model has
        the best weights so far.

    Raises
    ------
    ValueError
        If an argument is outside its range, there are no batches, or the checkpoint is not of this training.
    TypeError
        If the loss is not a tensor with one number.
    FloatingPointError
        If the training loss of an epoch is not finite; the model has the best weights of the epochs before.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models.training import train
    >>> _ = torch.manual_seed(0)
    >>> x = torch.linspace(-1, 1, 64)[:, None]
    >>> line = torch.nn.Linear(1, 1)
    >>> def squared_error(model, batch):
    ...     return torch.nn.functional.mse_loss(model(batch[0]), batch[1])
    >>> history = train(line, squared_error, [(x, 3 * x + 1)], 300, learning_rate=0.1, progress=False)
    >>> round(line.weight.item(), 2), round(line.bias.item(), 2), history.finished
    (3.0, 1.0, True)
    """
    learning_rate, max_norm = _validate.constants(learning_rate=learning_rate, max_norm=max_norm)
    _validate.instance("model", model, nn.Module, "a torch.nn.Module")
    for name, value in (("loss", loss), ("optimizer", optimizer), ("scheduler", scheduler), ("callback", callback)):
        if not (callable(value) or isinstance(value, torch.optim.Optimizer) or (value is None and name != "loss")):
            raise TypeError(f"{name} must be callable, got {type(value).__name__}")
    for name, value in (("batches", batches), ("validation", validation)):
        if isinstance(value, str) or not (isinstance(value, Iterable) or (value is None and name != "batches")):
            raise TypeError(f"{name} must be an iterable of batches, got {type(value).__name__}")
    _validate.real("learning_rate", learning_rate, positive=True)
    progress = _validate.flag("progress", progress)
    _validate.instance("description", description, str, "a string")
    if patience is not None:
        _validate.integer("patience", patience, minimum=1)
    if max_norm is not None:
        _validate.real("max_norm", max_norm, positive=True)
    device = _device_of(model) if device is None else checked_device("device", device)
    if checkpoint is not None:
        checkpoint = validate_path(checkpoint, (".pt", ".pth"), name="checkpoint")
        if not os.path.isdir(os.path.dirname(checkpoint)):
            raise ValueError(f"the folder of checkpoint {checkpoint!r} does not exist")
    training = _Training(model.to(device), loss, batches, validation, device, mixed_precision, max_norm)
    training.choose_optimizer(optimizer, learning_rate, scheduler)
    epochs = _validate.integer("epochs", epochs)

    def exhausted():
        return patience is not None and loop.done - history.best_epoch >= patience

    def after_epoch(number, _):
        return (callback is not None and callback(number + 1, history) is True) or exhausted()

    with own_randomness(seed, device), advising_on_memory(_LESS_MEMORY):
        history = training.history
        loop = training.loop = Loop(
            Run(progress=progress, callback=after_epoch, checkpoint=checkpoint, checkpoint_every=checkpoint_every),
            model.state_dict,
            training.about,
            training.parts(),
            training.generators(),
            "a training",
        )
        loop.stopped = exhausted()
        try:
            history.finished = loop.go(epochs, training.epoch, _length(batches), desc=description, leave=False)
        finally:
            if validation is not None or patience is not None or not history.finished:
                loop.restore()
            model.eval()
    if not history.finished:
        warn(
            f"training interrupted after {loop.done} of {epochs} epochs: the model has the weights of epoch "
            f"{history.best_epoch}",
            ConvergenceWarning,
        )
    return history


def _device_of(model) -> torch.device:
    first = next(model.parameters(), None)
    if first is None:
        raise ValueError(f"model must have parameters to train, {type(model).__name__} has none")
    return first.device


class _Training:
    """Epochs of a training: the model, its batches and what changes its weights."""

    loop: Loop

    def __init__(self, model, loss, batches, validation, device, mixed_precision, max_norm):
        self.model, self.loss, self.batches, self.validation = model, loss, batches, validation
        self.device, self.max_norm = device, max_norm
        self.mixed = _validate.flag("mixed_precision", mixed_precision) and device.type == "cuda"
        self.scaler = torch.amp.GradScaler("cuda", enabled=self.mixed)
        self.history = TrainingHistory()

    def choose_optimizer(self, optimizer, learning_rate, scheduler):
        """Take or construct the optimizer, then the scheduler."""
        if optimizer is None:
            optimizer = torch.optim.Adam(self.model.parameters(), lr=learning_rate)
        elif not isinstance(optimizer, torch.optim.Optimizer):
            optimizer = optimizer(self.model.parameters())
        self.optimizer = optimizer
        # Read before the scheduler is constructed, which changes these numbers.
        self.about = {
            "weights": {name: list(value.shape) for name, value in self.model.state_dict().items()},
            "optimizer": type(optimizer).__name__,
            "optimizer's settings": [_plain(group) for group in optimizer.param_groups],
            "number of batches": _length(self.batches),
            "number of generators": len(self.generators()),
            "mixed precision": self.mixed,
        }
        self.scheduler = None if scheduler is None else scheduler(optimizer)
        self.about["scheduler"] = None if scheduler is None else type(self.scheduler).__name__

    def parts(self):
        """Return what belongs to a checkpoint besides the weights: functions that return it and take it over."""
        held = {"optimizer": self.optimizer, "scheduler": self.scheduler, "scaler": self.scaler}
        found = {n: (part.state_dict, part.load_state_dict) for n, part in held.items() if part is not None}
        history = vars(self.history)
        return found | {"history": (history.copy, lambda state: history.update(vars(TrainingHistory(**state))))}

    def epoch(self) -> float:
        """Train for an epoch and return the loss by which its weights are judged."""
        self.loop.torn, number = True, self.loop.done + 1
        judged = training = self._mean_over(self.batches, "batches", self._step, self.loop.bar)
        if math.isfinite(training) and self.validation is not None:
            judged = self._mean_over(self.validation, "validation", self._validation_loss)
        for kind, value in (("training", training), ("validation", judged)):
            if not math.isfinite(value):
                raise FloatingPointError(
                    f"the {kind} loss of epoch {number} is {value}: lower the learning rate, or look for values of the "
                    "data that are not finite"
                )
        if self.validation is not None:
            self.history.validation.append(judged)
        self.history.training.append(training)
        if judged < self.history.best_loss:
            self.history.best_epoch, self.history.best_loss = number, judged
        self.loop.keep(torch.tensor(judged, dtype=torch.float64, device=self.device))
        if isinstance(self.scheduler, torch.optim.lr_scheduler.ReduceLROnPlateau):
            self.scheduler.step(judged)
        elif self.scheduler is not None:
            self.scheduler.step()
        self.loop.bar.set_postfix(loss=f"{judged:.3g}", best=f"{self.history.best_loss:.3g}", refresh=False)
        return judged

    def _mean_over(self, batches, name, value_of, bar=None) -> float:
        """Return the mean loss over batches, read from the device once at the end."""
        self.model.train(bar is not None)
        total, count = torch.zeros((), dtype=torch.float64, device=self.device), 0
        for batch in batches:
            total += value_of(_moved(batch, self.device)).detach()
            count += 1
            if bar is not None:
                bar.update()
        if count == 0:
            raise ValueError(
                f"{name} was empty in epoch {self.loop.done + 1}; a list or a DataLoader can be iterated once per epoch"
            )
        return float(total / count)

    def _step(self, batch) -> torch.Tensor:
        self.optimizer.zero_grad(set_to_none=True)
        with torch.enable_grad():
            value = self._value(batch)
            self.scaler.scale(value).backward()
        if self.max_norm is not None:
            self.scaler.unscale_(self.optimizer)
            nn.utils.clip_grad_norm_(self.model.parameters(), self.max_norm)
        self.scaler.step(self.optimizer)
        self.scaler.update()
        return value

    @torch.no_grad()
    def _validation_loss(self, batch) -> torch.Tensor:
        return self._value(batch)

    def _value(self, batch) -> torch.Tensor:
        with torch.autocast(self.device.type, enabled=self.mixed):
            value = self.loss(self.model, batch)
        if not isinstance(value, torch.Tensor) or value.numel() != 1:
            found = list(value.shape) if isinstance(value, torch.Tensor) else type(value).__name__
            raise TypeError(f"loss(model, batch) must be a tensor with one number, got {found}")
        return value.reshape(())

    def generators(self) -> list[torch.Generator]:
        """Return torch's own generators, and those that the batches draw from besides."""
        found = [torch.default_generator]
        if self.device.type == "cuda":
            found.append(torch.cuda.default_generators[torch.empty(0, device=self.device).device.index])
        for batches in (self.batches, self.validation):
            sampler = getattr(batches, "sampler", None)
            holders = (batches, sampler, getattr(getattr(batches, "batch_sampler", None), "sampler", None))
            for generator in (getattr(holder, "generator", None) for holder in holders):
                if isinstance(generator, torch.Generator) and not any(generator is other for other in found):
                    found.append(generator)
        return found


def _moved(batch, device):
    """Return a batch with its tensors on the device."""
    if isinstance(batch, torch.Tensor):
        return batch.to(device, non_blocking=True)
    if isinstance(batch, dict):
        return {name: _moved(part, device) for name, part in batch.items()}
    if isinstance(batch, (list, tuple)):
        parts = [_moved(part, device) for part in batch]
        return type(batch)(*parts) if hasattr(batch, "_fields") else type(batch)(parts)
    return batch


def _length(batches) -> int | None:
    return len(batches) if hasattr(batches, "__len__") else None


def _plain(group: dict[Any, Any]) -> dict[Any, Any]:
    return {name: value for name, value in group.items() if isinstance(value, (bool, int, float, str, tuple))}


REDUCTIONS = ("sum", "mean", "none")


def errors(reduction: str) -> tuple[torch.nn.MSELoss, torch.nn.L1Loss]:
    """Return torch's squared and absolute error with a reduction: "sum", "mean" or "none"."""
    reduction = _validate.one_of("reduction", reduction, REDUCTIONS)
    return torch.nn.MSELoss(reduction=reduction), torch.nn.L1Loss(reduction=reduction)


def weighted_errors(
    l2: torch.nn.MSELoss,
    l1: torch.nn.L1Loss,
    input_data: torch.Tensor,
    ground_truth: torch.Tensor,
    weights: Sequence[float],
) -> torch.Tensor:
    """Return weights[0]·squared error + weights[1]·absolute error.

    Parameters
    ----------
    l2, l1 : torch.nn.Module
        The two errors, from :func:`errors`.
    input_data, ground_truth : torch.Tensor
        Tensors of one shape.
    weights : sequence of float
        Two numbers.

    Raises
    ------
    ValueError
        If the shapes differ, or there are not two weights.
    """
    for name, value in (("input_data", input_data), ("ground_truth", ground_truth)):
        _validate.instance(name, value, torch.Tensor, "a tensor")
    _validate.alike(input_data=input_data, ground_truth=ground_truth)
    if not hasattr(weights, "__len__") or len(weights) != 2:
        raise ValueError(f"weights must be two numbers, squared error first; got {weights!r:.80}")
    weights = _validate.several("weights", weights, 2)
    return weights[0] * l2(input_data, ground_truth) + weights[1] * l1(input_data, ground_truth)


EXTENSIONS = (".pt", ".pth")

_LISTED = 20


def save_weights(
    module: nn.Module, filename: str | os.PathLike[str], *, extensions: Iterable[str] = EXTENSIONS
) -> None:
    """Write the state dict of a module to a file, atomically.

    Parameters
    ----------
    module : torch.nn.Module
        Module whose parameters and buffers are written.
    filename : str or os.PathLike
        File to write; an existing one stays as it is until the new one is complete.
    extensions : iterable of str
        Accepted extensions.

    Raises
    ------
    ValueError
        If the path is not acceptable or its folder does not exist.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.models import load_weights, save_weights
    >>> first, second = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "weights.pt")
    ...     save_weights(first, name)
    ...     load_weights(second, name)
    >>> torch.equal(first.weight, second.weight)
    True
    """
    with replacing(validate_path(filename, texts("extensions", extensions))) as stream:
        torch.save(_module(module).state_dict(), stream)


def load_weights(
    module: nn.Module,
    filename: str | os.PathLike[str],
    *,
    device: torch.device | str | None = None,
    extensions: Iterable[str] = EXTENSIONS,
) -> None:
    """Read a state dict from a file into a module, and put the module in evaluation mode.

    If the file does not fit, the module stays unchanged.

    Parameters
    ----------
    module : torch.nn.Module
        Module to load the weights into; it keeps its device and dtype.
    filename : str or os.PathLike
        File of :func:`save_weights`, or of ``torch.save(module.state_dict(), …)``.
    device : torch.device or str, optional
        Device that the file is read to; by default the device of the module, so that a file written on a GPU can be
        read without one.
    extensions : iterable of str
        Accepted extensions.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable; if the file is broken, would run code, or holds no state dict; or if its keys or
        shapes differ from the module's: the message names those missing, unexpected and of another shape.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.models import load_weights, save_weights
    >>> first, second = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "weights.pt")
    ...     save_weights(first, name)
    ...     load_weights(second, name)
    >>> torch.equal(first.weight, second.weight)
    True
    """
    path = validate_path(filename, texts("extensions", extensions))
    module, device = _module(module), checked_device("device", device)
    if device is None:
        first = next(itertools.chain(module.parameters(), module.buffers()), None)
        device = torch.device("cpu") if first is None else first.device
    set_state(module, read_state(path, device), path)


def set_state(module: nn.Module, state: dict[Any, Any], path: str) -> None:
    """Load a state dict read from a file into a module, and put the module in evaluation mode.

    Parameters
    ----------
    module : torch.nn.Module
        Module to load the state into; it stays unchanged if the state does not fit.
    state : dict
        Tensors by name.
    path : str
        Path of the file, for error messages.

    Raises
    ------
    ValueError
        If the keys or shapes differ from the module's.
    """
    if differences := _differences(module.state_dict(), state):
        raise ValueError(f"{path!r} does not fit {type(module).__name__}: {'; '.join(differences)}")
    module.load_state_dict(state)
    module.eval()


def read_state(path: str, device: torch.device | str | None) -> dict[Any, Any]:
    """Return the state dict in a file, its tensors on a device, without running code."""
    try:
        state = read_torch_file(path, device)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path!r} cannot be read as weights: {first_line(error)}") from error
    if not isinstance(state, dict) or not all(isinstance(value, torch.Tensor) for value in state.values()):
        raise ValueError(f"{path!r} contains no state dict (tensors by name)")
    return state


def _differences(wanted: dict[Any, Any], found: dict[Any, Any]) -> list[str]:
    """Describe the differences in keys and shapes between two state dicts."""
    # Older files of batch norms have no counter of batches; torch then starts it at zero.
    missing = [key for key in wanted if key not in found and not key.endswith("num_batches_tracked")]
    unexpected = [key for key in found if key not in wanted]
    reshaped = [
        f"{key} {tuple(found[key].shape)} instead of {tuple(wanted[key].shape)}"
        for key in wanted
        if key in found and found[key].shape != wanted[key].shape
    ]
    groups = {"missing": missing, "unexpected": unexpected, "of another shape": reshaped}
    return [f"{title}: {_listed(keys)}" for title, keys in groups.items() if keys]


def _listed(keys) -> str:
    rest = len(keys) - _LISTED
    return ", ".join(map(str, keys[:_LISTED])) + (f" and {rest} more" if rest > 0 else "")


def _module(module) -> nn.Module:
    _validate.instance("module", module, nn.Module, "a torch.nn.Module")
    return module
