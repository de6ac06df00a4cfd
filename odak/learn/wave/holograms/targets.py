"""Targets of holograms: what images of a display are to be. Touches a display by its places and stop."""

from typing import Any

import torch

from odak import _validate
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import floating
from odak.learn.wave.displays.display import Display
from odak.learn.wave.displays.panels import Iris
from odak.learn.wave.holograms.scenery import Scenery
from odak.learn.wave.loss import FocalTargets, multiplane_loss
from odak.learn.wave.training import checked_intensities


def focal_targets(display: Display, target: Any) -> FocalTargets | None:
    """Return the targets of the planes of a picture with depth; None for any other target."""
    if not isinstance(target, tuple) or len(target) != 2:
        return None
    if display.path.on_retinas:
        raise ValueError("target must be images [eyes, colours, rows, columns] where eyes look on, got one with depth")
    iris = display.iris
    # An iris passes frequencies up to radius/(λ·focal_length), λ in air: in a medium the sine of the cone is smaller.
    sine = iris.radius / (iris.focal_length * display.medium) if isinstance(iris, Iris) else None
    return multiplane_loss(
        *target,
        number_of_planes=display.shape[0],
        device=display.powers.device,
        distances=display.distances,
        wavelengths=[wavelength / display.medium for wavelength in display.wavelengths],
        pixel_pitch=display.modulator.pitch,
        numerical_aperture=sine,
    )


def checked_target(display: Display, target: Any) -> torch.Tensor:
    """Return a target ``[D, C, rows, columns]`` on the device of a display after checking that it fits."""
    target = target.images(display) if isinstance(target, Scenery) else floating("target", target)
    target = checked_intensities("target", target)
    planes, colours, rows, columns = display.shape
    accepted: set[tuple[int, ...]] = {(planes, colours, rows, columns)}
    # Eyes may all see the same.
    alike = planes == 1 or display.path.on_retinas
    accepted |= {(colours, rows, columns)} if alike else set()
    accepted |= {(rows, columns)} if alike and colours == 1 else set()
    if tuple(target.shape) not in accepted:
        raise ValueError(
            f"target must be [planes, colours, rows, columns] = {list(display.shape)}, "
            f"{_validate.in_order('target', target.shape, display.shape[-2:])}"
        )
    if float(target.max()) > 2:
        raise ValueError(f"target must be intensities of 0 … 1, got up to {float(target.max()):.4g}: divide by 255?")
    if not bool(target.any()):
        warn(
            "target is black: a modulator of phases leaves its light somewhere, and the quality means nothing",
            ArgumentWarning,
        )
    return target.expand(display.shape).to(display.powers.device)
