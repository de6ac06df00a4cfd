"""What the images of a colour hologram and its phase are judged by, and the slopes of all that."""

from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import floating
from odak.learn.wave.camera_in_the_loop import captured_by, seen
from odak.learn.wave.fields import squared_error
from odak.learn.wave.hologram_losses import check_pair, eyebox_mask, keywords_of, light_loss
from odak.learn.wave.phase_constraints import (
    checked_pattern,
    checkerboard,
    double_phase_roughness,
    eyebox_loss,
    roughness,
    zero_mean,
)
from odak.learn.wave.propagators import propagator
from odak.learn.wave.workspace import Workspace


class ColorHologramLosses:
    """Losses of images, light, eyebox and phase, for the optimizers of holograms in several colours.

    Attributes
    ----------
    propagator : odak.learn.wave.propagator
        The display.
    targets : torch.Tensor
        Intensities ``[D, C, ms, ns]``.
    phase, phase_offset : torch.Tensor
        What the pattern is made of.
    amplitude : torch.Tensor
        Amplitude of the light on the modulator, used where it is learned.
    weights : dict
        Weight of each loss.

    Notes
    -----
    The rest is as in :class:`odak.learn.wave.multi_color_hologram_optimizer`, which sets it.
    """

    propagator: propagator
    device: torch.device
    number_of_depth_layers: int
    targets: torch.Tensor
    phase: torch.Tensor
    phase_offset: torch.Tensor
    amplitude: torch.Tensor
    double_phase: bool
    optimize_peak_amplitude: bool
    camera: Callable | None
    weights: dict[str, float]
    _peak: float
    _eyebox: dict[str, Any]
    _noise: dict[str, Any]
    _workspace: Workspace | None = None

    def init_loss_function(self, loss_function: Callable | None, reduction: str = "sum") -> None:
        """Set the loss of an image, and how those of planes and pixels are put together."""
        self.loss_function = _validate.function_or_none("loss_function", loss_function)
        self.reduction = _validate.one_of("reduction", reduction, ("sum", "mean"))
        if loss_function is not None:
            self._loss_keywords = keywords_of(loss_function)

    def init_peak_amplitude_scale(self) -> None:
        """Set the brightness of the targets to begin with."""
        peak = _validate.real("peak_amplitude", self._peak, positive=True)
        self.peak_amplitude = torch.tensor(float(peak), dtype=self.targets.dtype, device=self.device)

    def evaluate(
        self,
        input_image: torch.Tensor,
        target_image: torch.Tensor,
        plane_id: int = 0,
        noise_ratio: float = 1e-3,
        inject_noise: bool = False,
    ) -> torch.Tensor:
        """Return the loss of an image against its target.

        Parameters
        ----------
        input_image, target_image : torch.Tensor
            Intensities ``[C, ms, ns]``.
        plane_id : int
            Plane, for losses that know planes.
        noise_ratio : float
            Standard deviation of the noise as a share of the target's range.
        inject_noise : bool
            Add noise to the target.

        Returns
        -------
        torch.Tensor
            The loss; that of a given function is summed over colours.
        """
        inject_noise = _validate.flag("inject_noise", inject_noise)
        plane_id, noise_ratio = _validate.integer("plane_id", plane_id), _validate.real("noise_ratio", noise_ratio)
        check_pair(input_image, target_image)
        if self.loss_function is not None:
            known = {"plane_id": plane_id, "noise_ratio": noise_ratio, "inject_noise": inject_noise}
            keywords = {name: value for name, value in known.items() if name in self._loss_keywords}
            pairs = zip(input_image, target_image, strict=True)
            return sum(self.loss_function(image, target, **keywords) for image, target in pairs)
        if inject_noise:
            spread = target_image.amax() - target_image.amin()
            target_image = target_image + noise_ratio * spread * torch.randn_like(target_image)
        error = squared_error(input_image, target_image, self._workspace)
        return error / input_image.numel() if self.reduction == "mean" else error

    def double_phase_constrain(
        self, phase: torch.Tensor, phase_offset: torch.Tensor, levels: int = 6
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the double phase (phase − offset and phase + offset in checkerboard) and how rough its parts are."""
        pattern = checkerboard(*checked_pattern(phase, phase_offset, of_frames=True))
        return pattern, double_phase_roughness(pattern, levels)

    def direct_phase_constrain(
        self, phase: torch.Tensor, phase_offset: torch.Tensor, levels: int = 6
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the phase less its mean and the offset, and how rough it is."""
        phase, phase_offset = checked_pattern(phase, phase_offset, of_frames=True)
        pattern = zero_mean(phase) - phase_offset
        return pattern, roughness(pattern, levels)

    def eyebox_constrain(self, phase: torch.Tensor, offset: float | Sequence[float], diameter: float) -> torch.Tensor:
        """Return how unevenly light fills a disc of the hologram's spectrum, and the share that misses it.

        Parameters
        ----------
        phase : torch.Tensor
            Phases ``[F, m, n]``.
        offset : float or sequence of float
            Distance of the disc's centre from zero frequency, in samples of the spectrum.
        diameter : float
            Diameter of the disc in samples of the spectrum.
        """
        phase = _validate.image("phase", floating("phase", phase))
        if not phase.numel():
            raise ValueError(f"phase must not be empty, got {list(phase.shape)}")
        return eyebox_loss(phase, eyebox_mask(phase.shape[-2:], offset, diameter).to(phase))

    def _pattern(self):
        """Return the phases shown, and the loss of the constraint they are held to (None without)."""
        if not self.weights["phase"]:
            return self.phase, None
        constrain = self.double_phase_constrain if self.double_phase else self.direct_phase_constrain
        return constrain(self.phase, self.phase_offset)

    def _gradient(self, iteration):
        phases, phase_loss = self._pattern()
        amplitude = torch.relu(self.amplitude) if self.amplitude.requires_grad else None
        powers = self.propagator.get_laser_powers()
        roots = [self.propagator.holograms(phases, amplitude)] + ([powers] if powers.requires_grad else [])
        # Planes stop at these, so that each chunk is done with when its slopes have been added to theirs.
        leaves = [root.detach().requires_grad_() for root in roots]
        total = self._image_gradient(phases, leaves[0], leaves[1] if powers.requires_grad else powers, iteration == 0)
        rest = self._other_losses(phases, phase_loss, powers)
        reached = [(root, leaf.grad) for root, leaf in zip(roots, leaves, strict=True) if leaf.grad is not None]
        if rest is not None and rest.requires_grad:
            reached.append((rest, None))
        if not reached:
            raise ValueError(f"weights leave nothing to learn from, got {self.weights}")
        torch.autograd.backward(*zip(*reached, strict=True))
        return total if rest is None else total + rest.detach()

    def _image_gradient(self, phases, hologram, powers, first):
        captured = None if self.camera is None else captured_by(self.camera, phases, tuple(self.targets.shape))
        if self.optimize_peak_amplitude and first:
            with torch.no_grad():
                shown = self._images(hologram, powers, captured)
                self._set_peak([_overlap(images, self.targets[planes]) for planes, images in shown])
        total, light = torch.zeros_like(self.peak_amplitude), []
        for planes, images in self._images(hologram, powers, captured):
            loss = self.weights["image"] * self._image_loss(images, planes)
            loss.backward()
            total += loss.detach()
            if self.optimize_peak_amplitude:
                light.append(_overlap(images.detach(), self.targets[planes]))
        if light:
            self._set_peak(light)
        return total

    def _images(self, hologram, powers, captured):
        """Yield some planes and their intensities, until all were there."""
        for planes in self.propagator.plane_chunks() if self.weights["image"] else []:
            images = self.propagator.exposures(hologram, planes, powers, workspace=self._workspace)
            yield planes, images if captured is None else seen(images, captured[planes])

    def _set_peak(self, overlaps):
        """Set the brightness at which the images of this iteration were closest to the targets, ⟨I, I⟩/⟨I, T⟩."""
        own, common = torch.stack(overlaps).sum(0)
        self.peak_amplitude.copy_(own / common.clamp_min(torch.finfo(common.dtype).tiny))

    def _image_loss(self, images, planes):
        targets = self.targets[planes]
        if self.optimize_peak_amplitude:
            # Relative to the brightness found: were targets scaled by it, darkness would be the best image of all.
            images = images / self.peak_amplitude
        elif self._peak != 1:
            targets = targets * self._peak
        share = len(images) / self.number_of_depth_layers if self.reduction == "mean" else 1
        if self.loss_function is None:
            return share * self.evaluate(images, targets, **self._noise)
        ids = range(planes.start, planes.stop)
        losses = [self.evaluate(*pair, plane, **self._noise) for *pair, plane in zip(images, targets, ids, strict=True)]
        return share * sum(losses) / (len(losses) if self.reduction == "mean" else 1)

    def _other_losses(self, phases, phase_loss, powers):
        losses = []
        if self.weights["light"] and powers.requires_grad:
            loss = light_loss(powers, self.targets, self._peak, self.reduction)
            losses.append(self.weights["light"] * loss)
        if self.weights["eyebox"]:
            losses.append(self.weights["eyebox"] * self.eyebox_constrain(phases, **self._eyebox))
        if phase_loss is not None:
            losses.append(self.weights["phase"] * phase_loss)
        return sum(losses) if losses else None


def _overlap(images, targets):
    """Return ⟨I, I⟩ and ⟨I, T⟩ in one tensor."""
    images, targets = images.flatten(), targets.flatten()
    return torch.stack([torch.dot(images, images), torch.dot(images, targets)])
