"""First light on a GPU: results beside those of the processor, numbers that are read back, tests and benchmarks.

    scripts/gpu_check.sh [WHEELS] [--minutes 6] [--device cuda] [--output gpu_check.json]

The checks run in the order of their worth, in a process that is ended when one takes too long and begun again with the
next one. What is known is in the JSON after each of them. ``--device cpu`` compares the processor with itself, and
``--device emulated`` with the device of the tests, whose tensors refuse those of the processor: both show that the
checks work where there is no GPU.
"""

import argparse
import contextlib
import json
import queue
import runpy
import subprocess
import sys
import threading
import time
import traceback
import warnings
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Largest difference in single precision, relative to the largest number: transforms of a million samples round to 1e-6.
SINGLE = 1e-4
# Results of iterations, which add up roundings: their quality in decibels differs by less.
DECIBELS = 0.3
# What the tests marked cuda import besides the package.
FOR_TESTS = ("pytest", "pytest_timeout", "xdist", "hypothesis", "array_api_strict")
# What some of them need besides, and are skipped without.
FOR_FIGURES = ("plotly", "kaleido")
# Groups of benchmarks, the most telling first.
BENCHMARKS = ("wave_optics", "displays", "lens_system", "perception", "rays")


class Place:
    """A device on which calls are made: "cuda", "cpu", or the emulated one of the tests."""

    def __init__(self, name: str):
        import torch

        self.name, self.torch = name, torch
        if name == "emulated":
            sys.path.insert(0, str(ROOT / "test" / "helpers"))
            import emulated_device

            self.emulation = emulated_device

    @property
    def full(self) -> bool:
        """Whether pictures have the size of a display's; small ones show as much elsewhere."""
        return self.name == "cuda"

    def moved(self, value):
        """Return a tensor, a module, or those in lists and dictionaries, on the device."""
        from torch.utils._pytree import tree_map_only

        device = self.emulation.DEVICE if self.name == "emulated" else self.name
        value = tree_map_only(self.torch.nn.Module, lambda module: module.to(device), value)
        return tree_map_only(self.torch.Tensor, lambda tensor: tensor.to(device), value)

    def back(self, value):
        """Return tensors on the processor."""
        from torch.utils._pytree import tree_map_only

        return tree_map_only(self.torch.Tensor, lambda tensor: tensor.detach().cpu(), value)

    def within(self):
        """Return the context that calls on the device need."""
        return self.emulation.EmulatedDevice() if self.name == "emulated" else contextlib.nullcontext()

    def reads_of(self, call) -> dict[str, int] | None:
        """Return how often each line waits for the device, of a call that was made before; None on the processor.

        It waits to read numbers, and to copy some of the processor there.
        """
        if self.name == "emulated":
            self.emulation.reads.clear()
            self.emulation.copies.clear()
            call()
            found = self.emulation.reads + self.emulation.copies
            return {line: count for line, count in found.items() if line != "outside"}
        if self.name == "cpu":
            return None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            self.torch.cuda.set_sync_debug_mode("warn")
            try:
                call()
            finally:
                self.torch.cuda.set_sync_debug_mode("default")
        found: dict[str, int] = {}
        for item in caught:
            if "synchroniz" in str(item.message):
                place = f"{Path(item.filename).name}:{item.lineno}"
                found[place] = found.get(place, 0) + 1
        return found

    def wait(self) -> None:
        """Wait until the device has done what it was given."""
        if self.name == "cuda":
            self.torch.cuda.synchronize()


def row(place: Place, what: str, call, *given, limit: float = SINGLE) -> dict:
    """Return the difference of a call's tensors on the device from those on the processor, times, and reads.

    `call` takes the tensors and modules `given`, and returns tensors.
    """
    import copy

    expected = place.back(call(*copy.deepcopy(given)))
    with place.within():
        there = place.moved(copy.deepcopy(given))
        found = place.back(call(*there))
        place.wait()
        begun = time.perf_counter()
        call(*there)
        place.wait()
        seconds = time.perf_counter() - begun
        reads = place.reads_of(lambda: call(*there))
    pairs = list(zip(found, expected, strict=True))
    worst = max(float((a - b).abs().max() / b.abs().max()) for a, b in pairs)
    return {"what": what, "difference": worst, "limit": limit, "ok": worst <= limit, "seconds": seconds, "reads": reads}


