"""What planes of a picture with depth should show: masks of the planes, and pictures out of focus elsewhere."""

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import checked_generator
from odak.learn.tools.device import get_device
from odak.learn.tools.matrix import blur_gaussian

SCHEMES = ("defocus", "naive")


def plane_indices(depth: torch.Tensor, number_of_planes: int) -> torch.Tensor:
    """Return the plane nearest to each pixel, round(depth·(P − 1)).

    Parameters
    ----------
    depth : torch.Tensor
        Depths, 0 … 1.
    number_of_planes : int
        Number of planes P.

    Returns
    -------
    torch.Tensor
        int64, 0 … P − 1; the even one of two planes that are equally near.
    """
    return torch.round(depth * (number_of_planes - 1)).long()


def plane_masks(indices: torch.Tensor, number_of_planes: int) -> torch.Tensor:
    """Return ones where a pixel belongs to a plane.

    Parameters
    ----------
    indices : torch.Tensor
        Plane of each pixel, ``[m, n]``.
    number_of_planes : int
        Number of planes P.

    Returns
    -------
    torch.Tensor
        Boolean ``[P, m, n]``; each pixel belongs to one plane.
    """
    planes = torch.arange(number_of_planes, device=indices.device)
    return indices == planes[:, None, None]


def defocused_targets(
    image: torch.Tensor, indices: torch.Tensor, number_of_planes: int, blur_ratio: float, blur_size: int
) -> torch.Tensor:
    """Return what each plane shows when the pixels of other planes are out of focus.

    A pixel j planes away is taken from the picture blurred by a Gaussian of σ = int(j·blur_ratio); σ = 0 leaves it
    sharp. The picture is blurred once for each σ.

    Parameters
    ----------
    image : torch.Tensor
        Picture ``[C, m, n]``.
    indices : torch.Tensor
        Plane of each pixel, ``[m, n]``.
    number_of_planes : int
        Number of planes P.
    blur_ratio : float
        Growth of σ from one plane to the next, in pixels of :func:`odak.learn.tools.generate_2d_gaussian`.
    blur_size : int
        Side of the Gaussian in pixels; an even one grows by one, so that it has a centre.

    Returns
    -------
    torch.Tensor
        Pictures ``[P, C, m, n]``; zeros surround the picture that is blurred.

    Raises
    ------
    ValueError, TypeError
        If `blur_ratio` is negative or `blur_size` not a positive integer.
    """
    if _validate.real("blur_ratio", blur_ratio) < 0:
        raise ValueError(f"blur_ratio must not be negative, got {blur_ratio}")
    side = _validate.integer("target_blur_size", blur_size, minimum=1) | 1
    sigmas = torch.tensor([int(distance * blur_ratio) for distance in range(number_of_planes)], device=image.device)
    widths, which = sigmas.unique(return_inverse=True)
    blurred = torch.stack([_blurred(image, width, side) for width in widths.tolist()])
    planes = torch.arange(number_of_planes, device=image.device)
    source = which[(indices - planes[:, None, None]).abs()]
    return blurred.gather(0, source[:, None].expand(-1, *image.shape))


def _blurred(image, sigma, side):
    return blur_gaussian(image, (side, side), (sigma, sigma), keep_sum=True) if sigma else image


