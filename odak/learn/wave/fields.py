"""Amplitude, phase, intensity and exposure of fields as tensors, with memory-efficient gradients."""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from odak import _array, _validate
from odak._torch_private import is_transformed, operator
from odak.learn._face import torch_face
from odak.learn._tensors import complex_tensor, real_tensor, tensor, trainable
from odak.wave import fields
from odak.wave.torch_convolution import Workspace, allocate_like

if TYPE_CHECKING:
    from odak.learn._faces.wave_fields import *  # noqa: F403

_HALVES = (torch.float16, torch.bfloat16)


def unit_phasor(phase: torch.Tensor) -> torch.Tensor:
    """Return exp(i·phase).

    Parameters
    ----------
    phase : torch.Tensor
        Real phase in radians, of any shape.

    Returns
    -------
    torch.Tensor
        Complex field of amplitude one, in the phase's precision; differentiable any number of times.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import unit_phasor
    >>> field = unit_phasor(torch.tensor([0.0, torch.pi / 2]))
    >>> [round(value, 6) for value in field.imag.tolist()]
    [0.0, 1.0]
    """
    real_tensor("phase", phase)
    # There are no complex dtypes of half precision.
    return _unit_phasor(phase.float() if phase.dtype in _HALVES else phase)


def intensity(field: torch.Tensor) -> torch.Tensor:
    """Return the intensity |field|² of a complex field.

    Parameters
    ----------
    field : torch.Tensor
        Complex field of any shape.

    Returns
    -------
    torch.Tensor
        Real, of the field's shape and precision; differentiable any number of times, also at zero.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import intensity
    >>> intensity(torch.tensor([3 + 4j, 2j])).tolist()
    [25.0, 4.0]
    """
    _validate.instance("field", field, torch.Tensor, "a complex tensor")
    field = _array.to_complex(field).resolve_conj()
    if torch.compiler.is_compiling():
        # The compiler of torch 2.11 makes the slope of the operator zero.
        return field.real.square() + field.imag.square()
    return _intensity(field)


def mean_intensity(field: torch.Tensor, frames: int) -> torch.Tensor:
    """Return the intensity of a field, averaged over frames where there are several, ``[frames, ...]``."""
    return intensity(field) if frames == 1 else intensity(field).mean(0)


def exposure(
    field: torch.Tensor, power: torch.Tensor, one_each: bool = False, *, workspace: Workspace | None = None
) -> torch.Tensor:
    """Return the intensity that the frames of a field, shown one after another, add up to on each plane and colour.

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[frames, planes, colours, rows, columns]``; with `one_each` ``[frames, planes, 1, rows, columns]``.
    power : torch.Tensor
        Amplitude of the light source ``[frames, colours]``; with `one_each` ``[frames, 1]``.
    one_each : bool
        Each frame is one colour and stays by itself.
    workspace : Workspace, optional
        Memory for the result. The backward pass then writes the field's gradient over the field, which nothing else may
        need; it can be run once, before the workspace is used again, and not be differentiated.

    Returns
    -------
    torch.Tensor
        Σ_f power² · |field|², ``[planes, colours, rows, columns]``, differentiable any number of times in both. With
        `one_each` no sum: ``[planes, frames, rows, columns]``.

    Examples
    --------
    Two frames of amplitude 1, of which the second is shown at twice the amplitude, add up to 1² + 2²:

    >>> import torch
    >>> from odak.learn.wave import exposure
    >>> field = torch.ones(2, 1, 1, 4, 4, dtype=torch.complex64)
    >>> exposure(field, torch.tensor([[1.0], [2.0]]))[0, 0, 0, 0].item()
    5.0
    """
    one_each = _validate.flag("one_each", one_each)
    complex_tensor("field", field)
    if field.ndim != 5 or (one_each and field.shape[2] != 1):
        raise ValueError(
            f"field must be [frames, planes, colours (1 with one_each), rows, columns], got {list(field.shape)}"
        )
    power = tensor("power", power).to(field.real.dtype)
    _validate.shaped("power", power, f"[{field.shape[0]}, {field.shape[2]}] like field")
    _validate.one_device(field=field, power=power)
    _validate.instance("workspace", workspace, (Workspace, type(None)), "a Workspace or None")
    if one_each:
        # Colours of one frame.
        field, power = field.transpose(0, 2), power.mT
    return exposed(trainable(field), trainable(power), workspace)


