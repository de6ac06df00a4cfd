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
