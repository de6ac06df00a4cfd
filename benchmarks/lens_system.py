"""Lens benchmarks: rays through sequential systems against the same arithmetic in plain torch operations.

Optiland's torch backend is timed beside it where it is installed.
"""

import importlib.util
from collections.abc import Iterator

import torch
from measure import interleave
from wave_optics import row

from odak.learn.raytracing.system import Rays, fused, launch, load_system, optical_system, surface, trace
from odak.learn.raytracing.system.prescription import layout_of

COUNT = 1_000_000
DTYPES = (torch.float32, torch.float64)


def _systems() -> dict:
    faces = [surface(50.0, thickness=5.0, material="N-BK7", stop=True), surface(-50.0, thickness=47.0)]
    singlet = optical_system(faces, aperture=10.0)
    triplet = load_system("cooke_triplet")
    triplet.wavelengths, triplet.reference = triplet.wavelengths[1:2], 0
    return {"singlet": singlet, "triplet": triplet}


def _rays(system, dtype, device: str) -> Rays:
    """Return a million rays through the pupil in memory of their own, none shared."""
    rays = launch(system, "random", COUNT, fields=[(0.0, 2.0)], dtype=dtype)
    return Rays(*(value.detach().expand(rays.x.shape).clone().to(device) for value in rays))


def forward(device: str) -> Iterator[dict]:
    """Yield a million rays to the image plane against one bare pass of the same arithmetic, out of place, whole."""
    for name, system in _systems().items():
        system = system.to(device)
        for dtype in DTYPES:
            rays = _rays(system, dtype, device)
            tasks = {"ours": lambda s=system, r=rays: trace(s, r), "bare": _bare(system, rays)}
            tasks |= _optiland(name, dtype)
            with torch.no_grad():
                timings = interleave(tasks, 5, device)
            yield _row(name, "forward", dtype, timings, rays)


def gradients(device: str) -> Iterator[dict]:
    """Yield forward and backward, by rays and all numbers, against the same of plain operations under autograd."""
    for name, system in _systems().items():
        system = system.to(device)
        system.vary(curvature=range(len(system.surfaces)), thickness=range(len(system.surfaces)))
        for dtype in DTYPES:
            rays = Rays(*(value[..., : COUNT // 4].clone().requires_grad_() for value in _rays(system, dtype, device)))

            def ours(system=system, rays=rays):
                (trace(system, rays).y.square().sum()).backward()

            plain = _bare(system, rays)

            def bare(plain=plain):
                plain()[1].square().sum().backward()

            timings = interleave({"ours": ours, "bare": bare}, 3, device)
            yield _row(name, "and back", dtype, timings, rays, saved=_saved(system, rays))


def _bare(system, rays):
    """Return the plain pass: what one would write down, with every ray whole."""
    numbers = system.prescription()
    layout = layout_of(system.surfaces, numbers)
    flat = tuple(value.reshape(1, -1) for value in rays)
    # Made anew each time: a graph lives for one backward pass.
    return lambda: fused.plain_trace(layout, system.prescription().numbers(), flat)


def _saved(system, rays) -> float:
    """Return the bytes per ray that autograd keeps, rays included."""
    kept = {}

    def note(value):
        kept[value.untyped_storage().data_ptr()] = value.untyped_storage().nbytes()
        return value

    with torch.autograd.graph.saved_tensors_hooks(note, lambda value: value):
        trace(system, rays)
    return sum(kept.values()) / rays.x.numel()


def _row(name: str, what: str, dtype, timings, rays, **more) -> dict:
    ours, bare = timings["ours"].best, timings["bare"].best
    count = rays.x.numel()
    more |= {"rays_per_s": count / ours}
    if "optiland" in timings:
        more["optiland_rays_per_s"] = count / timings["optiland"].best
    task = f"{name} {what}, {count / 1e6:g} M rays {str(dtype)[6:]}: {count / ours / 1e6:.1f} M/s"
    return row(task, ours, bare, "plain torch", 1.0, **more)


def _optiland(name: str, dtype) -> dict:
    """Return optiland's trace of the same singlet, if it is installed."""
    if name != "singlet" or importlib.util.find_spec("optiland") is None:
        return {}
    import optiland.backend as be
    from optiland.optic import Optic
    from optiland.rays import RealRays

    be.set_backend("torch")
    be.set_precision("float32" if dtype == torch.float32 else "float64")
    lens = Optic()
    lens.add_surface(index=0, thickness=be.inf)
    lens.add_surface(index=1, radius=50.0, thickness=5.0, material="N-BK7", is_stop=True)
    lens.add_surface(index=2, radius=-50.0, thickness=47.0)
    lens.add_surface(index=3)
    lens.set_aperture(aperture_type="EPD", value=10.0)
    lens.set_field_type("angle")
    lens.add_field(y=2.0)
    lens.add_wavelength(value=0.5875618, is_primary=True)
    place = torch.rand(2, COUNT, dtype=dtype) * 7 - 3.5
    still, one = torch.zeros(COUNT, dtype=dtype), torch.ones(COUNT, dtype=dtype)

    def task():
        lens.surface_group.trace(RealRays(*place, still - 1, still, still, one, one, 0.5875618 * one))

    return {"optiland": task}


ALL = (forward, gradients)
