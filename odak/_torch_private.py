"""Access to the private interface of torch: transforms that are running, and the state of single tensors."""

import sys
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import cache, wraps
from typing import Any, ClassVar, TypeVar

import torch
from torch.overrides import TorchFunctionMode

F = TypeVar("F", bound=Callable[..., Any])


def has_compiler() -> bool:
    """Return whether torch.compile has been used or may be in use: its module takes seconds to load."""
    return "torch._dynamo" in sys.modules


def is_wrapped(*tensors: torch.Tensor) -> bool:
    """Return whether torch.func (vmap, grad, jvp, …) wraps any of the tensors, whose values cannot be read then."""
    return any(map(torch._C._functorch.is_functorch_wrapped_tensor, tensors))


def in_functional_transform() -> bool:
    """Return whether a transform of torch.func is running, for any tensors."""
    return torch._C._functorch.peek_interpreter_stack() is not None


def as_constant(tensor: torch.Tensor) -> torch.Tensor:
    """Return the tensor that grad, jvp or another transform of torch.func wraps, without its derivatives."""
    while torch._C._functorch.is_gradtrackingtensor(tensor):
        tensor = torch._C._functorch.get_unwrapped(tensor)
    return tensor


def outside_functional_transforms(*tensors: torch.Tensor) -> AbstractContextManager:
    """Return a context in which no transform of torch.func is running, unless one wraps a tensor.

    What is computed there from these tensors, with derivatives of its own, is a constant to the transforms.
    """
    if is_wrapped(*tensors) or not in_functional_transform():
        return nullcontext()
    from torch._functorch.pyfunctorch import temporarily_clear_interpreter_stack

    return temporarily_clear_interpreter_stack()


def in_forward_mode() -> bool:
    """Return whether forward-mode differentiation is running."""
    return torch.autograd.forward_ad._current_level >= 0 and torch._C._is_fwd_grad_enabled()


def without_derivatives() -> AbstractContextManager:
    """Return a context without derivatives and transforms, for a computation that none of them wraps a tensor of."""
    contexts = ExitStack()
    contexts.enter_context(torch.no_grad())
    contexts.enter_context(torch.autograd.forward_ad._set_fwd_grad_enabled(False))
    contexts.enter_context(outside_functional_transforms())
    return contexts


def is_transformed(*tensors: torch.Tensor) -> bool:
    """Return whether torch.compile or forward-mode differentiation is running, or torch.func wraps a tensor.

    Operators with a custom autograd.Function, and cached values, cannot be used there.
    """
    compiled = has_compiler() and torch.compiler.is_compiling()
    return compiled or in_forward_mode() or (bool(tensors) and is_wrapped(*tensors))


def operator(function: type[torch.autograd.Function]) -> Callable[..., Any]:
    """Return ``function.apply``, without what only torch.func and forward mode ask for where neither is running.

    There torch looks up the signature of `function.forward` at each call, since its context is set up apart: longer
    than the transforms of a small field.
    """

    def forward(ctx, *inputs):
        output = function.forward(*inputs)
        function.setup_context(ctx, inputs, output)
        return output

    rules = {"forward": staticmethod(forward), "backward": staticmethod(function.backward)}
    recorded: Any = type(function.__name__, (torch.autograd.Function,), rules)

    def apply(*inputs):
        # The compiler follows no function that has a rule for forward mode.
        if not torch.compiler.is_compiling() and (in_forward_mode() or in_functional_transform()):
            return function.apply(*inputs)
        return recorded.apply(*inputs)

    return apply


