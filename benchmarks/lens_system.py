"""Lens benchmarks: rays through sequential systems against the same arithmetic in plain torch operations.

Optiland's torch backend traces the same rays through the same numbers beside it where it is installed: it is given
indices instead of glasses, keeps nothing of the surfaces on the way, and has fewer numbers to differentiate by.
"""

import importlib.util
import warnings
from collections.abc import Iterator

import torch
from measure import interleave
from wave_optics import row

from odak.learn.raytracing.system import Rays, fused, launch, load_system, optical_system, surface, trace
from odak.learn.raytracing.system.surfaces import layout_of

COUNT = 1_000_000
DTYPES = (torch.float32, torch.float64)


def _systems() -> dict:
    """Return a singlet and a triplet of six surfaces, at one wavelength."""
    faces = [surface(50.0, thickness=5.0, material="N-BK7", stop=True), surface(-50.0, thickness=47.0)]
    singlet = optical_system(faces, aperture=10.0)
    triplet = load_system("cooke_triplet")
    triplet.wavelengths, triplet.reference = triplet.wavelengths[1:2], 0
    return {"singlet": singlet, "triplet": triplet}


def _rays(system, dtype, device: str) -> Rays:
    """Return a million rays through the pupil in separate memory."""
    rays = launch(system, "random", COUNT, fields=[(0.0, 2.0)], dtype=dtype)
    return Rays(*(value.detach().expand(rays.x.shape).clone().to(device) for value in rays))


def forward(device: str) -> Iterator[dict]:
    """Yield a million rays to the image plane against one bare pass of the same arithmetic, out of place, whole."""
    for name, system in _systems().items():
        system = system.to(device)
        for dtype in DTYPES:
            rays = _rays(system, dtype, device)
            tasks = {"ours": lambda s=system, r=rays: trace(s, r), "plain torch": _bare(system, rays)}
            if theirs := _optiland(system, rays):
                tasks["optiland"] = lambda task=theirs, r=rays: task(r)
                _check(trace(system, rays), theirs(rays))
            with torch.no_grad():
                timings = interleave(tasks, 5, device)
            yield from _rows(f"{name} forward", dtype, timings)


def gradients(device: str) -> Iterator[dict]:
    """Yield forward and backward, by rays and all numbers, against the same of plain operations under autograd."""
    for name, system in _systems().items():
        system = system.to(device)
        system.vary(curvature=range(len(system.surfaces)), thickness=range(len(system.surfaces)))
        for dtype in DTYPES:
            rays = Rays(*(value.requires_grad_() for value in _rays(system, dtype, device)))
            plain, theirs = _bare(system, rays), _optiland(system, rays, gradients=True)
            tasks = {
                "ours": lambda s=system, r=rays: trace(s, r).y.square().sum().backward(),
                "plain torch": lambda task=plain: task()[1].square().sum().backward(),
            }
            more = {"saved_bytes_per_ray": _saved(lambda s=system, r=rays: trace(s, r))}
            if theirs:
                tasks["optiland"] = lambda task=theirs, r=rays: task(r).y.square().sum().backward()
                more["optiland_saved_bytes_per_ray"] = _saved(lambda task=theirs, r=rays: task(r))
            yield from _rows(f"{name} and back", dtype, interleave(tasks, 3, device), **more)


