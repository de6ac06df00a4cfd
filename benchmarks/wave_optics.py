"""Wave-optics benchmarks: each against the bare transforms of the same size, in the same process."""

import json
import subprocess
import sys
from collections.abc import Iterator

import torch
from measure import interleave, measure

from odak.learn import wave
from odak.wave import clear_kernel_cache

WAVELENGTH, DISTANCE, PITCH = 532e-9, 0.15, 8e-6
SHAPE = (1080, 1920)
PADDED = tuple(2 * n for n in SHAPE)
SQUARES = (64, 128, 256, 384, 512, 640, 768, 896, 1536)
BATCHES = ((64, 128, 128), (16, 256, 256))


def row(task: str, ours: float, floor: float, floor_name: str, bound: float | None, **more) -> dict:
    """Return one row of the table: seconds of ours and of the floor it is held against, and their ratio."""
    return {
        "task": task,
        "ours_s": ours,
        "floor_s": floor,
        "floor": floor_name,
        "ratio": ours / floor,
        "bound": bound,
        **more,
    }


def propagation(device: str) -> Iterator[dict]:
    """Yield one padded propagation, with and without a kernel at hand, against two bare FFTs of the padded size."""
    field = torch.randn(SHAPE, dtype=torch.complex64, device=device)
    padded = torch.randn(PADDED, dtype=torch.complex64, device=device)

    def propagate():
        wave.propagate_beam(field, None, DISTANCE, PITCH, WAVELENGTH)

    def propagate_first():
        clear_kernel_cache()
        propagate()

    timings = interleave({"fft": lambda: torch.fft.fft2(padded), "warm": propagate}, device=device)
    floor = 2 * timings["fft"].best
    yield row("propagation, cached kernel", timings["warm"].best, floor, "2 fft2", 1.4)
    yield row("propagation, first call", measure(propagate_first, 5, device).best, floor, "2 fft2", 4.0)