def exposed(field: torch.Tensor, power: torch.Tensor, workspace: Workspace | None = None) -> torch.Tensor:
    """Return :func:`exposure` of fields and amplitudes of the sources that have been checked, and are of one dtype."""
    if is_transformed(field, power):
        return (intensity(field) * power.square()[:, None, :, None, None]).sum(0)
    return _exposure(field.resolve_conj(), power, workspace)


def _lists_as_tensors(core, wavelength, **arguments):
    _validate.real("wavelength", wavelength, positive=True)
    wavelength = (
        tensor("wavelength", wavelength, torch.float64) if isinstance(wavelength, (list, tuple)) else wavelength
    )
    return core(wavelength, **arguments)


def _one_tensor(core, amplitude, phase) -> torch.Tensor:
    if not isinstance(amplitude, torch.Tensor) and not isinstance(phase, torch.Tensor):
        phase = torch.tensor(float(phase))
    return core(amplitude, phase)


if not TYPE_CHECKING:
    wavenumber = torch_face(fields.wavenumber, through=_lists_as_tensors)
    rotationspeed = torch_face(fields.rotationspeed, through=_lists_as_tensors)
    normalize_phase = torch_face(fields.normalize_phase, tensors=("phase",))
    generate_complex_field = torch_face(fields.generate_complex_field, through=_one_tensor)


def set_amplitude(field: torch.Tensor, amplitude: float | torch.Tensor) -> torch.Tensor:
    """Return amplitude·exp(i·arg field), a field with its phase kept and its amplitude replaced.

    Parameters
    ----------
    field : torch.Tensor
        Complex field.
    amplitude : float or torch.Tensor
        New amplitude; a negative one changes the phase by π.

    Returns
    -------
    torch.Tensor
        Complex field.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import set_amplitude
    >>> [round(value, 6) for value in set_amplitude(torch.tensor([3j, -4j]), 2.0).imag.tolist()]
    [2.0, -2.0]
    """
    field = _validate.array("field", field)
    if _array.is_array(amplitude):
        _validate.fitting(field=field, amplitude=amplitude)
    return generate_complex_field(amplitude, fields.calculate_phase(field))


