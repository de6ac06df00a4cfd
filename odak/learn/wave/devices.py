"""A batch of propagations spread over the GPUs of one machine: from one process, or with one process per GPU."""

import collections
import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist

from odak import _validate
from odak._torch_private import linear
from odak.learn._tensors import checked_device

Tensors = torch.Tensor | tuple[torch.Tensor, ...]


def across_devices(
    function: Callable[..., Tensors],
    batch: Tensors,
    *arguments: Any,
    devices: Sequence[torch.device | str | int] | None = None,
    **options: Any,
) -> Tensors:
    """Call a function with parts of a batch on several devices of this process, and join what it returns.

    CUDA devices work at the same time, since work is queued on them without waiting for it.

    Parameters
    ----------
    function : callable
        Called as ``function(part, *arguments, **options)``, such as :func:`odak.learn.wave.propagate_beam`. Each item
        of what it returns must depend on the same item of the batch alone. Of a `torch.nn.Module`, parameters and
        buffers are copied to each device.
    batch : torch.Tensor or tuple of torch.Tensor
        Split along the first axis into nearly equal parts; several tensors of the same length are passed one after
        another.
    *arguments, **options
        Passed to each call; tensors among them are copied to its device.
    devices : sequence, optional
        Devices to use, in order; all CUDA devices by default, the batch's own where there is none. A device may be
        named twice.

    Returns
    -------
    torch.Tensor or tuple of torch.Tensor
        As `function` returns it, on the device of the batch. Differentiable in the batch and in all tensors passed.

    Raises
    ------
    ValueError, TypeError
        If the batch has no first axis, its tensors differ in length, or there is no device.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import across_devices, propagate_beam
    >>> fields = torch.ones(5, 16, 16, dtype=torch.complex64)
    >>> across_devices(propagate_beam, fields, None, 1e-3, 8e-6, 532e-9, devices=["cpu", "cpu"]).shape
    torch.Size([5, 16, 16])
    """
    tensors, home = _checked(function, batch)
    where = _devices(devices, home)[: max(1, len(tensors[0]))]
    parts = zip(*(torch.tensor_split(tensor, len(where)) for tensor in tensors), strict=True)
    results = []
    for part, device in zip(parts, where, strict=True):
        copied = [_to(value, device) for value in (*part, *arguments)]
        own = {name: _to(value, device) for name, value in options.items()}
        results.append(_call(function, copied, own, lambda value, device=device: _to(value, device)))
    return _join(results, lambda pieces: torch.cat([piece.to(home) for piece in pieces]))


def across_ranks(
    function: Callable[..., Tensors],
    batch: Tensors,
    *arguments: Any,
    group: "torch.distributed.ProcessGroup | None" = None,
    device: torch.device | str | int | None = None,
    **options: Any,
) -> Tensors:
    """Call a function with parts of a batch in several processes, and give each of them all that it returns.

    Every process of a `torch.distributed` group calls this with the same arguments, computes its own part, and receives
    the parts of the others. Without such a group the function is simply called.

    Parameters
    ----------
    function : callable
        Called as ``function(part, *arguments, **options)``, such as :func:`odak.learn.wave.propagate_beam`. Each item
        of what it returns must depend on the same item of the batch alone.
    batch : torch.Tensor or tuple of torch.Tensor
        Split along the first axis into nearly equal parts; several tensors of the same length are passed one after
        another.
    *arguments
        Passed to each call.
    group : torch.distributed.ProcessGroup, optional
        Processes that take part; all of them by default.
    device : torch.device, optional
        Device of this process; by default the device of the batch.
    **options
        Passed to each call; tensors in the batch, the arguments and the options are copied to the device.

    Returns
    -------
    torch.Tensor or tuple of torch.Tensor
        As `function` returns it for the whole batch, on the device of the batch, the same in every process.

    Raises
    ------
    ValueError, TypeError
        If the batch has no first axis, is empty, or its tensors differ in length.

    Notes
    -----
    Differentiable in the batch, in all tensors passed, and in the parameters of a `torch.nn.Module`. Every process must
    go on to compute the same loss from the result and call ``backward``; each then holds the gradient of the whole
    batch. Tensors that the function takes from elsewhere get the gradient of this process's part alone.

    Examples
    --------
    Without a group of processes the function is called once, for the whole batch:

    >>> import torch
    >>> from odak.learn.wave import across_ranks, propagate_beam
    >>> fields = torch.ones(3, 16, 16, dtype=torch.complex64)
    >>> tuple(across_ranks(propagate_beam, fields, None, 1e-3, 8e-6, 532e-9).shape)
    (3, 16, 16)
    """
    tensors, home = _checked(function, batch)
    device = checked_device("device", device)
    if group is not None and not isinstance(group, getattr(dist, "ProcessGroup", ())):
        raise TypeError(f"group must be a torch.distributed.ProcessGroup or None, got {type(group).__name__}")
    if not dist.is_available() or not dist.is_initialized():
        return function(*tensors, *arguments, **options)
    group = dist.group.WORLD if group is None else group
    if not len(tensors[0]):
        raise ValueError("batch must not be empty where several processes share it")
    device = home if device is None else device

    def prepare(value: Any) -> Any:
        return _shared(_to(value, device), group)

    divided = _Divided(len(tensors[0]), group)
    part = [linear(divided, False, tensor.to(device)) for tensor in tensors]
    rows = len(part[0])
    if not rows:
        # A process without a part computes the first item, to determine the shape of the result.
        part = [torch.cat([own, tensor[:1].detach().to(device)]) for own, tensor in zip(part, tensors, strict=True)]
    shared = [prepare(value) for value in arguments]
    result = _call(function, [*part, *shared], {name: prepare(value) for name, value in options.items()}, prepare)
    return _join([result], lambda pieces: linear(divided, True, pieces[0][:rows]).to(home))