class FocalTargets(nn.Module):
    """Targets and masks of the planes of a picture with depth; the part that losses of several planes share.

    Arguments are those of :class:`odak.learn.wave.loss.multiplane_loss`.
    """

    target_image: torch.Tensor
    target_depth: torch.Tensor
    masks: torch.Tensor
    targets: torch.Tensor

    def __init__(
        self, image, depth, blur_ratio, blur_size, number_of_planes, multiplier, scheme, reduction, device, generator
    ):
        super().__init__()
        self.number_of_planes = _validate.integer("number_of_planes", number_of_planes, minimum=1)
        self.multiplier = _validate.real("multiplier", multiplier)
        self.scheme = _validate.one_of("scheme", scheme, SCHEMES)
        self.reduction = _validate.one_of("reduction", reduction, ("mean", "sum"))
        self.blur_ratio, self.target_blur_size, self.generator = blur_ratio, blur_size, None
        self.generator = checked_generator("generator", generator)
        image, depth = _checked_picture(image, depth)
        device = image.device if device is None else get_device(device)
        self.register_buffer("target_image", image.to(device), False)
        self.register_buffer("target_depth", plane_indices(depth, self.number_of_planes).to(device), False)
        for name in ("masks", "targets"):
            self.register_buffer(name, None, False)
        self.set_targets()
        if self.scheme == "defocus":
            self.add_defocus_blur()

    @property
    def focus_target(self) -> torch.Tensor:
        """The sharp picture ``[C, m, n]``: every pixel is in focus on its own plane."""
        return self.target_image

    def set_targets(self) -> None:
        """Cut the picture into planes: ``masks`` and ``targets`` ``[P, C, m, n]``, dark beyond each plane."""
        masks = plane_masks(self.target_depth, self.number_of_planes)[:, None]
        self.masks = masks.to(self.target_image.dtype).expand(-1, *self.target_image.shape)
        self.targets = self.masks * self.target_image * self.multiplier

    def add_defocus_blur(self) -> None:
        """Fill ``targets`` with what is out of focus beyond each plane."""
        self.targets = self.multiplier * defocused_targets(
            self.target_image, self.target_depth, self.number_of_planes, self.blur_ratio, self.target_blur_size
        )

    def get_targets(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the targets of the planes, the sharp picture, and its depth in whole planes.

        Returns
        -------
        tuple of torch.Tensor
            ``[P, C, m, n]``, ``[C, m, n]`` and ``[m, n]``, the depth from 0 to 1; copies.
        """
        depth = self.target_depth.to(self.target_image.dtype) / max(self.number_of_planes - 1, 1)
        return self.targets.clone(), self.focus_target.clone(), depth

    def pairs(
        self, image: torch.Tensor, target: torch.Tensor, plane_id: int | None, inject_noise: bool, noise_ratio: float
    ) -> tuple[tuple[torch.Tensor, torch.Tensor], ...]:
        """Return three pairs to compare: images, images inside the plane's mask, images weighed by the target."""
        for name, value in (("image", image), ("target", target)):
            if not isinstance(value, torch.Tensor) or value.is_complex():
                raise TypeError(f"{name} must be a real tensor, got {getattr(value, 'dtype', type(value).__name__)}")
        if plane_id is not None:
            plane_id = _validate.whole("plane_id", plane_id, minimum=-self.number_of_planes)
        inject_noise, noise_ratio = (
            _validate.flag("inject_noise", inject_noise),
            _validate.real("noise_ratio", noise_ratio),
        )
        image, target = _without_leading_ones(image, target)
        mask = self._mask(image, plane_id)
        noisy = target
        if inject_noise:
            spread = noise_ratio * (target.amax() - target.amin())
            noise = torch.randn(target.shape, generator=self.generator, dtype=target.dtype, device=target.device)
            noisy = target + spread * noise
        return (image, target), (image * mask, noisy * mask), (image * noisy, noisy * noisy)

    def _mask(self, image, plane_id):
        masks = self.masks
        if plane_id is not None:
            if not -len(masks) <= plane_id < len(masks):
                raise ValueError(f"plane_id must be None or 0 to {len(masks) - 1}, got {plane_id}")
            masks = masks[plane_id]
        if image.ndim == 2:
            # The mask is that of every colour.
            masks = masks[..., 0, :, :]
        fits = image.ndim <= 3 if plane_id is not None else image.ndim <= 4
        if not fits or image.shape != masks.shape[masks.ndim - image.ndim :]:
            raise ValueError(
                f"image must be [m, n], [C, m, n] or, without plane_id, [P, C, m, n] of the targets' "
                f"{tuple(self.targets.shape)}; got {tuple(image.shape)}"
            )
        return masks.to(image)


def _checked_picture(image, depth):
    for name, value in (("target_image", image), ("target_depth", depth)):
        if not isinstance(value, torch.Tensor) or not value.is_floating_point():
            kind = getattr(value, "dtype", type(value).__name__)
            raise TypeError(f"{name} must be a real floating tensor, got {kind}")
    _validate.image("target_image", image)
    while depth.ndim > 2 and len(depth) == 1:
        depth = depth[0]
    image = image[None] if image.ndim == 2 else image
    if image.ndim != 3 or depth.shape != image.shape[-2:]:
        raise ValueError(
            f"target_image must be [C, m, n] and target_depth [m, n], got {tuple(image.shape)} and {tuple(depth.shape)}"
        )
    _validate.one_device(target_image=image, target_depth=depth)
    if not bool(((depth >= 0) & (depth <= 1)).all()):
        raise ValueError(f"target_depth must be between 0 and 1, got {depth.min().item()} to {depth.max().item()}")
    return image.detach(), depth.detach()


def _without_leading_ones(image, target):
    _validate.alike(image=image, target=target)
    while image.ndim > 2 and len(image) == 1:
        image, target = image[0], target[0]
    return image, target
