"""castleCSF against tables made up here, in a stand-in for the package that has the true ones."""

import json
import sys

import pytest
import torch

from odak.learn.perception import castle_contrast_sensitivity, csf


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of tables that are powers of frequency and luminance, which logarithms interpolate exactly."""
    folder = tmp_path / "pycvvdp" / "vvdp_data"
    folder.mkdir(parents=True)
    (tmp_path / "pycvvdp" / "__init__.py").write_text("raise RuntimeError('only the tables are wanted')\n")
    luminances, frequencies = [0.01, 1.0, 50.0, 1e4], [0.1, 1.0, 8.0, 64.0]
    tables = {"omega": [0, 5], "ge_sigma": 1.5, "L_bkg": luminances, "rho": frequencies}
    for name, scale in (("o0_c1", 2.0), ("o0_c2", 3.0), ("o0_c3", 5.0), ("o5_c1", 7.0)):
        powers = torch.tensor(luminances)[:, None].pow(0.5) / torch.tensor(frequencies)
        tables[name] = (scale * powers).log10().tolist()
    (folder / "csf_lut_weber_fixed_size.json").write_text(json.dumps(tables))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pycvvdp", raising=False)
    csf._read.cache_clear()


@pytest.mark.usefixtures("package")
def test_values_between_the_knots():
    for arguments, scale in (
        (("achromatic", 0), 2),
        (("red-green", 0), 3),
        (("violet-yellow", 0), 5),
        (("achromatic", 5), 7),
    ):
        assert castle_contrast_sensitivity(3.0, 20.0, *arguments).item() == pytest.approx(scale * 20**0.5 / 3, rel=1e-5)
    frequency = torch.tensor([0.3, 3.0, 30.0], dtype=torch.float64, requires_grad=True)
    luminance = torch.tensor([[0.5], [700.0]], dtype=torch.float64, requires_grad=True)
    assert castle_contrast_sensitivity(frequency, luminance).shape == (2, 3)
    assert torch.autograd.gradcheck(castle_contrast_sensitivity, (frequency, luminance), fast_mode=True)
    assert castle_contrast_sensitivity(1e-3).item() == castle_contrast_sensitivity(0.1).item()
    assert (
        castle_contrast_sensitivity(torch.tensor(200.0)).item()
        == castle_contrast_sensitivity(torch.tensor(64.0)).item()
    )


@pytest.mark.usefixtures("package")
def test_refused():
    with pytest.raises(ValueError, match="channel must be one of"):
        castle_contrast_sensitivity(1.0, channel="green")
    for arguments in (("achromatic", 3), ("red-green", 5)):
        with pytest.raises(ValueError, match="temporal_frequency must be 0, or 5 for the achromatic channel"):
            castle_contrast_sensitivity(1.0, 100.0, *arguments)
    with pytest.raises(ValueError, match="frequency must be positive"):
        castle_contrast_sensitivity(0.0)


def test_without_the_package(monkeypatch):
    monkeypatch.setattr(csf, "MODULE", "no_such_package")
    with pytest.raises(ImportError, match="pip install cvvdp"):
        castle_contrast_sensitivity(1.0)
