"""Losses of holograms: smooth phase, low speckle contrast, and images on several planes."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import nn

from odak import _show, _validate
from odak._attributes import Prepared
from odak._torch_private import in_own_precision
from odak._warnings import AccuracyWarning, MissingPackageWarning, warn
from odak.learn import perception
from odak.learn._tensors import checked_device, checked_generator, floating_tensor, get_device, real_tensor, tensor
from odak.learn.perception.sight import checked_viewing
from odak.learn.tools.matrix import blur_gaussian, plane_indices, plane_masks
from odak.learn.wave.training import checked_noise, with_noise
from odak.wave.transfer_functions import checked_pitch, pitches

SCHEMES = ("defocus", "naive")
# Standard deviation of a blur, in pixels, below which a picture looks as sharp as before.
_LEAST_BLUR = 0.5


def defocused_targets(
    image: torch.Tensor, indices: torch.Tensor, number_of_planes: int, blur_ratio: float, blur_size: int
) -> torch.Tensor:
    """Return the targets of planes on which the pixels of other planes are out of focus.

    A pixel j planes away is taken from the picture blurred by a Gaussian of σ = j·blur_ratio; σ = 0 leaves it sharp.

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
        Pictures ``[P, C, m, n]``. At the rim the blur is divided by its share inside the picture: it is a mean of what
        the picture shows, so that an even picture stays even.

    Raises
    ------
    ValueError, TypeError
        If `blur_ratio` is negative or `blur_size` not a positive integer.
    """
    _validate.number("blur_ratio", blur_ratio, least=0)
    side = _validate.integer("target_blur_size", blur_size, minimum=1) | 1
    even, blurred = torch.ones_like(image[:1]), [image]
    for distance in range(1, number_of_planes):
        width = (distance * blur_ratio,) * 2
        blurred.append(
            torch.divide(*(blur_gaussian(picture, (side, side), width, keep_sum=True) for picture in (image, even)))
            if blur_ratio
            else image
        )
    planes = torch.arange(number_of_planes, device=image.device)
    source = (indices - planes[:, None, None]).abs()
    return torch.stack(blurred).gather(0, source[:, None].expand(-1, *image.shape))


def geometric_targets(
    image: torch.Tensor,
    indices: torch.Tensor,
    distances: torch.Tensor,
    wavelengths: Sequence[float],
    pixel_pitch: Sequence[float],
    numerical_aperture: float | None = None,
) -> torch.Tensor:
    """Return the targets of planes on which the pixels of other planes are out of focus, from their geometry.

    A pixel a distance z away from the plane in focus is taken from the picture blurred by a uniform disc of radius
    z·tan θ, sin θ being the numerical aperture: every point emits a cone.

    Parameters
    ----------
    image : torch.Tensor
        Picture ``[C, m, n]``.
    indices : torch.Tensor
        Plane of each pixel, ``[m, n]``.
    distances : torch.Tensor
        Distances of the planes in metres, ``[P]``.
    wavelengths : sequence of float
        Wavelength of each colour in metres.
    pixel_pitch : sequence of float
        Pixel pitch of the picture along rows and columns, in metres.
    numerical_aperture : float, optional
        Numerical aperture of the iris or of the eye; by default λ/(2·pixel_pitch) of the modulator along each axis and
        for each colour: the disc is an ellipse where the pitches differ.

    Returns
    -------
    torch.Tensor
        Pictures ``[P, C, m, n]``. At the rim the blur is divided by its share inside the picture, as in
        :func:`defocused_targets`.
    """
    dtype = image.dtype
    image = image.float() if dtype in (torch.float16, torch.bfloat16) else image
    rows, columns = image.shape[-2:]
    fy, fx = (
        2 * torch.pi * torch.fft.fftfreq(2 * n, pitch, dtype=torch.float64, device=image.device)
        for n, pitch in zip((rows, columns), pixel_pitch, strict=True)
    )
    spectrum, even = (
        torch.fft.fft2(picture, (2 * rows, 2 * columns)) for picture in (image, torch.ones_like(image[:1]))
    )
    masks = plane_masks(indices, len(distances))
    targets = torch.zeros(len(distances), *image.shape, dtype=image.dtype, device=image.device)
    places = distances.tolist()
    for focus, near in enumerate(places):
        for plane, far in enumerate(places):
            blurred = image
            if near != far:
                discs = []
                for wavelength in wavelengths:
                    down, across = (
                        abs(near - far) * math.tan(math.asin(min(sine, 0.999)))
                        for sine in _sines(wavelength, pixel_pitch, numerical_aperture)
                    )
                    argument = ((down * fy[:, None]) ** 2 + (across * fx) ** 2).sqrt()
                    # The transform of a disc of unit area, 2·J₁(x)/x.
                    safe = argument.clamp_min(1e-6)
                    discs.append(2 * torch.special.bessel_j1(safe) / safe)
                blurred, share = (
                    torch.fft.ifft2(picture * torch.stack(discs).to(image.dtype)).real[..., :rows, :columns]
                    for picture in (spectrum, even)
                )
                blurred = blurred / share
            targets[focus] += masks[plane] * blurred.clamp_min(0)
    return targets.to(dtype)


def _sines(wavelength: float, pixel_pitch: Sequence[float], numerical_aperture: float | None) -> list[float]:
    """Return the sine of the largest angle of the light along rows and columns."""
    return [wavelength / (2 * pitch) if numerical_aperture is None else numerical_aperture for pitch in pixel_pitch]


class FocalTargets(Prepared, nn.Module):
    """Targets and masks of the planes of a picture with depth; base of the losses of several planes.

    It takes the same arguments as :class:`odak.learn.wave.loss.multiplane_loss`.
    """

    _fixed = ("number_of_planes",)
    _follow = dict.fromkeys(("multiplier", "scheme", "blur_ratio", "target_blur_size"), "_fill_targets")
    target_image: torch.Tensor
    target_depth: torch.Tensor
    masks: torch.Tensor
    targets: torch.Tensor

    def __init__(
        self,
        image: torch.Tensor,
        depth: Any,
        blur_ratio: float,
        blur_size: int,
        number_of_planes: int,
        multiplier: float,
        scheme: str,
        reduction: str,
        device: Any,
        generator: Any,
        distances: Any = None,
        wavelengths: Any = None,
        pixel_pitch: Any = None,
        numerical_aperture: float | None = None,
    ) -> None:
        super().__init__()
        self.number_of_planes: int = _validate.integer("number_of_planes", number_of_planes, minimum=1)
        self.multiplier: float = _validate.real("multiplier", multiplier)
        self.scheme: str = _validate.one_of("scheme", scheme, SCHEMES)
        self.reduction: str = _validate.one_of("reduction", reduction, ("mean", "sum"))
        self.blur_ratio: float = blur_ratio
        self.target_blur_size: int = blur_size
        self.generator: torch.Generator | None = None
        self.generator = checked_generator("generator", generator)
        _validate.number("blur_ratio", blur_ratio, least=0)
        _validate.integer("target_blur_size", blur_size, minimum=1)
        image, depth = _checked_picture(image, depth)
        self._geometry = self._checked_geometry(distances, wavelengths, pixel_pitch, numerical_aperture, len(image))
        device = image.device if device is None else get_device(device)
        self.register_buffer("target_image", image.to(device), False)
        self.register_buffer("target_depth", plane_indices(depth, self.number_of_planes).to(device), False)
        for name in ("masks", "targets"):
            self.register_buffer(name, None, False)
        self._fill_targets()

    def _fill_targets(self):
        self.set_targets()
        if _validate.one_of("scheme", self.scheme, SCHEMES) == "defocus":
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
        picture = self.target_image, self.target_depth
        if self._geometry is not None:
            self.targets = self.multiplier * geometric_targets(*picture, **self._geometry)
            return
        self.targets = self.multiplier * defocused_targets(
            *picture, self.number_of_planes, self.blur_ratio, self.target_blur_size
        )
        if 0 < (widest := (self.number_of_planes - 1) * self.blur_ratio) < _LEAST_BLUR:
            warn(
                f"blur_ratio {self.blur_ratio} blurs by a σ of at most {widest:.2g} pixels on {self.number_of_planes} "
                "planes, hardly at all: give a larger one, or the distances, wavelengths and pixel_pitch that a blur "
                "follows from",
                AccuracyWarning,
            )

    def _checked_geometry(self, distances, wavelengths, pixel_pitch, numerical_aperture, colours) -> dict | None:
        given = {"distances": distances, "wavelengths": wavelengths, "pixel_pitch": pixel_pitch}
        if all(value is None for value in given.values()) and numerical_aperture is None:
            return None
        if missing := [name for name, value in given.items() if value is None]:
            raise ValueError(f"distances, wavelengths and pixel_pitch must be given together; missing {missing[0]}")
        places = torch.tensor(_validate.numbers(_validate.several("distances", distances)), dtype=torch.float64)
        waves = _validate.numbers(_validate.several("wavelengths", wavelengths, positive=True))
        if len(places) != self.number_of_planes:
            raise ValueError(f"distances must be one for each of {self.number_of_planes} planes, got {len(places)}")
        if len(waves) != colours:
            raise ValueError(f"wavelengths must be one for each of {colours} colours, got {len(waves)}")
        pitch = [float(step) for step in pitches(checked_pitch("pixel_pitch", pixel_pitch))]
        if numerical_aperture is not None:
            numerical_aperture = _validate.constant("numerical_aperture", numerical_aperture, positive=True, below=1)
        focus = min(w / max(_sines(w, pitch, numerical_aperture)) ** 2 for w in waves)
        volume = float(places.max() - places.min())
        if 0 < volume < focus:
            warn(
                f"the depth of focus, {focus:.3g} m, exceeds the {volume:.3g} m between the first plane and the last: "
                "a light field cannot distinguish them",
                AccuracyWarning,
            )
        return {
            "distances": places, "wavelengths": waves, "pixel_pitch": pitch, "numerical_aperture": numerical_aperture,
        }  # fmt: skip

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
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        plane_id: int | None,
        inject_noise: bool,
        noise_ratio: float,
        generator: torch.Generator | None = None,
    ) -> tuple[tuple[torch.Tensor, torch.Tensor], ...]:
        """Return three pairs to compare: images, images inside the plane's mask, images weighed by the target."""
        for name, value in (("image", image), ("target", target)):
            real_tensor(name, value)
        inject_noise, noise_ratio, generator = checked_noise(inject_noise, noise_ratio, generator)
        image, target = _without_leading_ones(image, target)
        mask = self._mask(image, plane_id)
        generator = self.generator if self.generator is not None else generator
        noisy = with_noise(target, noise_ratio, generator) if inject_noise else target
        return (image, target), (image * mask, noisy * mask), (image * noisy, noisy * noisy)

    def _mask(self, image, plane_id):
        masks = self.masks
        if plane_id is not None:
            masks = masks[_validate.place_in("plane_id", plane_id, len(masks))]
        if image.ndim == 2:
            # The mask is the same for every colour.
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
        floating_tensor(name, value, "a real floating tensor")
    _validate.image("target_image", image)
    while depth.ndim > 2 and len(depth) == 1:
        depth = depth[0]
    image = image[None] if image.ndim == 2 else image
    _validate.shaped("target_image", image, "[m, n] or [C, m, n]")
    _validate.shaped("target_depth", depth, f"[{image.shape[-2]}, {image.shape[-1]}] like target_image")
    _validate.one_device(target_image=image, target_depth=depth)
    if not bool(((depth >= 0) & (depth <= 1)).all()):
        raise ValueError(f"target_depth must be between 0 and 1, got {depth.min().item()} to {depth.max().item()}")
    return image.detach(), depth.detach()


