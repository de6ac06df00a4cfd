"""A loss for the periphery: distance from a picture that is blurred away from the gaze."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import checked_device
from odak.learn.perception.color_matrices import as_pictures
from odak.learn.perception.foveation import _growth, _point
from odak.learn.perception.radially_varying_blur import RadiallyVaryingBlur
from odak.learn.perception.util import check_loss_inputs, check_values


class BlurLoss(nn.Module):
    """Mean squared distance from the target as blurred for a gaze.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    alpha : float
        Growth of the eye's pooling regions with eccentricity.
    real_image_width, real_viewing_distance : float
        Width of the picture as shown and distance of the eye from its centre, in one unit.
    mode : str
        "quadratic" or "linear" growth.
    blur_source : bool
        Blur the image as well as the target.
    equi : bool
        Pictures are equirectangular; the gaze is then (yaw, pitch) in radians.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Attributes
    ----------
    target, blur, loss_func
        The last target, the blur and the mean squared error.

    Notes
    -----
    A baseline to :class:`odak.learn.perception.MetamericLoss`: it asks for blur where the eye only cannot tell.
    """

    _place: torch.Tensor

    def __init__(
        self,
        device: torch.device | str = "cpu",
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        mode: str = "quadratic",
        blur_source: bool = False,
        equi: bool = False,
    ) -> None:
        super().__init__()
        device = checked_device("device", device)
        self.register_buffer("_place", torch.empty(0, device=device), persistent=False)
        self.alpha, self.mode = _growth(alpha, mode)
        self.real_image_width = _validate.number("real_image_width", real_image_width, positive=True)
        self.real_viewing_distance = _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
        self.blur_source, self.equi = _validate.flag("blur_source", blur_source), _validate.flag("equi", equi)
        self.blur = RadiallyVaryingBlur().to(device)
        self.target: torch.Tensor | None = None
        self.loss_func = nn.MSELoss()

    @property
    def device(self) -> torch.device:
        """Where the loss was last moved to."""
        return self._place.device

    def blur_image(self, image: torch.Tensor, gaze: Sequence[float]) -> torch.Tensor:
        """Return a picture ``[B, C, H, W]`` blurred for a gaze (x, y), 0 to 1 from the top-left corner."""
        gaze = _point("gaze", gaze)
        return self.blur.blur(
            image, self.alpha, self.real_image_width, self.real_viewing_distance, gaze, self.mode, self.equi
        )

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Sequence[float] = (0.5, 0.5)) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1 in any colour space.
        gaze : sequence of float
            (x, y), 0 to 1 from the top-left corner; beside the picture is legal.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable in both; 0 for equal pictures with `blur_source` only.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or an argument makes no map.
        """
        check_loss_inputs("BlurLoss", image, target)
        as_pictures("image", image, None), as_pictures("target", target, None)
        pictures: dict[str, Any] = {"BlurLoss ERROR: image": image, "BlurLoss ERROR: target": target}
        check_values(**pictures)
        self.target = target.detach()
        if self.blur_source:
            image = self.blur_image(image, gaze)
        return self.loss_func(image, self.blur_image(target, gaze))
