"""Networks that estimate rotations from lensless images of speckle."""

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak._torch_private import differentiates
from odak.learn._tensors import checked_device
from odak.learn.models.layers import features
from odak.learn.models.training import TrainingHistory, errors, load_weights, save_weights, train, weighted_errors
from odak.learn.tools.file import save_torch_tensor
from odak.tools.file import check_directory
from odak.tools.paths import validate_path

FRAME = (5, 180, 320)
_CONVOLUTIONS = ((5, 32, 3), (32, 64, 5), (64, 128, 7))
_FEATURES = (6400, 2048, 1024, 512, 128, 3)


class spec_track(nn.Module):
    """Network that estimates three rotations of an object from the speckle that it casts on a bare sensor.

    Three convolutions with pooling and five linear layers, 16 260 419 parameters (Chen, Dogan, Spjut and Akşit,
    "SpecTrack: Learned Multi-Rotation Tracking via Speckle Imaging", SIGGRAPH Asia 2024 Posters).

    Parameters
    ----------
    reduction : {"sum", "mean", "none"}
        Reduction of the errors by :meth:`evaluate`; training needs one of the first two.
    device : torch.device or str
        Device of the network.

    Attributes
    ----------
    train_history : list of float
        Mean loss of the training batches in each epoch of :meth:`fit`.
    validation_history : list of float
        Mean loss of the validation batches in each epoch.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.lensless import spec_track
    >>> spec_track().eval()(torch.rand(2, 5, 180, 320)).shape
    torch.Size([2, 3])
    """

    l2: torch.nn.MSELoss
    l1: torch.nn.L1Loss

    def __init__(self, reduction: str = "sum", device: torch.device | str = "cpu"):
        super().__init__()
        self.device: torch.device = torch.device("cpu") if device is None else checked_device("device", device)
        self.reduction = reduction
        self.l2, self.l1 = errors(reduction)
        self.train_history: list[float] = []
        self.validation_history: list[float] = []
        self.init_layers()

    def init_layers(self) -> None:
        """Construct the network with new random weights on its device."""
        layers: dict[str, nn.Module] = {}
        for i, (before, after, kernel) in enumerate(_CONVOLUTIONS, start=1):
            layers[f"conv{i}"] = nn.Conv2d(before, after, kernel, padding=1)
            layers[f"bn{i}"] = nn.BatchNorm2d(after)
            layers[f"relu{i}"] = nn.ReLU()
            layers[f"pool{i}"] = nn.MaxPool2d(3)
        layers["flatten"] = nn.Flatten()
        last = len(_FEATURES) - 1
        for i in range(1, last):
            layers[f"fc{i}"] = nn.Linear(_FEATURES[i - 1], _FEATURES[i])
            layers[f"fc_bn{i}"] = nn.BatchNorm1d(_FEATURES[i])
            layers[f"relu_fc{i}"] = nn.ReLU()
        layers[f"fc{last}"] = nn.Linear(_FEATURES[-2], _FEATURES[-1])
        self.network: nn.Sequential = nn.Sequential()
        for name, layer in layers.items():
            self.network.add_module(name, layer)
        self.to(self.device)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the angles ``[B, 3]`` for images ``[B, 5, 180, 320]``.

        For a batch of one image in training the batch norms between the linear layers use their running statistics,
        because one sample has none.

        Parameters
        ----------
        x : torch.Tensor
            Speckle images ``[B, 5, 180, 320]``: five frames of 180×320 pixels.

        Raises
        ------
        ValueError
            If the images have another size.
        """
        x = features("x", x, None, next(self.network.parameters(), None))
        _validate.shaped("x", x, "[B, 5, 180, 320], images of 180×320 pixels")
        if self.training and len(x) == 1:
            with _gathered_statistics(self.network):
                return self.network(x)
        return self.network(x)

    def evaluate(
        self, input_data: torch.Tensor, ground_truth: torch.Tensor, weights: Sequence[float] = (100.0, 1.0)
    ) -> torch.Tensor:
        """Return weights[0]·squared error + weights[1]·absolute error, reduced by `reduction`.

        Parameters
        ----------
        input_data, ground_truth : torch.Tensor
            Angles of one shape.
        weights : sequence of float
            Weights of the squared and of the absolute error.

        Returns
        -------
        torch.Tensor
            The loss.
        """
        return weighted_errors(self.l2, self.l1, input_data, ground_truth, weights)

    @differentiates
    def fit(
        self,
        trainloader: Iterable[Any],
        testloader: Iterable[Any],
        number_of_epochs: int = 100,
        learning_rate: float = 1e-5,
        weight_decay: float = 1e-5,
        directory: str | os.PathLike[str] = "./output",
        *,
        patience: int | None = None,
        seed: int | None = None,
        mixed_precision: bool = False,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: bool = True,
    ) -> TrainingHistory:
        """Train the network by Adam; its final weights have the lowest validation loss.

        Each epoch with a new lowest validation loss writes ``best_model_epoch_N.pt`` to the folder, N from 1. At the
        end the histories, lists of numbers, are written to ``log/train_log.pt`` and ``log/validation_log.pt``.

        Parameters
        ----------
        trainloader : iterable
            Training batches (images ``[B, 5, 180, 320]``, angles ``[B, 3]``), iterated once per epoch.
        testloader : iterable
            Validation batches of the same form.
        number_of_epochs : int
            Number of epochs.
        learning_rate : float
            Step size of Adam.
        weight_decay : float
            Weight of the L2 penalty on the parameters.
        directory : str or os.PathLike
            Folder to write to; created if missing.
        patience : int, optional
            Stop after this number of consecutive epochs without improvement.
        seed : int, optional
            Seed of what torch draws during the training.
        mixed_precision : bool
            Compute the loss in half precision where that is safe, on CUDA only.
        checkpoint : str or os.PathLike, optional
            File of the state of the training, from which it continues if the file exists.
        progress : bool
            Show a progress bar.

        Returns
        -------
        TrainingHistory
            Losses of this training and the best epoch.
        """
        for name, value in (("learning_rate", learning_rate), ("weight_decay", weight_decay)):
            _validate.number(name, value, least=0)
        folder = validate_path(directory, name="directory")
        check_directory(os.path.join(folder, "log"))

        def save_if_best(epoch, history):
            if history.best_epoch == epoch:
                self.save_weights(os.path.join(folder, f"best_model_epoch_{epoch}.pt"))

        history = train(
            self,
            lambda model, batch: model.evaluate(model(batch[0]), batch[1]),
            trainloader,
            number_of_epochs,
            validation=testloader,
            optimizer=lambda parameters: torch.optim.Adam(parameters, lr=learning_rate, weight_decay=weight_decay),
            patience=patience,
            seed=seed,
            mixed_precision=mixed_precision,
            checkpoint=checkpoint,
            callback=save_if_best,
            progress=progress,
            description="spec_track",
        )
        self.train_history.extend(history.training)
        self.validation_history.extend(history.validation)
        save_torch_tensor(os.path.join(folder, "log", "train_log.pt"), self.train_history)
        save_torch_tensor(os.path.join(folder, "log", "validation_log.pt"), self.validation_history)
        return history

    def save_weights(self, filename: str | os.PathLike[str] = "./weights.pt") -> None:
        """Write the network's weights to a ``.pt`` or ``.pth`` file, atomically.

        Parameters
        ----------
        filename : str or path-like
            Path of the file, default "./weights.pt".
        """
        save_weights(self.network, filename)

    def load_weights(self, filename: str | os.PathLike[str] = "./weights.pt") -> None:
        """Read the network's weights from a file and put the network in evaluation mode.

        Parameters
        ----------
        filename : str or path-like
            Path of a file that :meth:`save_weights` wrote, default "./weights.pt".

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is broken, would run code, or does not fit; the message names missing and unexpected keys.
        """
        load_weights(self.network, filename)
        self.eval()


@contextmanager
def _gathered_statistics(network: nn.Sequential) -> Iterator[None]:
    """Let the one-dimensional batch norms use their running statistics within the context."""
    norms = [layer for layer in network if isinstance(layer, nn.BatchNorm1d) and layer.training]
    for norm in norms:
        norm.eval()
    try:
        yield
    finally:
        for norm in norms:
            norm.train()
