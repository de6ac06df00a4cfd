"""Holograms by every door, path, solver and start are the ones that are recorded in `recordings.json`.

Each case names all options and runs for few iterations, mostly in double precision, so that differences of rounding
between processors stay far below its bound. Of each array the file holds its shape, its root mean square, and four sums
with weights of which no sample is without any. What a change moves on purpose is recorded anew by

    python test/learn/wave/test_recordings.py [words of the names of cases]

which prints the old and the new values of the cases that moved.
"""

import json
import sys
import tempfile
import warnings
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

from odak.instruments import Lens
from odak.learn import wave
from odak.learn.wave.displays import judge

FILE = Path(__file__).with_name("recordings.json")
SHAPE, PITCH, COLOURS = (24, 20), 8e-6, [639e-9, 515e-9]
GREEN, CLOSE = 532e-9, 2e-3
QUIET = {"progress": False, "callback": None, "checkpoint": None, "checkpoint_every": 50}
CASES = {}


def case(name, *arguments, bound=1e-6, slow=False, **options):
    """Add a case: what `function(*arguments, **options)` returns, a dictionary of arrays."""

    def add(function):
        assert name not in CASES, name
        CASES[name] = (lambda folder: function(folder, *arguments, **options), bound, slow)
        return function

    return add


def picture(*shape, dtype=torch.float64):
    """Return smooth intensities of 0.05 … 0.85, of a formula, different on each plane and in each colour."""
    places = torch.meshgrid(*[torch.arange(n, dtype=torch.float64) / n for n in shape], indexing="ij")
    waves = sum(torch.sin(2 * torch.pi * (k + 1) * place + 0.7 * k) for k, place in enumerate(places)) / len(places)
    spot = sum((place - 0.4) ** 2 for place in places[-2:]) < 0.06
    return (0.25 + 0.2 * waves + 0.4 * spot).to(dtype)


def phases_of(*shape):
    return 6 * picture(*shape)


def phasors(phases):
    return wave.unit_phasor(phases)


def summary(values):
    """Return shape, root mean square and four weighted sums of an array."""
    values = torch.as_tensor(values).detach().resolve_conj().cpu()
    shape = list(values.shape)
    numbers = (torch.view_as_real(values) if values.is_complex() else values).double().flatten()
    index = torch.arange(1, len(numbers) + 1, dtype=torch.float64)
    sums = [(numbers * torch.cos(factor**0.5 * index)).sum() / max(len(numbers), 1) ** 0.5 for factor in (2, 3, 5, 7)]
    root = numbers.square().mean().sqrt()
    return {"shape": shape, "rms": float(f"{root:.9g}"), "sums": [float(f"{one:.9g}") for one in sums]}


# Displays, by all solvers, starts and paths.


def modulator(**options):
    given = {"resolution": SHAPE, "pitch": PITCH, "bits": 8, "fill": 0.9, "response": None, "lit_through": None}
    return wave.Modulator(**(given | options))


def a_display(panel=None, wavelengths=GREEN, distances=CLOSE, **options):
    given = {"frames": 1, "powers": None, "profile": None, "iris": "order", "medium": 1.0}
    return wave.Display(panel or modulator(), wavelengths, distances, **(given | options))


def two_panels(distance, iris):
    return modulator(lit_through=wave.AmplitudePanel(distance=distance, bits=8, fill=0.9, iris=iris))