def sizes(device: str) -> Iterator[dict]:
    """Yield padded propagations of small fields and batches, alone and with their gradient, against bare FFTs."""
    for shape in (*((side, side) for side in SQUARES), *BATCHES):
        field = torch.randn(shape, dtype=torch.complex64, device=device)
        followed = field.clone().requires_grad_()
        padded = torch.randn(*shape[:-2], *(2 * n for n in shape[-2:]), dtype=torch.complex64, device=device)
        # As many calls as make a millisecond or more.
        calls = max(1, 2**19 // padded.numel())

        def bare(padded=padded, calls=calls):
            for _ in range(calls):
                torch.fft.ifft2(torch.fft.fft2(padded))

        def forward(field=field, calls=calls):
            for _ in range(calls):
                wave.propagate_beam(field, None, 1e-3, PITCH, WAVELENGTH)

        def both(field=field, followed=followed, calls=calls):
            for _ in range(calls):
                result = wave.propagate_beam(followed, None, 1e-3, PITCH, WAVELENGTH)
                torch.autograd.grad(result, followed, field)

        timings = interleave({"bare": bare, "forward": forward, "both": both}, 15, device)
        best = {name: timing.best / calls for name, timing in timings.items()}
        name, bound = " × ".join(map(str, shape)), 1.0 if shape[-1] >= 512 else 1.3
        bound = bound if shape[-1] >= 128 else None
        yield row(f"propagation, {name}", best["forward"], best["bare"], "2 fft2", bound)
        yield row(f"propagation with gradient, {name}", best["both"], 2 * best["bare"], "4 fft2", bound)


def vector_fields_and_media(device: str) -> Iterator[dict]:
    """Yield a field of two components, and a slice of a medium, against propagations of one component."""
    side, slices, pitch = 512, 16, 0.5e-6
    field = torch.randn(2, side, side, dtype=torch.complex64, device=device)
    media = {
        "random": 1.5 + 0.02 * torch.rand(slices, side, side, device=device),
        "of two indices": 1.5 + 0.02 * (torch.rand(slices, side, side, device=device) > 0.5),
    }

    def vector():
        wave.propagate_beam(field, None, 1e-6, pitch, WAVELENGTH)

    def scalar():
        wave.propagate_beam(field[0], None, 1e-6, pitch, WAVELENGTH)

    timings = interleave({"scalar": scalar, "vector": vector}, device=device)
    yield row("field of two components, 512", timings["vector"].best, 2 * timings["scalar"].best, "2 scalar ones", 1.2)
    for medium, index in media.items():
        for method, options, bound in (
            ("split-step", {}, 1.2),
            ("split-step, reference given", {"reference": 1.51}, 1.0),
            ("wave propagation", {}, None),
        ):

            def through(index=index, method=method, options=options):
                name = method.split(",")[0]
                wave.propagate_through_medium(field[0], index, pitch, 1e-6, WAVELENGTH, name, **options)

            timings = interleave({"scalar": scalar, "through": through}, 5, device)
            ours = timings["through"].best / slices
            yield row(
                f"{method}, a slice of a medium {medium}, 512", ours, timings["scalar"].best, "propagate_beam", bound
            )


def hologram(device: str) -> Iterator[dict]:
    """Yield one iteration of gradient descent against four bare FFTs of the padded size."""
    target = torch.rand(SHAPE, device=device)
    padded = torch.randn(PADDED, dtype=torch.complex64, device=device)

    def bare():
        for _ in range(4):
            torch.fft.fft2(padded)

    def ten_iterations():
        wave.stochastic_gradient_descent(
            target, WAVELENGTH, DISTANCE, PITCH, n_iteration=10, initial_phase=torch.zeros_like(target), progress=False
        )

    def obvious():
        phase = torch.zeros_like(target, requires_grad=True)
        optimizer = torch.optim.Adam([phase], lr=0.1)
        kernel = wave.get_propagation_kernel(*PADDED, PITCH, WAVELENGTH, DISTANCE, target.device)
        _obvious_step(phase, optimizer, kernel, target)

    timings = interleave({"fft": bare, "ours": ten_iterations}, 5, device)
    # Ten iterations hold one propagation more, for the reconstruction that is returned: it is counted in.
    ours, floor = timings["ours"].best / 10, timings["fft"].best
    yield row("gradient descent, one iteration", ours, floor, "4 fft2", 1.8)
    alternative = measure(obvious, 3, device).best
    yield row("gradient descent, one iteration, plain autograd", alternative, floor, "4 fft2", None)


def _obvious_step(phase, optimizer, kernel, target) -> None:
    """Take one step as one would write it down: pad, shift, transform, multiply, transform back, shift, crop."""
    rows, columns = target.shape
    field = torch.nn.functional.pad(torch.exp(1j * phase), [columns // 2, columns // 2, rows // 2, rows // 2])
    spectrum = torch.fft.fftshift(torch.fft.fft2(torch.fft.fftshift(field))) * kernel
    image = torch.fft.ifftshift(torch.fft.ifft2(torch.fft.ifftshift(spectrum)))
    image = image[rows // 2 : rows // 2 + rows, columns // 2 : columns // 2 + columns]
    loss = torch.nn.functional.mse_loss(image.abs() ** 2, target)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


def impulse_response(device: str) -> Iterator[dict]:
    """Yield the averaged impulse-response kernel at 1024 × 1024 against one bare FFT of its size."""
    padded = torch.randn(1024, 1024, dtype=torch.complex64, device=device)
    timings = interleave(
        {
            "fft": lambda: torch.fft.fft2(padded),
            "ours": lambda: wave.get_impulse_response_fresnel_kernel(1024, 1024, distance=0.2, device=padded.device),
        },
        device=device,
    )
    yield row("impulse-response kernel 1024", timings["ours"].best, timings["fft"].best, "1 fft2", None)


def memory(device: str) -> Iterator[dict]:
    """Yield the peak memory of a hologram above what the process holds after import, in padded complex64 arrays."""
    code = (
        "import json, sys; sys.path.insert(0, 'benchmarks'); import torch; from measure import peak_memory; "
        "from odak.learn import wave; import odak.learn.wave.propagation; "
        f"device = {device!r}; target = torch.rand({SHAPE}, device=device); "
        # A small one loads what the transforms and the optimizer import.
        "small = torch.rand(64, 64, device=device); "
        f"wave.stochastic_gradient_descent(small, {WAVELENGTH}, 1e-3, {PITCH}, n_iteration=1, progress=False); "
        "before = peak_memory(device); "
        f"wave.stochastic_gradient_descent(target, {WAVELENGTH}, {DISTANCE}, {PITCH}, n_iteration=5, progress=False); "
        "print(json.dumps(peak_memory(device) - before))"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    array = PADDED[0] * PADDED[1] * 8
    arrays = json.loads(output) / array
    yield {
        "task": "gradient descent, peak memory",
        "ours_arrays": arrays,
        "floor": "padded complex64",
        "bound": 6.0,
        "ratio": arrays,
    }


def point_sources(device: str) -> Iterator[dict]:
    """Yield the field of a thousand point sources at a thousand points against the formula written down."""
    sources, targets = (torch.rand(1000, 3, dtype=torch.float64, device=device) for _ in range(2))
    targets[:, 2] += 10.0
    number = 2 * torch.pi / WAVELENGTH
    for dtype in (torch.complex64, torch.complex128):
        field = torch.randn(1000, dtype=dtype, device=device)

        def formula(field=field):
            distances = (targets[:, None] - sources).norm(dim=-1)
            return (field.abs() * torch.exp(1j * (number * distances + field.angle())) / distances**2).sum(-1)

        tasks = {"formula": formula, "ours": lambda field=field: wave.propagate_field(sources, targets, field, number)}
        timings = interleave(tasks, 9, device)
        name = f"1000 point sources at 1000 points, {str(dtype).removeprefix('torch.')}"
        yield row(name, timings["ours"].best, timings["formula"].best, "formula", 1.0)


def import_time(device: str) -> Iterator[dict]:
    """Yield the time that `import odak` adds to an interpreter that has loaded numpy."""
    times = {}
    for name, line in (("numpy", "import numpy"), ("odak", "import numpy, odak")):
        times[name] = measure(lambda line=line: subprocess.run([sys.executable, "-c", line], check=True), 7).best
    added = times["odak"] - times["numpy"]
    yield {"task": "import odak, seconds above numpy", "ours_s": added, "floor": "1 s", "ratio": added, "bound": 0.1}


ALL = (import_time, memory, impulse_response, propagation, sizes, vector_fields_and_media, point_sources, hologram)
