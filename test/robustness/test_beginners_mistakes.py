"""Likely mistakes of first programs: each message names what was given, and what endangers a result warns."""

import dataclasses
import inspect
import math
import re
import sys
import warnings

import numpy as np
import pytest
import torch

import odak
from odak import _validate
from odak._lengths import UNITS
from odak.learn import perception, wave
from odak.learn.raytracing import system
from odak.learn.tools import load_image, resize, save_image

WAVELENGTH, PITCH, DISTANCE = 532e-9, 8e-6, 1e-3


@pytest.mark.parametrize(
    "call",
    [
        lambda array: perception.MetamericLoss()(array, array),
        lambda array: perception.srgb_to_lab(array),
        lambda array: resize(array),
        lambda array: wave.propagator(resolution=[8, 8], aperture="open").reconstruct(array),
    ],
)
def test_an_array_in_place_of_a_tensor_is_called_an_array(call):
    with pytest.raises(TypeError, match="got ndarray"):
        call(np.ones((1, 3, 64, 64)))


@pytest.mark.parametrize("count", [5.0, -1.0, 0.0])
def test_iterations_that_are_no_integer_are_named(count):
    with pytest.raises(TypeError, match="n_iterations must be an integer, got float"):
        wave.gerchberg_saxton(torch.ones(8, 8), count, DISTANCE, PITCH, WAVELENGTH)


@pytest.mark.parametrize(
    "call",
    [
        lambda picture: wave.propagate_beam(picture, None, DISTANCE, PITCH, WAVELENGTH),
        lambda picture: wave.stochastic_gradient_descent(picture, WAVELENGTH, DISTANCE, PITCH, n_iteration=1),
        lambda picture: wave.gerchberg_saxton(picture, 1, DISTANCE, PITCH, WAVELENGTH),
    ],
)
@pytest.mark.filterwarnings("ignore::odak.SamplingWarning")
def test_a_picture_with_its_colours_last_is_pointed_out(call):
    picture = torch.rand(16, 20, 3)
    with pytest.warns(odak.ArgumentWarning, match="16 planes of 20 x 3 samples"):
        call(picture)
    call(picture.movedim(-1, 0))


GREY = torch.full((1, 3, 2, 2), 0.5)


@pytest.mark.parametrize(
    ("convert", "factor", "words"),
    [
        (perception.rgb_to_linear_rgb, 255, "image reaches 127.5 where 1 is white: divide values of 0 … 255"),
        (perception.linear_rgb_to_rgb, 255, "divide values of 0 … 255 by 255"),
        (perception.rgb_to_hsv, 255, "divide values of 0 … 255 by 255"),
        (perception.rgb_2_ycrcb, 255, "divide values of 0 … 255 by 255"),
        (perception.srgb_to_lab, 255, "divide values of 0 … 255 by 255"),
        (perception.xyz_to_lab, 100, "image reaches 50 where 1 is white: divide XYZ of 0 … 100 by 100"),
        (perception.xyz_to_luv, 100, "divide XYZ of 0 … 100 by 100"),
        (perception.xyz_to_oklab, 100, "divide XYZ of 0 … 100 by 100"),
        (perception.xyz_to_cam16_ucs, 100, "divide XYZ of 0 … 100 by 100"),
        (perception.hlg_decode, 1023, "divide code values by the largest one"),
        (perception.pq_decode, 1023, "divide code values by the largest one"),
    ],
)
def test_colours_of_another_scale_are_pointed_out(convert, factor, words):
    with pytest.warns(odak.ArgumentWarning, match=words):
        convert(GREY * factor)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        convert(GREY)
        convert(7 * GREY)  # highlights


def test_a_white_of_its_own_sets_the_scale_of_tristimulus_values():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch.allclose(
            perception.xyz_to_lab(100 * GREY, (95.0, 100.0, 108.0)), perception.xyz_to_lab(GREY, (0.95, 1.0, 1.08))
        )