DISTRIBUTED = "distributed"


class Ranks:
    """The processes of `torch.distributed` that share a piece of work, and what they tell one another."""

    def __init__(self):
        if not dist.is_available() or not dist.is_initialized():
            raise ValueError(
                f"devices={DISTRIBUTED!r} needs a group of processes: start them with torchrun, and call "
                "torch.distributed.init_process_group first"
            )
        self.group: Any = dist.group.WORLD
        self.rank: int = dist.get_rank()
        self.size: int = dist.get_world_size()

    def sharing(self, value: torch.Tensor) -> torch.Tensor:
        """Return a tensor that all ranks use alike, whose gradient is the sum of theirs."""
        return _shared(value, self.group)

    def sum(self, value: torch.Tensor) -> torch.Tensor:
        """Return the sum over all ranks; each rank receives the gradient."""
        return linear(_Shared(self.group), True, value)

    def any(self, flag: bool, device: torch.device) -> bool:
        """Say whether a flag is set in any rank."""
        flags = torch.tensor(float(flag), device=device)
        dist.all_reduce(flags, group=self.group)
        return bool(flags)

    def each(self, work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """Return ``work(item)`` of all items, each computed by one rank and sent to all as a pickle.

        An exception in one rank ends the call in all of them, so that none waits for it.
        """
        own = shares_of(items, self.size)[self.rank]
        found, error = [], None
        try:
            found = [work(item) for item in own]
        except Exception as caught:  # sent to the others, and raised below
            error = caught
        everything: list[Any] = [None] * self.size
        dist.all_gather_object(everything, (found, None if error is None else repr(error)), group=self.group)
        if error is not None:
            raise error
        for rank, (_, failure) in enumerate(everything):
            if failure is not None:
                raise RuntimeError(f"rank {rank} of {self.size} failed: {failure}")
        return [result for results, _ in everything for result in results]


def used_devices(devices: Sequence[torch.device | str | int] | str, home: torch.device) -> list[torch.device] | Ranks:
    """Return checked devices, or the ranks where `devices` is "distributed"."""
    if isinstance(devices, str):
        if devices != DISTRIBUTED:
            raise ValueError(f"devices must be a sequence of devices or {DISTRIBUTED!r}, got {devices!r:.80}")
        return Ranks()
    return _devices(devices, home)


def on_devices(prepare: Callable[..., Any], items: Sequence[Any], devices: Sequence[torch.device]) -> list[Any]:
    """Return ``prepare(device)(item)`` of each item, in order; a thread for each device takes one when it is free."""
    waiting, results = collections.deque(enumerate(items)), [None] * len(items)

    def work(device):
        with torch.cuda.device(device) if device.type == "cuda" else nullcontext():
            function = prepare(device)
            while waiting:
                try:
                    number, item = waiting.popleft()
                except IndexError:  # another thread took the last one
                    return
                results[number] = function(item)

    if len(devices) == 1:
        work(devices[0])
        return results
    with ThreadPoolExecutor(len(devices), thread_name_prefix="odak") as pool:
        running = [pool.submit(work, device) for device in devices[: len(items)]]
        try:
            for thread in as_completed(running):
                thread.result()
        finally:
            # After an error or an interrupt nothing new is begun.
            waiting.clear()
    return results


def shares_of(items: Sequence[Any], count: int) -> list[Sequence[Any]]:
    """Return nearly equal shares of items, in order."""
    ends = [0]
    for size in _sizes(len(items), count):
        ends.append(ends[-1] + size)
    return [items[a:b] for a, b in itertools.pairwise(ends)]


def _checked(function: Callable[..., Any], batch: Tensors) -> tuple[tuple[torch.Tensor, ...], torch.device]:
    _validate.function("function", function)
    tensors = (batch,) if isinstance(batch, torch.Tensor) else tuple(batch) if isinstance(batch, (tuple, list)) else ()
    if not tensors or not all(isinstance(tensor, torch.Tensor) for tensor in tensors):
        raise TypeError(f"batch must be a tensor or a tuple of them, got {type(batch).__name__}")
    if any(tensor.ndim == 0 for tensor in tensors) or len({len(tensor) for tensor in tensors}) > 1:
        shapes = ", ".join(str(tuple(tensor.shape)) for tensor in tensors)
        raise ValueError(f"batch must have a first axis, of the same length for all its tensors; got {shapes}")
    return tensors, tensors[0].device


def _devices(devices, home: torch.device) -> list[torch.device]:
    if devices is None:
        return [torch.device("cuda", index) for index in range(torch.cuda.device_count())] or [home]
    _validate.listed("devices", devices, "a sequence of devices")
    found: list[torch.device] = [checked_device("devices", device) for device in devices]
    if not found:
        raise ValueError("devices must name at least one device")
    return found


def _to(value: Any, device: torch.device) -> Any:
    return value.to(device, non_blocking=True) if isinstance(value, torch.Tensor) else value


def _join(results: list[Any], join: Callable[[list[torch.Tensor]], torch.Tensor]) -> Tensors:
    if isinstance(results[0], torch.Tensor):
        return join(results)
    return tuple(join(list(pieces)) for pieces in zip(*results, strict=True))


def _call(function, arguments, options, prepare: Callable[..., torch.Tensor]) -> Tensors:
    """Call a function, or a module with its parameters and buffers prepared."""
    if not isinstance(function, torch.nn.Module):
        return function(*arguments, **options)
    state = {name: prepare(value) for name, value in (*function.named_parameters(), *function.named_buffers())}
    return torch.func.functional_call(function, state, tuple(arguments), options)


def _shared(value: Any, group) -> Any:
    return linear(_Shared(group), False, value) if isinstance(value, torch.Tensor) and value.requires_grad else value


def _rows(count: int, group) -> list[int]:
    """Return how many items each process computes."""
    return _sizes(count, dist.get_world_size(group))


def _sizes(count: int, parts: int) -> list[int]:
    whole, rest = divmod(count, parts)
    return [whole + (part < rest) for part in range(parts)]


def _own(tensor: torch.Tensor, group) -> torch.Tensor:
    rows, rank = _rows(len(tensor), group), dist.get_rank(group)
    return tensor.narrow(0, sum(rows[:rank]), rows[rank])


@dataclass(frozen=True)
class _Divided:
    """The linear map of a batch of `count` items to the part that this process computes; its adjoint joins them."""

    count: int
    group: Any

    def forward(self, batch):
        return _own(batch, self.group).clone()

    def adjoint(self, part):
        rows = _rows(self.count, self.group)
        plain = torch.view_as_real(part) if part.is_complex() else part
        own = plain.new_zeros(max(rows), *plain.shape[1:])
        own[: len(plain)] = plain
        parts = [torch.empty_like(own) for _ in rows]
        dist.all_gather(parts, own, group=self.group)
        whole = torch.cat([piece[:height] for piece, height in zip(parts, rows, strict=True)])
        return torch.view_as_complex(whole) if part.is_complex() else whole


@dataclass(frozen=True)
class _Shared:
    """The linear map of a tensor that all processes have to itself; its adjoint is the sum of theirs."""

    group: Any

    def forward(self, value):
        return value.view_as(value)

    def adjoint(self, value):
        total = value.clone(memory_format=torch.contiguous_format)
        dist.all_reduce(torch.view_as_real(total) if total.is_complex() else total, group=self.group)
        return total
