"""Phase to field and field to intensity, with backward passes that touch each array once."""

import torch
from torch.autograd.function import once_differentiable


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
    """
    return _UnitPhasor.apply(phase)


def intensity(field: torch.Tensor) -> torch.Tensor:
    """Return |field|², real, in the field's precision; differentiable any number of times, also at zero."""
    return _Intensity.apply(field)


def exposure(
    field: torch.Tensor, power: torch.Tensor, one_each: bool = False, *, consume: bool = False
) -> torch.Tensor:
    """Return the light that the frames of a field, shown one after another, leave on each plane and colour.

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[frames, planes, colours, rows, columns]``; with `one_each` ``[frames, planes, 1, rows, columns]``.
    power : torch.Tensor
        Amplitude of the light source ``[frames, colours]``; with `one_each` ``[frames, 1]``.
    one_each : bool
        Each frame is one colour and stays by itself.
    consume : bool
        Let the backward pass write the field's gradient over the field, which nothing else may need. It can then be
        run once, and not be differentiated.

    Returns
    -------
    torch.Tensor
        Σ_f power² · |field|², ``[planes, colours, rows, columns]``, differentiable any number of times in both. With
        `one_each` no sum: ``[planes, frames, rows, columns]``.
    """
    return _Exposure.apply(field, power, one_each, consume)


def squared_error(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return Σ (image − target)², in one array instead of three; the backward pass can be run once."""
    return _SquaredError.apply(image, target)


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


class _SquaredError(torch.autograd.Function):
    """d Σ e² = 2·Σ e·de."""

    @staticmethod
    def forward(ctx, image, target):
        ctx.error = image - target
        return torch.dot(ctx.error.flatten(), ctx.error.flatten())

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        error, ctx.error = ctx.error, None
        if error is None:
            raise RuntimeError("squared_error has one backward pass: its error became the gradient")
        slope = error.mul_(2 * gradient)
        return slope, -slope if ctx.needs_input_grad[1] else None


class _Exposure(torch.autograd.Function):
    """d Σ p²|u|² = Σ 2p²·Re(conj(u)·du) + Σ 2p·|u|²·dp, frame by frame: only the slope is as large as the field."""

    @staticmethod
    def forward(field, power, one_each, consume):
        frames, planes, colours, *shape = field.shape
        total = field.real.new_empty(planes, frames if one_each else colours, *shape)
        for index, weight in enumerate(power.square()):
            place = total[:, index : index + 1] if one_each else total
            light = field[index].real.square().addcmul_(field[index].imag, field[index].imag)
            if one_each or index == 0:
                torch.mul(light, weight[:, None, None], out=place)
            else:
                place.addcmul_(light, weight[:, None, None])
        return total

    @staticmethod
    def setup_context(ctx, inputs, output):
        field, power, ctx.one_each, consume = inputs
        ctx.consumed = field if consume else None
        ctx.save_for_backward(*([] if consume else [field]), power)

    @staticmethod
    def backward(ctx, gradient):
        *saved, power = ctx.saved_tensors
        field, ctx.consumed = saved[0] if saved else ctx.consumed, None
        if field is None or (not saved and torch.is_grad_enabled()):
            raise RuntimeError("the fields were consumed: exposure(..., consume=True) has one backward pass")
        to_field = to_power = None
        if ctx.needs_input_grad[1]:
            to_power = 2 * power * _collected(field, gradient, ctx.one_each)
        if ctx.needs_input_grad[0]:
            to_field = _slope(field, gradient, power, ctx.one_each, None if saved else field)
        return to_field, to_power, None, None


def _slope(field, gradient, power, one_each, result=None):
    """Return 2p²·g·u, in the memory of `result` if given."""
    if torch.is_grad_enabled():
        own = gradient.transpose(0, 1)[:, :, None] if one_each else gradient[None]
        return field * (own * (2 * power.square())[:, None, :, None, None])
    result = torch.empty_like(field) if result is None else result.detach()
    for index, weight in enumerate(2 * power.square()):
        own = gradient[:, index : index + 1] if one_each else gradient
        parts = (torch.view_as_real(array[index]) for array in (field, result))
        torch.mul(next(parts), (own * weight[:, None, None])[..., None], out=next(parts))
    return result


def _collected(field, gradient, one_each):
    """Return Σ g·|u|² over planes and pixels, ``[frames, colours]``."""
    own = (gradient[:, index : index + 1] if one_each else gradient for index in range(len(field)))
    return torch.stack([(intensity(frame) * slope).sum((0, 2, 3)) for frame, slope in zip(field, own, strict=True)])