def _without_leading_ones(image, target):
    _validate.alike(image=image, target=target)
    while image.ndim > 2 and len(image) == 1:
        image, target = image[0], target[0]
    return image, target


_LAPLACIAN = ((-1.0, -1.0, -1.0), (-1.0, 8.0, -1.0), (-1.0, -1.0, -1.0))


class phase_gradient(nn.Module):
    """Loss of the Laplacian of a phase, which favours smooth phases.

    Parameters
    ----------
    kernel : torch.Tensor, optional
        Kernel ``[h, w]`` or ``[1, 1, h, w]`` to filter by; by default the Laplacian of eight neighbours, over 8.
    loss : callable
        ``loss(filtered, zeros)``.
    device : torch.device or str
        Device of the kernel; it follows the phase when it is used.

    Raises
    ------
    ValueError, TypeError
        If the kernel has other axes or the loss cannot be called.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import phase_gradient
    >>> phase = torch.zeros(5, 5)
    >>> phase[2, 2] = 1
    >>> round(phase_gradient()(phase).item(), 6)
    0.045
    """

    kernel: torch.Tensor

    extra_repr: Callable[..., str] = _show.numbers_of

    def __init__(
        self,
        kernel: torch.Tensor | None = None,
        loss: Callable[..., Any] = nn.MSELoss(),  # noqa: B008
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__()
        kernel = torch.tensor(_LAPLACIAN) / 8 if kernel is None else tensor("kernel", kernel)
        _validate.shaped("kernel", kernel, "[h, w] or [1, 1, h, w], not empty")
        self.register_buffer("kernel", kernel.reshape(1, 1, *kernel.shape[-2:]).to(get_device(device)), False)
        self.loss: Callable[..., torch.Tensor] = _checked_loss(loss)

    def forward(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the loss of a phase ``[m, n]`` or ``[..., 1, m, n]`` in radians."""
        edges = self.functional_conv2d(phase)
        return self.loss(edges, torch.zeros_like(edges))

    @in_own_precision
    def functional_conv2d(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the filtered phase ``[B, 1, m, n]``, zeros around it."""
        planes = _planes("phase", phase)
        kernel = self.kernel.to(planes)
        return nn.functional.conv2d(planes, kernel, padding=tuple(side // 2 for side in kernel.shape[-2:]))


class speckle_contrast(nn.Module):
    """Loss of the local speckle contrast of an intensity, standard deviation over mean, against zero.

    Parameters
    ----------
    kernel_size : int
        Side of the square of samples that a contrast is taken from.
    step_size : int or sequence of int
        Rows and columns from one square to the next.
    loss : callable
        ``loss(contrast, zeros)``.
    device : torch.device or str
        Not used, as there is nothing to keep; the computation runs where the intensity is.

    Raises
    ------
    ValueError, TypeError
        If a size is not positive or the loss cannot be called.

    Notes
    -----
    Fully developed speckle has a contrast of 1 (Goodman, Speckle Phenomena in Optics, 2007, section 3.2). The deviation
    is computed over the samples themselves, not estimated from fewer degrees of freedom.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import speckle_contrast
    >>> stripes = torch.tensor([1.0, 3.0]).repeat(4, 2)
    >>> speckle_contrast(2)(stripes).item()
    0.25
    """

    step_size: tuple[int, int]

    extra_repr: Callable[..., str] = _show.numbers_of

    def __init__(
        self,
        kernel_size: int = 11,
        step_size: int | Sequence[int] = (1, 1),
        loss: Callable[..., Any] = nn.MSELoss(),  # noqa: B008
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__()
        checked_device("device", device)
        self.kernel_size: int = _validate.integer("kernel_size", kernel_size, minimum=1)
        self.step_size = _validate.size("step_size", (step_size,) * 2 if isinstance(step_size, int) else step_size)
        self.loss: Callable[..., torch.Tensor] = _checked_loss(loss)

    def forward(self, intensity: torch.Tensor) -> torch.Tensor:
        """Return the loss of an intensity ``[m, n]`` or ``[..., 1, m, n]``."""
        contrast = self.functional_conv2d(intensity)
        return self.loss(contrast, torch.zeros_like(contrast))

    @in_own_precision
    def functional_conv2d(self, intensity: torch.Tensor) -> torch.Tensor:
        """Return the speckle contrast of each square window, ``[B, 1, m', n']``.

        The contrast is 0 where the intensity is uniform or zero.

        Parameters
        ----------
        intensity : torch.Tensor
            Intensity ``[B, 1, m, n]``.
        """
        given = _planes("intensity", intensity)
        # In single precision the variance of dark pixels beside bright ones would be rounding alone.
        planes = given.double()
        if min(planes.shape[-2:]) < self.kernel_size:
            raise ValueError(
                f"intensity must be at least kernel_size = {self.kernel_size} wide and high, "
                f"got {tuple(intensity.shape)}"
            )
        # Deviations from a common level avoid the cancellation of E[I²] − E[I]² at high intensities.
        level = planes.detach().mean((-2, -1), keepdim=True)
        mean, square = (
            nn.functional.avg_pool2d(values, self.kernel_size, self.step_size)
            for values in (planes - level, (planes - level) ** 2)
        )
        variance, mean = square - mean**2, mean + level
        # NaN counts as uneven, so that it shows in the loss.
        uneven = ~((variance <= 0) | (mean == 0))
        # Both branches must be finite, else the gradient of the one not taken is not a number.
        contrast = torch.where(uneven, variance.where(uneven, 1.0).sqrt() / mean.where(uneven, 1.0), 0.0)
        return contrast.to(given.dtype)


class multiplane_loss(FocalTargets):
    """Squared differences of images on several planes, with more weight on the parts in focus and the bright parts.

    With image I, target T and the mask M of the plane: w₀·MSE(I, T) + w₁·MSE(I·M, T·M) + w₂·MSE(I·T, T·T).

    Parameters
    ----------
    target_image : torch.Tensor
        Picture ``[C, m, n]`` or ``[m, n]``.
    target_depth : torch.Tensor
        Depth of each pixel ``[m, n]``, 0 … 1; a pixel belongs to plane round(depth·(P − 1)).
    blur_ratio : float
        Growth of the blur's σ from one plane to the next: a pixel j planes away is blurred by σ = j·blur_ratio.
    target_blur_size : int
        Side of the blur's kernel in pixels; an even one grows by one.
    number_of_planes : int
        Number of planes P.
    weights : sequence of float
        Weights of the three terms. A fourth, which the older form has, is not used.
    multiplier : float
        Factor of the targets' intensity.
    scheme : {"defocus", "naive"}
        Targets that show defocused content blurred, or are dark beyond their plane.
    reduction : {"mean", "sum"}
        How pixels are put together.
    device : torch.device or str, optional
        Device of the loss; by default where the picture is. It moves with :meth:`to`.
    generator : torch.Generator, optional
        Where noise is drawn from; torch's own by default.
    distances : sequence of float, optional
        Distances of the P planes in metres. With them the blur follows from the geometry, see
        :func:`odak.learn.wave.loss.geometric_targets`, and `blur_ratio` and `target_blur_size` have no effect.
    wavelengths : sequence of float, optional
        Wavelength of each of the C colours in metres, with `distances`.
    pixel_pitch : float or sequence of float, optional
        Pixel pitch of the picture in metres, one number or a pair (rows, columns), with `distances`.
    numerical_aperture : float, optional
        Sine of the half angle of the cone in which light arrives, as an iris or a pupil limits it; by default limited
        by the modulator, λ/(2·pixel_pitch).

    Attributes
    ----------
    targets : torch.Tensor
        Targets of the planes, ``[P, C, m, n]``.
    masks : torch.Tensor
        Pixels that belong to each plane, ``[P, C, m, n]``.
    focus_target : torch.Tensor
        The sharp picture ``[C, m, n]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Kavaklı, Itoh, Urey and Akşit, Realistic defocus blur for multiplane computer-generated holography, IEEE VR (2023).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import multiplane_loss
    >>> picture, depth = torch.rand(3, 8, 8), torch.rand(8, 8)
    >>> loss = multiplane_loss(picture, depth, blur_ratio=1.0, number_of_planes=2)
    >>> targets, _, _ = loss.get_targets()
    >>> loss(targets[1], targets[1], plane_id=1).item()
    0.0
    """

    extra_repr: Callable[..., str] = _show.numbers_of

    @_validate.takes_units("distances", "wavelengths", "pixel_pitch")
    def __init__(
        self,
        target_image: torch.Tensor,
        target_depth: torch.Tensor,
        blur_ratio: float = 0.25,
        target_blur_size: int = 10,
        number_of_planes: int = 4,
        weights: Sequence[float] = (1.0, 2.1, 0.6),
        multiplier: float = 1.0,
        scheme: str = "defocus",
        reduction: str = "mean",
        device: torch.device | str | None = None,
        *,
        generator: torch.Generator | None = None,
        distances: Sequence[float] | None = None,
        wavelengths: Sequence[float] | None = None,
        pixel_pitch: float | Sequence[float] | None = None,
        numerical_aperture: float | None = None,
    ) -> None:
        weights, distances, wavelengths, pixel_pitch = _validate.constants(
            weights=weights, distances=distances, wavelengths=wavelengths, pixel_pitch=pixel_pitch
        )
        super().__init__(
            target_image, target_depth, blur_ratio, target_blur_size, number_of_planes, multiplier, scheme, reduction,
            device, generator, distances, wavelengths, pixel_pitch, numerical_aperture,
        )  # fmt: skip
        weights = _validate.several("weights", weights)
        if len(weights) not in (3, 4):
            raise ValueError(f"weights must be three, or four of which the last is not used; got {weights!r}")
        self.weights: list[float] = _validate.numbers(weights)

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        plane_id: int | None = None,
        inject_noise: bool = False,
        noise_ratio: float = 1e-3,
        generator: torch.Generator | None = None,
    ) -> torch.Tensor:
        """Return the loss of an image.

        Parameters
        ----------
        image, target : torch.Tensor
            Intensities of one colour ``[m, n]``, of all ``[C, m, n]`` or, without `plane_id`, of all planes
            ``[P, C, m, n]``; leading axes of one are dropped.
        plane_id : int, optional
            Plane of the image. None holds the image against the masks of all planes.
        inject_noise : bool
            Add noise to the target of the second and third term.
        noise_ratio : float
            Standard deviation of the noise as a share of the target's range.
        generator : torch.Generator, optional
            Generator of the noise if the loss was given none; by default torch's own.

        Returns
        -------
        torch.Tensor
            The loss, without axes.

        Raises
        ------
        ValueError
            If the shapes do not fit or there is no such plane.
        """
        pairs = self.pairs(image, target, plane_id, inject_noise, noise_ratio, generator)
        terms = (nn.functional.mse_loss(*pair, reduction=self.reduction) for pair in pairs)
        total: Any = sum(weight * term for weight, term in zip(self.weights, terms, strict=False))
        return total


def _checked_loss(loss):
    _validate.function("loss", loss)
    return loss


def _planes(name, value):
    """Return a real image as ``[B, 1, m, n]``."""
    floating_tensor(name, value, "a real floating tensor")
    _validate.image(name, value)
    if value.ndim > 2 and value.shape[-3] != 1:
        raise ValueError(f"{name} must be [m, n] or [..., 1, m, n], got {tuple(value.shape)}")
    return value.reshape(-1, 1, *value.shape[-2:])


_NORMS = {"l2": nn.functional.mse_loss, "l1": nn.functional.l1_loss}
_TERMS = ("base_{}_loss", "loss_{}_mask", "loss_{}_cor")
_BASE_WEIGHTS = {term.format(norm): 1.0 for norm in _NORMS for term in _TERMS}


class perceptual_multiplane_loss(FocalTargets):
    """The terms of ``multiplane_loss``, squared and absolute, and perceptual measures of the difference of images.

    Parameters
    ----------
    target_image : torch.Tensor
        Picture ``[C, m, n]`` or ``[m, n]``.
    target_depth : torch.Tensor
        Depth of each pixel ``[m, n]``, 0 … 1; a pixel belongs to plane round(depth·(P − 1)).
    blur_ratio : float, default: 0.25
        Growth of the blur's σ from one plane to the next: a pixel j planes away is blurred by σ = j·blur_ratio.
    target_blur_size : int, default: 10
        Side of the blur's kernel in pixels; an even one grows by one.
    number_of_planes : int, default: 4
        Number of planes P.
    multiplier : float, default: 1.0
        Factor of the targets' intensity.
    scheme : {"defocus", "naive"}
        Targets that show defocused content blurred, or are dark beyond their plane.
    base_loss_weights : dict, optional
        Weights of "base_l2_loss", "loss_l2_mask", "loss_l2_cor", "base_l1_loss", "loss_l1_mask" and "loss_l1_cor"; all
        1 by default, and 0 for those that a dict leaves out.
    additional_loss_weights : dict, optional
        Weights of any of "cvvdp", "fvvdp", "lpips", "psnr", "ssim" and "msssim"; by default 1 for "cvvdp" where its
        package is installed, and none with a :class:`~odak.MissingPackageWarning` where it is not. Each
        term is the difference from the quality of equal images: 10 − JOD, 1 − SSIM; "psnr", which has no largest value,
        is negated, −∞ for equal images.
    reduction : {"mean", "sum"}
        How pixels are combined in the six terms.
    return_components : bool, default: False
        Return ``(loss, components)``, a dict of weighted terms that add up to the loss.
    device : torch.device or str, optional
        Device of the loss; by default where the picture is. It moves with :meth:`to`.
    generator : torch.Generator, optional
        Where noise is drawn from; torch's own by default.
    distances : sequence of float, optional
        Distances of the P planes in metres. With them the blur follows from the geometry, see
        :func:`odak.learn.wave.loss.geometric_targets`, and `blur_ratio` and `target_blur_size` have no effect.
    wavelengths : sequence of float, optional
        Wavelength of each of the C colours in metres, with `distances`.
    pixel_pitch : float or sequence of float, optional
        Pixel pitch of the picture in metres, one number or a pair (rows, columns), with `distances`.
    numerical_aperture : float, optional
        Sine of the half angle of the cone in which light arrives, as an iris or a pupil limits it; by default limited
        by the modulator, λ/(2·pixel_pitch).
    viewing : odak.learn.perception.Viewing, optional
        How images are seen, for "cvvdp" and "fvvdp"; by default on their packages' display.

    Raises
    ------
    ImportError
        If a requested measure needs a package that is missing; the message states what to install.
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import perceptual_multiplane_loss
    >>> picture, depth = torch.rand(3, 16, 16), torch.rand(16, 16)
    >>> loss = perceptual_multiplane_loss(
    ...     picture, depth, 1.0, additional_loss_weights={"ssim": 0.5}, return_components=True
    ... )
    >>> total, components = loss(loss.targets[0], loss.targets[0], plane_id=0)
    >>> total.item(), components["ssim"].item()
    (0.0, 0.0)
    """

    base_loss_weights: dict[str, float]

    @_validate.takes_units("distances", "wavelengths", "pixel_pitch")
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
        distances: Sequence[float] | None = None,
        wavelengths: Sequence[float] | None = None,
        pixel_pitch: float | Sequence[float] | None = None,
        numerical_aperture: float | None = None,
        viewing: perception.Viewing | None = None,
    ):
        distances, wavelengths, pixel_pitch = _validate.constants(
            distances=distances, wavelengths=wavelengths, pixel_pitch=pixel_pitch
        )
        super().__init__(
            target_image, target_depth, blur_ratio, target_blur_size, number_of_planes, multiplier, scheme, reduction,
            device, generator, distances, wavelengths, pixel_pitch, numerical_aperture,
        )  # fmt: skip
        self.base_loss_weights = _checked_weights("base_loss_weights", base_loss_weights, _BASE_WEIGHTS, _BASE_WEIGHTS)
        self.additional_loss_weights: dict[Any, float] = _checked_weights(
            "additional_loss_weights", additional_loss_weights, {"cvvdp": 1.0}, _MEASURES
        )
        self.return_components: bool = _validate.flag("return_components", return_components)
        viewing = None if viewing is None else checked_viewing(viewing)
        self.measures: nn.ModuleDict = nn.ModuleDict()
        for name in tuple(self.additional_loss_weights):
            try:
                self.measures[name] = _MEASURES[name][0](self.target_image.device, viewing)
            except ImportError as error:
                if additional_loss_weights is not None:
                    raise
                del self.additional_loss_weights[name]
                warn(f"perceptual_multiplane_loss leaves out {name!r}: {error}", MissingPackageWarning)

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        plane_id: int | None = None,
        inject_noise: bool = False,
        noise_ratio: float = 1e-3,
        generator: torch.Generator | None = None,
    ) -> torch.Tensor | tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Return the loss of an image, and its components if the class was made to return them.

        Parameters
        ----------
        image : torch.Tensor
            Reconstructed image, see :class:`multiplane_loss`.
        target : torch.Tensor
            Target image of the same shape.
        plane_id : int, optional
            Index of the plane; by default all planes.
        inject_noise : bool
            Whether to add noise to the target, default False.
        noise_ratio : float
            Standard deviation of that noise relative to the range of the target, default 1e-3.
        generator : torch.Generator, optional
            Generator of the noise.
        """
        pairs = self.pairs(image, target, plane_id, inject_noise, noise_ratio, generator)
        components = {}
        for norm, difference in _NORMS.items():
            for term, pair in zip(_TERMS, pairs, strict=True):
                name = term.format(norm)
                if weight := self.base_loss_weights.get(name, 0.0):
                    components[name] = weight * difference(*pair, reduction=self.reduction)
        # The quality is judged against the picture without noise.
        whole = [picture if picture.ndim > 2 else picture[None] for picture in pairs[0]]
        for name, measure in self.measures.items():
            components[name] = self.additional_loss_weights[name] * _MEASURES[name][1](measure(*whole))
        loss = sum(components.values(), whole[0].new_zeros(()))
        return (loss, components) if self.return_components else loss


def _jod_loss(quality):
    return 10 - quality


def _similarity_loss(similarity):
    return 1 - similarity


# How each measure is made for a device and a viewing or None, and how its value becomes a loss.
_MEASURES: dict[str, tuple[Callable[..., nn.Module], Callable[[torch.Tensor], torch.Tensor]]] = {
    "cvvdp": (lambda device, viewing: perception.CVVDP(device, viewing=viewing, required=True), _jod_loss),
    "fvvdp": (lambda device, viewing: perception.FVVDP(device, viewing=viewing, required=True), _jod_loss),
    "lpips": (lambda *_: perception.LPIPS(required=True), lambda distance: distance),
    "psnr": (lambda *_: perception.PSNR(), lambda decibels: -decibels),
    "ssim": (lambda *_: perception.SSIM(), _similarity_loss),
    "msssim": (lambda *_: perception.MSSSIM(), _similarity_loss),
}


def _checked_weights(argument, given, default, known):
    given = default if given is None else given
    _validate.instance(argument, given, Mapping, "a dictionary of weights")
    _validate.known(argument, given, known)
    weights = {name: _validate.constant(f"{argument}[{name!r}]", value) for name, value in given.items()}
    return {name: weight for name, weight in weights.items() if weight}