@pytest.mark.parametrize("difference", [perception.delta_e, perception.ciede2000])
def test_differences_of_colours_that_are_not_lab_are_pointed_out(difference):
    with pytest.warns(odak.ArgumentWarning, match="was RGB meant"):
        difference(GREY, 0.9 * GREY)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        difference(perception.srgb_to_lab(GREY), perception.srgb_to_lab(0.9 * GREY))
        perception.delta_e_itp(GREY, 0.9 * GREY)  # of ICtCp, which lies in 0 … 1


@pytest.mark.parametrize(("width", "distance"), [(0.2, 700.0), (300.0, 0.7)])
@pytest.mark.parametrize(
    "call",
    [
        lambda **view: perception.MetamericLoss(**view),
        lambda **view: perception.BlurLoss(**view),
        lambda **view: perception.CSFLoss(**view),
        lambda **view: perception.VisibilityLoss(**view),
        lambda **view: perception.foveated_budget((32, 32), **view),
        lambda **view: perception.eccentricity_report(torch.rand(1, 3, 32, 32), torch.rand(1, 3, 32, 32), **view),
    ],
)
def test_widths_and_distances_in_two_units_are_pointed_out(call, width, distance):
    with pytest.warns(odak.ArgumentWarning, match="both are lengths in one unit"):
        call(real_image_width=width, real_viewing_distance=distance)


def test_impossible_densities_of_pixels_are_refused():
    for density, words in ((3840.0, "1 to 1000, got 3840: pixels per radian"), (0.067, "got 0.067")):
        with pytest.raises(ValueError, match=words):
            perception.flip(GREY, GREY, density)


@pytest.mark.parametrize(
    ("word", "value", "remedy"),
    [
        ("iterations", 3, "run=Run(iterations=...)"),
        ("epochs", 3, "run=Run(iterations=...)"),
        ("seed", 3, "run=Run(seed=...)"),
        ("learning_rate", 0.1, "solver=Descent('adam', learning_rate=...)"),
        ("method", "adam", "solver, such as solver='adam'"),
        ("device", "cpu", "a display on that device, display.to(device)"),
    ],
)
def test_words_of_other_programs_are_answered_with_the_argument_that_holds_them(word, value, remedy):
    with pytest.raises(TypeError, match=re.escape(f"optimise has no argument {word!r}. Give {remedy}.")):
        wave.optimise(None, None, **{word: value})


@pytest.mark.parametrize(
    ("door", "word", "answer"),
    [
        (wave.propagate_beam, "z", "propagate_beam has no argument 'z'. Did you mean 'distance'?"),
        (odak.wave.propagate_beam, "lam", "propagate_beam has no argument 'lam'. Did you mean 'wavelength'?"),
        (wave.Display, "r", "Display has no argument 'r'. Did you mean 'distances'?"),
        (wave.Display, "pixel_pitch", "Give modulator=Modulator(resolution, pitch, ...)."),
        (wave.optimise, "z", "Give it to the display, Display(modulator, wavelengths, distances)."),
        (wave.stochastic_gradient_descent, "epochs", "Did you mean 'n_iteration'?"),
        (odak.learn.jones.polarizer, "angel", "polarizer has no argument 'angel'. Did you mean 'angle'?"),
        (system.surface, "r", "surface has no argument 'r'. Did you mean 'radius'?"),
        (system.surface, "glass", "surface has no argument 'glass'. Did you mean 'material'?"),
        (system.optical_system, "radii", "Give it to surface(radius, thickness=...)."),
        (system.optical_system, "epd", "Give aperture=SystemAperture(..., 'EPD')."),
        (system.optical_system, "feilds", "optical_system has no argument 'feilds'. Did you mean 'fields'?"),
        (system.optical_system, "lam", "Did you mean 'wavelengths'?"),
    ],
)
def test_words_of_other_programs_are_answered_by_every_door(door, word, answer):
    with pytest.raises(TypeError, match=re.escape(answer)):
        door(**{word: 1})