EYES = {"positions": [[0.0, -1e-3], [0.0, 1e-3]], "diameter": 2e-3, "focus": None, "rotation": (0.0, 0.0)}
DISPLAYS = {
    "free": lambda: a_display(),
    "free through an iris": lambda: a_display(iris=wave.Iris(2e-3, 0.2)),
    "free without an iris": lambda: a_display(iris=None),
    "narrow iris": lambda: a_display(iris=wave.Iris(4e-4 * 8, 0.2)),
    "planes": lambda: a_display(None, GREEN, [2e-3, 3e-3]),
    "planes and colours": lambda: a_display(None, COLOURS, [2e-3, 3e-3], frames=2),
    "oblong pixels": lambda: a_display(modulator(pitch=(8e-6, 6e-6))),
    "shared frames": lambda: a_display(None, COLOURS, CLOSE, frames=2, powers=torch.tensor([[1.0, 0.5], [0.25, 1.0]])),
    "profile in glass": lambda: a_display(profile=picture(*SHAPE) + 0.5, medium=1.5),
    "lens": lambda: a_display(None, GREEN, Lens(50e-3, before=40e-3, after=50e-3)),
    "eyes": lambda: a_display(None, GREEN, wave.Eyes(0.1, **EYES)),
    "eyepiece": lambda: a_display(None, GREEN, wave.Eyes(Lens(40e-3, after=25e-3), **EYES)),
    "two panels": lambda: a_display(two_panels(0.0, "order")),
    "two panels apart": lambda: a_display(two_panels(1e-3, None)),
}  # fmt: skip


def found(hologram):
    """Return what a hologram states: patterns, images and qualities."""
    parts = {"patterns": phasors(hologram.phases), "images": hologram.images, "brightness": hologram.brightness}
    parts |= {"psnr": hologram.psnr, "psnr at points": hologram.psnr_at_points}
    parts |= {"powers": hologram.display.powers}
    parts |= {"losses": list(hologram.losses)} if hologram.losses else {}
    others = {"in focus": hologram.psnr_in_focus, "amplitudes": hologram.amplitudes}
    return parts | {name: value for name, value in others.items() if value is not None}


def solved(folder, display, solver, start, seed=0, iterations=6, loss=None, target=None, dtype=torch.float64):
    shown = DISPLAYS[display]()
    run = wave.Run(iterations, seed=seed, **QUIET)
    target = picture(*shown.shape, dtype=dtype) if target is None else target
    # Registered, as all of them were when they were recorded.
    who = wave.Observer.camera(registered=True)
    return found(wave.optimise(shown, target, loss=loss, solver=solver, start=start, run=run, observer=who))


def noisy(images, target, generator=None):
    noise = torch.randn(target.shape, dtype=target.dtype, generator=generator)
    return (images - target - 0.1 * noise).square().mean()


for display in DISPLAYS:
    case(f"optimise · {display} · lbfgs", display, "lbfgs", "gs")(solved)
    case(f"optimise · {display} · adam", display, "adam", "random", seed=3)(solved)
for display in ("free", "free through an iris", "oblong pixels", "profile in glass"):
    case(f"optimise · {display} · gs", display, "gs", "quadratic")(solved)
case("optimise · free through an iris · double phase", "narrow iris", "double phase", "flat")(solved)
# In single precision, the level of a phase beside the middle of two is either of them: 2π/256 in a few of 480 pixels.
case("optimise · free · network", "free", "network", "flat", dtype=torch.float32, bound=1e-2)(solved)
case("optimise · free · lbfgs from double phase", "free", "lbfgs", "double phase")(solved)
case("optimise · free · adam with a loss that draws", "free", "adam", "flat", seed=5, loss=noisy)(solved)
case("optimise · shared frames · powers", "shared frames", wave.Descent("lbfgs", powers=True), "gs")(solved)
case("optimise · planes · with depth", "planes", "lbfgs", "gs", target=(picture(1, *SHAPE), picture(*SHAPE)))(solved)


def judged(folder, display):
    """Images and fields of phases that no solver has touched."""
    shown = DISPLAYS[display]()
    phases = phases_of(shown.frames, *SHAPE)
    amplitudes = None if shown.modulator.lit_through is None else picture(*phases.shape)
    areas, points = shown.judge(phases, amplitudes)
    parts = {"areas": areas, "points": points, "images": shown(phases, amplitudes=amplitudes)}
    return parts if shown.eyes is not None else parts | {"fields": shown.fields(phases, amplitudes)}


for display in DISPLAYS:
    case(f"display · {display}", display)(judged)


# Older doors.


