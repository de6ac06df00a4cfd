"""Individual observers: the published standard, signs of the variations, the failure of matches."""

import numpy as np
import pytest
import torch

from odak.learn.perception import (
    cone_fundamentals,
    display_color,
    illuminant_d65,
    individual_cone_fundamentals,
    metameric_failure,
    sample_observers,
)

WAVES = torch.arange(390.0, 781.0, dtype=torch.float64)


def lines(width, peaks=(638.0, 520.0, 450.0)):
    return torch.stack([torch.exp(-(((WAVES - peak) / width) ** 2) / 2) for peak in peaks])


def test_the_default_person_is_the_standard_observer():
    found, table = individual_cone_fundamentals(WAVES), cone_fundamentals(WAVES).double()
    assert float((found - table).abs().max()) < 0.02
    peaks = [float(WAVES[one.argmax()]) for one in found]
    assert peaks == pytest.approx([570.0, 543.0, 442.0], abs=3)


def test_formulas_of_stockman_and_rider():
    # Their scale factors: absorbances of maximum 1, densities of 0.35 at 460 nm and 1.7649 at 400 nm.
    bare = individual_cone_fundamentals(WAVES, lens=0.0, macular=0.0, densities=(1e-6, 1e-6, 1e-6))
    no_lens, no_macula = (individual_cone_fundamentals(WAVES, **{name: 0.0}) for name in ("lens", "macular"))
    standard = individual_cone_fundamentals(WAVES)
    at = {nm: nm - 390 for nm in (400, 460, 700)}
    for absent, nm, density in ((no_lens, 400, 1.7649), (no_macula, 460, 0.35)):
        # At 700 nm neither absorbs: the ratio there takes away the normalisation.
        ratio = (absent / standard)[0, [at[nm], at[700]]].log10()
        assert float(ratio[0] - ratio[1]) == pytest.approx(density, abs=2e-4)
    # In quanta, the peaks of their table: L (mean of two variants), M and S absorbance.
    quanta = bare / WAVES
    assert [float(WAVES[one.argmax()]) for one in quanta] == pytest.approx([551.9, 529.8, 416.9], abs=0.6)


def test_population_has_the_published_deviations(monkeypatch):
    # Asano et al. (2016), table 5, step 2, from what each person's cones are made of.
    given = []
    monkeypatch.setattr(display_color, "individual_cone_fundamentals", lambda _, *made: given.append(made) or WAVES[:1])
    sample_observers(2000, [550.0], seed=3)
    made = torch.tensor([[lens, macula, *density, *shift] for lens, macula, density, shift in given])
    mean = torch.tensor([1.7649, 0.35, 0.5, 0.5, 0.4, 1.0, 1.0, 1.0])
    published = torch.tensor([0.187, 0.365, 0.09, 0.09, 0.074, 2.0, 1.5, 1.3])
    # Of the deviation of 2000 normal numbers: 1.6 % standard error.
    assert float(((made / mean).std(0) / published - 1).abs().max()) < 0.06
    assert float(((made / mean).mean(0) - torch.tensor([1.0] * 5 + [0.0] * 3)).abs().max()) < 0.15


def test_densities_and_peaks_do_what_they_say():
    standard = individual_cone_fundamentals(WAVES)
    more_lens = individual_cone_fundamentals(WAVES, lens=2.2)
    ratio = more_lens[0] / standard[0]
    assert float(ratio[WAVES == 420]) < float(ratio[WAVES == 480]) < float(ratio[WAVES == 560])
    # Twice the macular pigment: absorbed is 10^-0.35 at 460 nm, beyond 550 nm nothing.
    doubled = individual_cone_fundamentals(WAVES, macular=0.7)
    step = (doubled[1] / standard[1])[[int(nm) - 390 for nm in (460, 600)]]
    assert float(step[0] / step[1]) == pytest.approx(10**-0.35, rel=0.02)
    shifted = individual_cone_fundamentals(WAVES, shifts=(4.0, 0.0, 0.0))
    assert float(WAVES[shifted[0].argmax()] - WAVES[standard[0].argmax()]) == pytest.approx(4, abs=1.5)
    assert torch.equal(shifted[1], standard[1])


def test_narrow_primaries_fail_more():
    people, light = sample_observers(40, seed=1), illuminant_d65(WAVES).double()
    lasers, phosphors = lines(2.0), lines(30.0, (610.0, 540.0, 460.0))
    narrow, wide = (metameric_failure(one, light, people).differences for one in (lasers, phosphors))
    assert float(narrow.mean()) > 2 * float(wide.mean()) > 1
    assert torch.equal(people, sample_observers(40, seed=1))


def test_standard_observer_sees_no_difference_one_person_does():
    light, standard = illuminant_d65(WAVES).double(), cone_fundamentals(WAVES).double()
    lasers = lines(2.0)
    person = individual_cone_fundamentals(WAVES, lens=2.3)
    found = metameric_failure(lasers, light, torch.stack([standard, person]))
    assert float(found.differences[0]) < 1e-6 < 0.5 < float(found.differences[1])
    # The weights make the cones of the standard observer answer alike.
    shown = (found.weights[:, None] * lasers).sum(0).numpy()
    np.testing.assert_allclose(standard.numpy() @ shown, standard.numpy() @ light.numpy())
    ratio = (person.numpy() @ shown) / (person.numpy() @ light.numpy())
    assert abs(ratio[2] - 1) > 0.02


def test_gradients_and_wrong_arguments():
    light, people = illuminant_d65(WAVES).double(), sample_observers(2)
    primaries = lines(20.0).requires_grad_()
    metameric_failure(primaries, light, people).differences.sum().backward()
    assert bool(primaries.grad.isfinite().all()) and float(primaries.grad.abs().max()) > 0
    with pytest.raises(ValueError, match="wavelengths"):
        individual_cone_fundamentals([300.0])
    with pytest.raises(ValueError, match="distinguish"):
        metameric_failure(torch.ones(3, 391, dtype=torch.float64), light, people)
