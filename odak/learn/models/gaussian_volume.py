"""A density in space as a mean of Gaussians, and its fit to samples."""

import itertools
import os
from collections.abc import Mapping
from numbers import Integral
from typing import Any

import torch
from torch import nn
from torch.utils.checkpoint import checkpoint

from odak import _validate
from odak.learn._tensors import checked_device, tensor, trainable
from odak.learn.models.arguments import features
from odak.learn.models.training import train
from odak.learn.models.volume_losses import DEFAULT_WEIGHTS, complete_weights, volume_loss
from odak.learn.models.weights import load_weights, save_weights
from odak.learn.tools.function import evaluate_3d_gaussians
from odak.log import logger
from odak.tools._paths import validate_path

_EXTENSIONS = (".pth", ".pt", ".bin")
_COLUMNS = {"centers": 3, "angles": 3, "scales": 3, "alphas": 1}
# Pairs of a point and a Gaussian computed at once, a dozen numbers each.
_PAIRS = 1 << 20


def whole_number(name: str, value) -> int:
    """Return a positive integer; raise ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise ValueError(f"{name} must be a positive integer, got {value!r}")
    return int(value)


class gaussian_3d_volume(nn.Module):
    """A density in space: the mean of Gaussians, see :func:`odak.learn.tools.evaluate_3d_gaussians`.

    Parameters
    ----------
    number_of_elements : int
        Number N of Gaussians.
    initial_centers, initial_angles, initial_scales, initial_alphas : torch.Tensor, optional
        First parameters, see :meth:`initialize_parameters`.

    Attributes
    ----------
    centers, scales : torch.nn.Parameter
        Centres and standard deviations along the Gaussians' own axes ``[N, 3]``.
    angles : torch.nn.Parameter
        Rotations about X, Y and Z in half-turns ``[N, 3]``: 1 is 180°.
    alphas : torch.nn.Parameter
        Weights ``[N, 1]``.
    l1_loss, l2_loss : torch.nn.Module
        Mean absolute and mean squared difference.

    Raises
    ------
    ValueError
        If the number is not a positive integer, or a shape is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussian_3d_volume
    >>> gaussian_3d_volume(10)(torch.zeros(5, 3)).shape
    torch.Size([5])
    """

    centers: nn.Parameter
    scales: nn.Parameter
    angles: nn.Parameter
    alphas: nn.Parameter

    def __init__(
        self,
        number_of_elements: int = 10,
        initial_centers: torch.Tensor | None = None,
        initial_angles: torch.Tensor | None = None,
        initial_scales: torch.Tensor | None = None,
        initial_alphas: torch.Tensor | None = None,
    ):
        super().__init__()
        self.number_of_elements = whole_number("number_of_elements", number_of_elements)
        given = (initial_centers, initial_angles, initial_scales, initial_alphas)
        self._take(dict(zip(_COLUMNS, given, strict=True)), prefix="initial_")
        self.l2_loss, self.l1_loss = nn.MSELoss(), nn.L1Loss()

    def initialize_parameters(
        self,
        centers: torch.Tensor | None = None,
        angles: torch.Tensor | None = None,
        scales: torch.Tensor | None = None,
        alphas: torch.Tensor | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """Replace all parameters: by those given, and the others by random ones.

        Parameters
        ----------
        centers, angles : torch.Tensor, optional
            ``[N, 3]``; from standard normal distributions by default.
        scales : torch.Tensor, optional
            ``[N, 3]``; even between 0 and 1 by default.
        alphas : torch.Tensor, optional
            ``[N, 1]`` or ``[N]``; even between 0 and 1 by default.
        device : torch.device or str
            Where the parameters live.

        Raises
        ------
        ValueError
            If a shape is wrong.
        """
        self._take({"centers": centers, "angles": angles, "scales": scales, "alphas": alphas}, device)

    def _take(self, given, device="cpu", prefix: str = ""):
        device = checked_device("device", device)
        for name, value in given.items():
            shape = (self.number_of_elements, _COLUMNS[name])
            if value is None:
                value = torch.randn(shape) if name in ("centers", "angles") else torch.rand(shape)
            value = tensor(prefix + name, value).detach().clone()
            value = value if value.is_floating_point() else value.float()
            if name == "alphas" and value.shape == shape[:1]:
                value = value[:, None]
            if tuple(value.shape) != shape:
                raise ValueError(f"{prefix}{name} must be {list(shape)}, got {list(value.shape)}")
            self.register_parameter(name, nn.Parameter(value.to(device)))

    def forward(self, points: torch.Tensor, test: bool = False) -> torch.Tensor:
        """Return the density at points.

        Parameters
        ----------
        points : torch.Tensor
            ``[n, 3]``.
        test : bool
            Keep nothing for gradients.

        Returns
        -------
        torch.Tensor
            ``[n]``. Many points are computed part by part, and once more in the backward pass.
        """
        at_once = max(1, _PAIRS // self.number_of_elements)
        points = features("points", points, 3)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not _validate.flag("test", test)):
            if len(points) <= at_once:
                return self._density(points)
            parts = points.split(at_once)
            options: dict[str, Any] = {"use_reentrant": False, "preserve_rng_state": False}
            return torch.cat([checkpoint(self._density, part, **options) for part in parts])

    def _density(self, points):
        return evaluate_3d_gaussians(points, self.centers, self.scales, 180 * self.angles, self.alphas).mean(dim=1)

    def evaluate(
        self,
        estimate: torch.Tensor,
        ground_truth: torch.Tensor,
        epoch_id: int = 0,
        epoch_count: int = 1,
        weights: Mapping = DEFAULT_WEIGHTS,
    ) -> torch.Tensor:
        """Return the loss of an estimate, with penalties on the parameters.

        Parameters
        ----------
        estimate, ground_truth : torch.Tensor
            Densities ``[n]``.
        epoch_id, epoch_count : int
            The weight of "utilization" grows with epoch_id/epoch_count.
        weights : dict
            Weights of the terms, see :func:`odak.learn.models.volume_losses.volume_loss`; those left out have their
            default.

        Returns
        -------
        torch.Tensor
            A number.

        Raises
        ------
        ValueError
            If a weight has an unknown name, or the percentile is not one.
        """
        _same_samples("estimate", estimate, ground_truth)
        _validate.integer("epoch_id", epoch_id)
        _validate.integer("epoch_count", epoch_count, minimum=1)
        return volume_loss(self, estimate, ground_truth, epoch_id, epoch_count, weights)

    def optimize(
        self,
        points: torch.Tensor,
        ground_truth: torch.Tensor,
        loss_weights: Mapping,
        learning_rate: float = 1e-2,
        number_of_epochs: int = 10,
        scheduler_power: float = 1,
        save_at_every: int = 1,
        max_norm: float | None = None,
        weights_filename: str | os.PathLike | None = None,
        *,
        verbose: bool = True,
    ) -> None:
        """Fit the density to samples by AdamW, the learning rate falling to zero.

        Parameters
        ----------
        points : torch.Tensor
            Where the samples are ``[n, 3]``.
        ground_truth : torch.Tensor
            The samples ``[n]``.
        loss_weights : dict
            As in :meth:`evaluate`.
        learning_rate : float
            First learning rate.
        number_of_epochs : int
            Number of steps.
        scheduler_power : float
            The rate falls as (1 − epoch/epochs)^power.
        save_at_every : int
            Epochs between two writings of the file.
        max_norm : float, optional
            Bound on the norm of the gradient.
        weights_filename : str or os.PathLike, optional
            File to write the parameters to; without one nothing is written.
        verbose : bool
            Show a progress bar.

        Raises
        ------
        ValueError, TypeError
            If an argument is outside its range.
        FloatingPointError
            If the loss is not finite.
        """
        epochs = _validate.integer("number_of_epochs", number_of_epochs)
        every = _validate.integer("save_at_every", save_at_every, minimum=1)
        _validate.real("learning_rate", learning_rate, positive=True)
        if _validate.real("scheduler_power", scheduler_power) < 0:
            raise ValueError(f"scheduler_power must be at least 0, got {scheduler_power}")
        if weights_filename is not None:
            validate_path(weights_filename, _EXTENSIONS, name="weights_filename")
        complete_weights(loss_weights, "loss_weights")
        points = features("points", points, 3).to(self.centers.device)
        _same_samples("points", points[..., 0], ground_truth)
        ground_truth = trainable(ground_truth.to(self.centers.device))
        steps = itertools.count()

        def loss(model, batch):
            return model.evaluate(model(batch[0]), batch[1], next(steps), epochs, loss_weights)

        def save(epoch, history):
            if weights_filename is not None and epoch % every == 0:
                self.save_weights(weights_filename)

        train(
            self,
            loss,
            [(points, ground_truth)],
            epochs,
            optimizer=lambda parameters: torch.optim.AdamW(parameters, lr=learning_rate),
            scheduler=lambda made: torch.optim.lr_scheduler.PolynomialLR(made, epochs, scheduler_power),
            max_norm=max_norm,
            callback=save,
            progress=_validate.flag("verbose", verbose),
            description="Gaussians",
        )

    def save_weights(self, weights_filename: str | os.PathLike) -> None:
        """Write the parameters to a ``.pth``, ``.pt`` or ``.bin`` file, whole or not at all.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        validate_path(weights_filename, _EXTENSIONS, name="weights_filename")
        save_weights(self, weights_filename, extensions=_EXTENSIONS)

    def load_weights(
        self,
        weights_filename: str | os.PathLike | None = None,
        device: torch.device | str | None = "cpu",
    ) -> None:
        """Read the parameters from a file of :meth:`save_weights`, and switch to evaluation.

        Parameters
        ----------
        weights_filename : str or os.PathLike, optional
            ``.pth``, ``.pt`` or ``.bin`` file; None does nothing. If there is no such file the parameters stay as they
            are, and a warning is logged.
        device : torch.device or str
            Device to read the tensors to on their way; the parameters stay on theirs.

        Raises
        ------
        ValueError
            If the path is not acceptable, or the file is broken, would run code or holds other parameters.
        """
        if weights_filename is None:
            return
        validate_path(weights_filename, _EXTENSIONS, name="weights_filename")
        try:
            load_weights(self, weights_filename, device=device, extensions=_EXTENSIONS)
        except FileNotFoundError:
            logger.warning("There is no file %s: the Gaussians stay as they are", weights_filename)


def _same_samples(name, samples, ground_truth):
    for key, value in ((name, samples), ("ground_truth", ground_truth)):
        if not isinstance(value, torch.Tensor):
            raise TypeError(f"{key} must be a tensor, got {type(value).__name__}")
    if samples.shape != ground_truth.shape:
        raise ValueError(
            f"{name} and ground_truth must hold as many samples, got {list(samples.shape)} and "
            f"{list(ground_truth.shape)}"
        )
    _validate.one_device(**{name: samples, "ground_truth": ground_truth})
