"""What to do when the memory of a GPU is not enough, said where it happens."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def advising_on_memory(advice: str) -> Iterator[None]:
    """Add a sentence of advice to the error that torch raises when a GPU has no memory left.

    Parameters
    ----------
    advice : str
        What takes less memory, such as "use fewer planes".

    Raises
    ------
    torch.OutOfMemoryError
        The same kind of error, torch's own text after the advice.
    """
    try:
        yield
    except torch.cuda.OutOfMemoryError as error:
        raise torch.cuda.OutOfMemoryError(
            f"The memory of the GPU is not enough; {advice}. torch says: {error}"
        ) from error
