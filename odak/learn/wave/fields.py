"""Phase to field and field to intensity, with backward passes that touch each array once."""

import torch


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


def exposure(field: torch.Tensor, power: torch.Tensor) -> torch.Tensor:
    """Return the light that the frames of a field, shown one after another, leave on each plane and colour.

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[frames, planes, colours, rows, columns]``.
    power : torch.Tensor
        Amplitude of the light source ``[frames, colours]``.

    Returns
    -------
    torch.Tensor
        Σ_f power² · |field|², ``[planes, colours, rows, columns]``; differentiable any number of times in both.
    """
    return _Exposure.apply(field, power)


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


class _Exposure(torch.autograd.Function):
    """d Σ p²|u|² = Σ 2p²·Re(conj(u)·du) + Σ 2p·|u|²·dp, frame by frame: only the slope is as large as the field."""

    @staticmethod
    def forward(field, power):
        total = field.real.new_zeros(field.shape[1:])
        for frame, weight in zip(field, power.square(), strict=True):
            total.addcmul_(frame.real.square().addcmul_(frame.imag, frame.imag), weight[:, None, None])
        return total

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs)

    @staticmethod
    def backward(ctx, gradient):
        field, power = ctx.saved_tensors
        to_field = to_power = None
        if ctx.needs_input_grad[0]:
            slope = gradient * (2 * power.square())[:, None, :, None, None]
            to_field = torch.view_as_complex(torch.view_as_real(field) * slope.unsqueeze(-1))
        if ctx.needs_input_grad[1]:
            collected = [(intensity(frame) * gradient).sum((0, 2, 3)) for frame in field]
            to_power = 2 * power * torch.stack(collected)
        return to_field, to_power
