"""One training of a network: its epochs, the best weights so far, and the checkpoint it goes on from."""

import copy
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import nn

from odak import _validate
from odak.learn.tools._checkpoints import randomness, read_checkpoint, set_randomness, taking_up, write_checkpoint
from odak.log import logger
from odak.tools._paths import validate_path

_PARTS = ("done", "model", "best", "history", "optimizer", "scheduler", "scaler", "randomness", "generators")


@dataclass
class TrainingHistory:
    """What a training went through.

    Attributes
    ----------
    training : list of float
        Mean loss of the training batches in each epoch, taken while the weights change.
    validation : list of float
        Mean loss of the validation batches after each epoch; empty without such batches.
    best_epoch : int
        Epoch with the lowest validation loss, or training loss where nothing is validated. Epochs count from 1; 0 means
        that none was completed.
    best_loss : float
        The loss of that epoch.
    finished : bool
        Whether the training came to its end; False after a KeyboardInterrupt.
    """

    training: list[float] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    best_epoch: int = 0
    best_loss: float = math.inf
    finished: bool = False


class TrainingRun:
    """One training: the model, where it is, and the best it has been."""

    epochs: int
    patience: int | None
    max_norm: float | None
    callback: Callable | None

    def __init__(self, model, loss, batches, validation, device, mixed_precision):
        self.model, self.loss, self.batches, self.validation = model, loss, batches, validation
        self.device = device
        self.mixed = _validate.flag("mixed_precision", mixed_precision) and device.type == "cuda"
        self.scaler = torch.amp.GradScaler("cuda", enabled=self.mixed)
        self.history = TrainingHistory()
        self.done = 0
        self.best = None
        self.saved = None
        self.torn = self.stopped = False

    def choose_optimizer(self, optimizer, learning_rate, scheduler):
        """Take the optimizer given, or make it; then the scheduler."""
        if optimizer is None:
            rate = _validate.real("learning_rate", learning_rate, positive=True)
            optimizer = torch.optim.Adam(self.model.parameters(), lr=rate)
        elif not isinstance(optimizer, torch.optim.Optimizer):
            optimizer = optimizer(self.model.parameters())
        self.optimizer = optimizer
        # A scheduler changes these numbers, so that they are read before there is one.
        self.about = {
            "weights": {name: list(value.shape) for name, value in self.model.state_dict().items()},
            "optimizer": type(optimizer).__name__,
            "optimizer's settings": [_plain(group) for group in optimizer.param_groups],
            "number of batches": _length(self.batches),
            "number of generators": len(self._generators()),
            "mixed precision": self.mixed,
        }
        self.scheduler = None if scheduler is None else scheduler(optimizer)
        self.about["scheduler"] = None if scheduler is None else type(self.scheduler).__name__

    def choose_checkpoint(self, checkpoint, every):
        """Take the path of the checkpoint and how often it is written."""
        self.checkpoint = None if checkpoint is None else validate_path(checkpoint, (".pt", ".pth"), name="checkpoint")
        self.checkpoint_every = _validate.integer("checkpoint_every", every, minimum=1)
        if self.checkpoint is not None and not os.path.isdir(os.path.dirname(self.checkpoint)):
            raise ValueError(f"the folder of checkpoint {self.checkpoint!r} does not exist")

    def steps(self, epochs) -> int | None:
        """Return the number of batches in so many epochs where it is known."""
        length = _length(self.batches)
        return None if length is None else epochs * length

    def go(self, bar):
        """Train until the end, an interruption or a stop, and choose the weights that the model is left with."""
        try:
            with bar:
                bar.update(self.steps(self.done) or 0)
                while not self._over():
                    self._epoch(bar)
        except KeyboardInterrupt:
            self._save()
            logger.warning(
                "interrupted after %d of %d epochs: the model has the weights of epoch %d",
                *(self.done, self.epochs, self.history.best_epoch),
            )
        else:
            self.history.finished = True
            self._save()
        finally:
            if not self.history.finished or self.validation is not None or self.patience is not None:
                self._take_best()
            self.model.eval()

    def _over(self) -> bool:
        waited = self.done - self.history.best_epoch
        return self.done >= self.epochs or self.stopped or (self.patience is not None and waited >= self.patience)

    def _epoch(self, bar):
        self.torn = True
        training = self._mean_over(self.batches, "batches", self._step, bar)
        if not math.isfinite(training):
            raise FloatingPointError(
                f"the training loss of epoch {self.done + 1} is {training}: lower the learning rate"
            )
        judged = training
        if self.validation is not None:
            judged = self._mean_over(self.validation, "validation", self._look)
            self.history.validation.append(judged)
        self.history.training.append(training)
        self.done += 1
        if judged < self.history.best_loss:
            self.history.best_epoch, self.history.best_loss = self.done, judged
            self.best = copy.deepcopy(self.model.state_dict())
        self._schedule(judged)
        self.randomness, self.torn = self._random_state(), False
        bar.set_postfix(loss=f"{judged:.3g}", best=f"{self.history.best_loss:.3g}", refresh=False)
        if self.callback is not None:
            self.stopped = self.callback(self.done, self.history) is True
            self.randomness = self._random_state()
        if self.done % self.checkpoint_every == 0:
            self._save()

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
                f"{name} gave nothing in epoch {self.done + 1}; a list or a DataLoader can be gone through each epoch"
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
    def _look(self, batch) -> torch.Tensor:
        return self._value(batch)

    def _value(self, batch) -> torch.Tensor:
        with torch.autocast(self.device.type, enabled=self.mixed):
            value = self.loss(self.model, batch)
        if not isinstance(value, torch.Tensor) or value.numel() != 1:
            found = list(value.shape) if isinstance(value, torch.Tensor) else type(value).__name__
            raise TypeError(f"loss(model, batch) must be a tensor with one number, got {found}")
        return value.reshape(())

    def _schedule(self, judged):
        if isinstance(self.scheduler, torch.optim.lr_scheduler.ReduceLROnPlateau):
            self.scheduler.step(judged)
        elif self.scheduler is not None:
            self.scheduler.step()

    def _take_best(self):
        if self.best is not None:
            self.model.load_state_dict(self.best)

    def _random_state(self):
        return randomness(self.device), [generator.get_state() for generator in self._generators()]

    def _generators(self) -> list[torch.Generator]:
        """Return the generators that the batches draw from besides torch's own."""
        found: list[torch.Generator] = []
        for batches in (self.batches, self.validation):
            sampler = getattr(batches, "sampler", None)
            holders = (batches, sampler, getattr(getattr(batches, "batch_sampler", None), "sampler", None))
            for generator in (getattr(holder, "generator", None) for holder in holders):
                if isinstance(generator, torch.Generator) and not any(generator is other for other in found):
                    found.append(generator)
        return found

    def _save(self):
        """Write the checkpoint, unless weights are half-way between two epochs or it is there already."""
        if self.checkpoint is None or self.torn or self.saved == self.done:
            return
        states, generators = self.randomness
        history = {"training": self.history.training, "validation": self.history.validation}
        best = {"best_epoch": self.history.best_epoch, "best_loss": self.history.best_loss}
        state = {
            "about": self.about,
            "done": self.done,
            "model": self.model.state_dict(),
            "best": self.best,
            "history": history | best,
            "optimizer": self.optimizer.state_dict(),
            "scheduler": None if self.scheduler is None else self.scheduler.state_dict(),
            "scaler": self.scaler.state_dict(),
            "randomness": states,
            "generators": generators,
        }
        write_checkpoint(self.checkpoint, state)
        self.saved = self.done

    def resume(self):
        """Take up the checkpoint, if there is one."""
        self.randomness = self._random_state()
        if self.checkpoint is None or not os.path.exists(self.checkpoint):
            return
        # Adam counts its steps on the CPU wherever the weights are: what is read goes there, and on from there.
        state = read_checkpoint(self.checkpoint, torch.device("cpu"), _PARTS, self.about, "a training")
        with taking_up(self.checkpoint):
            self._take_up(state)

    def _take_up(self, state):
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        if self.scheduler is not None:
            self.scheduler.load_state_dict(state["scheduler"])
        self.scaler.load_state_dict(state["scaler"])
        self.best, self.done = state["best"], _validate.integer("done", state["done"])
        self.saved = self.done
        self.history = TrainingHistory(**state["history"])
        set_randomness(state["randomness"], self.device)
        for generator, before in zip(self._generators(), state["generators"], strict=True):
            generator.set_state(before.to("cpu"))
        self.randomness = self._random_state()


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


def _plain(group: dict) -> dict:
    return {name: value for name, value in group.items() if isinstance(value, (bool, int, float, str, tuple))}