def test_doors_that_take_words_apart_answer_an_unknown_one():
    words = {"wavelength", "wavelengths", "distance", "distances", "radius", "run", "solver", "display"}
    bare = []
    for package in (wave, odak.wave, system):
        for name in package.__all__:
            door = getattr(package, name)
            results = dataclasses.is_dataclass(door) or hasattr(door, "_fields")
            if not callable(door) or results or not words & {*inspect.signature(door).parameters}:
                continue
            if inspect.Parameter.VAR_KEYWORD in {p.kind for p in inspect.signature(door).parameters.values()}:
                continue
            with pytest.raises(TypeError) as caught:
                door(no_such_word=1)
            bare += [name] if "has no argument 'no_such_word'" not in str(caught.value) else []
    assert bare == []


def test_what_readers_of_files_return_is_told_apart_from_the_system_in_it():
    with pytest.raises(TypeError, match=r"got a tuple with one in front, .* unpack it, system, report"):
        system.spot_diagram((system.load_system("singlet"), "report"))
    with pytest.raises(TypeError, match="got tuple"):
        system.spot_diagram(())


def test_pictures_with_their_axes_in_another_order_are_told_the_order():
    display = wave.Display(wave.Modulator((32, 48), 8e-6), [639e-9, 532e-9, 473e-9], 2e-3)
    last, turned = torch.rand(32, 48, 3), torch.rand(3, 48, 32)
    for call in (
        lambda: wave.optimise(display, last),
        lambda: wave.light_of(last, display),
        lambda: perception.flip(last, last),
        lambda: perception.srgb_to_lab(last[None]),
        lambda: perception.ciede2000(last[None], last[None]),
        lambda: perception.MetamericLoss()(last[None], last[None]),
        lambda: perception.texture_statistics(last[None]),
    ):
        with pytest.raises(ValueError, match=r"got \[.*32, 48, 3\]: colours go first, \w+\.movedim\(-1, -3\)"):
            call()
    for call in (
        lambda: wave.optimise(display, turned),
        lambda: display(turned[0]),
    ):
        with pytest.raises(ValueError, match=r"48, 32\]: rows go before columns, \w+\.mT"):
            call()
    with pytest.raises(ValueError, match=r"got \[3, 20, 30\]$"):
        wave.optimise(display, torch.rand(3, 20, 30))


@pytest.mark.parametrize("name", ["sgd", "SGD", "gradient descent"])
def test_descent_by_another_name_is_adam(name):
    display = wave.Display(wave.Modulator((16, 16), 8e-6), 532e-9, 2e-3)
    with pytest.raises(ValueError, match=r"solver must be one of .*Did you mean 'adam'"):
        wave.optimise(display, torch.ones(16, 16), solver=name)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("BlurLoss", {}),
        ("MetamericLoss", {}),
        ("MetamericLoss", {"use_radial_weight": True}),
        ("MetamerMSELoss", {"iterations": 0}),
    ],
)
def test_a_gaze_in_pixels_is_pointed_out_once(kind, options):
    picture = torch.rand(1, 3, 64, 64)
    loss = getattr(perception, kind)(**options)
    with pytest.warns(odak.ArgumentWarning, match="^gaze must be shares .* divide pixels") as caught:
        loss(picture, picture, gaze=[32, 24])
    assert len(caught) == 1
    loss(picture, picture, gaze=[-0.5, 1.5])


def test_image_slightly_above_one_is_not_saved_black_unnoticed(tmp_path):
    image = torch.tensor([[0.0, 0.5, 1.0001]])
    with pytest.warns(odak.ArgumentWarning, match="give cmax=1.0"):
        save_image(tmp_path / "dark.png", image)
    save_image(tmp_path / "bright.png", image, cmax=1.0)
    assert load_image(tmp_path / "bright.png")[0].tolist() == pytest.approx([0.0, 128 / 255, 1.0])
    save_image(tmp_path / "levels.png", torch.tensor([[0.0, 100.0, 255.0]]))


def test_powers_are_named_with_spaces_underscores_or_hyphens():
    for method in ("multi-color", "multi_color", "Multi color"):
        assert wave.propagator(resolution=[8, 8], aperture="open", method=method).method == "multi-color"
    with pytest.raises(ValueError, match="got 'mixed_color'"):
        wave.propagator(resolution=[8, 8], aperture="open", method="mixed_color")


