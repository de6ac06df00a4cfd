"""A multi-layer perceptron for curves, and the choice of the parameters that are trained."""

import logging
import os

import torch

from odak import _validate
from odak._bars import tqdm
from odak._torch_private import differentiates
from odak.learn._tensors import floating, trainable
from odak.learn.tools.file import save_torch_tensor, torch_load


def freeze(model: torch.nn.Module) -> None:
    """Exclude all parameters of a model from the computation of gradients.

    Parameters
    ----------
    model : torch.nn.Module
        Model to change.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import freeze, unfreeze
    >>> model = torch.nn.Linear(2, 1)
    >>> freeze(model)
    >>> frozen = model.weight.requires_grad
    >>> unfreeze(model)
    >>> frozen, model.weight.requires_grad
    (False, True)
    """
    _module(model).requires_grad_(False)


def unfreeze(model: torch.nn.Module) -> None:
    """Include all parameters of a model in the computation of gradients again.

    Parameters
    ----------
    model : torch.nn.Module
        Model to change.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import freeze, unfreeze
    >>> model = torch.nn.Linear(2, 1)
    >>> freeze(model)
    >>> frozen = model.weight.requires_grad
    >>> unfreeze(model)
    >>> frozen, model.weight.requires_grad
    (False, True)
    """
    _module(model).requires_grad_(True)


def _module(model):
    _validate.instance("model", model, torch.nn.Module, "a torch.nn.Module")
    return model


class multi_layer_perceptron(torch.nn.Module):
    """A perceptron: a linear layer, hidden layers with rectifiers, a linear layer.

    Its weights keep the names that they have in the files of Odak 0.2.

    Parameters
    ----------
    n_input : int
        Numbers per sample of the input.
    n_hidden : int
        Numbers per sample of the hidden layers.
    n_output : int
        Numbers per sample of the output.
    n_layers : int
        Number of hidden layers.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import multi_layer_perceptron
    >>> multi_layer_perceptron(n_hidden=8)(torch.zeros(5, 1)).shape
    torch.Size([5, 1])
    """

    def __init__(self, n_input: int = 1, n_hidden: int = 64, n_output: int = 1, n_layers: int = 4):
        super().__init__()
        for name, value in (("n_input", n_input), ("n_hidden", n_hidden), ("n_output", n_output)):
            _validate.integer(name, value, minimum=1)
        hidden = (
            torch.nn.Sequential(torch.nn.Linear(n_hidden, n_hidden), torch.nn.ReLU())
            for _ in range(_validate.integer("n_layers", n_layers))
        )
        self.layers: torch.nn.ModuleList = torch.nn.ModuleList([torch.nn.Linear(n_input, n_hidden), *hidden])
        self.layer_final: torch.nn.Linear = torch.nn.Linear(n_hidden, n_output)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the outputs ``[..., n_output]`` for inputs ``[..., n_input]``.

        Parameters
        ----------
        x : torch.Tensor
            Inputs ``[..., n_input]``.
        """
        return self._output("x", x)

    def _output(self, name: str, value: torch.Tensor) -> torch.Tensor:
        weight = self.layer_final.weight
        x = trainable(floating(name, value, weight.dtype))
        width = self.layers[0].in_features
        _validate.shaped(name, x, f"[..., {width}]")
        if x.dtype != weight.dtype and not torch.is_autocast_enabled(x.device.type):
            raise TypeError(f"{name} must have the perceptron's precision, {weight.dtype}; got {x.dtype}")
        for layer in self.layers:
            x = layer(x)
        return self.layer_final(x)

    def estimate(self, x: torch.Tensor) -> torch.Tensor:
        """Return the outputs of :meth:`forward`, computed without a gradient.

        Parameters
        ----------
        x : torch.Tensor
            Inputs ``[..., n_input]``.
        """
        with torch.no_grad():
            return self.forward(x)

    @differentiates
    def fit(
        self,
        x_values: torch.Tensor,
        y_values: torch.Tensor,
        epochs: int = 100,
        learning_rate: float = 1e-5,
        *,
        progress: bool = True,
    ) -> bool:
        """Fit the perceptron to samples by Adam on the mean squared error of all of them at once.

        Parameters
        ----------
        x_values, y_values : torch.Tensor
            ``[n, n_input]`` and ``[n, n_output]``.
        epochs : int
            Number of steps.
        learning_rate : float
            Step size.
        progress : bool
            Show a progress bar.

        Returns
        -------
        bool
            True. The loss of the last step goes to the log.

        Raises
        ------
        ValueError
            If the output does not have the shape of `y_values`.
        """
        (learning_rate,) = _validate.constants(learning_rate=learning_rate)
        rate = _validate.number("learning_rate", learning_rate, least=0)
        self.optimizer: torch.optim.Adam = torch.optim.Adam(self.parameters(), lr=rate)
        self.loss_function: torch.nn.MSELoss = torch.nn.MSELoss()
        loss = None
        _validate.one_device(x_values=x_values, y_values=y_values)
        y_values = trainable(floating("y_values", y_values, self.layer_final.weight.dtype))
        for _ in tqdm(
            range(_validate.integer("epochs", epochs)), disable=not _validate.flag("progress", progress), leave=False
        ):
            self.optimizer.zero_grad()
            with torch.enable_grad():
                estimate = self._output("x_values", x_values)
                _validate.shaped("y_values", y_values, f"{list(estimate.shape)} for x_values of {list(x_values.shape)}")
                loss = self.loss_function(estimate, y_values)
            loss.backward()
            self.optimizer.step()
        if loss is not None:
            logging.getLogger("odak").info("Fitted in %d steps, loss %.3e", epochs, loss.item())
        return True

    def save_weights(self, filename: str | os.PathLike[str] = "./weights.pt") -> None:
        """Write the weights to a ``.pt``, ``.pth`` or ``.pkl`` file, atomically.

        Parameters
        ----------
        filename : str or path-like
            Path of the file, default "./weights.pt".
        """
        save_torch_tensor(filename, self.state_dict())

    def load_weights(self, filename: str | os.PathLike[str] = "./weights.pt") -> None:
        """Read the weights from a file of :meth:`save_weights`; a file that would run code is refused.

        Parameters
        ----------
        filename : str or path-like
            Path of the file, default "./weights.pt".
        """
        self.load_state_dict(torch_load(filename, map_location="cpu"))