def descent(folder, interrupted=False, **options):
    given = {
        "propagation_type": "Bandlimited Angular Spectrum", "n_iteration": 6, "loss_function": None,
        "learning_rate": 0.1, "optimizer": "adam", "initial_phase": None, "seed": 3, "scale": False, "frames": 1,
        "slm": None, "iris_radius": None, "iris_focal_length": None, "camera": None, "pixel_fill": None,
    }  # fmt: skip
    given |= QUIET | options
    path = folder / "state.pt"
    if interrupted:
        halfway = given | {"callback": stops, "checkpoint": path}
        wave.stochastic_gradient_descent(0.8 * picture(*SHAPE), GREEN, CLOSE, PITCH, **halfway)
        given |= {"checkpoint": path}
    hologram, shown = wave.stochastic_gradient_descent(0.8 * picture(*SHAPE), GREEN, CLOSE, PITCH, **given)
    parts = {"pattern": hologram, "image": shown}
    return parts | (held(path) if interrupted else {})


def stops(step, loss):
    """Stop a run after its third step, so that the next takes it up."""
    return step == 2


def held(path):
    """Return what a checkpoint holds."""
    state = torch.load(path, weights_only=True)
    known = {f"{part} {name}": value for part in ("parameters", "best") for name, value in state[part].items()}
    return {f"checkpoint: {name}": value for name, value in (known | {"done": state["done"]}).items()}


class Bent(torch.nn.Module):
    """A modulator whose phase falls short."""

    def forward(self, phase, scale=1.0):
        return 0.9 * wave.unit_phasor(0.95 * phase * scale) + 0.1


case("descent · adam")(descent)
case("descent · adam and a checkpoint", interrupted=True)(descent)
case("descent · lbfgs and a checkpoint", interrupted=True, optimizer="lbfgs", initial_phase="gs", scale=True)(descent)
case("descent · iris and fill", iris_radius=2e-3, iris_focal_length=0.2, pixel_fill=0.8, scale=True)(descent)
case("descent · frames and a modulator", frames=2, slm=Bent(), initial_phase="quadratic")(descent)
case("descent · a loss that draws", loss_function=noisy, initial_phase="random")(descent)
case("descent · Fresnel", propagation_type="Transfer Function Fresnel", initial_phase="double phase")(descent)


def projections(folder, function=wave.gerchberg_saxton, **options):
    given = {
        "slm_range": 6.28, "propagation_type": "auto", "initial_phase": None, "seed": 3, "progress": False,
        "callback": None, "pixel_fill": None, "accelerated": False,
    }  # fmt: skip
    field = picture(*SHAPE).sqrt() + 0j
    hologram, shown = wave.gerchberg_saxton(field, 6, CLOSE, PITCH, GREEN, **(given | options))
    return {"pattern": hologram, "image": shown}


case("projections")(projections)
case("projections · accelerated", accelerated=True, pixel_fill=0.9, slm_range=2 * np.pi, seed=4)(projections)
case("projections · from a phase", initial_phase=phases_of(*SHAPE), propagation_type="Angular Spectrum")(projections)


@case("projections · in space")
@case("projections · in space, doubly constrained", target_type="double constraint", coefficients=(1.0, 0.6, 0.8))
def in_space(folder, target_type="no constraint", coefficients=None):
    fields = picture(2, *SHAPE).sqrt() + 0j
    hologram = wave.gerchberg_saxton_3d(
        fields, 5, [2e-3, 3e-3], PITCH, GREEN, slm_range=6.28, propagation_type="auto", initial_phase=None,
        target_type=target_type, coefficients=coefficients, seed=3, pixel_fill=None,
    )  # fmt: skip
    return {"pattern": hologram}


@case("double phase")
@case("double phase · iris, fill and phase", radius=1e-3, fill=0.9, phase=True)
def double_phase(folder, radius=None, fill=None, phase=False):
    hologram, shown = wave.double_phase_hologram(
        picture(*SHAPE), GREEN, CLOSE, PITCH, "Bandlimited Angular Spectrum", iris=True, iris_radius=radius,
        image_phase=phases_of(*SHAPE) if phase else None, iris_focal_length=None if radius is None else 0.2,
        pixel_fill=fill,
    )  # fmt: skip
    return {"pattern": hologram, "image": shown}


