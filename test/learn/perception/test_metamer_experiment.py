"""The files of an experiment, and the script that shows its trials, run with a stand-in for PsychoPy."""

import json
import math
import runpy
import shutil
import subprocess
import sys
import types

import pytest
import torch

from odak.learn.perception import Metamer, PooledModel, Viewing, export_experiment, metamer_experiment
from odak.learn.tools import load_image

VIEW = Viewing(0.4, 0.7)


def noise(*shape, seed=11):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_the_script_of_an_experiment_shows_each_trial_and_writes_the_answers(tmp_path, monkeypatch):
    samples = Metamer(PooledModel("luminance", 0.5, VIEW), noise(1, 1, 16, 24), samples=2, limit=0.9)
    trials = export_experiment(samples, tmp_path, VIEW, repeats=4)
    folder, shown = tmp_path, []
    # Each case of which is A and which is X once.
    assert sorted((t["a"], t["answer"]) for t in trials) == sorted(
        (f"sample_{n}.png", answer) for n in (1, 2) for answer in "ab"
    )
    assert all(t["x"] == t[t["answer"]] for t in trials)
    settings = json.loads((folder / "settings.json").read_text())
    assert settings["width_degrees"] == pytest.approx(2 * math.degrees(math.atan(0.2 / 0.7)))
    with pytest.raises(SystemExit, match="screen_width_cm, screen_distance_cm, screen_pixels"):
        runpy.run_path(str(folder / "experiment.py"), run_name="__main__")
    settings |= {"screen_width_cm": 60, "screen_distance_cm": 70, "screen_pixels": [1920, 1080]}
    (folder / "settings.json").write_text(json.dumps(settings))

    class Stimulus:
        def __init__(self, window, what, **options):
            self.what, self.size = what, (24, 16)

        def draw(self):
            shown.append((self.what, self.size))

    class Clock:
        def __init__(self):
            self.calls = 0

        def getTime(self):
            self.calls += 1
            return 0.0 if self.calls == 1 else 10.0

    class Window:
        def __init__(self, size, **options):
            self.flip = self.close = lambda: None

    monitor = types.SimpleNamespace(setSizePix=lambda size: None)
    psychopy = types.ModuleType("psychopy")
    psychopy.core = types.SimpleNamespace(Clock=Clock, quit=lambda: None)
    psychopy.event = types.SimpleNamespace(waitKeys=lambda keyList: ["left"])
    psychopy.monitors = types.SimpleNamespace(Monitor=lambda *a: monitor)
    psychopy.visual = types.SimpleNamespace(Window=Window, ImageStim=Stimulus, TextStim=Stimulus)
    monkeypatch.setitem(sys.modules, "psychopy", psychopy)
    runpy.run_path(str(folder / "experiment.py"), run_name="__main__")
    pictures = [(what.rsplit("/")[-1].rsplit("\\")[-1], size) for what, size in shown if what.endswith("png")]
    wanted = [t[part] for t in trials for part in "abx"]
    assert [name for name, _ in pictures if name.startswith("sample")] == wanted
    assert pictures[0][1] == pytest.approx((0.4 / 0.7 * 70, 0.4 / 0.7 * 70 * 16 / 24))
    lines = (folder / "answers.csv").read_text().split()
    assert [line.rsplit(",", 1)[1] for line in lines[1:]] == [str(int(t["answer"] == "a")) for t in trials]


# Stands in for the document, the pictures, the screen and jsPsych of a page; prints what was shown and saved.
STAND_IN = """
const page = process.argv[1], shown = [], kept = [];
const save = (names, file) =>
  console.log(JSON.stringify({ shown, file, rows: kept.map((data) => names.map((name) => data[name])) }));
const inner = (start, end) => page.split(start)[1].split(end)[0];
const element = { textContent: inner('id="experiment">', "</script>"), remove() {} };
element.addEventListener = (kind, run) => run({ preventDefault() {}, target: element });
const values = { width: "60", distance: "70" };
globalThis.document = { getElementById: (id) => (id in values ? { value: values[id] } : element) };
globalThis.screen = { width: 1920 };
globalThis.Image = class { naturalWidth = 24; naturalHeight = 16; async decode() {} };
globalThis.jsPsychHtmlKeyboardResponse = "plugin";
globalThis.initJsPsych = ({ on_finish }) => ({
  data: { get: () => ({ filter: () => ({ filterColumns: (names) => ({
    localSave: (form, file) => save(names, file),
  }) }) }) },
  async run(timeline) {
    for (const trial of timeline) {
      shown.push([trial.stimulus, trial.trial_duration]);
      if (!trial.on_finish) continue;
      const data = { ...trial.data, response: "arrowleft" };
      trial.on_finish(data);
      kept.push(data);
    }
    on_finish();
  },
});
eval(page.split("<script>")[1].split("</script>")[0]);
"""