def propagation(place: Place):
    """Yield each propagation method, with the gradient by the field."""
    import torch

    from odak.learn.wave import propagate_beam
    from odak.wave.methods import METHODS

    size = 1024 if place.full else 24
    generator = torch.Generator().manual_seed(1)
    field = torch.randn(size, size, dtype=torch.complex64, generator=generator)
    for method in METHODS:
        kernel = torch.randn(2 * size, 2 * size, dtype=torch.complex64, generator=generator)
        given = (kernel if method.name == "custom" else torch.zeros(1),)

        def call(field, kernel, name=method.name):
            field = field.detach().requires_grad_()
            kernel = kernel if name == "custom" else None
            result = propagate_beam(field, None, 5e-3, 8e-6, 532e-9, name, kernel, [True, False, True])
            (gradient,) = torch.autograd.grad(result.abs().square().sum(), field)
            return result, gradient

        yield row(place, method.name, call, field, *given)


def displays(place: Place):
    """Yield a display's images, and the first steps of its optimisation: behind free space, a lens, and of colours."""
    import torch

    from odak.instruments import Lens
    from odak.learn.wave import Descent, Display, Modulator, Run, optimise

    shape, frames = (1080, 1920) if place.full else (16, 24), 3
    target = torch.rand(*shape, generator=torch.Generator().manual_seed(2))
    phases = 6.28 * torch.rand(1, *shape, generator=torch.Generator().manual_seed(3))
    run = Run(iterations=3, progress=False)

    def losses(display, target, start, graph=False):
        found = optimise(display, target, solver=Descent("adam", graph=graph), start=start, run=run)
        return (torch.tensor(found.losses),)

    def replayed(*given):
        return losses(*given, graph=given[1].is_cuda and place.full)

    def steps(what, call, *given):
        seen = []

        def told(*there):
            seen.append(call(*there))
            return seen[-1]

        found = row(place, f"losses of three steps {what}", told, *given, limit=1e-3)
        # Losses that hardly change would agree whatever the steps do.
        first, *_, last = seen[0][0].tolist()
        return {**found, "change": abs(last / first - 1), "ok": found["ok"] and abs(last / first - 1) > 1e-2}

    for name, space in (("free space", 5e-3), ("a lens", Lens(0.1))):
        display = Display(Modulator(shape, pitch=8e-6), wavelengths=532e-9, distances=space)
        yield row(place, f"images behind {name}", lambda d, p: (d(p),), display, phases)
        yield steps(f"behind {name}", losses, display, target, phases)
    small = [n // 4 for n in shape] if place.full else [n // 2 for n in shape]
    display = Display(Modulator(small, pitch=8e-6), wavelengths=532e-9, distances=5e-3)
    there = [value[..., : small[0], : small[1]].contiguous() for value in (target, phases)]
    yield steps("from a CUDA graph", replayed, display, *there)
    display = Display(Modulator(small, pitch=8e-6), [639e-9, 532e-9, 473e-9], [4e-3, 5e-3], frames)
    generator = torch.Generator().manual_seed(5)
    pictures, start = torch.rand(3, *small, generator=generator), 6.28 * torch.rand(frames, *small, generator=generator)
    yield steps("of 3 colours, 2 planes", losses, display, pictures.expand(2, 3, *small), start)


def hologram(place: Place):
    """Yield the README's hologram by its quality."""
    import torch

    from odak.learn.tools import load_image
    from odak.learn.wave import Display, Modulator, Run, optimise

    target = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[1]
    if not place.full:
        target = target[:40, :60].contiguous()
    display = Display(Modulator(target.shape, pitch=8e-6), wavelengths=532e-9, distances=0.05 if place.full else 2e-3)
    run = Run(iterations=20 if place.full else 2, progress=False)

    def quality(display, target):
        return (torch.as_tensor(float(optimise(display, target, run=run).psnr)).reshape(1),)

    found = row(place, "the README's hologram, quality", quality, display, target)
    expected = float(quality(display, target)[0])
    found["decibels"], found["limit"] = expected, DECIBELS / expected
    yield found | {"ok": found["difference"] <= found["limit"]}


def perception(place: Place):
    """Yield losses and their gradients."""
    import torch

    from odak.learn.perception import FLIP, MSSSIM, BlurLoss, MetamericLoss, Viewing, delta_e, srgb_to_lab

    size = 512 if place.full else 192
    pictures = torch.rand(2, 1, 3, size, size, generator=torch.Generator().manual_seed(4))
    loss = MetamericLoss(n_pyramid_levels=3)

    def call(loss, image, target):
        image = image.detach().requires_grad_()
        value = loss(image, target, gaze=[0.5, 0.3])
        return value.reshape(1), *torch.autograd.grad(value, image)

    yield row(place, "metameric loss", call, loss, *pictures, limit=1e-3)

    def difference(image, target):
        return delta_e(srgb_to_lab(image), srgb_to_lab(target)).mean()

    viewing = Viewing.head_mounted((size, size), 20)
    for name, other in (
        ("MS-SSIM", MSSSIM()),
        ("FLIP", FLIP(viewing=viewing)),
        ("blurs", BlurLoss()),
        ("colour difference", difference),
    ):

        def plain(image, target, other=other):
            image = image.detach().requires_grad_()
            value = other(image, target).mean()
            return value.reshape(1), *torch.autograd.grad(value, image)

        yield row(place, name, plain, *pictures, limit=1e-3)


def lens(place: Place):
    """Yield rays through a triplet, in double precision, and the gradient by its curvatures."""
    import torch

    from odak.learn.raytracing.system import Rays, launch, load_system, trace

    triplet = load_system("cooke_triplet")
    rays = launch(triplet, "random", 100_000 if place.full else 30, fields=[(0.0, 10.0)])
    rays = [value.detach().expand(rays.x.shape).clone() for value in rays]

    def call(system, rays):
        traced = trace(system, Rays(*rays))
        return (torch.stack([traced.x, traced.y]).nan_to_num(),)

    yield row(place, "rays through a triplet", call, triplet, rays, limit=1e-9)


def scene(place: Place):
    """Yield light that finds its way through a plate and a ball to a screen, in double precision."""
    from odak.learn.raytracing import Conic, Element, Interface, Light, Plane, RayScene, light_source

    plate = [Element(Plane(), (1.0, 1.5)), Element(Plane(), (1.5, 1.0), center=(0, 0, 3))]
    ball = [
        Element(Conic(0.2), (1.0, 1.6), center=(0, 0, 5), aperture=4.0),
        Element(Conic(-0.2), (1.6, 1.0), center=(0, 0, 13), aperture=4.0),
    ]
    screen = Element(Plane(), interface=Interface(0, 0), center=(0, 0, 20), detects=True, name="screen")
    found = light_source("collimated", 100_000 if place.full else 40, size=1.0, center=(0, 0, -1))

    def call(rays, power):
        traced = RayScene([*plate, *ball, screen]).trace(Light(rays, power, None), 550e-6, split=True, threshold=1e-4)
        seen = traced.received["screen"]
        return traced.absorbed, (seen.point**2 * seen.power[:, None]).sum(0)

    yield row(place, "light through a plate and a lens", call, found.rays.double(), found.power.double(), limit=1e-9)


def compiled(place: Place):
    """Yield a propagation that torch compiled, beside the plain one of the processor."""
    import torch

    from odak.learn.wave import propagate_beam

    if place.name == "emulated":
        yield {"what": "a compiled propagation", "ok": True, "skipped": "torch does not compile within a mode"}
        return
    size = 512 if place.full else 24
    field = torch.randn(size, size, dtype=torch.complex64, generator=torch.Generator().manual_seed(6))

    def propagate(field):
        return propagate_beam(field, None, 5e-3, 8e-6, 532e-9, "Bandlimited Angular Spectrum") * 1

    made = torch.compile(propagate, fullgraph=True, backend="inductor" if place.full else "aot_eager")

    def call(field):
        return (made(field) if field.is_cuda or not place.full else propagate(field),)

    yield row(place, "a compiled propagation", call, field)


def tests(place: Place):
    """Yield the tests that are marked cuda."""
    missing = [name for name in FOR_TESTS if find_spec(name) is None]
    if missing or not place.full:
        yield {"what": "pytest -m cuda", "ok": not missing, "skipped": ", ".join(missing) or "no GPU"}
        return
    tested = runpy.run_path(str(ROOT / "benchmarks" / "__main__.py"))["tested"]
    found = tested(["test", "-m", "cuda", "-n", "0", "--continue-on-collection-errors"])
    yield {"what": "pytest -m cuda", "ok": bool(found["passed"]) and not found["failed"], **found}


def benchmarks(place: Place):
    """Yield the rows of one group of benchmarks after the other."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    for group in BENCHMARKS if place.full else ():
        for benchmark in runpy.run_path(str(ROOT / "benchmarks" / f"{group}.py"), run_name=group)["ALL"]:
            for found in benchmark(place.name):
                yield {"what": f"{group}: {found['task']}", "ok": True, **found}


# Checks and the most seconds that each may take.
CHECKS = (
    (propagation, 60),
    (displays, 90),
    (hologram, 45),
    (perception, 45),
    (lens, 30),
    (scene, 30),
    (compiled, 60),
    (tests, 120),
    (benchmarks, 600),
)


def work(device: str, first: int) -> None:
    """Run the checks from one on, and print a line of JSON for each row and for the end of each check."""
    warnings.simplefilter("ignore")
    place = Place(device)
    for number, (check, _) in enumerate(CHECKS[first:], first):
        begun, ended = time.perf_counter(), {"check": number}
        try:
            for found in check(place):
                print(json.dumps({"check": number, "row": found}), flush=True)
        except Exception as error:
            ended["error"] = f"{type(error).__name__}: {error}"[:2000]
            traceback.print_exc()
        print(json.dumps({**ended, "seconds": time.perf_counter() - begun}), flush=True)


def _lines(worker, kept: queue.SimpleQueue) -> None:
    with worker.stdout:
        for line in worker.stdout:
            kept.put(line)
    kept.put(None)


def supervise(device: str, minutes: float, output: Path, limits=None) -> dict:
    """Run the checks in a process of their own, within their limits, and write what is known after each line."""
    limits = limits or [seconds for _, seconds in CHECKS]
    report = {"about": about(device), "checks": {check.__name__: {"rows": []} for check, _ in CHECKS}}
    names, number, deadline = list(report["checks"]), 0, time.monotonic() + 60 * minutes
    while number < len(names) and time.monotonic() < deadline:
        command = [sys.executable, __file__, "--device", device, "--work", str(number)]
        worker = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        lines: queue.SimpleQueue = queue.SimpleQueue()
        reader = threading.Thread(target=_lines, args=(worker, lines), daemon=True)
        reader.start()
        begun, line = time.monotonic(), ""
        while number < len(names):
            held = report["checks"][names[number]]
            try:
                line = lines.get(timeout=max(0.0, min(begun + limits[number], deadline) - time.monotonic()))
            except queue.Empty:
                line, held["error"] = None, "ended: it took too long"
            if line is None:
                held.setdefault("error", "the process ended")
                number += 1
                break
            told = json.loads(line) if line.startswith("{") else {}
            if "row" in told:
                held["rows"].append(told["row"])
                print(_shown(names[number], told["row"]), flush=True)
            elif "check" in told:
                held.update({key: value for key, value in told.items() if key != "check"})
                number, begun = told["check"] + 1, time.monotonic()
            _write(report, output)
        worker.kill()
        worker.wait()
        reader.join()
    for name in names[number:]:
        report["checks"][name]["error"] = "not begun: the time was over"
    _write(report, output)
    return report


def _shown(check: str, found: dict) -> str:
    said = "ok" if found["ok"] else "FAILED"
    numbers = f"difference {found['difference']:.1e}, {found['seconds']:.4f} s" if "difference" in found else ""
    reads = f", {sum(found['reads'].values())} reads" if found.get("reads") is not None else ""
    return f"{check:12} {found['what']:50} {said:6} {numbers}{reads}"


def _write(report: dict, output: Path) -> None:
    report["ok"] = all("error" not in held and all(r["ok"] for r in held["rows"]) for held in report["checks"].values())
    output.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def about(device: str) -> dict:
    """Return the machine and the versions."""
    found = runpy.run_path(str(ROOT / "benchmarks" / "__main__.py"))["about"](device, 0)
    import torch

    missing = [name for name in (*FOR_TESTS, *FOR_FIGURES) if find_spec(name) is None]
    return {**found, "cuda": torch.version.cuda, "missing": missing}


def main() -> int:
    """Run what the command line asks for; return 1 if a check fails, 2 if there is no such device."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cuda", choices=["cuda", "cpu", "emulated"])
    parser.add_argument("--minutes", type=float, default=6.0, help="time for all checks together")
    parser.add_argument("--output", type=Path, default=Path("gpu_check.json"))
    parser.add_argument("--work", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    import torch

    if arguments.device == "cuda" and not torch.cuda.is_available():
        print(f"torch {torch.__version__} finds no CUDA device on this machine", file=sys.stderr)
        return 2
    if arguments.work is not None:
        work(arguments.device, arguments.work)
        return 0
    report = supervise(arguments.device, arguments.minutes, arguments.output)
    for name, held in report["checks"].items():
        if "error" in held:
            print(f"{name}: {held['error']}")
    if report["about"]["missing"]:
        print(f"not installed: {', '.join(report['about']['missing'])}; tests that need them are skipped")
    print(f"{'all checks passed' if report['ok'] else 'not all checks passed'}: see {arguments.output}")
    return int(not report["ok"])


if __name__ == "__main__":
    sys.exit(main())
