"""Results do not depend on what is switched on: inference mode, mixed precision, NumPy's errors."""

import numpy as np
import pytest
import torch
from api_sweep import contract, examples, samples, walk

from odak.learn.raytracing import create_ray_from_angles
from odak.learn.raytracing.system import field_curvature, load_system
from odak.learn.tools import multi_layer_perceptron, rotate_points
from odak.learn.wave import Display, Modulator, Run, optimise

CALLABLES = walk.public_callables()
SURROUNDINGS = {
    "inference": torch.inference_mode,
    "no gradients": torch.no_grad,
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "NumPy's errors": lambda: np.errstate(all="raise"),
}
# Networks are what automatic mixed precision is for.
NETWORKS = ("odak.learn.models.", "odak.learn.tools.multi_layer_perceptron")
NETWORKS += ("odak.learn.wave.focal_surface_light_propagation", "odak.learn.wave.holobeam_multiholo")


@pytest.mark.slow
@pytest.mark.parametrize("path", [path for path in CALLABLES if samples.is_called(path) and path not in examples.SLOW])
def test_a_call_gives_the_same_result(path, tmp_path):
    owner, name = CALLABLES.get(path.rpartition(".")[0]), path.rpartition(".")[2]

    def result():
        made = CALLABLES[path]
        if isinstance(owner, type):
            given = samples.arguments(path.rpartition(".")[0], owner, lambda: contract.fresh_folder(tmp_path))
            made = getattr(contract.call(owner, given), name)
        given = samples.arguments(path, CALLABLES[path], lambda: contract.fresh_folder(tmp_path))
        torch.manual_seed(0)
        return contract.call(made, given)

    expected = result()
    if not contract.same(expected, result(), 1e-6):
        pytest.skip("differs from call to call")
    for kind, surroundings in SURROUNDINGS.items():
        if kind == "autocast" and path.startswith(NETWORKS):
            continue
        with surroundings():
            try:
                found = result()
            except RuntimeError as error:
                # Of an object that is to learn, and was made in that mode.
                assert kind == "inference" and "was made in inference mode" in str(error), error
                continue
        assert contract.same(expected, found, 1e-6), kind


def test_optimisation_goes_on_in_inference_mode():
    target = torch.rand(16, 24, generator=torch.Generator().manual_seed(0))

    def found(display):
        return optimise(display, target, start="flat", run=Run(6, progress=False)).phases

    display = Display(Modulator((16, 24), 8e-6), 532e-9, 2e-3)
    expected = found(display)
    with torch.inference_mode():
        assert torch.equal(found(display), expected)
        with pytest.raises(RuntimeError, match="Display was made in inference mode"):
            found(Display(Modulator((16, 24), 8e-6), 532e-9, 2e-3))
        perceptron = multi_layer_perceptron(1, 2, 1, 1)
        with pytest.raises(RuntimeError, match="multi_layer_perceptron was made in inference mode"):
            perceptron.fit(torch.rand(4, 1), torch.rand(4, 1), epochs=1, progress=False)
    with pytest.raises(ValueError, match="loss must depend on what is optimised"):
        optimise(display, target, loss=lambda images, target: (images.detach() - target).square().mean())


def test_foci_of_a_lens_in_inference_mode():
    lens = load_system("cooke_triplet")
    expected = field_curvature(lens)
    with torch.inference_mode():
        assert all(map(torch.equal, field_curvature(lens), expected))


@pytest.mark.parametrize(
    "call",
    [
        lambda: rotate_points(torch.tensor([[1.0, 2.0, 3.0]]), torch.tensor([10.0, 20.0, 30.0]))[0],
        lambda: create_ray_from_angles(torch.zeros(1, 3), torch.tensor([[10.0, 20.0, 30.0]])),
        lambda: Display(Modulator((16, 24), 8e-6), 532e-9, 2e-3)(torch.arange(384.0).reshape(1, 16, 24)),
    ],
)
def test_mixed_precision_rounds_no_light(call):
    expected = call()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(call(), expected)
