"""The README's Python runs as printed, and its commands are where continuous integration looks for them."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("full", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_readme_code_makes_a_hologram(full, tmp_path, monkeypatch):
    """As printed with the slow tests, in fewer iterations otherwise."""
    from odak.tools import load_image

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    (shown,) = re.findall(r"^DisplayedHologram: ([\d.]+) dB for a camera", readme, re.MULTILINE)
    if not full:
        assert code.count("Run(iterations=20)") == 1
        code = code.replace("Run(iterations=20)", "Run(iterations=4)")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    # After four iterations it is 28.4.
    assert abs(float(names["hologram"].psnr) - (float(shown) if full else 28.4)) < 0.2
    pattern, picture = (load_image(str(tmp_path / name)) for name in ("hologram.png", "reconstruction.png"))
    assert pattern.shape == picture.shape[:2] == (400, 600)
    assert pattern.max() - pattern.min() > 200
    # The reconstruction is saved as a picture in grey; the photograph's luminance is near its green channel.
    assert (picture == picture[..., :1]).all()
    target = load_image(str(ROOT / "odak" / "assets" / "photo.png"))[..., 1]
    assert abs(picture[..., 0] - target).mean() < 0.1 * 255


@pytest.mark.parametrize("name", ["hologram", "tests"])
def test_continuous_integration_finds_its_commands(name):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (line,) = re.findall(rf"<!-- ci: {name} -->\n```bash\n(.*)\n```", readme)
    requirements = "requirements.txt" if name == "hologram" else "requirements-tests.txt"
    torch = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()[1]
    pip = ".venv/bin/python -m pip install"
    index = "--no-deps --timeout 15 --retries 1 --extra-index-url https://download.pytorch.org/whl/cpu"
    assert line.startswith(f"python3 -m venv .venv && {pip} -q {index} {torch} && {pip} -q -r {requirements} && ")
    assert torch.startswith("torch==")
