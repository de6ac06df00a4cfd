"""Display benchmarks: frames, planes and colours against bare transforms, against a loop, and in memory."""

import json
import subprocess
import sys
from collections.abc import Iterator

import torch
from measure import interleave
from wave_optics import PADDED, PITCH, SHAPE, row

from odak.learn.wave import multi_color_hologram_optimizer, propagator

COLOURS = (639e-9, 515e-9, 473e-9)
PLANES, FRAMES = 4, 3
STEPS = 6


def optimization(device: str) -> Iterator[dict]:
    """Yield one step for three colours on four planes against as many bare padded FFTs as it needs."""
    padded = torch.randn(PADDED, dtype=torch.complex64, device=device)
    targets = torch.rand(PLANES, len(COLOURS), *SHAPE, device=device)
    # Forward: the spectrum of each frame, and the field of each frame, plane and colour. Backward: the same again.
    needed = {"conventional": 2 * (3 + 3 * PLANES), "multi-color": 2 * (FRAMES + FRAMES * 3 * PLANES)}
    for method, count in needed.items():
        display = propagator(
            SHAPE, COLOURS, PITCH, number_of_frames=FRAMES, number_of_depth_layers=PLANES, volume_depth=5e-3,
            image_location_offset=0.15, propagator_type="forward", method=method, device=torch.device(device),
            aperture="open",
        )  # fmt: skip
        optimizer = multi_color_hologram_optimizer(
            COLOURS, SHAPE, targets, display, FRAMES, PLANES, method=method, progress=False
        )

        def bare(count=count):
            for _ in range(count // 2):
                torch.fft.fft2(padded)

        def steps(optimizer=optimizer):
            optimizer.gradient_descent(STEPS)

        timings = interleave({"fft": bare, "ours": steps}, 3, device)
        name = f"3 colours, 4 planes, {method}, one step"
        yield row(name, timings["ours"].best / STEPS, 2 * timings["fft"].best, f"{count} fft2", 1.3)
        del display, optimizer


def reconstruction(device: str) -> Iterator[dict]:
    """Yield the images of all frames, planes and colours in one call against a loop over single propagations."""
    display = propagator(
        SHAPE, COLOURS, PITCH, number_of_frames=FRAMES, number_of_depth_layers=PLANES, volume_depth=5e-3,
        image_location_offset=0.15, propagator_type="forward", laser_channel_power=torch.ones(3, 3), aperture="open",
        device=torch.device(device),
    )  # fmt: skip
    phases = torch.rand(FRAMES, *SHAPE, device=device)

    def loop():
        images = torch.empty(FRAMES, PLANES, len(COLOURS), *SHAPE, device=device)
        with torch.no_grad():
            for frame in range(FRAMES):
                field = torch.exp(1j * phases[frame])
                for plane in range(PLANES):
                    for colour in range(len(COLOURS)):
                        images[frame, plane, colour] = display(field, colour, plane).abs() ** 2
        return images

    timings = interleave({"loop": loop, "ours": lambda: display.reconstruct(phases)}, 3, device)
    yield row("reconstruct 3 x 4 x 3 in one call", timings["ours"].best, timings["loop"].best, "its loop", 1.0)


def memory(device: str) -> Iterator[dict]:
    """Yield the peak memory of a step above the targets', with all planes at once and with one at a time."""
    for name, budget in (("all planes at once", None), ("memory_budget=50 MB", 50_000_000)):
        code = (
            "import json, sys; sys.path.insert(0, 'benchmarks'); import torch; from measure import peak_memory; "
            "from odak.learn.wave import multi_color_hologram_optimizer, propagator; "
            f"device, shape, colours = torch.device({device!r}), (540, 960), [639e-9, 515e-9, 473e-9]; "
            "targets = torch.rand(8, 3, *shape, device=device); "
            "display = propagator(shape, colours, 8e-6, number_of_frames=3, number_of_depth_layers=8, "
            "volume_depth=5e-3, image_location_offset=0.1, propagator_type='forward', device=device, "
            "aperture='open', "
            f"memory_budget={budget}); "
            "optimizer = multi_color_hologram_optimizer(colours, shape, targets, display, 3, 8, progress=False); "
            f"before = peak_memory({device!r}); optimizer.gradient_descent(2); "
            f"print(json.dumps(peak_memory({device!r}) - before))"
        )
        output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        arrays = json.loads(output) / (2 * 540 * 2 * 960 * 8)
        yield {
            "task": f"3 frames, 8 planes, 3 colours: {name}",
            "ours_arrays": arrays,
            "floor": "padded complex64",
            "bound": None,
            "ratio": arrays,
        }


ALL = (memory, reconstruction, optimization)
