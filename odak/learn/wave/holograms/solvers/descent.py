"""Gradient descent over the phases of a hologram. Touches a problem by its loss."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch

from odak import _validate
from odak.learn.tools.iterations import minimise
from odak.learn.wave.camera import captured_by, with_model_gradient
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.training import REGISTER, cosine, fingerprint, recorded, seeded_loss


@dataclass(frozen=True)
class Descent:
    """Gradient descent over the phases, by L-BFGS or Adam: the solver to begin with.

    Use L-BFGS unless the loss changes from one iteration to the next, as with random numbers in it or a camera.

    Parameters
    ----------
    method : {"lbfgs", "adam"}
        The method; see :func:`odak.learn.wave.stochastic_gradient_descent`.
    learning_rate : float
        Step of Adam in radians, which falls to a half along a cosine.
    powers : bool
        Find the powers of the sources in each frame too, beginning with the display's own; a source that is off in
        a frame stays off. With ``powers=torch.ones(F, C)`` in the display all colours share all frames (Kavaklı et al.,
        Multi-color holograms improve brightness in holographic displays, SIGGRAPH Asia 2023).
    graph : bool
        Record the loss and its gradient as one CUDA graph and replay it in each iteration: one launch instead of some
        hundred kernels, which is faster for small displays on a GPU. The loss must depend on the images and the target
        alone and read no number from the device.
    camera : callable, optional
        ``camera(phases)`` shows phases ``[rows, columns]`` on the real display and returns the intensity it captures,
        of the same shape, such as :class:`odak.learn.wave.simulated_camera`. The loss is then that of the captured
        image, its gradient that of the display (camera in the loop), for one frame of one colour on one plane, by Adam.
        The phases of the lowest loss are returned.

    Warns
    -----
    ConvergenceWarning
        If the loss with a camera has risen since it was lowest.

    Examples
    --------
    >>> from odak.learn.wave import Descent
    >>> Descent("adam").learning_rate
    0.1
    """

    method: str = "lbfgs"
    learning_rate: float = 0.1
    powers: bool = False
    # No part of the text by which a checkpoint is recognised: the results are the same.
    graph: bool = field(default=False, repr=False)
    camera: Callable[[torch.Tensor], torch.Tensor] | None = field(default=None, repr=False)

    def solve(self, problem: Problem) -> torch.Tensor | tuple[torch.Tensor | None, ...]:
        """Return the phases of a problem, ``[F, rows, columns]``, or with the powers ``[F, C]`` and the amplitudes.

        Powers are None where they are not to be found, and amplitudes are left out without a panel in front.
        """
        if self.method == "lbfgs" and problem.display.path.jitter:
            raise ValueError(
                "method must be 'adam' for distances with jitter, whose loss changes from step to step; got 'lbfgs'"
            )
        if self.camera is not None and (problem.display.frames, *problem.target.shape[:2]) != (1, 1, 1):
            raise ValueError(f"camera must be None but for one frame, plane and colour, got {self.camera!r:.80}")
        phases, run = problem.start.clone().requires_grad_(), problem.run
        learned, powers = {"phase": phases}, problem.display.powers
        # The slope along a phase falls with the number of pixels, that along the amplitude of a source does not; these
        # units make them alike. Adam takes the same step in all.
        unit = math.sqrt(powers.numel() / phases.numel()) if self.method == "lbfgs" else 1.0
        if self.powers:
            learned["amplitude"] = (powers.sqrt() / unit).to(phases.dtype).requires_grad_()
        if problem.display.modulator.lit_through is not None:
            # Amplitudes are squares of sines, between 0 and 1; they begin at 0.75.
            learned["turn"] = torch.full_like(problem.start, math.pi / 3).requires_grad_()
        loss, drawn_from = seeded_loss(problem.loss, run.seed, phases.device)
        problem = replace(problem, loss=loss)
        # Not the random numbers of the start, nor those of the loss.
        drawn_from = [*drawn_from, *problem.display._seeded((run.seed + 2) % 2**62)]

        def found():
            return (unit * learned["amplitude"]).square() if self.powers else None

        def attenuation():
            return learned["turn"].sin().square() if "turn" in learned else None

        def value():
            if self.camera is not None:
                image = problem.display(phases)
                captured = captured_by(self.camera, phases[0], problem.target.shape[2:])[None, None]
                return problem.loss_of_images(with_model_gradient(image, captured))
            return problem.loss_of(phases, found(), attenuation())

        if self.graph and (drawn_from or problem.display.shares or self.camera is not None):
            what = "random numbers are drawn" if drawn_from else "parts of the picture are computed apart or captured"
            raise ValueError(f"graph must be False where {what}, got True")
        evaluate = recorded(value, list(learned.values())) if self.graph else value
        rate = cosine(self.learning_rate, self.learning_rate / 2, run.iterations)
        display, given = problem.display, (problem.target, problem.start)
        minimise(
            learned,
            lambda iteration: evaluate(),
            rate,
            run,
            solver=self.method,
            about=lambda: {"solver": repr(self), "display": display.fingerprint(), "target": fingerprint(*given)},
            generators=drawn_from,
            rising=None if self.camera is None else REGISTER,
        )
        powers = found().detach() if self.powers else None
        if "turn" in learned:
            return phases.detach(), powers, attenuation().detach()
        return phases.detach() if powers is None else (phases.detach(), powers)

    def __post_init__(self) -> None:
        object.__setattr__(self, "method", _validate.one_of("method", self.method, ("lbfgs", "adam")))
        _validate.flag("powers", self.powers)
        _validate.flag("graph", self.graph)
        _validate.real("learning_rate", self.learning_rate, positive=True)
        if _validate.function_or_none("camera", self.camera) is not None and self.method != "adam":
            raise ValueError(f"method must be 'adam' with a camera, whose captures have noise, got {self.method!r}")
