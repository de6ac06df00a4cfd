"""Holograms by each method of the command line, and the light that a pattern sends to the picture."""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager

import torch
from tqdm import tqdm

from odak.cli.job import Job
from odak.learn import wave

FILTER = 0.5
NOISE = {"slight": 0.3, "normal": 1.0}


def compute(job: Job, intensity: torch.Tensor, wavelength: float) -> tuple[torch.Tensor, float | None]:
    """Return the hologram of one channel.

    Parameters
    ----------
    job : Job
        What was asked for.
    intensity : torch.Tensor
        Target ``[rows, columns]`` on the device to compute on.
    wavelength : float
        Wavelength in metres.

    Returns
    -------
    tuple
        Complex hologram ``[rows, columns]`` of unit amplitude, and the seconds per iteration (None without them).
    """
    if job.method == "double-phase":
        return _double_phase(job, intensity, wavelength), None
    with progress(job, f"{wavelength * 1e9:.6g} nm") as clock:
        hologram = (_descend if job.method == "sgd" else _retrieve)(job, intensity, wavelength, clock.tick)
        finish(intensity.device)
    return hologram, clock.seconds_per_tick()


def reconstruct(job: Job, hologram: torch.Tensor, wavelength: float, propagation_type: str) -> torch.Tensor:
    """Return the field at the picture's plane, over the modulator's window.

    Parameters
    ----------
    job : Job
        What was asked for.
    hologram : torch.Tensor
        Complex ``[rows, columns]``.
    wavelength : float
        Wavelength in metres.
    propagation_type : str
        How to propagate.

    Returns
    -------
    torch.Tensor
        Complex ``[rows, columns]``. Double-phase holograms pass the Fourier filter that they need.
    """
    aperture = half_band(hologram.shape, hologram.device) if job.method == "double-phase" else 1.0
    return wave.propagate_beam(
        hologram,
        None,
        job.distance,
        job.pixel_pitch,
        wavelength,
        propagation_type,
        zero_padding=[True, False, True],
        aperture=aperture,
    )


def half_band(shape: Sequence[int], device: torch.device) -> torch.Tensor:
    """Return the centred Fourier filter of a 4f relay that passes the inner half of the band along each axis.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the hologram; the filter is for the grid of twice that size.
    device : torch.device
        Where to make it.

    Returns
    -------
    torch.Tensor
        Ones where both frequencies are within ±1/(4·pitch), zeros elsewhere.
    """
    rows, columns = (
        ((torch.arange(2 * n, device=device) - n).abs() <= FILTER * n).to(torch.float32) for n in shape[-2:]
    )
    return rows[:, None] * columns[None, :]


def grating_phase(shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Return the phase of the binary grating that `--grating` adds: π on every second column, from the first."""
    return wave.calculate_phase(wave.linear_grating(*shape, every=2, axis="y")).abs().double().to(device)


def _descend(job: Job, intensity: torch.Tensor, wavelength: float, callback: Callable) -> torch.Tensor:
    hologram, _ = wave.stochastic_gradient_descent(
        intensity,
        wavelength,
        job.distance,
        job.pixel_pitch,
        job.propagation_type,
        job.iterations,
        learning_rate=job.learning_rate,
        initial_phase=starting_phase(job, intensity, wavelength),
        scale=job.scale,
        progress=False,
        callback=callback,
    )
    return hologram


def _retrieve(job: Job, intensity: torch.Tensor, wavelength: float, callback: Callable) -> torch.Tensor:
    hologram, _ = wave.gerchberg_saxton(
        wave.generate_complex_field(intensity.sqrt(), torch.zeros_like(intensity)),
        job.iterations,
        job.distance,
        job.pixel_pitch,
        wavelength,
        2 * math.pi,
        job.propagation_type,
        initial_phase=starting_phase(job, intensity, wavelength),
        progress=False,
        callback=callback,
    )
    return hologram


def _double_phase(job: Job, intensity: torch.Tensor, wavelength: float) -> torch.Tensor:
    phase = wave.shift_w_double_phase(
        starting_phase(job, intensity, wavelength),
        -job.distance,
        job.pixel_pitch,
        wavelength,
        job.propagation_type,
        kernel_length=0,
        amplitude=intensity.sqrt(),
    )
    return wave.generate_complex_field(1.0, phase)


def starting_phase(job: Job, like: torch.Tensor, wavelength: float) -> torch.Tensor:
    """Return the phase to start from: of the hologram, or of the picture for double phase.

    Parameters
    ----------
    job : Job
        What was asked for.
    like : torch.Tensor
        Real ``[..., rows, columns]``, whose shape, precision and device the phase takes.
    wavelength : float
        Wavelength in metres.

    Returns
    -------
    torch.Tensor
        Zeros; a lens of focal length 2·distance; normal noise of deviation 0.3 or 1 rad; or noise uniform over 2π.
    """
    generator = torch.Generator().manual_seed(job.seed)
    if job.initial_phase == "quadratic":
        phase = wave.lens_phase(tuple(like.shape[-2:]), 2 * job.distance, job.pixel_pitch, wavelength)
    elif job.initial_phase in NOISE:
        phase = NOISE[job.initial_phase] * torch.randn(like.shape, generator=generator)
    elif job.initial_phase == "uniform":
        phase = 2 * math.pi * torch.rand(like.shape, generator=generator)
    else:
        phase = torch.zeros(like.shape)
    return phase.to(like).expand(like.shape).clone()


class _Clock:
    """Moves the progress bar and times the iterations, the first one (which builds the kernel) left out."""

    def __init__(self, bar: tqdm) -> None:
        self.bar, self.ticks, self.first, self.last = bar, 0, 0.0, 0.0

    def tick(self, *_) -> None:
        self.bar.update()
        self.ticks += 1
        if self.ticks == 1:
            self.first = time.perf_counter()

    def seconds_per_tick(self) -> float | None:
        return (self.last - self.first) / (self.ticks - 1) if self.ticks > 1 else None


@contextmanager
def progress(job: Job, description: str):
    """Show a progress bar, and yield the clock whose `tick` moves it."""
    start = time.perf_counter()
    with tqdm(total=job.iterations, desc=description, unit="it", disable=job.quiet) as bar:
        clock = _Clock(bar)
        clock.first = start
        yield clock
        clock.last = time.perf_counter()
    if clock.ticks < job.iterations:
        # The optimizers return their best so far after Ctrl-C: files of that would pass for the whole run's.
        raise KeyboardInterrupt


def finish(device: torch.device) -> None:
    """Wait for the device, whose work runs behind the program, so that times are true."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
