"""The bench as a module of PyTorch, against the bench of the core."""

import copy

import numpy as np
import pytest
import torch

import odak
from odak.learn.wave import CircularAperture, FreeSpace, Mask, ThinLens, optical_bench

PITCH, WAVELENGTH = 8e-6, 532e-9


def field():
    return torch.randn(2, 48, 64, dtype=torch.complex128, generator=torch.Generator().manual_seed(0))


def parts(focal=0.05, shift=2e-5, distance=0.02):
    mask = torch.linspace(0.5, 1, 48 * 64, dtype=torch.float64).reshape(48, 64)
    return [CircularAperture(2e-4, (shift, 0.0)), Mask(mask), ThinLens(focal), FreeSpace(distance)]


def test_numbers_of_elements_are_parameters_and_buffers_with_the_light_of_the_core():
    focal, shift = (torch.nn.Parameter(torch.tensor(v, dtype=torch.float64)) for v in (0.05, 2e-5))
    bench = optical_bench(parts(focal, shift), torch.tensor(WAVELENGTH, dtype=torch.float64))
    assert isinstance(bench, odak.wave.optical_bench)
    assert {name for name, _ in bench.named_parameters()} == {"element_0_offset_0", "element_2_focal"}
    assert {name for name, _ in bench.named_buffers()} == {"element_1_transmission", "wavelength"}
    found, pitch = bench(field(), PITCH)
    of_core, core_pitch = odak.wave.optical_bench(parts(), WAVELENGTH).propagate(field().numpy(), PITCH)
    np.testing.assert_allclose(found.detach().numpy(), of_core, atol=1e-12)
    assert pitch == core_pitch and len(bench.planes(field(), PITCH)) == 5
    found.abs().square()[..., 20:28, 20:28].sum().backward()
    assert focal.grad.isfinite() and focal.grad != 0 and shift.grad.isfinite()


def test_states_devices_and_copies_reach_the_elements():
    given = parts(torch.nn.Parameter(torch.tensor(0.05, dtype=torch.float64)))
    bench, other = optical_bench(given, WAVELENGTH), optical_bench(parts(torch.nn.Parameter(torch.tensor(0.08))), 5e-7)
    other.double().load_state_dict(bench.state_dict())
    assert other.elements[2].focal.item() == 0.05 and other.elements[2].focal.dtype == torch.float64
    single = copy.deepcopy(bench).float()
    assert {e.dtype for e in (single.elements[1].transmission, single.elements[2].focal)} == {torch.float32}
    # What was given stays as it was, and shares its parameters.
    assert given[1].transmission.dtype == torch.float64 and bench.elements[2].focal is given[2].focal
    assert single.elements[2].focal is not given[2].focal
    assert bench.to("meta").elements[1].transmission.is_meta
    with torch.no_grad():
        other.element_2_focal.fill_(0.1)
    torch.testing.assert_close(other(field(), PITCH)[0], optical_bench(parts(0.1), 5e-7)(field(), PITCH)[0])


def test_modules_among_the_elements_are_trained_with_it():
    class Plate(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.phase = torch.nn.Parameter(torch.zeros(48, 64, dtype=torch.float64))

        def apply(self, field, pitch, wavelength):
            return field * torch.exp(1j * self.phase), pitch

    plate = Plate()
    bench = optical_bench([plate, FreeSpace(0.02)], WAVELENGTH)
    optimiser = torch.optim.Adam(bench.parameters(), lr=0.2)

    def middle():
        return bench(torch.ones(48, 64, dtype=torch.complex128), PITCH)[0][24, 32].abs().square()

    start = middle().item()
    for _ in range(5):
        optimiser.zero_grad()
        (-middle()).backward()
        optimiser.step()
    assert middle().item() > 2 * start and bench.elements[0] is plate


def test_what_is_no_element_is_refused():
    with pytest.raises(TypeError, match="elements must have a method apply"):
        optical_bench([torch.ones(3)], WAVELENGTH)
    with pytest.raises(ValueError, match="wavelength"):
        optical_bench([], -1.0)