def test_the_page_holds_the_trials_and_no_text_of_the_caller_ends_it(tmp_path):
    samples = Metamer(Named(), noise(1, 1, 16, 24), samples=2, limit=0.9)
    trials = export_experiment(samples, tmp_path, VIEW, repeats=4)
    page = (tmp_path / "experiment.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page and page.count("</script>") == 4
    data = json.loads(page.split('id="experiment">')[1].split("</script>")[0])
    assert data["trials"] == trials and data["settings"]["model"] == repr(samples.model)
    assert data["settings"] == json.loads((tmp_path / "settings.json").read_text())
    node = shutil.which("node")
    if node is None:
        return
    ran = subprocess.run([node, "-e", STAND_IN, page], capture_output=True, text=True, check=True, timeout=60)
    found = json.loads(ran.stdout)
    pictures = [(text.split('src="')[1].split('"')[0], time) for text, time in found["shown"] if "src" in text]
    assert [name for name, _ in pictures if name.startswith("sample")] == [t[part] for t in trials for part in "abx"]
    assert {time for _, time in pictures} == {200} and len(pictures) == 2 * 3 * len(trials)
    # 0.4/0.7 of 70 cm on a screen of 1920 pixels in 60 cm.
    for part in ("width:1280", "height:853.33", "left:50%;top:50%"):
        assert part in found["shown"][0][0]
    assert found["file"] == "answers.csv"
    wanted = [[*(t[n] for n in ("a", "b", "x", "answer")), "a", int(t["answer"] == "a")] for t in trials]
    assert found["rows"] == wanted


class Named(torch.nn.AvgPool2d):
    """A model whose name is markup."""

    def __init__(self):
        super().__init__(4)

    def __repr__(self):
        return "</script><script>alert(1)</script>"


def test_the_files_hold_the_pictures_in_colour(tmp_path):
    picture = noise(1, 3, 8, 16)
    picture[0, :, 0, 0] = 1
    samples = Metamer(torch.nn.AvgPool2d(4), picture, samples=2)
    trials = export_experiment(samples, tmp_path, VIEW, repeats=8)
    names = ("mask_1", "mask_2", "picture", "sample_1", "sample_2")
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == list(names)
    for name, wanted in zip(names[2:], (picture[0], *samples.pictures[:, 0]), strict=True):
        found = load_image(str(tmp_path / f"{name}.png"), normalizeby=255, torch_style=True)
        torch.testing.assert_close(found.double(), wanted.double().clamp(0, 1), rtol=0, atol=0.51 / 255)
    settings = json.loads((tmp_path / "settings.json").read_text())
    assert settings["height_degrees"] == pytest.approx(2 * math.degrees(math.atan(0.1 / 0.7)))
    assert settings["width_over_distance"] == pytest.approx(0.4 / 0.7)
    assert (settings["seconds"], settings["pause_seconds"], settings["masks"]) == (0.2, 0.5, 2)
    assert export_experiment(samples, tmp_path, VIEW, repeats=8, seed=0) == trials
    # Four cases of each pair with the picture, twice each.
    with_picture = export_experiment(samples, tmp_path, VIEW, repeats=8, original=True)
    cases = [tuple(trial.values()) for trial in with_picture]
    assert len(cases) == 16 and len(set(cases)) == 8 and all(cases.count(case) == 2 for case in cases)


def test_masks_keep_the_spectrum_and_the_mean_of_a_picture():
    picture = 0.5 + 0.04 * noise(3, 8, 12)
    mask = metamer_experiment._scrambled(picture, torch.Generator().manual_seed(5))
    before, after = torch.fft.fft2(picture), torch.fft.fft2(mask)
    torch.testing.assert_close(after.abs(), before.abs())
    torch.testing.assert_close(after[:, 0, 0], before[:, 0, 0])
    # The phases differ, by the same in all channels.
    turned = (after / before)[:, 1:, 1:]
    torch.testing.assert_close(turned[1:], turned[:1].expand(2, -1, -1))
    assert (turned[0] - 1).abs().mean() > 0.5
    loud = metamer_experiment._scrambled(torch.eye(12).repeat(1, 1, 1), torch.Generator().manual_seed(5))
    assert loud.min() == 0 and loud.max() <= 1
    assert metamer_experiment._scrambled(1 - torch.eye(12)[None], torch.Generator().manual_seed(5)).max() == 1


@pytest.mark.parametrize(
    ("shape", "named"),
    [((1, 1, 8, 8), "metamer must have two samples"), ((1, 8, 8), r"metamer must be of a picture \[1, C")],
)
def test_refused(shape, named):
    with pytest.raises(ValueError, match=named):
        export_experiment(Metamer(torch.square, noise(*shape)), "x", VIEW)
