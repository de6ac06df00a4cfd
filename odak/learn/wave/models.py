"""Networks that compute holograms, and one that propagates light to curved focal surfaces."""

import os
from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak._torch_private import differentiates
from odak.learn._tensors import checked_device
from odak.learn.models.layers import channels, images
from odak.learn.models.training import (
    EXTENSIONS,
    TrainingHistory,
    errors,
    load_weights,
    read_state,
    save_weights,
    set_state,
    train,
    weighted_errors,
)
from odak.learn.models.unets import (
    spatially_adaptive_unet,
    spatially_varying_kernel_generation_model,
    unet,
)
from odak.tools.file import check_directory, load_dictionary
from odak.tools.paths import validate_path

__all__ = ["focal_surface_light_propagation", "holobeam_multiholo"]

_LEAKY_RELU = nn.LeakyReLU(0.2, inplace=True)

# Sub-model of a focal surface model, and the name of its part in a key mapping file.
_MAPPINGS = {
    "sv_kernel_generation": "sv_kernel_generation_key_mapping",
    "light_propagation": "light_prop_key_mapping",
}


class holobeam_multiholo(nn.Module):
    """A U-Net that turns images into phase-only holograms (Akşit and Itoh, "HoloBeam", IEEE VR 2023).

    Parameters
    ----------
    n_input : int
        Channels of an image.
    n_hidden : int
        Channels of the U-Net's first level.
    n_output : int
        Output channels, at least 2: the two phases of the double-phase pattern.
    device : torch.device or str
        Device of the network.
    reduction : {"sum", "mean", "none"}
        How :meth:`evaluate` sums up errors; training needs one of the first two.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import holobeam_multiholo
    >>> holobeam_multiholo(n_hidden=4)(torch.rand(1, 1, 32, 48), test=True).shape
    torch.Size([1, 1, 32, 48])
    """

    l2: nn.MSELoss
    l1: nn.L1Loss

    def __init__(
        self,
        n_input: int = 1,
        n_hidden: int = 16,
        n_output: int = 2,
        device: torch.device | str = "cpu",
        reduction: str = "sum",
    ):
        super().__init__()
        _validate.integer("n_output", n_output, minimum=2)
        n_input, n_hidden = channels("n_input", n_input), channels("n_hidden", n_hidden)
        self.device: torch.device = checked_device("device", device)
        self.reduction = reduction
        self.l2, self.l1 = errors(reduction)
        self.network: unet = unet(dimensions=n_hidden, input_channels=n_input, output_channels=n_output)
        self.to(self.device)

    def forward(self, x: torch.Tensor, test: bool = False) -> torch.Tensor:
        """Return the holograms' phases.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, n_input, H, W]``.
        test : bool
            Compute without gradients.

        Returns
        -------
        torch.Tensor
            ``[B, 1, H, W]``: the network's first channel where row + column is even, its second where it is odd.
        """
        test = _validate.flag("test", test)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not test):
            phases = self.network(x)
            rows, columns = (torch.arange(n, device=x.device) for n in phases.shape[-2:])
            even = (rows[:, None] + columns) % 2 == 0
            return torch.where(even, phases[:, :1], phases[:, 1:2])

    def evaluate(
        self, input_data: torch.Tensor, ground_truth: torch.Tensor, weights: Sequence[float] = (1.0, 0.1)
    ) -> torch.Tensor:
        """Return weights[0]·squared error + weights[1]·absolute error, summed up as `reduction` says.

        Parameters
        ----------
        input_data, ground_truth : torch.Tensor
            Holograms of one shape.
        weights : sequence of float
            Two numbers.

        Returns
        -------
        torch.Tensor
            The loss.
        """
        return weighted_errors(self.l2, self.l1, input_data, ground_truth, weights)

    @differentiates
    def fit(
        self,
        dataloader: Iterable[Any],
        number_of_epochs: int = 100,
        learning_rate: float = 1e-5,
        directory: str | os.PathLike[str] = "./output",
        save_at_every: int = 100,
        *,
        seed: int | None = None,
        mixed_precision: bool = False,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: bool = True,
    ) -> TrainingHistory:
        """Train the network by Adam.

        The folder gets ``weights_NNNN.pt`` after each epoch N that `save_at_every` divides, N from 0, and
        ``weights.pt`` at the end.

        Parameters
        ----------
        dataloader : iterable
            Batches (images ``[B, n_input, H, W]``, holograms ``[B, 1, H, W]``), gone through once an epoch.
        number_of_epochs : int
            Number of epochs.
        learning_rate : float
            Adam's step size.
        directory : str or os.PathLike
            Folder to write to; it is made if need be.
        save_at_every : int
            Epochs from one file of weights to the next.
        seed : int, optional
            Seed of what torch draws during the training; by default it is drawn from torch's generator.
        mixed_precision : bool
            Compute the loss in half precision where that is safe; on CUDA only.
        checkpoint : path, optional
            File of the state of the training (``.pt``, ``.pth``), from which a training continues if it exists.
        progress : bool
            Show a progress bar.

        Returns
        -------
        TrainingHistory
            Losses of the epochs, and which was best.
        """
        (learning_rate,) = _validate.constants(learning_rate=learning_rate)
        folder = validate_path(directory)
        every = _validate.integer("save_at_every", save_at_every, minimum=1)
        epochs = _validate.integer("number_of_epochs", number_of_epochs)
        _validate.listed("dataloader", dataloader, "an iterable of batches")
        check_directory(folder)

        def save_now_and_then(epoch, history):
            if (epoch - 1) % every == 0:
                self.save_weights(os.path.join(folder, f"weights_{epoch - 1:04d}.pt"))

        history = train(
            self,
            lambda model, batch: model.evaluate(model(batch[0]), batch[1]),
            dataloader,
            epochs,
            learning_rate=learning_rate,
            seed=seed,
            mixed_precision=mixed_precision,
            checkpoint=checkpoint,
            callback=save_now_and_then,
            progress=progress,
            description="holobeam_multiholo",
        )
        self.save_weights(os.path.join(folder, "weights.pt"))
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


