"""Images right on every plane, for an eye."""

from collections.abc import Mapping

import torch
from torch import nn

from odak import _validate
from odak.learn import perception
from odak.learn.wave.focal_targets import FocalTargets

_NORMS = {"l2": nn.functional.mse_loss, "l1": nn.functional.l1_loss}
_TERMS = ("base_{}_loss", "loss_{}_mask", "loss_{}_cor")
_BASE_WEIGHTS = {term.format(norm): 1.0 for norm in _NORMS for term in _TERMS}


class perceptual_multiplane_loss(FocalTargets):
    """The terms of ``multiplane_loss``, squared and absolute, and measures of how close an eye finds images.

    Parameters
    ----------
    target_image, target_depth, blur_ratio, target_blur_size, number_of_planes, multiplier, scheme, device, generator
        As in :class:`~odak.learn.wave.loss.multiplane_loss`.
    base_loss_weights : dict, optional
        Weights of "base_l2_loss", "loss_l2_mask", "loss_l2_cor", "base_l1_loss", "loss_l1_mask" and "loss_l1_cor"; all
        1 by default, and 0 for those that a dict leaves out.
    additional_loss_weights : dict, optional
        Weights of any of "cvvdp", "fvvdp", "lpips", "psnr", "ssim" and "msssim"; by default 1 for "cvvdp". What counts
        is how far a quality is from that of equal images: 10 − JOD, 1 − SSIM; of "psnr", which has no largest value,
        its negative, −∞ for equal images.
    reduction : {"mean", "sum"}
        How pixels are put together in the six terms.
    return_components : bool
        Return ``(loss, components)``, a dict of weighted terms that add up to the loss.

    Raises
    ------
    ImportError
        If a measure needs a package that is missing; the message says what to install.
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import perceptual_multiplane_loss
    >>> picture, depth = torch.rand(3, 16, 16), torch.rand(16, 16)
    >>> loss = perceptual_multiplane_loss(picture, depth, additional_loss_weights={"ssim": 0.5}, return_components=True)
    >>> total, components = loss(loss.targets[0], loss.targets[0], plane_id=0)
    >>> total.item(), components["ssim"].item()
    (0.0, 0.0)
    """

    def __init__(
        self,
        target_image: torch.Tensor,
        target_depth: torch.Tensor,
        blur_ratio: float = 0.25,
        target_blur_size: int = 10,
        number_of_planes: int = 4,
        multiplier: float = 1.0,
        scheme: str = "defocus",
        base_loss_weights: dict[str, float] | None = None,
        additional_loss_weights: dict[str, float] | None = None,
        reduction: str = "mean",
        return_components: bool = False,
        device: torch.device | str | None = None,
        *,
        generator: torch.Generator | None = None,
    ):
        super().__init__(
            target_image, target_depth, blur_ratio, target_blur_size, number_of_planes, multiplier, scheme, reduction,
            device, generator,
        )  # fmt: skip
        self.base_loss_weights = _checked_weights("base_loss_weights", base_loss_weights, _BASE_WEIGHTS, _BASE_WEIGHTS)
        self.additional_loss_weights = _checked_weights(
            "additional_loss_weights", additional_loss_weights, {"cvvdp": 1.0}, _MEASURES
        )
        self.return_components = _validate.flag("return_components", return_components)
        self.measures = nn.ModuleDict(
            {name: _MEASURES[name][0](self.target_image.device) for name in self.additional_loss_weights}
        )

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        plane_id: int | None = None,
        inject_noise: bool = False,
        noise_ratio: float = 1e-3,
    ) -> torch.Tensor | tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Return the loss of an image, and its parts if asked for; arguments as in ``multiplane_loss``."""
        pairs = self.pairs(image, target, plane_id, inject_noise, noise_ratio)
        components = {}
        for norm, difference in _NORMS.items():
            for term, pair in zip(_TERMS, pairs, strict=True):
                name = term.format(norm)
                if weight := self.base_loss_weights.get(name, 0.0):
                    components[name] = weight * difference(*pair, reduction=self.reduction)
        # Quality is that of the picture as it should be, without noise.
        whole = [picture if picture.ndim > 2 else picture[None] for picture in pairs[0]]
        for name, measure in self.measures.items():
            components[name] = self.additional_loss_weights[name] * _MEASURES[name][1](measure(*whole))
        loss = sum(components.values(), whole[0].new_zeros(()))
        return (loss, components) if self.return_components else loss


def _jod_loss(quality):
    return 10 - quality


def _similarity_loss(similarity):
    return 1 - similarity


# How each measure is made for a device, and how its value becomes a loss.
_MEASURES = {
    "cvvdp": (lambda device: perception.CVVDP(device, required=True), _jod_loss),
    "fvvdp": (lambda device: perception.FVVDP(device, required=True), _jod_loss),
    "lpips": (lambda device: perception.LPIPS(required=True), lambda distance: distance),
    "psnr": (lambda device: perception.PSNR(), lambda decibels: -decibels),
    "ssim": (lambda device: perception.SSIM(), _similarity_loss),
    "msssim": (lambda device: perception.MSSSIM(), _similarity_loss),
}


def _checked_weights(argument, given, default, known):
    given = default if given is None else given
    if not isinstance(given, Mapping):
        raise TypeError(f"{argument} must be a dictionary of weights, got {given!r:.80}")
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ValueError(f"{argument} must be of {', '.join(known)}; got {', '.join(map(repr, unknown))}")
    weights = {name: float(_validate.real(f"{argument}[{name!r}]", value)) for name, value in given.items()}
    return {name: weight for name, weight in weights.items() if weight}
