"""The function that computes holograms for a display: it poses a problem, has it solved, and has the result judged."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any, overload

import torch

from odak import _validate
from odak._bars import tqdm
from odak._call_forms import takes_units
from odak._torch_private import differentiates, in_own_precision
from odak._warnings import AccuracyWarning, warn
from odak.learn.tools.iterations import Run
from odak.learn.wave.devices import DISTRIBUTED, Ranks, on_devices, used_devices
from odak.learn.wave.displays.display import Display
from odak.learn.wave.displays.judge import Comparison, judged
from odak.learn.wave.displays.observers import ANYWHERE, Observer, brightest, decibels, squared_errors
from odak.learn.wave.displays.parts import copied_to, shared_among, streamed
from odak.learn.wave.holograms.bounds import tell_bounds
from odak.learn.wave.holograms.problem import Problem, Solver
from odak.learn.wave.holograms.result import DisplayedHologram
from odak.learn.wave.holograms.scenery import Scenery
from odak.learn.wave.holograms.solvers.descent import Descent
from odak.learn.wave.holograms.solvers.double_phase import DoublePhase
from odak.learn.wave.holograms.solvers.levels import FEW_BITS, LevelSearch
from odak.learn.wave.holograms.solvers.network import Network
from odak.learn.wave.holograms.solvers.projections import AlternatingProjections
from odak.learn.wave.holograms.starts import named, starting_phases
from odak.learn.wave.holograms.targets import checked_target, focal_targets
from odak.learn.wave.loss import FocalTargets
from odak.learn.wave.training import brightness_of

SOLVERS: dict[str, Callable] = {
    "lbfgs": Descent,
    "adam": lambda: Descent("adam"),
    "gs": AlternatingProjections,
    "double phase": DoublePhase,
    "network": Network,
    "levels": LevelSearch,
}
# Loss of quality by rounding to levels, in decibels, of which is warned where a search over levels is possible.
_ROUNDED = 3.0
Target = torch.Tensor | tuple[torch.Tensor, torch.Tensor] | FocalTargets | Scenery


@overload
def optimise(
    display: Display,
    target: Target,
    loss: Callable[..., Any] | None = None,
    solver: str | Solver = "auto",
    start: str | torch.Tensor = "gs",
    run: Run | None = None,
    devices: Sequence[torch.device | str | int] | str | None = None,
    observer: Observer | None = None,
) -> DisplayedHologram: ...


@overload
def optimise(
    display: Display,
    target: list[Target] | list[torch.Tensor],
    loss: Callable[..., Any] | None = None,
    solver: str | Solver = "auto",
    start: str | torch.Tensor = "gs",
    run: Run | None = None,
    devices: Sequence[torch.device | str | int] | str | None = None,
    observer: Observer | None = None,
) -> list[DisplayedHologram]: ...


@takes_units()
@differentiates
@in_own_precision
def optimise(
    display: Display,
    target: Target | list[Target] | list[torch.Tensor],
    loss: Callable[..., Any] | None = None,
    solver: str | Solver = "auto",
    start: str | torch.Tensor = "gs",
    run: Run | None = None,
    devices: Sequence[torch.device | str | int] | str | None = None,
    observer: Observer | None = None,
) -> DisplayedHologram | list[DisplayedHologram]:
    """Return the patterns that show a target on a display, with their images and quality.

    Use it for a picture on one plane, for several planes, colours and frames alike. What is optimised is what is
    stated: what an observer sees, on planes or on the retinas of :class:`Eyes`. The solvers "gs", "double phase" and
    "network" cannot aim at an observer; what it sees of their patterns is stated alike.

    Parameters
    ----------
    display : Display
        The display.
    target : torch.Tensor, tuple of torch.Tensor, DepthScene, LightField, multiplane_loss or list of them
        Intensities 0 … 1, ``[rows, columns]`` for one plane and colour, ``[C, rows, columns]`` for one plane, or
        ``[D, C, rows, columns]``; eyes that get no targets of their own see the same. Its brightness is free: the
        sources of each colour are dimmed to it. A picture with depth is a pair of ``[C, rows, columns]`` and a depth
        ``[rows, columns]``, 0 the first plane and 1 the last: each pixel is in focus on its own plane, and blurred on
        the others by the cone of its light. For another blur, give a :class:`odak.learn.wave.multiplane_loss`. A
        :class:`DepthScene`, a :class:`LightField` or another object with a method ``images(display)`` gives what each
        plane or pupil is to show. A list is of several pictures, each with a hologram of its own.
    loss : callable, optional
        ``loss(images, target)``, both ``[D, C, rows, columns]``; the mean squared error by default, for a picture with
        depth its :class:`odak.learn.wave.multiplane_loss`. One that takes a `generator` is given one.
    solver : str or object
        "lbfgs", "adam", "levels", "gs" (or "gerchberg-saxton"), "double phase" or "network", or an object with a
        method ``solve(problem) -> phases``, or phases and powers, such as :class:`Descent` or :class:`LevelSearch`.
        "auto" is "adam" for distances with jitter, "levels" for a single panel of at most four bits, and "lbfgs" for
        others.
    start : str or torch.Tensor
        "gs", "double phase" or "network", a hologram by these methods, or "quadratic", "flat" or "random", see
        :func:`odak.learn.wave.stochastic_gradient_descent`; or phases ``[F, rows, columns]`` in radians.
    run : Run, optional
        Iterations, progress, callback, checkpoint and seed.
    devices : sequence of torch.device, str or int, or "distributed", optional
        Devices that share the work, such as ``["cuda:0", "cuda:1"]``; by default the display's own device. Of a list,
        each picture is computed by one device; of a single picture the planes, colours and frames are shared out, for
        solvers that descend along a gradient. "distributed" shares out in the same way among the processes of
        `torch.distributed`, each on the device of its display: all call this with the same arguments.
    observer : Observer, optional
        Who looks; by default a camera of the image's pitch at any place. A camera whose pixels are known to be those of
        the image is ``Observer.camera(registered=True)``; what is optimised for it alone is worse for every other.

    Returns
    -------
    DisplayedHologram or list of DisplayedHologram
        Patterns, images and quality, one for each picture of a list, on the device of the display; in every process.
        It shows itself in a notebook.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit the display, naming it.
    RuntimeError
        If a picture of a list failed in another process, naming that.

    Notes
    -----
    Pictures of a list are computed as they are alone, to the bit on equal devices. The shared images of one picture
    are sums in another order, equal to rounding. A loss or a response that is a `torch.nn.Module` is copied to each
    device; other objects must accept tensors of every device, and a callback is called from a thread per device. Where
    processes share one picture, they need equal hardware, and one whose callback returns True stops all.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Run, optimise
    >>> target = torch.zeros(48, 64)
    >>> target[12:36, 16:48] = 1.0
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> hologram = optimise(display, target, run=Run(iterations=20, progress=False))
    >>> hologram.phases.shape, bool(hologram.psnr > 20)
    (torch.Size([1, 48, 64]), True)
    """
    run = Run() if run is None else run
    observer = ANYWHERE if observer is None else observer
    for name, given, kind in (("display", display, Display), ("run", run, Run), ("observer", observer, Observer)):
        _validate.instance(name, given, kind, f"an odak.learn.wave.{kind.__name__}")
    for colour in range(display.shape[1]):
        observer.places(display.shape[2:], display.path.image_pitches(colour))
    where = None if devices is None else used_devices(devices, display.powers.device)
    if isinstance(target, list):
        options = {"loss": loss, "solver": solver, "start": start, "observer": observer}
        return _optimise_each(display, target, where, options, run)
    focal = target if isinstance(target, FocalTargets) else focal_targets(display, target)
    target = checked_target(display, target if focal is None else focal.targets)
    if isinstance(solver, str):
        name = named("solver", solver, ("auto", *SOLVERS))
        solver = SOLVERS[_chosen(display) if name == "auto" else name]()
    if not callable(getattr(solver, "solve", None)):
        raise TypeError(f"solver must have a method solve(problem), got {type(solver).__name__}")
    if where is not None and isinstance(solver, (AlternatingProjections, DoublePhase, Network)):
        raise ValueError(f"devices must be None for one picture by {type(solver).__name__}, got {devices!r:.80}")
    first = display.modulator.lit_through
    if where is not None and first is not None:
        raise ValueError(f"devices must be None for one picture on two panels, got {devices!r:.80}")
    if isinstance(where, Ranks) and run.checkpoint is not None:
        raise ValueError(f"run must be without a checkpoint where devices={DISTRIBUTED!r}, got {run.checkpoint!r:.80}")
    usual = torch.nn.functional.mse_loss if focal is None else focal
    loss = usual if loss is None else _validate.function_or_none("loss", loss)
    losses: list[torch.Tensor] = []

    def record(iteration, value):
        losses.append(value)
        stops = run.callback is not None and run.callback(iteration, value) is True
        return where.any(stops, value.device) if isinstance(where, Ranks) and run.callback is not None else stops

    tell_bounds(display, target)
    begun = starting_phases(display, target, start, run.seed)
    own = replace(run, callback=record, progress=run.progress and not (isinstance(where, Ranks) and where.rank))
    computing = _in_parts(display, where, run, devices)
    problem = Problem(computing, target, loss, begun, own, observer=observer)
    solved = solver.solve(problem)
    solved = solved if isinstance(solved, tuple) else (solved,)
    phases, powers, amplitudes, gain = (*solved, None, None, None)[:4]
    amplitudes = None if first is None or amplitudes is None else first.shown(amplitudes)
    if gain is None and _chosen(display) == "levels" and powers is None:
        _warn_of_rounding(problem, phases)
    # Of many frames, as much memory as what follows.
    del problem, begun, solved
    phases, display = display.modulator.shown(phases), display if powers is None else display.lit_by(powers)
    held = Comparison(observer, target, None if focal is None else focal.masks)
    found = judged(display, phases, amplitudes, held)
    lights = brightest(found.compared).to(target)
    images = found.areas * lights[:, None, None]
    if powers is not None:
        relative = powers / powers.sum(0) * lights.clamp_min(1e-6)
        display = display.lit_by(relative / relative.max())

    def ratio(compared):
        return decibels(squared_errors(compared, lights.double())).to(target)

    points = found.points * brightness_of(found.points, target)
    at_points = decibels((points - target).square().mean((-2, -1)))
    sharp = None if focal is None else ratio(found.sharp)[0]
    history = tuple(torch.stack(losses).tolist()) if losses else ()
    ratios = ratio(found.compared), at_points
    return DisplayedHologram(
        *(display, target, phases, images, lights), *ratios, history, sharp, amplitudes, observer, gain, found.error
    )


def _in_parts(display, where, run: Run, devices) -> Display:
    """Return a display that computes its images on some devices, or in parts that fit a memory budget."""
    if where is None:
        return display if run.memory_budget is None else streamed(display, run.memory_budget)
    for what, used in (("jitter of its distances", display.path.jitter), ("a memory_budget", run.memory_budget)):
        if used:
            raise ValueError(f"devices must be None for one picture with {what}, got {devices!r:.80}")
    return shared_among(display, where)


def _chosen(display: Display) -> str:
    """Return the solver that "auto" stands for."""
    panel = display.modulator
    if display.path.jitter:
        return "adam"
    return "levels" if panel.lit_through is None and panel.bits is not None and panel.bits <= FEW_BITS else "lbfgs"


def _warn_of_rounding(problem: Problem, phases: torch.Tensor) -> None:
    """Warn where most of the quality of phases is lost when they are rounded to the levels of the panel."""
    with torch.no_grad():
        found, rounded = (problem.loss_of(one) for one in (phases, problem.display.modulator.shown(phases)))
    cost = 10 * math.log10(max(float(rounded), 1e-30) / max(float(found), 1e-30))
    if cost > _ROUNDED:
        count = 2 ** (problem.display.modulator.bits or 0)
        warn(
            f"rounding to the {count} levels of the panel costs {cost:.1f} dB of the loss: the solver 'levels' "
            "searches among them",
            AccuracyWarning,
        )


def _optimise_each(display, targets, where, options: dict[str, Any], run: Run) -> list[DisplayedHologram]:
    """Return the holograms of several pictures, each computed on one of some devices or by one of the ranks."""
    if not targets:
        raise ValueError("target must hold at least one picture, got an empty list")
    if run.checkpoint is not None:
        raise ValueError(f"run must be without a checkpoint for a list of pictures, got {run.checkpoint!r:.80}")
    home = display.powers.device
    first = not (isinstance(where, Ranks) and where.rank)
    bar = tqdm(total=len(targets), desc="pictures", disable=not (run.progress and first))
    alone = replace(run, progress=False)

    def prepared(device):
        own = display if device == home else copied_to(display, device)
        given = {name: _on_device(value, device, home) for name, value in options.items()}

        def work(target):
            found = optimise(own, _on_device(target, device, home), **given, run=alone)
            bar.update()
            return _packed(found, own, torch.device("cpu") if isinstance(where, Ranks) else home)

        return work

    with bar:
        if isinstance(where, Ranks):
            packed = where.each(prepared(home), targets)
        else:
            packed = on_devices(prepared, targets, [home] if where is None else where)
    return [_unpacked(parts, display) for parts in packed]


def _on_device(value, device, home):
    """Return a loss or a target whose tensors are on a device; a module is copied, unless it is at home there."""
    return copy.deepcopy(value).to(device) if isinstance(value, torch.nn.Module) and device != home else value


def _packed(hologram: DisplayedHologram, display: Display, device: torch.device) -> dict[str, Any]:
    """Return the parts of a hologram on a device; of its display those powers that were found, or None."""
    parts = {part.name: getattr(hologram, part.name) for part in fields(hologram)}
    parts["display"] = None if hologram.display is display else hologram.display.powers
    return {name: value.to(device) if isinstance(value, torch.Tensor) else value for name, value in parts.items()}


def _unpacked(parts: dict[str, Any], display: Display) -> DisplayedHologram:
    home = display.powers.device
    moved: dict[str, Any] = {k: v.to(home) if isinstance(v, torch.Tensor) else v for k, v in parts.items()}
    powers = moved.pop("display")
    return DisplayedHologram(display if powers is None else display.lit_by(powers), **moved)
