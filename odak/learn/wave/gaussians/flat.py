"""Complex-valued Gaussians in the plane of a picture, and the field of their sum."""

import math
import os
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import floating
from odak.learn.tools.device import get_device
from odak.learn.wave.gaussians import parameters as shared
from odak.learn.wave.gaussians.splatting import sum_of_gaussians
from odak.log import logger
from odak.tools.matrix import zero_pad

# Square pixels added to each axis of a covariance, so that no Gaussian falls between pixels.
_SOFTNESS = 0.1


class complex_2d_gaussians(nn.Module):
    """Gaussians in a plane, each with a size, a rotation, and an amplitude and a phase for each colour.

    Parameters
    ----------
    num_points : int
        Number N of Gaussians.
    img_size : tuple of int
        Width and height of the picture in pixels.
    device : torch.device or str
        Device of the parameters.
    merge_opacity : bool
        Set the opacities to one, so that the colours alone give the amplitudes.
    seed : int, optional
        Makes the first parameters reproducible.
    channels : int
        Number C of colours, one for each wavelength of :class:`Scene2D`.

    Attributes
    ----------
    means_2d : torch.nn.Parameter
        Centres ``[N, 2]``, see :meth:`apply_activations`.
    pre_act_scales : torch.nn.Parameter
        Sizes before their activation, ``[N, 2]``.
    pre_act_rotation : torch.nn.Parameter
        Rotations before their activation, ``[N]``.
    pre_act_opacities : torch.nn.Parameter
        Opacities before their activation, ``[N]``.
    colours : torch.nn.Parameter
        Amplitudes ``[N, C]``.
    pre_act_phase : torch.nn.Parameter
        Phases before their activation, ``[N, C]``.

    Raises
    ------
    ValueError
        If the number or the size is not positive.

    Notes
    -----
    Zhan et al., complex-valued Gaussians for holograms (2026).

    Examples
    --------
    >>> from odak.learn.wave import complex_2d_gaussians
    >>> len(complex_2d_gaussians(5, (32, 24), "cpu"))
    5
    """

    means_2d: nn.Parameter
    pre_act_scales: nn.Parameter
    pre_act_rotation: nn.Parameter
    colours: nn.Parameter
    pre_act_phase: nn.Parameter
    pre_act_opacities: nn.Parameter

    def __init__(
        self,
        num_points: int,
        img_size: tuple[int, int],
        device: torch.device | str,
        merge_opacity: bool = False,
        *,
        seed: int | None = None,
        channels: int = 3,
    ):
        super().__init__()
        channels = _validate.integer("channels", channels, minimum=1)
        number = _validate.integer("num_points", num_points, minimum=1)
        self.img_size = shared.picture_size("img_size", img_size)
        self.device, self.merge_opacity = get_device(device), _validate.flag("merge_opacity", merge_opacity)
        draw = torch.Generator()
        if seed is not None:
            draw.manual_seed(_validate.integer("seed", seed))
        if seed is None:
            draw.manual_seed(int(torch.randint(2**62, ())))

        def even(low, high, *shape):
            return torch.rand(number, *shape, generator=draw) * (high - low) + low

        first = {
            "means_2d": even(-1, 1, 2).clamp(-0.999, 0.999).atanh(),
            "pre_act_scales": even(1.5, 5, 2).log(),
            "pre_act_rotation": even(-math.pi, math.pi),
            "colours": even(0, 1, channels),
            "pre_act_phase": torch.zeros(number, channels),
            "pre_act_opacities": torch.full((number,), -0.5),
        }
        for name, value in first.items():
            self.register_parameter(name, nn.Parameter(value.to(self.device), requires_grad=False))
        logger.debug("%d complex Gaussians on %d x %d pixels", number, *self.img_size)

    def __len__(self) -> int:
        return len(self.means_2d)

    def apply_activations(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the parameters after their activations.

        Returns
        -------
        tuple of torch.Tensor
            Standard deviations exp(·) + 0.1 in pixels ``[N, 2]``, rotations in radians ``[N]``, phases from 0 to 2π
            ``[N, C]``, opacities from 0 to 1 ``[N]`` (ones when merged), and centres [x, y] in pixels ``[N, 2]``,
            (tanh(·) + 1)/2 times the size of the picture.
        """
        size = self.means_2d.new_tensor(self.img_size)
        opacities = self.pre_act_opacities
        return (
            self.pre_act_scales.exp() + 0.1,
            self.pre_act_rotation,
            shared.wrapped(self.pre_act_phase),
            torch.ones_like(opacities) if self.merge_opacity else opacities.sigmoid(),
            (self.means_2d.tanh() + 1) / 2 * size,
        )

    @staticmethod
    def compute_cov_2D(scales: torch.Tensor, rotation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the entries Σ₀₀, Σ₀₁ and Σ₁₁ of covariances in square pixels ``[N]``, variances 0.1 larger than given.

        Parameters
        ----------
        scales : torch.Tensor
            Standard deviations ``[N, 2]``.
        rotation : torch.Tensor
            Radians ``[N]``.
        """
        scales, rotation = floating("scales", scales), floating("rotation", rotation)
        if scales.ndim == 0 or scales.shape[-1] != 2:
            raise ValueError(f"scales must be [N, 2], got {list(scales.shape)}")
        _validate.fitting(scales=scales[..., 0], rotation=rotation)
        cosine, sine = rotation.cos(), rotation.sin()
        first, second = scales.square().unbind(-1)
        return (
            first * cosine.square() + second * sine.square() + _SOFTNESS,
            (first - second) * cosine * sine,
            first * sine.square() + second * cosine.square() + _SOFTNESS,
        )

    @staticmethod
    def invert_cov_2D(
        cov_00: torch.Tensor, cov_01: torch.Tensor, cov_11: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the entries 00, 01 and 11 of the inverses of symmetric 2×2 covariance matrices.

        Determinants below 1e-10 are replaced by 1e-10.

        Parameters
        ----------
        cov_00 : torch.Tensor
            Entries 00 of the matrices, ``[N]``.
        cov_01 : torch.Tensor
            Entries 01 of the matrices, ``[N]``.
        cov_11 : torch.Tensor
            Entries 11 of the matrices, ``[N]``.
        """
        given = {"cov_00": cov_00, "cov_01": cov_01, "cov_11": cov_11}
        given = {name: floating(name, value) for name, value in given.items()}
        _validate.fitting(**given)
        cov_00, cov_01, cov_11 = given.values()
        determinant = (cov_00 * cov_11 - cov_01.square()).clamp_min(1e-10)
        return cov_11 / determinant, -cov_01 / determinant, cov_00 / determinant

    def make_trainable(self) -> None:
        """Let all parameters require gradients, the opacities only where they are not merged."""
        for name, parameter in self.named_parameters():
            parameter.requires_grad_(not (self.merge_opacity and name == "pre_act_opacities"))

    def save_gaussians(self, save_path: str | os.PathLike) -> None:
        """Write the parameters, the size and `merge_opacity` to a ``.pth`` or ``.pt`` file, atomically.

        Parameters
        ----------
        save_path : str or path-like
            Path of the file.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        tensors = {name: parameter.detach() for name, parameter in self.named_parameters()}
        shared.save(save_path, {**tensors, "img_size": self.img_size, "merge_opacity": self.merge_opacity}, "save_path")
        logger.info("%d complex Gaussians saved to %s", len(self), save_path)

    def load_gaussians(self, load_path: str | os.PathLike) -> None:
        """Set the parameters and `merge_opacity` to those in a file of :meth:`save_gaussians`, in place.

        Parameters
        ----------
        load_path : str or path-like
            Path of the file.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the path is not acceptable; if the file is broken or would run code; or if it holds another number of
            Gaussians or those of a picture of another size. The Gaussians then stay as they were.
        """
        held = dict(self.named_parameters())
        found = shared.load(load_path, held, self.means_2d.device, "load_path")
        size = found.get("img_size", self.img_size)
        if tuple(size) != self.img_size:
            raise ValueError(f"{load_path!r} contains Gaussians of a picture of {tuple(size)}, not of {self.img_size}")
        for name, parameter in held.items():
            if found[name].shape != parameter.shape:
                raise ValueError(
                    f"{load_path!r} holds {name} of shape {tuple(found[name].shape)}, not {tuple(parameter.shape)}"
                )
        with torch.no_grad():
            for name, parameter in held.items():
                parameter.copy_(found[name])
        self.merge_opacity = bool(found.get("merge_opacity", self.merge_opacity))
        logger.info("%d complex Gaussians loaded from %s", len(self), load_path)


class Scene2D:
    """The complex field of a sum of Gaussians in a plane.

    Parameters
    ----------
    gaussians : complex_2d_gaussians
        The Gaussians.
    args_prop : object
        With the attributes `wavelengths` (metres, one for each colour) and `pad_size` (rows and columns of the field).

    Attributes
    ----------
    wavelengths : torch.Tensor
        In metres.
    pad_size : tuple of int
        Rows and columns of the field.

    Raises
    ------
    ValueError
        If an attribute is missing or not positive, or there are more or fewer wavelengths than colours.

    Examples
    --------
    >>> from argparse import Namespace
    >>> from odak.learn.wave import Scene2D, complex_2d_gaussians
    >>> settings = Namespace(wavelengths=[639e-9, 532e-9, 473e-9], pad_size=[48, 64])
    >>> Scene2D(complex_2d_gaussians(5, (32, 24), "cpu"), settings).render((32, 24)).shape
    torch.Size([3, 48, 64])
    """

    def __init__(self, gaussians: complex_2d_gaussians, args_prop: Any):
        if not isinstance(gaussians, complex_2d_gaussians):
            raise TypeError(f"gaussians must be complex_2d_gaussians, got {type(gaussians).__name__}")
        wavelengths, pad_size = shared.settings(args_prop, ("wavelengths", "pad_size"))
        self.gaussians, self.args_prop = gaussians, args_prop
        self.wavelengths = _validate.real("wavelengths", shared.lengths(wavelengths), positive=True)
        self.pad_size = _validate.size("pad_size", pad_size)
        if (colours := gaussians.colours.shape[1]) != len(self.wavelengths):
            raise ValueError(
                f"args_prop.wavelengths must be one for each of the {colours} colours of the Gaussians, "
                f"got {len(self.wavelengths)}"
            )
        self._grids: dict = {}

    def __repr__(self) -> str:
        return f"<Scene2D with {len(self.gaussians)} Gaussians>"

    def get_pixel_grid(self, img_size: tuple[int, int]) -> torch.Tensor:
        """Return the coordinates [x, y] of all pixels, row by row, ``[1, H·W, 2]``; kept for the next call.

        Parameters
        ----------
        img_size : tuple of int
            Width and height.
        """
        width, height = shared.picture_size("img_size", img_size)
        like = self.gaussians.means_2d
        key = (width, height, like.dtype, like.device)
        if key not in self._grids:
            axes = (torch.arange(n, dtype=like.dtype, device=like.device) for n in (height, width))
            y, x = torch.meshgrid(*axes, indexing="ij")
            self._grids = {key: torch.stack([x.flatten(), y.flatten()], dim=-1)[None]}
        return self._grids[key]

    def render(self, img_size: tuple[int, int]) -> torch.Tensor:
        """Return the field Σ colour·opacity·exp(−½ dᵀΣ⁻¹d)·exp(iφ), surrounded by zeros.

        Σ in the exponent is the covariance of :meth:`complex_2d_gaussians.compute_cov_2D`.

        Parameters
        ----------
        img_size : tuple of int
            Width and height of the picture; pixels are at whole coordinates.

        Returns
        -------
        torch.Tensor
            A field for each wavelength, complex64 ``[C, *pad_size]`` (complex128 for parameters in double precision),
            differentiable in the parameters. Memory does not grow with N·H·W: see
            :func:`odak.learn.wave.gaussians.splatting.sum_of_gaussians`.

        Raises
        ------
        ValueError
            If the picture is larger than `pad_size`.
        """
        width, height = shared.picture_size("img_size", img_size)
        if height > self.pad_size[0] or width > self.pad_size[1]:
            raise ValueError(f"img_size must fit into pad_size {list(self.pad_size)}, got (width, height) {img_size}")
        scales, rotation, phase, opacities, means = self.gaussians.apply_activations()
        covariance = self.gaussians.compute_cov_2D(scales, rotation)
        conics = torch.stack(self.gaussians.invert_cov_2D(*covariance), dim=-1)
        weights = torch.polar(torch.ones_like(phase), phase) * (self.gaussians.colours * opacities[:, None])
        return zero_pad(sum_of_gaussians(means, conics, weights, height, width), self.pad_size)
