import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import odak
from odak.learn import wave as torch_wave


def test_phase_range_scales_with_wavelength():
    assert odak.wave.adjust_phase_only_slm_range(6.28, 500e-9, 600e-9) == pytest.approx(6.28 * 1.2)


def test_pattern_levels_are_floors_of_the_phase():
    phase = np.array([[0.0, 1.0, 3.0, 6.2, -1.0]])
    field, pattern = odak.wave.produce_phase_only_slm_pattern(np.exp(1j * phase), 2 * np.pi, bits=4)
    expected = np.floor((phase % (2 * np.pi)) / (2 * np.pi) * 16).astype(np.int32)
    assert pattern.dtype == np.int32
    np.testing.assert_array_equal(pattern, expected)
    np.testing.assert_allclose(field, np.exp(1j * expected / 16 * 6.28), atol=1e-12)
    both = torch_wave.produce_phase_only_slm_pattern(torch.from_numpy(np.exp(1j * phase)), 2 * np.pi, bits=4)
    np.testing.assert_array_equal(both[1].numpy(), expected)
    lit, _ = odak.wave.produce_phase_only_slm_pattern(np.exp(1j * phase), 2 * np.pi, illumination=np.full((1, 5), 2.0))
    np.testing.assert_allclose(np.abs(lit), 2.0)


@pytest.mark.parametrize("face", [odak.wave, torch_wave])
@pytest.mark.parametrize("phase_range", [1.6 * np.pi, 2 * np.pi, 2.5 * np.pi, 2.9 * np.pi, 5 * np.pi])
def test_panel_shows_the_phase_whatever_its_range(face, phase_range):
    phase = np.linspace(-3, 3, 101)[None]
    hologram = np.exp(1j * phase)
    hologram = torch.from_numpy(hologram) if face is torch_wave else hologram
    field, levels = face.produce_phase_only_slm_pattern(hologram, phase_range)
    shown = np.exp(1j * np.asarray(levels) / 256 * phase_range)
    # Where the range has a gap, the nearer end is half the gap away at most.
    farthest = max(0.0, 2 * np.pi - phase_range) / 2
    assert np.abs(np.angle(shown * np.exp(-1j * phase))).max() < farthest + phase_range / 256 + 1e-9
    np.testing.assert_allclose(np.asarray(field), shown, atol=0.0033)


def test_pattern_is_saved(tmp_path):
    path = str(tmp_path / "pattern.png")
    phase = np.linspace(0, 6.2, 64).reshape(8, 8)
    _, pattern = odak.wave.produce_phase_only_slm_pattern(np.exp(1j * phase), 2 * np.pi, filename=path)
    saved = odak.tools.load_image(path)
    np.testing.assert_array_equal(saved, pattern)


@given(
    rows=st.integers(1, 5), columns=st.integers(1, 5), batch=st.lists(st.integers(1, 3), max_size=2), face=st.booleans()
)
def test_double_phase_parts_compose_again(rows, columns, batch, face):
    image = np.arange(np.prod([*batch, 2 * rows, 2 * columns]), dtype=float).reshape(*batch, 2 * rows, 2 * columns)
    image = torch.from_numpy(image) if face else image
    high, low = odak.wave.decompose_double_phase(image)
    assert high.shape == (*batch, 2 * rows, columns)
    np.testing.assert_array_equal(odak.wave.compose_double_phase(high, low), image)


def test_double_phase_parts_are_two_colours_of_checkerboard():
    image = np.arange(25).reshape(5, 5)
    high, low = odak.wave.decompose_double_phase(image)
    np.testing.assert_array_equal(high, [[0, 2], [6, 8], [10, 12], [16, 18]])
    np.testing.assert_array_equal(low, [[1, 3], [5, 7], [11, 13], [15, 17]])
    with pytest.raises(ValueError, match="at least 2 rows"):
        odak.wave.decompose_double_phase(image[:1])
    with pytest.raises(ValueError, match=r"component_low must be .* as component_high"):
        odak.wave.compose_double_phase(high, low[:2])