# Distance, pitch and wavelength of one propagation, and what was probably meant.
IMPOSSIBLE = [
    ((0.1, 8, 532e-9), "dx must .* did you mean 8um"),
    ((0.1, 8e-6, 532), "wavelength must .* did you mean 532nm"),
    ((532e-9, 8e-6, 0.1), "wavelength and distance exchanged"),
    ((8e-6, 1e-3, 532e-9), "distance and dx exchanged"),
    ((0.1, (8e-6, 8), 532e-9), "did you mean 8um"),
]


@pytest.mark.parametrize(("lengths", "message"), IMPOSSIBLE)
def test_lengths_that_cannot_belong_together_are_refused(lengths, message):
    for face, field in ((odak.wave, np.ones((4, 4))), (wave, torch.ones(4, 4))):
        with pytest.raises(ValueError, match=message):
            face.propagate_beam(field, None, *lengths)


def test_pixels_of_eight_metres_are_refused_everywhere():
    picture = torch.ones(8, 8)
    for call in (
        lambda: wave.stochastic_gradient_descent(picture, WAVELENGTH, 0.1, 8, n_iteration=1),
        lambda: wave.gerchberg_saxton(picture, 1, 0.1, 8, WAVELENGTH),
        lambda: wave.propagator(resolution=[8, 8], aperture="open", pixel_pitch=8.0),
        lambda: odak.wave.lens_phase((8, 8), 0.1, 8, WAVELENGTH),
        lambda: odak.wave.gaussian_beam((8, 8), 8, WAVELENGTH, 1e-3),
        lambda: odak.wave.sampling_report((8, 8), 8, WAVELENGTH, 0.1),
        lambda: odak.wave.optical_bench([odak.wave.FreeSpace(0.1)], WAVELENGTH).propagate(np.ones((8, 8)), 8),
    ):
        with pytest.raises(ValueError, match="did you mean 8um"):
            call()


@pytest.mark.parametrize(
    "lengths",
    # Light, light in a telescope, X-rays, terahertz, radio, sound in air, lengths in wavelengths, a near field.
    [
        (0.1, 8e-6, 5e-7),
        (100.0, 0.01, 5e-7),
        (1.0, 1e-6, 1e-10),
        (0.1, 1e-4, 3e-4),
        (1e3, 10.0, 300.0),
        (5.0, 0.1, 0.34),
        (100, 0.5, 1),
        (2e-8, 2e-8, 5e-7),
    ],
)
def test_other_waves_pass_without_a_word(lengths):
    with warnings.catch_warnings():
        warnings.simplefilter("error", odak.ArgumentWarning)
        odak.wave.propagate_beam(np.ones((4, 4)), None, *lengths)


class Quantity:
    """A length as pint has it; with another name for its number, as astropy has it."""

    def __init__(self, number, unit, name):
        self.number, self.unit = number, unit
        setattr(self, name, number)

    def to(self, unit):
        if unit != "m":
            raise TypeError(f"not a length: {unit}")
        name = "magnitude" if hasattr(self, "magnitude") else "value"
        return Quantity(self.number * UNITS[self.unit], "m", name)