class focal_surface_light_propagation(nn.Module):
    """A network that propagates phase-only holograms to curved focal surfaces.

    One part makes a convolution kernel for each place from the focal surface and the hologram; the other, a U-Net,
    convolves with them (Zheng, Zhan, Shi, Cakmakci and Akşit, "Focal Surface Holographic Light Transport using Learned
    Spatially Adaptive Convolutions", SIGGRAPH Asia 2024 Technical Communications). By default its state dict holds
    1 861 138 numbers, of which the weights of the adaptive layers, 96 840, come twice.

    Parameters
    ----------
    depth : int
        Levels of both parts.
    dimensions : int
        Channels of their first level.
    input_channels : int
        Real and imaginary parts of the colours, 6 for three of them.
    out_channels : int
        Channels of the propagated field, an even number, real parts first.
    kernel_size : int
        Size of the kernels.
    bias : bool
        Whether convolutions add a constant.
    device : torch.device or str
        Device of the network.
    activation : torch.nn.Module
        Non-linearity between layers.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import focal_surface_light_propagation
    >>> model = focal_surface_light_propagation().eval()
    >>> with torch.no_grad():
    ...     model(torch.rand(1, 1, 64, 64), torch.rand(1, 3, 64, 64)).shape
    torch.Size([1, 3, 64, 64])
    """

    def __init__(
        self,
        depth: int = 3,
        dimensions: int = 8,
        input_channels: int = 6,
        out_channels: int = 6,
        kernel_size: int = 3,
        bias: bool = True,
        device: torch.device | str = "cpu",
        activation: nn.Module = _LEAKY_RELU,
    ):
        super().__init__()
        if _validate.integer("out_channels", out_channels, minimum=2) % 2:
            raise ValueError(f"out_channels must be even, real and imaginary parts of colours; got {out_channels}")
        bias, input_channels = _validate.flag("bias", bias), channels("input_channels", input_channels)
        self.depth = depth
        self.device: torch.device = checked_device("device", device)
        common: dict[str, Any] = {"depth": depth, "dimensions": dimensions, "kernel_size": kernel_size, "bias": bias}
        common |= {"normalization": False, "activation": activation}
        self.sv_kernel_generation: spatially_varying_kernel_generation_model = (
            spatially_varying_kernel_generation_model(input_channels=input_channels + 1, **common)
        )
        self.light_propagation: spatially_adaptive_unet = spatially_adaptive_unet(
            input_channels=input_channels, out_channels=out_channels, **common
        )
        self.to(self.device)

    def forward(self, focal_surface: torch.Tensor, phase_only_hologram: torch.Tensor) -> torch.Tensor:
        """Return the intensity on a focal surface.

        Parameters
        ----------
        focal_surface : torch.Tensor
            Distance at each pixel, ``[B, 1, H, W]``.
        phase_only_hologram : torch.Tensor
            Phases over 2π, 0 … 1, ``[B, 3, H, W]``.

        Returns
        -------
        torch.Tensor
            Intensities ``[B, 3, H, W]``.
        """
        smallest, weight = 2 ** (self.depth + 1), next(self.parameters())
        colours = (self.sv_kernel_generation.input_channels - 1) // 2
        phase_only_hologram = images("phase_only_hologram", phase_only_hologram, colours, weight, smallest=smallest)
        focal_surface = images("focal_surface", focal_surface, 1, weight)
        rows, columns = phase_only_hologram.shape[-2:]
        _validate.shaped(
            "focal_surface", focal_surface, f"[..., {rows}, {columns}], with the sides of phase_only_hologram"
        )
        input_field = self.generate_input_field(phase_only_hologram)
        kernels = self.sv_kernel_generation(focal_surface, input_field)
        real, imaginary = self.light_propagation(kernels, input_field).chunk(2, dim=1)
        return real.square() + imaginary.square()

    def generate_input_field(self, phase_only_hologram: torch.Tensor) -> torch.Tensor:
        """Return the field of a phase-only hologram as real channels.

        Parameters
        ----------
        phase_only_hologram : torch.Tensor
            Phases over 2π, ``[B, C, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[B, 2C, H, W]``: the cosines of all colours, then their sines.
        """
        phase = 2 * torch.pi * images("phase_only_hologram", phase_only_hologram)
        return torch.cat([phase.cos(), phase.sin()], dim=1)

    def load_weights(
        self, weight_filename: str | os.PathLike[str], key_mapping_filename: str | os.PathLike[str]
    ) -> None:
        """Read weights whose keys have other names, and put the model in evaluation mode.

        Parameters
        ----------
        weight_filename : str or os.PathLike
            A ``.pt`` or ``.pth`` file with a state dict.
        key_mapping_filename : str or os.PathLike
            A ``.json`` file with ``sv_kernel_generation_key_mapping`` and ``light_prop_key_mapping``, each from keys in
            the file of weights to keys of the sub-model ``sv_kernel_generation`` or ``light_propagation``.

        Raises
        ------
        FileNotFoundError
            If a file is missing.
        ValueError
            If a file is broken, the mapping is not one, or its result does not fit the model, which then stays as it
            was; the message names the fault.
        """
        path = validate_path(weight_filename, EXTENSIONS, name="weight_filename")
        validate_path(key_mapping_filename, name="key_mapping_filename")
        mapping = _read_mapping(key_mapping_filename)
        state = read_state(path, self.device)
        if missing := [old for old in mapping.values() if old not in state]:
            raise ValueError(f"{path!r} lacks keys that the mapping names: {', '.join(missing[:20])}")
        set_state(self, {new: state[old] for new, old in mapping.items()}, path)


def _read_mapping(filename) -> dict[str, str]:
    """Return the key in a file for each key of a model, from a JSON file with one part for each sub-model."""
    parts = load_dictionary(filename)
    name = repr(os.fspath(filename))
    keys = {}
    for sub, part in _MAPPINGS.items():
        mapping = parts.get(part) if isinstance(parts, dict) else None
        if not isinstance(mapping, dict) or not all(isinstance(new, str) for new in mapping.values()):
            raise ValueError(f"{name} must map keys to keys under {part!r}")
        for old, new in mapping.items():
            if f"{sub}.{new}" in keys:
                raise ValueError(f"{name} names two keys for {new!r} under {part!r}")
            keys[f"{sub}.{new}"] = old
    return keys
