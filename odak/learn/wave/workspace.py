"""Memory for results that are made again and again."""

import math
from collections.abc import Sequence

import torch


class Workspace:
    """Memory for results that are made again and again: each takes the place of the one before of its name.

    Fresh memory is cleared page by page by the system, which takes as long as a transform.
    """

    def __init__(self):
        self._memory = {}

    def take(self, name: str, shape: Sequence[int], dtype: torch.dtype, device: torch.device) -> torch.Tensor:
        """Return a tensor of that shape; what it holds is left over."""
        held, count = self._memory.get(name), math.prod(shape)
        if held is None or held.dtype != dtype or held.device != device or held.numel() < count:
            # The old one goes first, or both would be there at once.
            held = self._memory[name] = None
            held = self._memory[name] = torch.empty(count, dtype=dtype, device=device)
        return held[:count].view(shape)


def room(workspace: Workspace | None, name: str, shape: Sequence[int], like: torch.Tensor) -> torch.Tensor:
    """Return memory of the dtype and on the device of `like`: from a workspace, or fresh without one."""
    if workspace is None:
        return like.new_empty(shape)
    return workspace.take(name, shape, like.dtype, like.device)