def test_lengths_with_units_are_those_in_metres():
    field = odak.wave.propagate_beam(np.ones((8, 8)), None, 1e-3, 8e-6, 532e-9)
    quantities = Quantity(1, "mm", "magnitude"), Quantity(8, "um", "value"), Quantity(532, "nm", "magnitude")
    for lengths in (("1mm", "8um", "532nm"), quantities, ("0.1 cm", ["8um", 8e-6], "0.532µm")):
        np.testing.assert_allclose(odak.wave.propagate_beam(np.ones((8, 8)), None, *lengths), field, rtol=1e-9)
        by_torch = wave.propagate_beam(torch.ones(8, 8, dtype=torch.complex128), None, *lengths)
        np.testing.assert_allclose(by_torch.numpy(), field, rtol=1e-9)
    optimised = [
        wave.stochastic_gradient_descent(torch.ones(8, 8), *lengths, n_iteration=2, seed=0, progress=False)[0]
        for lengths in ((532e-9, 1e-3, 8e-6), ("532nm", "1mm", "8um"))
    ]
    torch.testing.assert_close(*optimised)
    bench = odak.wave.optical_bench([odak.wave.ThinLens("5cm"), odak.wave.FreeSpace("1mm")], wavelength="532nm")
    same = odak.wave.optical_bench([odak.wave.ThinLens(0.05), odak.wave.FreeSpace(1e-3)], wavelength=532e-9)
    light = np.ones((8, 8))
    np.testing.assert_allclose(bench.propagate(light, "8um")[0], same.propagate(light, 8e-6)[0], rtol=1e-9)
    display = wave.propagator(
        wavelengths=["639nm", "532nm", "473nm"], resolution=[8, 8], pixel_pitch="8um", aperture="open"
    )
    assert [float(value) for value in display.wavelengths] == pytest.approx([639e-9, 532e-9, 473e-9])
    for wrong in ("15cc", "nonsense", Quantity(1, "parsec", "value")):
        with pytest.raises(ValueError, match="distance must be a length"):
            odak.wave.propagate_beam(np.ones((8, 8)), None, wrong, 8e-6, 532e-9)


@pytest.mark.parametrize("package", [odak.wave, wave])
def test_every_door_takes_units(package):
    lengths = {"wavelength", "wavelengths", "distance", "distances", "dx", "pixel_pitch", "slm_pixel_pitch"}
    missing = []
    for name in package.__all__:
        door = getattr(package, name)
        if not callable(door) or name in ("BenchPlane", "PictureLight", "SamplingReport"):  # results
            continue
        units = getattr(door.__init__ if inspect.isclass(door) else door, "__units__", {})
        missing += [f"{name}({argument})" for argument in lengths & {*inspect.signature(door).parameters} - {*units}]
    assert missing == []


def calls_in(function, arguments):
    """Return how many functions of Python and of C a call of a function calls."""
    calls, before = [], sys.getprofile()
    sys.setprofile(lambda frame, event, argument: calls.append(event in ("call", "c_call")))
    try:
        function(*arguments)
    finally:
        sys.setprofile(before)
    return sum(calls)


def test_the_check_of_lengths_is_quick_and_reads_no_gpu():
    check = _validate.takes_units("distance", "dx", "wavelength")(lambda distance, dx, wavelength: distance)
    far = torch.ones(1, device="meta")  # has no values to read
    assert check(far, far, far) is far
    # Some 0.2 µs each. Calls are counted, as the time depends on what else the machine does.
    numbers, pair = (0.1, 8e-6, 532e-9), (0.1, (8e-6, 7e-6), 532e-9)
    for lengths, most in ((numbers, 20), (pair, 60), ((torch.tensor(0.1), 8e-6, torch.tensor(532e-9)), 90)):
        check(*lengths)
        assert 5 < calls_in(check, lengths) < most


@pytest.mark.parametrize("package", [odak.wave, wave])
def test_a_misspelt_keyword_is_named(package):
    with pytest.raises(TypeError, match=r"propagate_beam has no argument 'wavelenght'. Did you mean 'wavelength'?"):
        package.propagate_beam(torch.ones(4, 4), distance=0.1, dx=8e-6, wavelenght=532e-9)
    with pytest.raises(TypeError, match=r"has no argument 'learning_rat'. Did you mean 'learning_rate'?"):
        wave.stochastic_gradient_descent(torch.ones(4, 4), 532e-9, 0.1, 8e-6, learning_rat=0.1)
    with pytest.raises(TypeError, match=r"propagator has no argument 'pixel_pich'. Did you mean 'pixel_pitch'?"):
        wave.propagator(pixel_pich=8e-6)


