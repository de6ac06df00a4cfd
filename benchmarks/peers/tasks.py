"""Tasks of the comparison in the documented calls of each library.

``python tasks.py LIBRARY TRUTH`` runs in that library's environment and prints one JSON object. TRUTH is a file with
the exact field of the beam `TIGHT`.
"""

import json
import pathlib
import sys
import time
import warnings
from collections.abc import Callable

import numpy
from beams import TIGHT, TIMED, WAVELENGTH, error

# At the end, so that no module of the benchmarks hides one that a library imports.
sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from measure import peak_memory

RUNS, RAYS = 5, 1_000_000
# A Cooke triplet: radius and thickness in mm, index behind the surface. The fourth surface is the stop.
TRIPLET = (
    (22.01359, 3.258956, 1.62041),
    (-435.76044, 6.007551, 1.0),
    (-22.21328, 0.9999746, 1.62004),
    (20.29192, 4.750409, 1.0),
    (79.68360, 2.952076, 1.62041),
    (-18.39533, 42.20778, 1.0),
)


def odak() -> dict:
    """Measure the band-limited angular spectrum in both precisions and a sequential trace."""
    import torch

    from odak.learn.raytracing.system import Rays, optical_system, surface, trace
    from odak.learn.wave import band_limited_angular_spectrum
    from odak.wave.transfer_functions import clear_kernel_cache

    torch.set_num_threads(2)

    def field(beam, distance, dtype=torch.complex128):
        start = torch.from_numpy(beam.start()).to(dtype)
        call = 2 * torch.pi / WAVELENGTH, distance, beam.pitch, WAVELENGTH
        return lambda: band_limited_angular_spectrum(start, *call)

    def forgetful(beam, distance):
        task = field(beam, distance)
        return lambda: (clear_kernel_cache(), task())[1]

    faces = [surface(r, thickness=t, material=n, stop=i == 3) for i, (r, t, n) in enumerate(TRIPLET)]
    system = optical_system(faces, aperture=10.0, wavelengths=[587.6e-9])
    rays = Rays(*(torch.from_numpy(values)[None, None] for values in parallel_rays()))

    def traced():
        found = trace(system, rays)
        return found.x, found.y

    with torch.no_grad():
        return {
            "waves": {
                "new distance": propagation(forgetful),
                "same again": propagation(field),
                "same again, complex64": propagation(lambda beam, z: field(beam, z, torch.complex64)),
            },
            "slope": torch_slope(field),
            "rays": {"torch": rays_of(traced)},
        }


def torchoptics() -> dict:
    """Measure ``Field.propagate_to_z`` as it comes and with its padding off."""
    import torch
    from torchoptics import Field

    torch.set_num_threads(2)

    def field(beam, distance, **options):
        start = Field(torch.from_numpy(beam.start()), WAVELENGTH, spacing=beam.pitch)
        return lambda: start.propagate_to_z(distance, **options).data

    def unpadded(beam, distance):
        return field(beam, distance, asm_pad=(0, 0))

    with torch.no_grad():
        waves = {"as it comes": propagation(field), "asm_pad=0": propagation(unpadded)}
        return {"waves": waves, "slope": torch_slope(unpadded)}