@case("points and shifts")
def points_and_shifts(folder):
    lens = wave.point_wise(picture(*SHAPE), GREEN, CLOSE, PITCH, torch.device("cpu"), lens_size=9)
    shifted = wave.shift_w_double_phase(
        phases_of(*SHAPE), 1e-3, PITCH, GREEN, "Transfer Function Fresnel", kernel_length=4, sigma=0.5,
        amplitude=picture(*SHAPE), pixel_fill=0.9,
    )  # fmt: skip
    return {"points": lens, "shifted": phasors(shifted)}


def a_propagator(**options):
    given = {
        "resolution": SHAPE, "wavelengths": COLOURS, "pixel_pitch": PITCH, "resolution_factor": 1,
        "number_of_frames": 2, "number_of_depth_layers": 2, "volume_depth": 1e-3, "image_location_offset": CLOSE,
        "propagation_type": "Bandlimited Angular Spectrum", "propagator_type": "forward",
        "back_and_forth_distance": 0.3, "laser_channel_power": None, "aperture": "open", "aperture_size": None,
        "distances": None, "aperture_samples": (20, 20, 5, 5), "method": "conventional", "vaccination_scale": 1e-4,
        "vaccination": False, "slm": None, "memory_budget": None, "seed": None, "iris_radius": None,
        "iris_focal_length": None, "pixel_fill": None,
    }  # fmt: skip
    given |= {"aperture": None} if {"aperture_size", "iris_radius"} & options.keys() else {}
    return wave.propagator(**(given | options))


def propagated(folder, method="conventional", **options):
    display = a_propagator(method=method, **options)
    phases, light = phases_of(2, *SHAPE), torch.ones(SHAPE, dtype=torch.complex128) * phasors(phases_of(*SHAPE))
    kernels = {"kernels": display.kernels} if display._has_kernels else {}
    return kernels | {
        "images": display.reconstruct(phases), "fields": display.reconstruct(phases, get_complex=True),
        "one plane": display(light, 1, 0), "distances": display.distances,
    }  # fmt: skip


FREE = {"propagator_type": "forward"}
RELAYED = {"propagator_type": "back and forth", "image_location_offset": 1e-3}
# Averages over points of the target lose light, as they say.
POINTS = {"aperture_samples": (20, 20, 1, 1), "resolution_factor": 2}
case("propagator · open", **FREE)(propagated)
case("propagator · relayed", **RELAYED)(propagated)
case("propagator · round stop", aperture_size=16, **RELAYED)(propagated)
case("propagator · released stop", aperture=None, **RELAYED)(propagated)
case("propagator · mask", aperture=picture(*SHAPE), **FREE)(propagated)
case("propagator · iris and fill", iris_radius=2e-3, iris_focal_length=0.2, pixel_fill=0.9, **FREE)(propagated)
case("propagator · angular spectrum, distances", propagation_type="Angular Spectrum", distances=[1e-3, 2.5e-3])(
    propagated
)
case("propagator · Fresnel, powers", propagation_type="Transfer Function Fresnel", laser_channel_power=picture(2, 2))(
    propagated
)
case("propagator · impulse response", propagation_type="Impulse Response Fresnel", **POINTS)(propagated)
case("propagator · separable response", propagation_type="Seperable Impulse Response Fresnel", **POINTS, **RELAYED)(
    propagated
)
case("propagator · incoherent", propagation_type="Incoherent Angular Spectrum", **FREE)(propagated)
case("propagator · Fraunhofer", propagation_type="Fraunhofer", **FREE)(propagated)
case("propagator · misplaced, powers by cosines", "multi-color", vaccination=True, seed=7, **FREE)(propagated)
case("propagator · a modulator, in parts", slm=Bent(), memory_budget=100_000, **RELAYED)(propagated)