def test_degrees_that_look_like_radians_are_pointed_out():
    for package in (odak.jones, odak.learn.jones):
        with pytest.warns(odak.ArgumentWarning, match="angle is in degrees: 0.785398 is 45 degrees in radians"):
            package.polarizer(math.pi / 4)
        with pytest.warns(odak.ArgumentWarning, match="angle is in degrees"):
            package.rotator(math.pi / 4)
        package.polarizer(0.79)
    with pytest.warns(odak.ArgumentWarning, match="angles is in degrees"):
        odak.wave.reference_wave((8, 8), 8e-6, WAVELENGTH, (0.0, math.radians(1)))


@pytest.mark.filterwarnings("ignore::odak.SamplingWarning")
def test_pictures_of_8_bits_are_named_once():
    levels = torch.rand(8, 8, generator=torch.Generator().manual_seed(0)) * 255
    place = (WAVELENGTH, DISTANCE, PITCH)
    for call in (
        lambda: wave.stochastic_gradient_descent(levels, *place, n_iteration=2, scale=True, initial_phase="gs"),
        lambda: wave.gerchberg_saxton(levels, 2, DISTANCE, PITCH, WAVELENGTH),
        lambda: odak.wave.gerchberg_saxton(levels.numpy(), 2, DISTANCE, PITCH, WAVELENGTH),
        lambda: odak.wave.gerchberg_saxton_3d(levels.numpy()[None], 2, [DISTANCE], PITCH, WAVELENGTH),
        lambda: odak.learn.tools.psnr(levels, levels / 255),
        lambda: perception.rgb_2_ycrcb(levels.expand(3, 8, 8)),
    ):
        with pytest.warns(odak.ArgumentWarning, match="where 1 is white") as caught:
            call()
        assert len(caught) == 1
    odak.learn.tools.psnr(levels, levels + 1, peak_value=255)


@pytest.mark.parametrize("spoilt", [math.nan, math.inf])
def test_values_that_are_not_finite_are_named(spoilt):
    picture = torch.full((8, 8), 0.5)
    picture[2, 3] = spoilt
    place = (DISTANCE, PITCH, WAVELENGTH)
    for name, call in (
        ("field", lambda: wave.gerchberg_saxton(picture, 1, *place)),
        ("field", lambda: odak.wave.gerchberg_saxton(picture.numpy(), 1, *place)),
        ("initial_phase", lambda: wave.gerchberg_saxton(torch.ones(8, 8), 1, *place, initial_phase=picture)),
        ("fields", lambda: odak.wave.gerchberg_saxton_3d(picture.numpy()[None], 1, [DISTANCE], PITCH, WAVELENGTH)),
        ("field", lambda: odak.wave.sampling_report((8, 8), PITCH, WAVELENGTH, DISTANCE, field=picture.numpy())),
        ("target", lambda: wave.stochastic_gradient_descent(picture, WAVELENGTH, DISTANCE, PITCH)),
    ):
        with pytest.raises(ValueError, match=f"^{name} must be finite"):
            call()
    with pytest.warns(odak.ArgumentWarning, match="image must be finite"):
        perception.rgb_2_ycrcb(picture.expand(3, 8, 8))


def test_other_words_for_a_parameter_are_taken():
    target = torch.rand(24, 24, generator=torch.Generator().manual_seed(0))
    kept = wave.double_phase_hologram(target, 532e-9, 2e-3, pitch=8e-6, iris_radius=None)
    torch.testing.assert_close(
        wave.double_phase_hologram(target, 532e-9, 2e-3, pixel_pitch="8um", iris_radius=None), kept
    )
    with pytest.raises(TypeError, match="pitch and pixel_pitch are one argument"):
        wave.double_phase_hologram(target, 532e-9, 2e-3, pitch=8e-6, pixel_pitch=8e-6)
    same = [
        wave.stochastic_gradient_descent(target, 532e-9, 2e-3, seed=0, progress=False, **words)[0]
        for words in ({"pixel_pitch": 8e-6, "n_iteration": 2}, {"pitch": "8um", "iterations": 2})
    ]
    torch.testing.assert_close(*same)
    with pytest.raises(TypeError, match=r"no argument 'iteration'\. Did you mean 'n_iteration'"):
        wave.stochastic_gradient_descent(target, 532e-9, 2e-3, 8e-6, iteration=2)


