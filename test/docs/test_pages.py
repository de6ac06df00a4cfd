"""Every page of the site runs top to bottom and prints what it shows."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
from documentation import ROOT, agrees, script

import odak

SLOW = {
    "guides/a_hologram_in_a_lens.md",
    "guides/automatic_design.md",
    "guides/calibrate_a_table.md",
    "guides/colour.md",
    "guides/compute_a_hologram.md",
    "guides/design_a_display.md",
    "guides/design_a_lens.md",
    "guides/distributed_computing.md",
    "guides/foveated_holograms.md",
    "guides/from_slm_to_hologram.md",
    "guides/displays.md",
    "guides/ecosystem.md",
    "guides/hologram_network.md",
    "guides/large_fields.md",
    "guides/learned_models.md",
    "guides/light_fields.md",
    "guides/metamers.md",
    "guides/multiplane_and_colour.md",
    "guides/near_eye_display.md",
    "guides/photographs_to_a_hologram.md",
    "guides/pictures_through_a_lens.md",
    "guides/polarised_light_and_media.md",
    "guides/polarised_rays.md",
    "guides/propagate_light.md",
    "guides/real_displays.md",
    "guides/see_results.md",
    "guides/stray_light.md",
    "guides/the_eye.md",
    "guides/toolkit.md",
    "guides/windows_and_partial_coherence.md",
    "guides/your_table_in_an_afternoon.md",
    "index.md",
    "notes/accuracy.md",
    "notes/hologram_optimization.md",
    "notes/light_transport.md",
    "notes/metameric_loss.md",
    "notes/published_results.md",
}
# Of those, what shows numbers of few steps, or rough ones (≈) of what was optimised, learned or drawn.
EXACT = {
    "guides/a_hologram_in_a_lens.md",
    "guides/colour.md",
    "guides/design_a_lens.md",
    "guides/distributed_computing.md",
    "guides/light_fields.md",
    "guides/near_eye_display.md",
    "guides/pictures_through_a_lens.md",
    "guides/polarised_light_and_media.md",
    "guides/polarised_rays.md",
    "guides/propagate_light.md",
    "guides/see_results.md",
    "guides/stray_light.md",
    "guides/the_eye.md",
    "guides/toolkit.md",
    "guides/windows_and_partial_coherence.md",
    "notes/light_transport.md",
    "notes/published_results.md",
}
NEED_A_BROWSER = {"guides/see_results.md"}
NEED_BLENDER = {"guides/render_in_blender.md"}
make_pictures = script("make_pictures")


def _case(path):
    name = path.relative_to(make_pictures.DOCS).as_posix()
    groups = (
        (pytest.mark.slow, SLOW),
        (pytest.mark.browser, NEED_A_BROWSER),
        (pytest.mark.blender, NEED_BLENDER),
    )
    marks = [mark for mark, pages in groups if name in pages]
    return pytest.param(path, id=name, marks=marks)


# A page shows a training that is interrupted. Matplotlib asks tensors for a copy in a way that torch does not take yet.
@pytest.mark.filterwarnings("ignore::odak.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore:__array:DeprecationWarning")
@pytest.mark.parametrize("path", [_case(path) for path in make_pictures.pages()])
def test_page_prints_what_it_shows(path, tmp_path):
    # Numbers of few steps to the digits that are shown, those of many within 2 %.
    name = path.relative_to(make_pictures.DOCS).as_posix()
    by_digits = name not in SLOW or name in EXACT
    for block, printed in make_pictures.run_page(path, tmp_path):
        said = f"{path}:{block.line} shows\n{block.expected}\nbut prints\n{printed}"
        assert agrees(block.expected, printed, by_digits or block.language == "bash"), said
    stored = {picture.name for picture in make_pictures.pictures_of(path).glob("*.png")}
    assert {picture.name for picture in tmp_path.glob("*.png")} == stored, "run docs/make_pictures.py"


@pytest.mark.parametrize("path", sorted(make_pictures.DOCS.rglob("*.md")), ids=lambda path: path.stem)
def test_pictures_of_a_page_exist_and_all_are_shown(path):
    shown = {Path(target).name for target in re.findall(r"!\[[^\]]*\]\(([^)]*)\)", path.read_text(encoding="utf-8"))}
    stored = {picture.name for picture in make_pictures.pictures_of(path).glob("*.png")}
    assert shown == stored


def test_agreement_of_numbers():
    assert agrees("PSNR 30.1 dB\n", "PSNR 30.3 dB\n") and agrees("117 materials", "118 materials")
    assert not agrees("PSNR 30.1 dB\n", "PSNR 33.0 dB\n")
    assert not agrees("PSNR 30.1 dB\n", "SSIM 30.1 dB\n")
    assert agrees("PSNR ≈ 30.1 dB\n", "PSNR ≈ 33.0 dB\n") and not agrees("PSNR ≈ 30 dB\n", "PSNR ≈ 20 dB\n")
    assert agrees("error ≈ 3e-16", "error ≈ 4e-15") and not agrees("error ≈ 3e-16", "error ≈ 3e-12")
    assert not agrees("error 3e-16", "error ≈ 3e-16") and not agrees("error ≈ 3e-5", "error ≈ 3e-3")


def test_agreement_by_digits():
    def equal(shown, printed):
        return agrees(shown, printed, by_digits=True)

    assert equal("PSNR 30.1 dB\n", "PSNR 30.2 dB\n") and not equal("PSNR 30.1 dB\n", "PSNR 30.3 dB\n")
    assert equal("of 2.50e-07", "of 2.51e-07") and not equal("of 2.50e-07", "of 2.52e-07")
    assert equal("11.810498697705988", "11.8104987") and not equal("11.810498697705988", "11.81055")
    assert not equal("117 materials", "118 materials") and equal("2774 ppm", "2773 ppm")
    assert equal("PSNR ≈ 30 dB\n", "PSNR ≈ 33 dB\n") and not equal("PSNR ≈ 30 dB\n", "PSNR ≈ 20 dB\n")


def test_blocks_are_read_with_their_output(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "```python\nprint(1)\n```\n\n```text\n1\n```\n\n    ```python\n    x = 2\n    ```\n", encoding="utf-8"
    )
    first, second = make_pictures.read_blocks(page)
    assert (first.code, first.line, first.expected) == ("print(1)\n", 2, "1\n")
    assert (second.code, second.line, second.expected) == ("x = 2\n", 10, "")
    assert [printed for _, printed in make_pictures.run_page(page, tmp_path)] == ["1\n", ""]


def test_commands_before_an_output_are_run_with_the_files_of_the_page(tmp_path):
    page = tmp_path / "page.md"
    command = "```bash\nodak examples lenses \\\n    --output here  # all\nodak --version\n```\n\n```text\n2 lines\n```\n"
    page.write_text(f"```toml\n# bench.toml\na = 1\n```\n\n{command}\n```bash\nrm x\n```\n", encoding="utf-8")
    (_, nothing), (block, printed) = make_pictures.run_page(page, tmp_path)
    assert nothing == "" and block.expected == "2 lines\n"
    assert printed.splitlines()[-1] == odak.__version__ and list((tmp_path / "here").iterdir())
    assert (tmp_path / "bench.toml").read_text(encoding="utf-8") == "# bench.toml\na = 1\n"
    for wrong in ("odak examples --quickly", "rm x"):
        page.write_text(f"```bash\n{wrong}\n```\n\n```text\n```\n", encoding="utf-8")
        with pytest.raises(RuntimeError, match=f"page.md:2: {wrong} fails, or is no command of odak"):
            make_pictures.run_page(page, tmp_path)


def test_commands_of_all_pages_exist_with_their_options():
    """They are read as the command line reads them, whether they are run or not."""
    cli, known = importlib.import_module("odak.cli.app"), 0
    for path in [*sorted(make_pictures.DOCS.rglob("*.md")), ROOT / "README.md"]:
        for code in re.findall(r"^ *```bash\n(.*?)^ *```$", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
            for words in make_pictures.commands(code):
                # What stands for options of the reader, and the one that prints the help.
                words = [word for word in words if word not in ("$TLS", "…", "--help")]
                if words and Path(words[0]).name == "odak":
                    command = cli._command().commands[words[1]]
                    command.make_context(f"{path}: {shlex.join(words)}", cli._apart(words[2:]))
                    known += 1
    assert known > 60


@pytest.mark.parametrize("path", sorted(make_pictures.DOCS.rglob("*.md")), ids=lambda path: path.stem)
def test_code_fits_its_column(path):
    blocks = make_pictures.read_blocks(path)
    assert all(len(line) <= 88 for block in blocks for line in block.code.splitlines()), path