def produce_phase_only_slm_pattern(
    hologram: torch.Tensor,
    slm_range: float,
    bits: int = 8,
    default_range: float | None = None,
    illumination: torch.Tensor | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the field of a hologram quantised for a phase-only modulator, and its integer levels.

    Parameters
    ----------
    hologram : torch.Tensor
        Complex hologram ``[..., rows, columns]``; its phase is what counts.
    slm_range : float
        Phase range of the modulator in radians: level ℓ shows ℓ/2^bits·slm_range. The phase is wrapped by 2π; below
        2π, a phase beyond the range takes its nearer end.
    bits : int, default: 8
        Bits per pixel, 1 to 16.
    default_range : float, optional
        Phase range, in radians, over which the levels are spread when the field is rebuilt from them: by default
        `slm_range`, or 6.28, as in earlier versions, where `slm_range` is 2π to three digits.
    illumination : torch.Tensor, optional
        Amplitude of the light on the modulator; ones by default.

    Returns
    -------
    tuple of torch.Tensor
        Complex field illumination·exp(i·level/2^bits·default_range) and the levels, int32, 0 … 2^bits − 1.

    See Also
    --------
    odak.wave.produce_phase_only_slm_pattern : The same for arrays, which can save the pattern too.

    Examples
    --------
    With 2 bits the phases 0 and π are the levels 0 and 2:

    >>> import torch
    >>> from odak.learn.wave import produce_phase_only_slm_pattern
    >>> hologram = torch.tensor([[1 + 0j, -1 + 0j]])
    >>> field, levels = produce_phase_only_slm_pattern(hologram, 2 * torch.pi, bits=2, default_range=2 * torch.pi)
    >>> levels.tolist(), [round(value, 6) for value in field[0].real.tolist()]
    ([[0, 2]], [1.0, -1.0])
    """
    return fields.produce_phase_only_slm_pattern(hologram, slm_range, None, bits, default_range, illumination)


class _UnitPhasor(torch.autograd.Function):
    """d exp(iφ) = i·exp(iφ)·dφ, from the field itself: no sine is computed twice."""

    generate_vmap_rule = True

    @staticmethod
    def forward(phase):
        return torch.complex(torch.cos(phase), torch.sin(phase))

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(output)
        ctx.save_for_forward(output)

    @staticmethod
    def backward(ctx, gradient):
        (field,) = ctx.saved_tensors
        return gradient.imag * field.real - gradient.real * field.imag

    @staticmethod
    def jvp(ctx, tangent):
        (field,) = ctx.saved_tensors
        return 1j * field * tangent


_unit_phasor = operator(_UnitPhasor)


class _Intensity(torch.autograd.Function):
    """d|u|² = 2·Re(conj(u)·du)."""

    generate_vmap_rule = True

    @staticmethod
    def forward(field):
        return field.real.square().add_(field.imag.square())

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx, gradient):
        (field,) = ctx.saved_tensors
        return torch.view_as_complex(torch.view_as_real(field) * (2 * gradient).unsqueeze(-1))

    @staticmethod
    def jvp(ctx, tangent):
        (field,) = ctx.saved_tensors
        return 2 * (field.real * tangent.real + field.imag * tangent.imag)


_intensity = operator(_Intensity)


class _Exposure(torch.autograd.Function):
    """d Σ p²|u|² = Σ 2p²·Re(conj(u)·du) + Σ 2p·|u|²·dp, frame by frame: only the gradient is as large as the field."""

    @staticmethod
    def forward(field, power, workspace):
        frames, planes, *shape = field.shape
        total = allocate_like(workspace, "exposure", (planes, *shape), field.real)
        weights = power.square()
        # Plane by plane, so that intermediate results stay in the cache.
        for frame, plane in itertools.product(range(frames), range(planes)):
            own, weight = field[frame, plane], weights[frame, :, None, None]
            light = own.real.square().addcmul_(own.imag, own.imag)
            if frame == 0:
                torch.mul(light, weight, out=total[plane])
            else:
                total[plane].addcmul_(light, weight)
        return total

    @staticmethod
    def setup_context(ctx, inputs, output):
        field, power, workspace = inputs
        consume = workspace is not None
        ctx.consumed = field if consume else None
        ctx.save_for_backward(*([] if consume else [field]), power)

    @staticmethod
    def backward(ctx, gradient):
        *saved, power = ctx.saved_tensors
        field, ctx.consumed = saved[0] if saved else ctx.consumed, None
        if field is None or (not saved and torch.is_grad_enabled()):
            raise RuntimeError("the fields were overwritten: exposure(..., workspace=) has one backward pass")
        to_field = to_power = None
        if ctx.needs_input_grad[1]:
            to_power = 2 * power * torch.stack([_overlap(frame, gradient) for frame in field])
        if ctx.needs_input_grad[0]:
            to_field = _slope(field, gradient, power, None if saved else field)
        return to_field, to_power, None


_exposure = operator(_Exposure)


def _slope(field, gradient, power, result=None):
    """Return 2p²·g·u, in the memory of `result` if given."""
    if torch.is_grad_enabled():
        return field * (gradient * (2 * power.square())[:, None, :, None, None])
    result = torch.empty_like(field) if result is None else result.detach()
    weights = 2 * power.square()
    for frame, plane in itertools.product(*map(range, field.shape[:2])):
        factor = (gradient[plane] * weights[frame, :, None, None])[..., None]
        torch.mul(torch.view_as_real(field[frame, plane]), factor, out=torch.view_as_real(result[frame, plane]))
    return result


def _overlap(field, slope):
    return sum((intensity(plane) * own).sum((-2, -1)) for plane, own in zip(field, slope, strict=True))


def disc(shape: Sequence[int], radius: float, offset: Sequence[float] = (0.0, 0.0)) -> torch.Tensor:
    """Return ones closer than `radius` to a point, zeros elsewhere, float32 ``[rows, columns]``.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    radius : float
        In samples.
    offset : tuple of float
        Distance of the point from sample n // 2 of each axis.
    """
    rows, columns = (
        torch.arange(n, dtype=torch.float64) - n // 2 - shift for n, shift in zip(shape, offset, strict=True)
    )
    return (rows[:, None] ** 2 + columns**2 < radius**2).float()
