"""The loop that trains networks: batches, validation, the best weights, early stopping, interruption, checkpoints."""

import os
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import nn
from tqdm import tqdm

from odak import _validate
from odak.learn._tensors import checked_device
from odak.learn.models.training_run import TrainingHistory, TrainingRun
from odak.learn.tools._checkpoints import own_randomness
from odak.learn.tools._memory import advising_on_memory

__all__ = ["TrainingHistory", "train"]

_LESS_MEMORY = "use smaller batches, mixed_precision=True or device='cpu'; a checkpoint written so far can be taken up"


def train(
    model: nn.Module,
    loss: Callable[[Any, Any], torch.Tensor],
    batches: Iterable,
    epochs: int = 100,
    *,
    validation: Iterable | None = None,
    optimizer: torch.optim.Optimizer | Callable | None = None,
    learning_rate: float = 1e-3,
    scheduler: Callable | None = None,
    max_norm: float | None = None,
    patience: int | None = None,
    seed: int | None = None,
    device: torch.device | str | None = None,
    mixed_precision: bool = False,
    checkpoint: str | os.PathLike | None = None,
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
        Training batches, gone through once an epoch: a list or a ``torch.utils.data.DataLoader``. Tensors in tuples,
        lists and dictionaries are moved to the device.
    epochs : int
        Number of epochs. A checkpoint may be taken up with more of them.
    validation : iterable, optional
        Batches that tell which epoch is best; without them the training loss does.
    optimizer : torch.optim.Optimizer or callable, optional
        The optimizer, or ``optimizer(parameters)`` that makes it; Adam by default.
    learning_rate : float
        Adam's step size.
    scheduler : callable, optional
        ``scheduler(optimizer)`` makes a learning rate scheduler, which steps once an epoch.
    max_norm : float, optional
        Largest norm of the gradient; a longer one is shortened to it.
    patience : int, optional
        Stop after so many epochs in a row without a new best.
    seed : int, optional
        Seed of all that torch draws meanwhile: the order of a DataLoader, dropout, noise. By default it is drawn from
        torch's generator. That generator is otherwise left alone.
    device : torch.device or str, optional
        Device to move the model to; by default it stays where its parameters are.
    mixed_precision : bool
        Compute the loss in half precision where that is safe, with scaled gradients. On CUDA only; elsewhere it has no
        effect.
    checkpoint : path, optional
        File to keep the state in (``.pt``, ``.pth``). If it is there, the training goes on from it, to the same result
        bit for bit on a CPU. On a GPU some of torch's operations add in an order that varies from run to run.
    checkpoint_every : int
        Epochs between two writings of that file; it is written at the end too. An interruption within an epoch goes
        back to the last one written.
    callback : callable, optional
        ``callback(epoch, history)`` after each epoch, the first being 1; returning True stops.
    progress : bool
        Show a progress bar.
    description : str
        Name of the progress bar.

    Returns
    -------
    TrainingHistory
        Losses of the epochs, and which was best. After a KeyboardInterrupt its ``finished`` is False and the model has
        the best weights so far.

    Raises
    ------
    ValueError
        If an argument is outside its range, there are no batches, or the checkpoint is not of this training.
    TypeError
        If the loss is not a tensor with one number.
    FloatingPointError
        If the training loss of an epoch is not finite; the model has the best weights of those before.

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
    if not isinstance(model, nn.Module):
        raise TypeError(f"model must be a torch.nn.Module, got {type(model).__name__}")
    for name, value in (("loss", loss), ("optimizer", optimizer), ("scheduler", scheduler), ("callback", callback)):
        if not (callable(value) or isinstance(value, torch.optim.Optimizer) or (value is None and name != "loss")):
            raise TypeError(f"{name} must be callable, got {type(value).__name__}")
    for name, value in (("batches", batches), ("validation", validation)):
        if isinstance(value, str) or not (isinstance(value, Iterable) or (value is None and name != "batches")):
            raise TypeError(f"{name} must be an iterable of batches, got {type(value).__name__}")
    _validate.real("learning_rate", learning_rate, positive=True)
    progress = _validate.flag("progress", progress)
    if not isinstance(description, str):
        raise TypeError(f"description must be a string, got {type(description).__name__}")
    if patience is not None:
        _validate.integer("patience", patience, minimum=1)
    if max_norm is not None:
        _validate.real("max_norm", max_norm, positive=True)
    device = _device_of(model) if device is None else checked_device("device", device)
    run = TrainingRun(model.to(device), loss, batches, validation, device, mixed_precision)
    run.epochs = _validate.integer("epochs", epochs)
    run.patience, run.max_norm, run.callback = patience, max_norm, callback
    run.choose_optimizer(optimizer, learning_rate, scheduler)
    run.choose_checkpoint(checkpoint, checkpoint_every)
    with own_randomness(seed, device):
        run.resume()
        with advising_on_memory(_LESS_MEMORY):
            run.go(tqdm(disable=not progress, desc=description, leave=False, total=run.steps(epochs)))
    return run.history


def _device_of(model) -> torch.device:
    first = next(model.parameters(), None)
    if first is None:
        raise ValueError(f"model must have parameters to train, {type(model).__name__} has none")
    return first.device
