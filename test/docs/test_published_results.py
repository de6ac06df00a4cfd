"""Numbers of books and articles on the page of published results, within the deviations that the page explains."""

import re

import pytest
from documentation import script

make_pictures = script("make_pictures")
PAGE = make_pictures.DOCS / "notes" / "published_results.md"
_LINE = re.compile(r"^(.{36}) (\S+) +(\S+?) *[-+]\d+\.\d\d%$", re.MULTILINE)
# Relative deviations explained on the page, by the start of the line; all other numbers agree to 0.01 %.
TOLERANCES = {
    "bright ring": 0.02,
    "light in dark ring": 1e-3,
    "largest delay": 3e-4,
    "its angle": 3e-4,
    "smaller angle": 3e-4,
    "larger angle": 3e-4,
    "transmission": 0.01,
    "reflection": 3e-3,
    "ring, radial": 0.1,
    "ring, linear": 0.02,
    "obscuration": 5e-4,
    "2 levels": 0.012,
    "4 levels": 2e-3,
    "8 levels": 2e-3,
    "16 levels": 3e-3,
    "arcseconds": 1e-3,
    "waves RMS": 0.05,
    "designed": 0.03,
    "as built": 0.06,
    "10 degrees": 4e-6,
    "20 degrees": 4e-6,
    "30 degrees": 4e-6,
    "PQ": 2e-3,
    "HLG": 2e-3,
}
TABLES = ("Strehl ratios", "Arrays of optical traps")  # with tests of their own
pytestmark = pytest.mark.slow


def _sections():
    """Return the headings of the entries and the lines at which they begin."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    return {line[4:]: number for number, line in enumerate(lines, 1) if line.startswith("### ")}


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """What the code of each entry prints now."""
    results = make_pictures.run_page(PAGE, tmp_path_factory.mktemp("published"))
    starts = sorted((line, title) for title, line in _sections().items())
    texts = {}
    for block, text in results:
        before = [title for line, title in starts if line < block.line]
        if before:
            texts[before[-1]] = text
    return texts


def _numbers(text):
    return [float(number) for number in re.findall(r"\d+\.?\d*(?:e[-+]?\d+)?", text)]


@pytest.mark.parametrize("title", list(_sections()))
def test_numbers_are_those_published(title, printed):
    lines = _LINE.findall(printed[title])
    assert lines or title.startswith(TABLES)
    for name, published, ours in lines:
        tolerance = next((value for start, value in TOLERANCES.items() if name.strip().startswith(start)), 1e-4)
        assert float(ours) == pytest.approx(float(published), rel=tolerance), name


def test_fresnel_methods_part_at_the_critical_distance(printed):
    rows = [_numbers(row) for row in printed["A square beam (Voelz 2011)"].splitlines()[1:]]
    (_, near, repeats), (_, *equal), (_, aliases, far), (_, stairs, _) = rows
    assert near < 3 and repeats > 50 and equal[0] == equal[1] < 1 and aliases > 5 and far < 1 and stairs > 20


def test_radial_polarisation_is_the_worse_one_of_a_full_pupil(printed):
    linear, radial = printed["A sharper focus (Dorn, Quabis and Leuchs 2003)"].splitlines()[-2:]
    assert 1.3 * _numbers(linear)[0] < _numbers(radial)[0]


def test_the_marechal_formula_errs_by_less_than_a_tenth(printed):
    rows = printed["Strehl ratios of primary aberrations (Mahajan 1982, 1983)"].splitlines()[1:]
    assert len(rows) == 4
    for marechal, exponential in map(_numbers, rows):
        assert exponential < marechal < 10


def test_trap_arrays_are_as_efficient_and_even_as_published(printed):
    """The random superposition and its deviation are explained on the page."""
    rows = printed["Arrays of optical traps (Di Leonardo, Ianni and Ruocco 2007)"].splitlines()[2:]
    table = {row[:24].strip(): _numbers(row[24:]) for row in rows}
    for name, even in (("random mask", 0.12), ("superposition", 0.02), ("Gerchberg-Saxton", 0.1), ("weighted", 0.04)):
        e, u, sigma, efficiency, uniformity, deviation = table[name]
        assert efficiency == pytest.approx(e, abs=0.02) and uniformity == pytest.approx(u, abs=even)
        assert deviation == pytest.approx(sigma, abs=3, rel=0.05)
    assert table["weighted, fixed phases"][1] >= 0.99


def test_few_rays_at_the_nodes_of_gauss_beat_many_on_a_grid(printed):
    rows = printed["Gaussian quadrature of the pupil (Forbes 1988)"].splitlines()[-3:]
    grid, rings, gauss = (dict(zip(_numbers(row)[::2], _numbers(row)[1::2], strict=True)) for row in rows)
    assert gauss[36] < grid[3209] / 10 and gauss[36] < rings[3169] / 10 and gauss[100] < 1e-7
