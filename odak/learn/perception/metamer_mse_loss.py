"""A baseline to the metameric loss: distance from one fixed metamer of the target."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak.learn.perception import pyramid_statistics as statistics
from odak.learn.perception.foveation import _point
from odak.learn.perception.metameric_loss import MetamericLoss


def _of_the_metameric_loss(name: str) -> Any:
    """Return a property that is the attribute of the same name of the loss that makes the statistics."""
    return property(
        lambda self: getattr(self.metameric_loss, name), lambda self, value: setattr(self.metameric_loss, name, value)
    )


class MetamerMSELoss(nn.Module):
    """Mean squared distance from one metamer of the target.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    alpha, real_image_width, real_viewing_distance, mode, n_pyramid_levels, n_orientations, equi
        As for :class:`odak.learn.perception.MetamericLoss`.

    Attributes
    ----------
    alpha, real_image_width, real_viewing_distance, mode, n_pyramid_levels, n_orientations, equi
        As given; a change counts from the next call on.
    target, target_metamer
        Of the last call; None before.
    metameric_loss : MetamericLoss
        Makes the statistics.
    loss_func : torch.nn.MSELoss
        The distance.

    Notes
    -----
    Equal pictures do not give 0: the target is one of its own metamers, but not the one that was drawn. The metamer is
    kept as long as the same unchanged target comes with the same gaze and parameters.
    """

    alpha = _of_the_metameric_loss("alpha")
    mode = _of_the_metameric_loss("mode")
    equi = _of_the_metameric_loss("equi")
    real_image_width = _of_the_metameric_loss("real_image_width")
    real_viewing_distance = _of_the_metameric_loss("real_viewing_distance")
    n_pyramid_levels = _of_the_metameric_loss("n_pyramid_levels")
    n_orientations = _of_the_metameric_loss("n_orientations")

    def __init__(
        self,
        device: torch.device | str = "cpu",
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        mode: str = "quadratic",
        n_pyramid_levels: int = 5,
        n_orientations: int = 2,
        equi: bool = False,
    ) -> None:
        super().__init__()
        self.metameric_loss = MetamericLoss(
            device=device,
            alpha=alpha,
            real_image_width=real_image_width,
            real_viewing_distance=real_viewing_distance,
            n_pyramid_levels=n_pyramid_levels,
            mode=mode,
            n_orientations=n_orientations,
            use_l2_foveal_loss=False,
            equi=equi,
        )
        self.loss_func = nn.MSELoss()
        self.target: Any = None
        self.target_metamer: Any = None
        self.noise: Any = None
        self._kept = statistics.TargetCache()

    @property
    def device(self) -> torch.device:
        """Where the loss was last moved to."""
        return self.metameric_loss.device

    def gen_metamer(self, image: torch.Tensor, gaze: Sequence[float], seed: int = 0) -> torch.Tensor:
        """Return a picture that looks like another to an eye with one gaze: noise with its pooled statistics.

        Parameters
        ----------
        image : torch.Tensor
            RGB or grey ``[B, C, H, W]``, about 0 … 1.
        gaze : sequence of float
            (x, y), 0 to 1 from the top-left corner.
        seed : int
            Of the noise; equal input gives equal output.

        Returns
        -------
        torch.Tensor
            ``[B, C, H, W]``, not clipped to 0 … 1. Where single pixels are resolved it is the picture, but for small
            errors of the pyramid.

        Raises
        ------
        ValueError, TypeError
            If the picture is too small for the pyramid, or no picture.

        Notes
        -----
        Walton et al., ACM Trans. Graph. 40, 48 (2021), section 4.
        """
        inner = self.metameric_loss
        statistics.checked_pictures("MetamerMSELoss", image, image, inner.n_pyramid_levels)
        padded, stats, _ = inner._described(image, _point("gaze", gaze), "RGB")
        maker: Any = inner.pyramid_maker
        metamer = statistics.matched_noise(padded, stats, maker, inner.n_pyramid_levels, seed)
        return statistics.as_picture(metamer, image.shape)

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Sequence[float] = (0.5, 0.5)) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1.
        gaze : sequence of float
            (x, y), 0 to 1 from the top-left corner; beside the picture is legal.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable in the image. The metamer counts as a constant.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the pyramid.
        """
        statistics.checked_pictures("MetamerMSELoss", image, target, self.metameric_loss.n_pyramid_levels)
        self.target, gaze = target.detach(), _point("gaze", gaze)
        key = (gaze, self.metameric_loss._options())
        self.target_metamer = self._kept.get(self.target, key, lambda: self.gen_metamer(self.target, gaze))
        return self.loss_func(image, self.target_metamer)

    def _apply(self, function, recurse=True):
        self._kept.clear()
        return super()._apply(function, recurse)