def saved(device: str) -> Iterator[dict]:
    """Yield what is kept per ray for gradients, the rays that came in included; with a surface tilted, too."""
    for name, system in _systems().items():
        system = system.to(device)
        system.vary(curvature=range(len(system.surfaces)))
        for dtype, tilted in ((torch.float32, False), (torch.float64, False), (torch.float32, True)):
            if tilted:
                system.vary(tilt=1)
            rays = Rays(*(value[..., : COUNT // 10].clone() for value in _rays(system, dtype, device)))
            kept = _saved(lambda s=system, r=rays: trace(s, r))
            task = f"{name}{', tilted' * tilted}: bytes a ray kept, {str(dtype)[6:]}"
            yield {"task": task, "ours_arrays": kept, "floor": "300 bytes", "ratio": kept / 300, "bound": 1.0}


def _bare(system, rays):
    """Return the plain pass: what one would write down, with every ray whole."""
    numbers = system.prescription()
    layout = layout_of(system.surfaces, numbers)
    flat = tuple(value.reshape(1, -1) for value in rays)
    # Created each time, because a graph is freed by its backward pass.
    return lambda: fused.plain(layout, system.prescription().numbers(), flat)


def _saved(task) -> float:
    """Return the bytes per ray that autograd keeps of a task, rays included."""
    kept = {}

    def note(value):
        kept[value.untyped_storage().data_ptr()] = (value.untyped_storage().nbytes(), value)
        return value

    with torch.autograd.graph.saved_tensors_hooks(note, lambda value: value):
        traced = task()
    return sum(size for size, _ in kept.values()) / traced.y.numel()


def _rows(what: str, dtype, timings, **more) -> Iterator[dict]:
    """Yield our time against that of each of the others."""
    ours = timings.pop("ours").best
    for name, timing in timings.items():
        rates = {"rays_per_s": COUNT / ours, "floor_rays_per_s": COUNT / timing.best}
        task = f"{what}, 1 M rays {str(dtype)[6:]}: {COUNT / ours / 1e6:.1f} M/s"
        yield row(task, ours, timing.best, name, 1.0, **rates, **more)
    if "optiland" not in timings:
        yield row(f"{what}, 1 M rays {str(dtype)[6:]}", ours, ours, "itself, no optiland", None)


def _optiland(system, rays: Rays, gradients: bool = False):
    """Return optiland's trace through the same system as a function of the rays, None if it is not installed."""
    if importlib.util.find_spec("optiland") is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import optiland.backend as be
        from optiland.materials import IdealMaterial
        from optiland.optic import Optic
        from optiland.rays import RealRays

    dtype, device = rays.x.dtype, rays.x.device
    be.set_backend("torch")
    be.set_device(device.type)
    be.set_precision(str(dtype)[6:])
    be.grad_mode.enable() if gradients else be.grad_mode.disable()
    lens = Optic()
    lens.surfaces.add(index=0, thickness=be.inf)
    for i, item in enumerate(system.surfaces):
        medium = IdealMaterial(n=float(system.prescription().index[0, i + 1]))
        lens.surfaces.add(
            index=i + 1,
            radius=float(item.radius.detach()),
            thickness=float(item.thickness.detach()),
            material="air" if item.material == "air" else medium,
            is_stop=i == system.stop,
        )
        if gradients:
            radius = torch.tensor(float(item.radius.detach()), dtype=dtype, device=device, requires_grad=True)
            lens.surfaces[i + 1].geometry.radius = radius
    lens.surfaces.add(index=len(system.surfaces) + 1)
    lens.set_aperture(aperture_type="EPD", value=system.aperture)
    lens.fields.set_type(field_type="angle")
    lens.fields.add(y=0)
    lens.wavelengths.add(value=0.5875618, is_primary=True)
    one = torch.ones(rays.x.numel(), dtype=dtype, device=device)

    def task(rays):
        # The trace moves its rays in place.
        flat = [value.reshape(-1) for value in rays]
        return lens.surfaces.trace(RealRays(*flat, one, 0.5875618 * one), record=False)

    return task


def _check(ours, theirs) -> None:
    """Raise unless both came to the same points by the same optical paths."""
    share = 64 * torch.finfo(ours.y.dtype).eps
    torch.testing.assert_close(theirs.y, ours.y.reshape(-1), rtol=0, atol=100 * share)
    torch.testing.assert_close(theirs.opd, ours.path.reshape(-1), rtol=0, atol=1000 * share)


ALL = (forward, gradients, saved)