def diffractio() -> dict:
    """Measure ``Scalar_field_XY.RS``."""
    from diffractio.scalar_fields_XY import Scalar_field_XY

    def field(beam, distance):
        axis = (numpy.arange(beam.size) - beam.size // 2) * beam.pitch * 1e6  # micrometres
        start = Scalar_field_XY(axis, axis, WAVELENGTH * 1e6)
        start.u = beam.start()
        return lambda: start.RS(z=distance * 1e6, new_field=True, verbose=False).u

    return {"waves": {"RS": propagation(field)}}


def prysm() -> dict:
    """Measure ``propagation.angular_spectrum`` without and with its padding."""
    from prysm.propagation import angular_spectrum

    def field(beam, distance, padding):
        start, edge = beam.start(), (padding - 1) * beam.size // 2
        middle = slice(edge, edge + beam.size)
        call = WAVELENGTH * 1e6, beam.pitch * 1e3, distance * 1e3  # micrometres, millimetres
        return lambda: angular_spectrum(start, *call, Q=padding)[middle, middle]

    return {"waves": {f"Q={q}": propagation(lambda beam, z, q=q: field(beam, z, q)) for q in (1, 2)}}


def LightPipes() -> dict:
    """Measure ``Forvard`` (spectral) and ``Fresnel`` (convolution)."""
    from LightPipes import Begin, Forvard, Fresnel

    def field(beam, distance, task):
        start = Begin(beam.size * beam.pitch, WAVELENGTH, beam.size)
        start.field[:] = beam.start()
        return lambda: task(start, distance).field

    tasks = {"Forvard": Forvard, "Fresnel": Fresnel}
    return {"waves": {name: propagation(lambda beam, z, t=t: field(beam, z, t)) for name, t in tasks.items()}}


def optiland() -> dict:
    """Measure a sequential trace with either backend."""
    import optiland.backend as be

    found = {}
    for backend in ("numpy", "torch"):
        be.set_backend(backend)
        if backend == "torch":
            import torch

            torch.set_num_threads(2)
            be.set_precision("float64")
            be.grad_mode.disable()
        found[backend] = rays_of(_optiland_trace(be))
    return {"rays": found}


def _optiland_trace(be):
    from optiland.materials import IdealMaterial
    from optiland.optic import Optic
    from optiland.rays import RealRays

    lens = Optic()
    lens.surfaces.add(index=0, thickness=be.inf)
    for i, (radius, thickness, index) in enumerate(TRIPLET):
        medium = IdealMaterial(n=index) if index > 1 else "air"
        lens.surfaces.add(index=i + 1, radius=radius, thickness=thickness, material=medium, is_stop=i == 3)
    lens.surfaces.add(index=len(TRIPLET) + 1)
    lens.set_aperture(aperture_type="EPD", value=10.0)
    lens.fields.set_type(field_type="angle")
    lens.fields.add(y=0)
    lens.wavelengths.add(value=0.5876, is_primary=True)
    given = [*parallel_rays(), numpy.ones(RAYS), numpy.full(RAYS, 0.5876)]

    def traced():
        found = lens.surfaces.trace(RealRays(*(be.array(value) for value in given)), record=False)
        return found.x, found.y

    return traced


def propagation(prepared: Callable) -> dict:
    """Time the beam `TIMED` and hold the beam `TIGHT` against its exact field."""
    field = prepared(TIGHT, TIGHT.distance)()
    return timed(prepared(TIMED, TIMED.distance)) | {"error": error(field, numpy.load(sys.argv[2]))}


def torch_slope(prepared: Callable) -> float:
    """Return the relative error of d(intensity on the axis)/d(distance), found by autograd."""
    import torch

    with torch.enable_grad():
        distance = torch.tensor(TIMED.distance, dtype=torch.float64, requires_grad=True)
        field = prepared(TIMED, distance)()
        intensity = field[..., TIMED.size // 2, TIMED.size // 2].abs().square().sum()
        return abs(torch.autograd.grad(intensity, distance)[0].item() / TIMED.on_axis_slope() - 1)


def parallel_rays() -> tuple[numpy.ndarray, ...]:
    """Return x, y, z and the direction cosines of RAYS rays along the axis, in a disk of 5 mm radius."""
    generator = numpy.random.default_rng(1)
    radius, angle = 5 * numpy.sqrt(generator.random(RAYS)), 2 * numpy.pi * generator.random(RAYS)
    zero = numpy.zeros(RAYS)
    return radius * numpy.cos(angle), radius * numpy.sin(angle), zero - 5, zero, zero, zero + 1


def rays_of(traced: Callable) -> dict:
    """Time a trace; the RMS spot size in mm verifies that all traced the same lens."""
    x, y = (numpy.asarray(value).reshape(-1) for value in traced())
    return timed(traced) | {"rms": float(numpy.sqrt(numpy.var(x) + numpy.var(y)))}


def timed(task: Callable) -> dict:
    """Return the best of RUNS runs after one to warm up, and by how much the peak of resident memory grew."""
    before = peak_memory()
    task()
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        task()
        seconds.append(time.perf_counter() - start)
    return {"seconds": min(seconds), "bytes": peak_memory() - before}


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    print(json.dumps(globals()[sys.argv[1]]()))