def older_display(folder, pad=(True, True), illumination=None, **options):
    display = wave.holographic_display(
        wavelengths=COLOURS, pixel_pitch=PITCH, resolution=SHAPE, volume_depth=1e-3, number_of_depth_layers=2,
        image_location_offset=CLOSE, pad=pad, illumination=illumination,
        **({"pinhole_size": 1500, "propagation_type": "Bandlimited Angular Spectrum"} | options),
    )  # fmt: skip
    light = phasors(phases_of(*SHAPE))
    return {"images": display.reconstruct(phases_of(3, *SHAPE), picture(3, 2)), "one plane": display(light, 1, 0)}


case("holographic display")(older_display)
case("holographic display · pinhole, light", pinhole_size=14, illumination=picture(*SHAPE))(older_display)
case("holographic display · not padded", (False, True), propagation_type="Angular Spectrum")(older_display)


def several_planes(folder, interrupted=False, **options):
    given = {
        "propagation_type": "Bandlimited Angular Spectrum", "propagator_type": "forward", "number_of_iterations": 4,
        "learning_rate": 0.1, "phase_initial": None, "amplitude_initial": None, "loss_function": None,
        "mask_limits": (0.2, 0.8, 0.05, 0.95), "number_of_planes": 2, "zero_mode_distance": 0.15, "seed": 3,
        "pixel_fill": None, "frames": 1, "aperture": "open", "aperture_size": None,
    }  # fmt: skip
    given |= QUIET | options
    path = folder / "state.pt"
    if interrupted:
        halfway = given | {"callback": stops, "checkpoint": path}
        wave.multiplane_hologram_optimizer(
            GREEN, CLOSE, 1e-3, PITCH, SHAPE, 0.8 * picture(2, *SHAPE), **halfway
        ).optimize()
        given |= {"checkpoint": path}
    optimizer = wave.multiplane_hologram_optimizer(GREEN, CLOSE, 1e-3, PITCH, SHAPE, 0.8 * picture(2, *SHAPE), **given)
    phase, amplitude, images = optimizer.optimize()
    parts = {"pattern": phasors(phase), "amplitude": amplitude, "images": images}
    return parts | (held(path) if interrupted else {})


def of_planes(image, target, plane_id):
    return (1 + plane_id) * (image - target).square().mean()


case("planes · forward")(several_planes)
case("planes · a checkpoint", interrupted=True)(several_planes)
case("planes · relayed", propagator_type="back and forth", zero_mode_distance=0.3)(several_planes)
case("planes · released stop", aperture=None, propagator_type="back and forth")(several_planes)
case("planes · frames, fill and a loss", frames=2, pixel_fill=0.9, loss_function=of_planes)(several_planes)
case(
    "planes · from phase and amplitude", phase_initial=phases_of(*SHAPE), amplitude_initial=0.5 + picture(*SHAPE),
    propagation_type="Transfer Function Fresnel", mask_limits=(0.0, 1.0, 0.0, 1.0),
)(several_planes)  # fmt: skip


def several_colours(folder, mixed=False, call=None, display=None, interrupted=False, **options):
    rate = {"learning_rate_floor": 5e-3} if mixed else {"min_learning_rate": None}
    given = rate | {
        "number_of_frames": 2, "number_of_depth_layers": 2, "learning_rate": 2e-2, "double_phase": True,
        "scale_factor": 1, "method": "multi-color", "channel_power_filename": "", "loss_function": None,
        "peak_amplitude": 1.0, "optimize_peak_amplitude": False, "reduction": "sum", "camera": None,
        "initial_phase": None, "seed": 3,
    }  # fmt: skip
    kind = wave.mixed_color_hologram_optimizer if mixed else wave.multi_color_hologram_optimizer
    usual = {"weights": {"image": 1.0, "light": 0.1, "phase": 0.1, "eyebox": 0.2}}
    usual |= {} if mixed else {"eyebox": None, "bits": 8, "inject_noise": False, "noise_ratio": 1e-3}
    call = usual | (call or {})
    path = folder / "state.pt"
    given |= QUIET | options | ({"checkpoint": path, "checkpoint_every": 2} if interrupted else {})
    optimizer = kind(COLOURS, SHAPE, 0.8 * picture(2, 2, *SHAPE), a_propagator(**(display or {})), **given)
    if interrupted:
        optimizer.options = wave.Run(progress=False, checkpoint=path, callback=stops)
        optimizer.optimize(number_of_iterations=4, **call)
        optimizer = kind(COLOURS, SHAPE, 0.8 * picture(2, 2, *SHAPE), a_propagator(**(display or {})), **given)
    parts = list(optimizer.optimize(number_of_iterations=4, **call))
    names = ["phases", "images", "powers", "channel powers", "peak"]
    parts = dict(zip(names if mixed else ["amplitude", *names], parts, strict=True))
    return parts | {"phases": phasors(parts["phases"])} | (held(path) if interrupted else {})


