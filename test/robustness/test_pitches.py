"""Pixel pitches of every public call: one number, an equal pair, and different pitches of rows and columns."""

import functools
import inspect

import pytest
from api_sweep import contract, samples, walk

CALLABLES = walk.public_callables()
# Pixels that are square by nature, with the reason; a pair is refused by name.
SQUARE = {
    "odak.learn.models.hologram_network.": "trained for square pixels",
    "odak.learn.raytracing.system.": "samples of retinas and point spread functions, at a pitch of one's choice",
    "odak.learn.wave.get_light_kernels": "a list of pitches already",
    "odak.measurement.slanted_edge_mtf": "ISO 12233 measures along rows or along columns of square pixels",
    "odak.wave.scattered_field": "cubic cells",
}
# Their own tests: modulators and cameras of benches; files; a record of older calls that nothing is computed from.
ELSEWHERE = ("odak.instruments.", "odak.tools.save_ome_tiff", "odak.learn.perception.display_color_hvs")
# What the pitch of columns or of rows alone decides, or nothing for the arguments of their examples.
UNCHANGED = (
    "odak.learn.wave.beam_quality",
    "odak.learn.wave.power_in_bucket",
    "odak.learn.wave.dammann_grating",
    "odak.learn.wave.prism_grating",
    "odak.learn.wave.pupil_function",
    "odak.learn.wave.zernike_phase",
    "odak.wave.beam_quality",
    "odak.wave.dammann_grating",
    "odak.wave.hologram_in_chunks",
    "odak.wave.prism_grating",
    "odak.wave.pupil_function",
)
GIVEN = 2e-6
CALLS = [
    (path, parameter.name)
    for path, declared in CALLABLES.items()
    if samples.is_called(path) and not path.startswith(ELSEWHERE)
    for parameter in samples.parameters_of(declared)
    if parameter.name in ("dx", "output_dx", "pixel_pitches") or parameter.name.endswith("pitch")
]


class Call:
    """A public call with its valid arguments."""

    def __init__(self, path, folder):
        self.path, self.owner_path = path, path.rpartition(".")[0]
        self.fresh = functools.partial(contract.fresh_folder, folder)
        self.owner = CALLABLES.get(self.owner_path)

    def __call__(self, **changed):
        arguments = samples.arguments(self.path, CALLABLES[self.path], self.fresh)
        return contract.call(self.function(), arguments | changed)

    def function(self):
        if not inspect.isclass(self.owner):
            return CALLABLES[self.path]
        own = samples.arguments(self.owner_path, self.owner, self.fresh)
        return getattr(contract.call(self.owner, own), CALLABLES[self.path].__name__)

    def pitch(self, name):
        """Return the pitch of the example as one number."""
        valid = samples.arguments(self.path, CALLABLES[self.path], self.fresh)[name]
        return GIVEN if valid is None else float(valid[0] if isinstance(valid, (list, tuple)) else valid)


@pytest.mark.slow
@pytest.mark.parametrize(("path", "name"), CALLS)
def test_pitches_of_rows_and_columns(path, name, tmp_path):
    call = Call(path, tmp_path)
    pitch = call.pitch(name)
    pair = (pitch, 1.5 * pitch)
    if path.startswith(tuple(SQUARE)):
        with pytest.raises((TypeError, ValueError), match=name):
            call(**{name: [pair] if name == "pixel_pitches" else pair})
        return
    square = call(**{name: pitch})
    equal, different = call(**{name: (pitch, pitch)}), call(**{name: pair})
    # The planes of a bench say what pitch they were given, a number or a pair.
    if contract.flat(square) and not path.endswith("optical_bench.planes"):
        assert contract.same(square, equal, 1e-6)
        assert path in UNCHANGED or not contract.same(square, different, 1e-6)


def test_the_calls_are_found():
    assert len(CALLS) > 100
    assert all(any(path.startswith(square) for path, _ in CALLS) for square in SQUARE)
