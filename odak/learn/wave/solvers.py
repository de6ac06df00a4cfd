"""Adam and L-BFGS for hologram optimizers: a step, and a state that a checkpoint can hold."""

from collections.abc import Callable, Sequence

import torch

SOLVERS = ("adam", "lbfgs")


def make_solver(name: str, parameters: Sequence[torch.Tensor]):
    """Return the solver of that name ("adam" or "lbfgs") for some leaf tensors."""
    return {"adam": Adam, "lbfgs": LBFGS}[name](parameters)


class Adam:
    """Adam (Kingma and Ba, 2015, algorithm 1).

    ``torch.optim.Adam`` does the same, but its constructor loads the compiler: two seconds and 80 MB, as much as
    twenty iterations at full size and more memory than the hologram's padded field. Weights do not decay: a phase is
    no better for being near zero.

    Parameters
    ----------
    parameters : sequence of torch.Tensor
        Leaf tensors that require grad.
    betas : tuple of float
        Memory of the mean and of the square of the gradient.
    epsilon : float
        Added to the root of the square.
    """

    def __init__(self, parameters: Sequence[torch.Tensor], betas=(0.9, 0.999), epsilon: float = 1e-8):
        self.parameters, self.betas, self.epsilon = list(parameters), betas, epsilon
        self.means = [torch.zeros_like(parameter, requires_grad=False) for parameter in self.parameters]
        self.squares = [torch.zeros_like(mean) for mean in self.means]
        self.count = 0

    @torch.no_grad()
    def step(self, gradient: Callable[[], torch.Tensor], learning_rate: float) -> torch.Tensor:
        """Take one step and return the loss before it; `gradient()` returns that and fills the parameters' ``grad``."""
        loss = gradient()
        count = self.count + 1
        mean_bias, square_bias = (1 - beta**count for beta in self.betas)
        for parameter, mean, square in zip(self.parameters, self.means, self.squares, strict=True):
            slope = parameter.grad
            if slope is None:
                continue
            mean.lerp_(slope, 1 - self.betas[0])
            square.mul_(self.betas[1]).addcmul_(slope, slope, value=1 - self.betas[1])
            # The gradient's memory is done with, so the denominator takes its place.
            denominator = torch.sqrt(square, out=slope).div_(square_bias**0.5).add_(self.epsilon)
            parameter.addcdiv_(mean, denominator, value=-learning_rate / mean_bias)
        self.count = count
        return loss

    def state(self) -> dict:
        """Return what the next step depends on besides the parameters."""
        return {"means": self.means, "squares": self.squares, "count": self.count}

    def load(self, state: dict) -> None:
        """Take over a state that :meth:`state` returned."""
        for have, given in zip((*self.means, *self.squares), (*state["means"], *state["squares"]), strict=True):
            have.copy_(given)
        self.count = state["count"]


class LBFGS:
    """L-BFGS with a strong-Wolfe line search, one iteration a step; it chooses its own step length.

    torch's solver forgets a step whose y·s is below 1e-10. The mean over a million pixels makes it that small, so the
    solver is given the sum, and the caller the mean again.

    Parameters
    ----------
    parameters : sequence of torch.Tensor
        Leaf tensors that require grad.
    """

    def __init__(self, parameters: Sequence[torch.Tensor]):
        self.parameters = list(parameters)
        self.pixels = sum(parameter.numel() for parameter in self.parameters)
        self.solver = torch.optim.LBFGS(
            self.parameters, lr=1, max_iter=1, tolerance_grad=0, tolerance_change=0, line_search_fn="strong_wolfe"
        )

    def step(self, gradient: Callable[[], torch.Tensor], learning_rate: float) -> torch.Tensor:
        """Take one step and return the loss before it; the learning rate does not matter."""

        def summed():
            loss = gradient()
            for parameter in self.parameters:
                parameter.grad.mul_(self.pixels)
            return self.pixels * loss

        return self.solver.step(summed).detach() / self.pixels

    def state(self) -> dict:
        """Return what the next step depends on besides the parameters."""
        return self.solver.state_dict()

    def load(self, state: dict) -> None:
        """Take over a state that :meth:`state` returned, but not how many evaluations a step may take."""
        settings = [
            {key: value for key, value in group.items() if key != "params"} for group in self.solver.param_groups
        ]
        self.solver.load_state_dict(state)
        for group, own in zip(self.solver.param_groups, settings, strict=True):
            group.update(own)