case("colours")(several_colours)
case("colours · a checkpoint", interrupted=True)(several_colours)
case("colours · relayed, round stop", display=RELAYED | {"aperture_size": 16})(several_colours)
case("colours · released stop", display={"aperture": None})(several_colours)
case("colours · conventional, free scale", method="conventional", optimize_peak_amplitude=True)(several_colours)
case("colours · complex, mean, no levels", method="full_complex_multi-color", reduction="mean", call={"bits": None})(
    several_colours
)
case("colours · smooth, list of weights", double_phase=False, call={"weights": [1.0, 0.2, 0.1]})(several_colours)
case(
    "colours · noise and an eyebox",
    peak_amplitude=1.2,
    initial_phase=phases_of(2, *SHAPE),
    call={"inject_noise": True, "noise_ratio": 0.01, "eyebox": {"offset": [2, -1], "diameter": 8}, "bits": 4},
)(several_colours)
case("mixed colours", mixed=True, call={"weights": [1.0, 0.2, 0.1]})(several_colours)
case("mixed colours · smooth", mixed=True, double_phase=False, call={"weights": {"light": 0.1, "phase": 0.1}})(
    several_colours
)


@case("eyebox")
@case("eyebox · frames, rotated eyes", frames=2, rotation=[[0.0, 0.0], [2.0, -3.0]], focus=0.5, loss_function=noisy)
@case("eyebox · lbfgs", optimizer="lbfgs", initial_phase=phases_of(*SHAPE))
@case("eyebox · some places at once", pupils_per_step=1, slm=Bent())
def places(folder, **options):
    given = {
        "pupil_diameter": 2e-3, "focus": None, "iterations": 5, "loss_function": None, "learning_rate": 0.2,
        "rotation": (0.0, 0.0), "optimizer": "adam", "initial_phase": None, "frames": 1, "slm": None,
        "pupils_per_step": None, "seed": 3,
    }  # fmt: skip
    where = [[0.0, -1e-3], [0.0, 1e-3]]
    hologram, seen = wave.eyebox_hologram(picture(2, *SHAPE), GREEN, 0.1, PITCH, where, **(given | QUIET | options))
    return {"pattern": hologram, "images": seen}


@case("display model")
@case("display model · iris, points", iris=0.5, samples_per_pixel=2)
@case("display model · lens", distance=Lens(50e-3))
def model(folder, distance=CLOSE, iris=None, samples_per_pixel=None):
    model = wave.display_model(
        SHAPE, PITCH, GREEN, distance, (20, 24), 8e-6, phases=None, amplitude=None, wavefront=None, registration=None,
        samples_per_pixel=samples_per_pixel, iris=iris, zernike_order=3, source_order=2, nodes=8, free_form=0,
        residual=0, dtype=torch.float64,
    )  # fmt: skip
    target = picture(*model.shape)
    shown = model((40 * phases_of(*SHAPE)).to(torch.uint8))
    if not isinstance(distance, float):
        return {"captured": shown}
    levels = wave.display_hologram(
        model, target, (0.0, 1e-3), iterations=4, learning_rate=0.1, phase=phases_of(*SHAPE), seed=0, callback=None
    )
    pattern = phasors(levels.double() * (2 * torch.pi / 256))
    return {"captured": shown, "pattern": pattern, "image": model.image(phases_of(*SHAPE), 1e-3)}