class _Linear(torch.autograd.Function):
    """A linear map or its adjoint, of tensors of which some may be None; each is the other's gradient."""

    @staticmethod
    def forward(kind, adjoint, *values):
        return kind.adjoint(*values) if adjoint else kind.forward(*values)

    @staticmethod
    def setup_context(context, inputs, output):
        context.kind, context.adjoint = inputs[:2]
        context.set_materialize_grads(False)

    @staticmethod
    def backward(context, *gradients):
        if all(one is None for one in gradients):
            return (None,) * len(context.needs_input_grad)
        found = linear(context.kind, not context.adjoint, *gradients)
        found = found if isinstance(found, tuple) else (found,)
        wanted = context.needs_input_grad[2:]
        return None, None, *(one if needed else None for one, needed in zip(found, wanted, strict=True))

    @staticmethod
    def jvp(context, _, __, *tangents):
        return linear(context.kind, context.adjoint, *tangents)

    @staticmethod
    def vmap(info, in_dims, kind, adjoint, *values):
        count, dims = info.batch_size, in_dims[2:]
        first = [
            value if value is None else value.expand(count, *value.shape) if dim is None else value.movedim(dim, 0)
            for value, dim in zip(values, dims, strict=True)
        ]
        if hasattr(kind, "over"):
            return kind.over(count, adjoint, *first), 0
        found = linear(kind, adjoint, *(value if value is None else value.flatten(0, 1) for value in first))
        several = found if isinstance(found, tuple) else (found,)
        parts = tuple(one.unflatten(0, (count, len(one) // count)) for one in several)
        return (parts, (0,) * len(parts)) if isinstance(found, tuple) else (*parts, 0)


_linear = operator(_Linear)


def linear(kind: Any, adjoint: bool, *values: torch.Tensor | None) -> Any:
    """Return what a linear map makes of tensors, or its adjoint; differentiable in them any number of times.

    Parameters
    ----------
    kind : object
        What has methods `forward` and `adjoint` of tensors, whose first axis is a batch: torch.func.vmap makes it a
        longer one. Where it is none, a method ``over(count, adjoint, *values)`` takes tensors with an axis of `count`
        in front.
    adjoint : bool
        Whether the adjoint is wanted.
    *values : torch.Tensor or None
        Tensors; None for those that are zero.
    """
    if torch.is_grad_enabled() or torch.compiler.is_compiling() or in_forward_mode() or in_functional_transform():
        return _linear(kind, adjoint, *values)
    return kind.adjoint(*values) if adjoint else kind.forward(*values)


def is_plain_on_cpu(tensor: torch.Tensor) -> bool:
    """Return whether a tensor is on a CPU, without a transform, forward-mode derivative or compiler."""
    # Not the tensor alone: those beside one that is vmapped take part in the same operations.
    return tensor.is_cpu and not (is_transformed() or in_functional_transform())


def takes_operators(*tensors: torch.Tensor) -> bool:
    """Return whether an autograd.Function with a rule for forward mode may take the tensors.

    So it may if nothing transforms them, or nothing but torch.func.vmap and a single torch.func.jvp.
    """
    if not is_transformed(*tensors):
        return True
    if torch.compiler.is_compiling() or not in_functional_transform():
        return False
    kinds = [level.key() for level in torch._C._functorch.get_interpreter_stack() or ()]
    transforms = torch._C._functorch.TransformType
    if transforms.Jvp in kinds and torch.is_grad_enabled() and any(as_constant(t).requires_grad for t in tensors):
        # Rules for forward mode have no graph: the result would lack the derivatives of a derivative.
        return False
    return kinds.count(transforms.Jvp) <= 1 and set(kinds) <= {transforms.Jvp, transforms.Vmap}


def forward_derivative(function: Callable, at: torch.Tensor, direction: torch.Tensor, *, has_aux: bool = False) -> Any:
    """Return what ``torch.func.jvp(function, (at,), (direction,))`` does, several times faster.

    Where a number or tensor that is constant meets one that is not, torch takes a tensor without memory for its
    derivative, and looks up the shape of each sum and product with that in Python, which takes 0.2 ms. Here constants
    have zeros for it.
    """
    _load_forward_rules()
    if torch.compiler.is_compiling():
        return torch.func.jvp(function, (at,), (direction,), has_aux=has_aux)

    def with_zeros(value):
        with _Zeros():
            return function(value)

    return torch.func.jvp(with_zeros, (at,), (direction,), has_aux=has_aux)


@cache
def _load_forward_rules() -> None:
    """Load the forward derivatives that torch writes in Python, without the warning of torch's own that this raises."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import torch._decomp.decompositions_for_jvp  # noqa: F401


class _Zeros(TorchFunctionMode):
    """Gives constants in sums and products with differentiated tensors a derivative, zeros."""

    FUNCTIONS: ClassVar = {
        getattr(owner, name) for owner in (torch, torch.Tensor) for name in ("add", "sub", "mul", "div")
    } | {torch.Tensor.__rdiv__}
    DTYPES = (torch.float32, torch.float64, torch.complex64, torch.complex128)
    SIZE = 2**15  # to add the zeros of larger tensors takes longer

    def __torch_function__(self, function, types, args=(), kwargs=None):
        if function in self.FUNCTIONS and len(args) == 2 and not kwargs:
            one, other = args
            differs = self.differs(one), self.differs(other)
            if differs == (True, False):
                args = one, self.constant(other, one)
            elif differs == (False, True):
                args = self.constant(one, other), other
        return function(*args, **(kwargs or {}))

    def differs(self, value):
        """Return whether a value has a derivative."""
        if not isinstance(value, torch.Tensor) or not torch._C._functorch.is_gradtrackingtensor(value):
            return False
        return torch.autograd.forward_ad.unpack_dual(value).tangent is not None

    def constant(self, value, like):
        """Return a constant, with a derivative where a tensor like the other needs one."""
        if like.dtype not in self.DTYPES or like.numel() > self.SIZE:
            return value
        if type(value) in (int, float):
            value = torch.full((), value, dtype=like.dtype, device=like.device)
        elif not isinstance(value, torch.Tensor) or value.dtype not in self.DTYPES or value.numel() > self.SIZE:
            return value
        value = value.contiguous()  # of an expanded tensor each sample needs a place for its derivative
        return torch.autograd.forward_ad.make_dual(value, torch.zeros_like(value))


def keeping() -> AbstractContextManager:
    """Return a context in which a tensor is made that later calls use too: one with values, which takes gradients.

    In inference mode a tensor could not take part in gradients later, and while torch.export records a call, tensors
    have no values: one that is kept would falsify each call that comes after.
    """
    stack = torch.inference_mode(False)
    if torch.compiler.is_dynamo_compiling() or not is_recording():
        return stack
    from torch.utils._python_dispatch import _disable_current_modes

    contexts = ExitStack()
    contexts.enter_context(stack)
    contexts.enter_context(_disable_current_modes())
    return contexts


def differentiates(function: F) -> F:
    """Return a function that takes derivatives itself, and so must leave the inference mode of its caller.

    In that mode nothing is recorded: gradients would be missing, in silence or with an error of autograd's own. Tensors
    that were made in it are copied, since they can take no part in gradients.
    """

    @wraps(function)
    def run(*args, **options):
        if not torch.is_inference_mode_enabled():
            return function(*args, **options)
        from torch.utils._pytree import tree_map

        with torch.inference_mode(False), torch.no_grad():
            args, options = tree_map(_recordable, (args, options))
            return function(*args, **options)

    return run  # type: ignore[return-value]


def _recordable(value):
    """Return a tensor or module that autograd can record, in place of one made in inference mode."""
    if isinstance(value, torch.Tensor) and value.is_inference():
        return value.clone().requires_grad_(value.requires_grad)
    if hasattr(value, "__dict__") and _holds_inference_tensors(value):
        raise RuntimeError(
            f"{type(value).__name__} was made in inference mode, where its tensors cannot take part in gradients: make "
            "it outside of torch.inference_mode()"
        )
    return value


def _holds_inference_tensors(value, depth: int = 3) -> bool:
    """Return whether an object, or what it is made of, holds tensors that were made in inference mode."""
    from torch.utils._pytree import tree_leaves

    leaves = tree_leaves(value)
    if len(leaves) != 1 or leaves[0] is not value:
        return any(_holds_inference_tensors(leaf, depth) for leaf in leaves)
    if isinstance(value, torch.Tensor):
        return value.is_inference()
    return depth > 0 and _holds_inference_tensors(list(getattr(value, "__dict__", {}).values()), depth - 1)


def in_own_precision(function: F) -> F:
    """Return the function, run with torch.autocast off.

    Differences of nearly equal means, colours and coordinates need the digits that bfloat16 does not have; networks
    are what it is for.
    """

    @wraps(function)
    def careful(*args, **options):
        on = [kind for kind in ("cpu", "cuda") if torch.is_autocast_enabled(kind)]
        if not on:
            return function(*args, **options)
        with ExitStack() as stack:
            for kind in on:
                stack.enter_context(torch.autocast(kind, enabled=False))
            return function(*args, **options)

    return careful  # type: ignore[return-value]


product = in_own_precision(torch.matmul)


def spread_means(means: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Return the adjoint of ``adaptive_avg_pool2d`` of means ``[B, C, h, w]``: pixels ``[B, C, *size]``."""
    above = means.new_empty(*means.shape[:2], *size)
    return torch.ops.aten._adaptive_avg_pool2d_backward(means, above)


def kept_constant(tensor: torch.Tensor) -> torch.Tensor:
    """Return a kept tensor, contiguous while torch.export records, which warns of any other constant as it writes."""
    if torch.compiler.is_dynamo_compiling() or not is_recording():
        return tensor
    with keeping():
        return tensor.contiguous()


def is_recording() -> bool:
    """Return whether operations are recorded on tensors without values, as torch.export does."""
    return torch._C._get_dispatch_mode(torch._C._TorchDispatchModeKey.FAKE) is not None


def count_of_writes(tensor: torch.Tensor) -> int | None:
    """Return the number of times that operations in place have written to a tensor; None if torch does not count."""
    return None if tensor.is_inference() else tensor._version


def has_hooks(tensor: torch.Tensor) -> bool:
    """Return whether a tensor has hooks: functions that are called with its gradient."""
    return bool(tensor._backward_hooks)


def entries_of_sparse(tensor: torch.Tensor) -> list[torch.Tensor]:
    """Return indices and values of a tensor in coordinate format, whether or not they are coalesced."""
    return [tensor._indices(), tensor._values()]
