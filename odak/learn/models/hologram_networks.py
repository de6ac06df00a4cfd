"""A network that computes phase-only holograms, conditioned on wavelength, pixel pitch and distance."""

import math
from collections.abc import Iterator, Sequence
from importlib.resources import files

import numpy as np
import torch
from torch import nn

from odak import _validate
from odak._array import phasor
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import floating_tensor, trainable
from odak.learn.models.training import load_weights
from odak.learn.tools.matrix import plane_indices, plane_masks
from odak.wave.propagation import propagate_beam, propagate_within_window

# Range of wavelength·distance/pitch² and of wavelength/pitch in training; what lies outside is taken as its end.
SPREADS, RATIOS = (10.0, 150.0), (0.035, 0.23)
# Largest spread of light for which the weights included in odak are valid, relative to the shorter side of a picture.
FARTHEST = 0.6
# Amplitudes and magnitudes below this are taken as this, of images whose mean intensity is one.
_DARK = 1e-3
# Pixels beyond the edges of a periodic picture that a convolution uses.
_MARGIN = 8


class hologram_network(nn.Module):
    """A network that computes phase-only holograms of pictures of any size, for any wavelength, pitch and distance.

    The amplitude of the target is propagated back to the modulator, where a small convolutional network computes a
    first hologram from the field. In each refinement the image of the hologram is computed, its difference from the
    target is propagated back, and a second network, the same in all of them, computes a correction of the hologram.
    A picture with a depth for each pixel has one image for each of several planes, in which the pixels of that plane
    are in focus. The propagation is exact and has no weights, so that the networks have to learn little of the
    geometry, which enters them by three ratios: wavelength·distance/dx² and wavelength/dx, with the mean distance of
    the planes, and the distance between the first and the last over that mean.

    Parameters
    ----------
    channels : int
        Channels of the convolutions, 16 in the weights included in odak.
    refinements : int
        Number of refinements. More take more time and improve the image; the weights are the same.
    pretrained : bool
        Load the weights included in odak, trained by ``scripts/train_hologram_network.py``, instead of random ones.
    periodic : bool
        Propagate pictures that repeat themselves without end, as part of the training does, which stands for the inside
        of large pictures.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    AccuracyWarning
        If light spreads so far that most of it leaves the picture, which the weights that come with odak were not
        trained for: wavelength·distance/(2·dx²) is the number of pixels.

    Notes
    -----
    Gradients reach the target; wavelength, pitch, distance and depth have none. With these fixed and without depth,
    ``torch.export`` takes the network. Where light spreads over more than some hundred pixels to each side, gradient
    descent from the start "gs" of :func:`odak.learn.wave.stochastic_gradient_descent` gains more in the same time.

    Each step of an iterative solver has a learned correction, as in Adler and Öktem, Inverse Problems 33, 124007
    (2017). Without the corrections, the steps are the alternating projections of Gerchberg and Saxton, Optik 35, 237
    (1972).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import hologram_network
    >>> network = hologram_network(pretrained=True)
    >>> target = torch.zeros(64, 96)
    >>> target[16:48, 24:72] = 1.0
    >>> with torch.no_grad():
    ...     phase = network(target, 532e-9, 8e-6, 5e-3)
    >>> tuple(phase.shape)
    (64, 96)

    A picture whose columns lie deeper and deeper, on three planes:

    >>> depth = torch.linspace(0, 1, 96).expand(64, 96)
    >>> with torch.no_grad():
    ...     phase = network(target, 532e-9, 8e-6, (4e-3, 5e-3, 6e-3), depth)
    >>> tuple(phase.shape)
    (64, 96)
    """

    def __init__(self, channels: int = 16, refinements: int = 8, pretrained: bool = False, periodic: bool = False):
        super().__init__()
        channels = _validate.integer("channels", channels, minimum=1)
        self.refinements: int = _validate.integer("refinements", refinements)
        self.periodic: bool = _validate.flag("periodic", periodic)
        self.encoding: _Correction = _Correction(3, 2, channels)
        self.refinement: _Correction = _Correction(5, 2, channels)
        self.pretrained: bool = _validate.flag("pretrained", pretrained)
        if self.pretrained:
            load_weights(self, str(files("odak") / "assets" / "hologram_network.pt"))

    def forward(
        self,
        target: torch.Tensor,
        wavelength: float | Sequence[float],
        dx: float,
        distance: float | Sequence[float],
        depth: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the phase of the hologram of an image.

        Parameters
        ----------
        target : torch.Tensor
            Intensity ``[..., rows, columns]`` of at least 0; its brightness has no effect.
        wavelength : float or sequence of float
            Wavelength in metres; several belong to the colours of a target ``[..., colours, rows, columns]``.
        dx : float
            Pixel pitch in metres.
        distance : float or sequence of float
            Distance from hologram to image in metres; negative if the image lies before the hologram. With `depth`,
            the distances of the planes, all of one sign.
        depth : torch.Tensor, optional
            Depth of each pixel ``[rows, columns]``, or one map for each picture of a batch, ``[..., rows, columns]``,
            the same for all colours. 0 is the first plane of `distance` and 1 the last; a pixel belongs to the nearest
            of planes that divide this range evenly. By default all pixels lie at one distance.

        Returns
        -------
        torch.Tensor
            Phase in radians, −π … π, of the target's shape and dtype.
        """
        target = _intensity(target)
        if isinstance(wavelength, Sequence) or getattr(wavelength, "ndim", False):
            wavelengths = _validate.several("wavelength", wavelength, positive=True)
            if target.ndim < 3 or target.shape[-3] != len(wavelengths):
                raise ValueError(
                    "wavelength must be one number, or one for each colour of target [..., colours, rows, columns]; "
                    f"got {len(wavelengths)} numbers and {list(target.shape)}"
                )
            colours = (self(one, w, dx, distance, depth) for one, w in zip(target.unbind(-3), wavelengths, strict=True))
            return torch.stack(list(colours), -3)
        *_, last = self.stages(target, wavelength, dx, distance, depth)
        return last

    def stages(
        self,
        target: torch.Tensor,
        wavelength: float,
        dx: float,
        distance: float | Sequence[float],
        depth: torch.Tensor | None = None,
    ) -> Iterator[torch.Tensor]:
        """Return an iterator over the phase before the first refinement and after each.

        Parameters
        ----------
        target : torch.Tensor
            Intensity ``[..., rows, columns]`` of at least 0.
        wavelength : float
            Wavelength in metres.
        dx : float
            Pixel pitch in metres.
        distance : float or sequence of float
            Distance from hologram to image in metres; negative if the image lies before the hologram. With `depth`,
            the distances of the planes, all of one sign.
        depth : torch.Tensor, optional
            Depth of each pixel ``[rows, columns]`` or ``[..., rows, columns]``, 0 the first plane of `distance` and 1
            the last. By default all pixels lie at one distance.

        Returns
        -------
        iterator of torch.Tensor
            Phase in radians, −π … π, of the target's shape and dtype.
        """
        target = _intensity(target)
        wavelength = _validate.constant("wavelength", wavelength, positive=True)
        dx = _validate.constant("dx", dx, positive=True)
        distances, masks = _planes(target, distance, depth)
        reach, shorter = 0.5 * wavelength * max(map(abs, distances)) / dx**2, min(target.shape[-2:])
        if self.pretrained and not self.periodic and reach > FARTHEST * shorter:
            warn(
                f"light spreads over {reach:.0f} pixels to each side, more than {FARTHEST} of the {shorter} of the "
                "target's shorter side: the weights were not trained for that; use gradient descent",
                AccuracyWarning,
            )
        images = trainable(target).to(self.encoding.enter.weight).reshape(-1, 1, *target.shape[-2:])
        # An image before the hologram is the one behind the conjugate hologram.
        sign = math.copysign(1, distances[0])
        return (
            (sign * hologram.angle()).reshape(target.shape).to(target.dtype)
            for hologram in self._holograms(images, masks.to(images), wavelength, dx, [abs(z) for z in distances])
        )

    def _holograms(self, images, masks, wavelength, dx, distances) -> Iterator[torch.Tensor]:
        """Yield phasors ``[B, 1, rows, columns]`` of images of that shape with masks ``[B or 1, P, rows, columns]``."""
        middle, half = sum(distances) / len(distances), 0.5 * (max(distances) - min(distances))
        # As NumPy's, the distances are known while a graph of these steps is recorded.
        distances = np.asarray(distances)
        cycles = torch.as_tensor(distances / wavelength % 1, device=images.device)
        carriers = phasor(2 * math.pi * cycles, images.dtype.to_complex())[:, None, None]

        def propagate(fields, sign):
            """Return the fields ``[B, P, rows, columns]`` of the planes, or the sum of those that they send back."""
            lengths = (sign * distances, dx, wavelength, "Angular Spectrum")
            if self.periodic:
                there = propagate_beam(fields, None, *lengths, zero_padding=(False, False, False))
            else:
                there = propagate_within_window(fields, *lengths)
            return there * carriers.conj() if sign > 0 else (there * carriers).sum(1, keepdim=True)

        spread = wavelength * middle / dx**2
        geometry = torch.tensor([_place(spread, SPREADS), _place(wavelength / dx, RATIOS), 2 * half / middle])
        geometry = geometry.to(images)
        mean = images.mean((-2, -1), keepdim=True).clamp_min(torch.finfo(images.dtype).tiny)
        amplitude = (images / mean).clamp_min(_DARK**2).sqrt()
        covered = torch.ones_like(amplitude)
        if not self.periodic:
            for axis in (-2, -1):
                covered = covered * _covered(amplitude.shape[axis], 0.5 * spread, axis, images)

        def corrected(network, error, *fields):
            known = torch.cat([geometry.expand(len(images), -1), error.view(-1, 1)], 1)
            parts = [part for field in fields for part in (field.real, field.imag)]
            found = network(torch.cat([*parts, covered], 1), known, self.periodic)
            # Autocast computes the convolutions in half precision, which complex numbers do not have.
            return torch.complex(*found.to(images.dtype).split(1, 1))

        field = propagate((masks * amplitude).to(carriers.dtype), -1)
        hologram = _unit(field + corrected(self.encoding, torch.zeros_like(mean), field))
        yield hologram
        step = torch.zeros_like(hologram)
        for _ in range(self.refinements):
            planes = propagate(hologram, 1)
            magnitudes = planes.abs()
            magnitude = (masks * magnitudes).sum(1, keepdim=True)
            scale = _mean(magnitude * amplitude) / _mean(amplitude * amplitude)
            # The field beside the pixels in focus is not constrained: only the error at these is propagated back.
            lacking = masks * (scale * amplitude / magnitudes.clamp_min(_DARK) - 1) * planes
            back = propagate(lacking, -1) * hologram.conj()
            error = _mean(lacking.abs().square().sum(1, keepdim=True)) / _mean(magnitude * magnitude)
            error = 1 + 0.5 * error.clamp_min(_DARK**2).log10()
            turn = corrected(self.refinement, error, back, step)
            before, hologram = hologram, _unit(hologram * (1 + back + turn))
            step = hologram * before.conj() - 1
            yield hologram


class _Correction(nn.Module):
    """A U-Net of two scales, half and a quarter of the picture's, scaled and shifted by functions of the geometry.

    Four neighbouring pixels are channels of one, so that what is not the same for even and odd pixels can be learned.
    The output, −1 … 1, is zero before training.
    """

    def __init__(self, inputs: int, outputs: int, channels: int):
        super().__init__()
        self.enter = nn.Conv2d(4 * inputs, channels, 3, padding=1)
        self.fine = _residual(channels)
        self.down = nn.Conv2d(channels, channels, 2, stride=2)
        self.coarse = _residual(channels)
        self.up = nn.Conv2d(channels, 4 * channels, 1)
        self.last = _residual(channels)
        self.leave = nn.Conv2d(channels, 4 * outputs, 3, padding=1)
        modulating = nn.Linear(16, 4 * channels)
        self.modulation = nn.Sequential(nn.Linear(4, 16), nn.SiLU(), modulating)
        for parameter in (*self.leave.parameters(), *modulating.parameters()):
            nn.init.zeros_(parameter)

    def forward(self, images: torch.Tensor, geometry: torch.Tensor, periodic: bool) -> torch.Tensor:
        """Return ``[B, outputs, rows, columns]`` for ``[B, inputs, rows, columns]`` and ``[B, 4]`` of the geometry."""
        rows, columns = images.shape[-2:]
        margin = min(_MARGIN, rows // 4 * 4, columns // 4 * 4) if periodic else 0
        padding = (margin, margin + -columns % 4, margin, margin + -rows % 4)
        padded = nn.functional.pad(images, padding, mode="circular" if periodic else "replicate")
        scale, shift, coarse_scale, coarse_shift = self.modulation(geometry).view(len(images), 4, -1, 1, 1).unbind(1)
        fine = self.enter(nn.functional.pixel_unshuffle(padded, 2)) * (1 + scale) + shift
        fine = fine + self.fine(fine)
        coarse = self.down(fine) * (1 + coarse_scale) + coarse_shift
        coarse = coarse + self.coarse(coarse)
        fine = fine + nn.functional.pixel_shuffle(self.up(coarse), 2)
        fine = fine + self.last(fine)
        # Bounded, because gradients do not return a phase to the first cycles once it has left them.
        large = nn.functional.pixel_shuffle(self.leave(fine).tanh(), 2)
        return large[..., margin : margin + rows, margin : margin + columns]


def _residual(channels: int) -> nn.Sequential:
    first, second = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))
    return nn.Sequential(first, nn.LeakyReLU(0.1), second)


def _covered(count: int, reach: float, axis: int, like: torch.Tensor) -> torch.Tensor:
    """Return the share of the light of each pixel, spread over ± reach pixels, that stays inside along an axis."""
    place = torch.arange(count, device=like.device, dtype=like.dtype) + 0.5
    share = ((place + reach).clamp_max(count) - (place - reach).clamp_min(0)) / (2 * reach)
    return share[:, None] if axis == -2 else share


def _unit(field: torch.Tensor) -> torch.Tensor:
    return field / field.abs().clamp_min(_DARK)


def _mean(values: torch.Tensor) -> torch.Tensor:
    return values.mean((-2, -1), keepdim=True)


def _place(value: float, ends: tuple[float, float]) -> float:
    """Return where a ratio lies between two ends, −1 … 1 on a logarithmic scale."""
    low, high = map(math.log, ends)
    return 2 * (min(max(math.log(value), low), high) - low) / (high - low) - 1


def _planes(target, distance, depth) -> tuple[list[float], torch.Tensor]:
    """Return the distances of the planes, and ones where a pixel belongs to one, ``[B or 1, P, rows, columns]``."""
    (distance,) = _validate.constants(distance=distance)
    if depth is None or not (isinstance(distance, Sequence) or getattr(distance, "ndim", False)):
        distances = [_validate.constant("distance", distance)]
    else:
        distances = [float(one) for one in _validate.numbers(_validate.several("distance", distance))]
    flat = depth is None
    if flat:
        depth = target.new_zeros(target.shape[-2:])
    floating_tensor("depth", depth, "a real floating tensor")
    if depth.shape not in (target.shape[-2:], target.shape):
        raise ValueError(
            f"depth must be [rows, columns] or have a map for each picture of target {list(target.shape)}, "
            f"got {list(depth.shape)}"
        )
    low, high = (0, 0) if flat else torch.stack(depth.aminmax()).tolist()
    if not 0 <= low <= high <= 1:
        raise ValueError(f"depth must be from 0 to 1, got {low:g} to {high:g}")
    if not distances or not (min(distances) > 0 or max(distances) < 0):
        given = distances[0] if len(distances) == 1 else distances
        raise ValueError(f"distance must be positive or negative for all planes, not 0; got {given}")
    nearest = plane_indices(depth.detach(), len(distances)).reshape(-1, *target.shape[-2:])
    return distances, plane_masks(nearest, len(distances))


def _intensity(target) -> torch.Tensor:
    floating_tensor("target", target, "a real floating tensor of intensities")
    return _validate.image("target", target)