@case("named kernels", bound=1e-5)
def kernels(folder):
    made = {
        name: getattr(wave, f"get_{name}_kernel")(*SHAPE, PITCH, GREEN, CLOSE)
        for name in (
            "angular_spectrum", "band_limited_angular_spectrum", "transfer_function_fresnel",
            "incoherent_angular_spectrum",
        )
    }  # fmt: skip
    for name in ("impulse_response_fresnel", "seperable_impulse_response_fresnel"):
        kernel = getattr(wave, f"get_{name}_kernel")
        found = kernel(*SHAPE, PITCH, GREEN, CLOSE, scale=2, aperture_samples=(20, 20, 5, 5))
        made |= {name: found} if torch.is_tensor(found) else {f"{name} {k}": part for k, part in enumerate(found)}
    return made


@case("named propagators")
def propagators(folder):
    field, lengths = phasors(phases_of(*SHAPE)), (2 * np.pi / GREEN, CLOSE, PITCH, GREEN)
    names = (
        "angular_spectrum", "band_limited_angular_spectrum", "transfer_function_fresnel", "incoherent_angular_spectrum",
        "fraunhofer", "fraunhofer_inverse", "band_extended_angular_spectrum",
    )  # fmt: skip
    return {name: getattr(wave, name)(field, *lengths) for name in names}


@pytest.fixture(scope="module")
def recorded():
    return json.loads(FILE.read_text())


def differences(now, before, bound):
    """Return what differs between the values of a case and their records, by a share of the root mean square."""
    found = []
    for name in dict.fromkeys([*before, *now]):
        old, new = before.get(name), now.get(name)
        if old is None or new is None or old["shape"] != new["shape"]:
            found.append(f"{name}: {old} before, {new} now")
            continue
        values = zip([old["rms"], *old["sums"]], [new["rms"], *new["sums"]], strict=True)
        most = max(abs(a - b) for a, b in values)
        if not most <= bound * max(abs(old["rms"]), 1e-12):
            found.append(f"{name}: {old} before, {new} now")
    return found


def computed(name, folder):
    # The judge's grid is four times the panel, as it is of large ones: test_truth.py compares larger ones with sums.
    with mock.patch.object(judge, "_LEAST", 4 * min(SHAPE)):
        return {part: summary(values) for part, values in CASES[name][0](folder).items()}


# Fields that one method averages, or another leaves out, are recorded all the same.
@pytest.mark.filterwarnings("ignore::odak.AccuracyWarning", "ignore:.*round stop of earlier releases")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * slow) for name, (_, _, slow) in CASES.items()]
)
def test_a_case_is_as_recorded(name, recorded, tmp_path):
    wrong = differences(computed(name, tmp_path), recorded[name], CASES[name][1])
    assert not wrong, "\n".join(wrong)


def test_no_case_is_without_record(recorded):
    assert list(recorded) == list(CASES)


def record(words):
    """Write the values of cases whose names hold all of some words, and print those that moved."""
    before = json.loads(FILE.read_text()) if FILE.exists() else {}
    kept = {}
    for name in CASES:
        kept[name] = before.get(name, {})
        if all(word in name for word in words) or not kept[name]:
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
                now = computed(name, Path(folder))
            moved = differences(now, kept[name], CASES[name][1]) if kept[name] else []
            if moved or not kept[name]:
                kept[name] = now
            sys.stdout.write("".join(f"{name}: {line}\n" for line in moved))
    lines = [
        f"  {json.dumps(name, ensure_ascii=False)}: {{\n"
        + ",\n".join(
            f"    {json.dumps(part, ensure_ascii=False)}: {json.dumps(values)}" for part, values in parts.items()
        )
        + "\n  }"
        for name, parts in kept.items()
    ]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    record(sys.argv[1:])