def test_names_are_taken_in_any_case_by_what_acts_on_them():
    """What a check accepts, the function that it stands in must also understand."""
    red = torch.tensor([0.2, 0.12, 0.05]).reshape(3, 1, 1)
    for written in ("Dim", "dim"):
        found = perception.color_appearance(red, surround=written, model="cam02")
        assert torch.equal(found.hue, perception.color_appearance(red, surround="dim", model="CAM02").hue)
    assert odak.catalog.internal_transmittance("N-BK7", 400, 25, "NM") == odak.catalog.internal_transmittance(
        "N-BK7", 400, 25, "nm"
    )
    assert perception.Viewer(deficiency="Deutan") == perception.Viewer(deficiency="deutan")
    assert wave.Descent("LBFGS").method == "lbfgs"
    assert system.Coating.quarter_waves([1.38], 550, "NM").thicknesses[0] == pytest.approx(550 / 4 / 1.38)
    surfaces = [system.surface(51.5, thickness=4.0, material="N-BK7"), system.surface(thickness=97.0)]
    lens = system.optical_system(surfaces, 20.0)
    needle = system.needle_design(system.Coating([1.38], [100.0]), [1.38, 2.3], [1.0, 1.5], 500.0, films=1, unit="NM")
    assert needle.merit < 0.2
    limited = system.standard_design(lens, limits={"Track": 60.0})
    assert [item.upper for item in limited.operands if item.kind == "total_track"] == [60.0]
    names = [system.sensitivity(lens, system.Perturbation(name, 0, 0.1)).names for name in ("Thickness", "thickness")]
    assert names[0] == names[1]
    design = system.lens_design(lens, system.Operand("Focal_Length", 100.0), system.Variable("Curvature", 0))
    design.optimise(5)
    assert float(system.first_order(lens).focal_length.detach()) == pytest.approx(100.0, abs=1e-6)


_SEVEN, _FIELD = np.full(7, 0.5), np.ones((16, 16), dtype=complex)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("aperture", lambda: odak.wave.angular_spectrum(_FIELD, None, 1e-4, PITCH, WAVELENGTH, aperture=_SEVEN)),
        ("range_max", lambda: odak.wave.normalize_phase(_SEVEN, 0.0, _SEVEN)),
        ("k", lambda: odak.wave.propagate_plane_waves(_FIELD, 1.0, _SEVEN)),
        ("k", lambda: odak.wave.electric_field_per_plane_wave(1.0, 1.0, _SEVEN)),
        ("wave_number", lambda: odak.wave.propagate_field(np.zeros((2, 3)), np.ones((3, 3)), np.ones(2), _SEVEN)),
        ("wavelength", lambda: odak.wave.fraunhofer_equal_size_adjust(_FIELD, 1e-3, PITCH, 1e-6 * _SEVEN)),
        ("dx", lambda: odak.wave.sampling_report((16, 16), 2e-5 * _SEVEN, WAVELENGTH, 1e-3)),
        ("wavelength", lambda: odak.wave.spot_hologram(np.ones((2, 3)), (16, 16), 1e-6 * _SEVEN, PITCH)),
        ("wavelength", lambda: odak.wave.thin_film_transfer((16, 16), PITCH, 1e-6 * _SEVEN, [1.0, 1.5], [])),
        ("wavelength", lambda: odak.raytracing.rays_from_field(_FIELD, PITCH, 1e-6 * _SEVEN)),
        ("temperature", lambda: odak.catalog.air_index(np.array([5e-7, 6e-7]), _SEVEN)),
        ("thickness", lambda: odak.catalog.internal_transmittance("N-BK7", np.array([5e-7, 6e-7]), _SEVEN)),
        ("nd", lambda: odak.catalog.nearest_materials(1 + _SEVEN, 60.0)),
    ],
)
def test_arrays_that_fit_no_other_argument_are_named(name, call):
    with pytest.raises(ValueError, match=rf"\b{name}\b") as caught:
        call()
    assert "operands" not in str(caught.value) and "ambiguous" not in str(caught.value)
