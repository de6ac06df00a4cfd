"""The files of an experiment, and the script that shows its trials, run with a stand-in for PsychoPy."""

import json
import math
import runpy
import sys
import types

import pytest
import torch

from odak.learn.perception import Metamer, PooledModel, Viewing, export_experiment

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


@pytest.mark.parametrize(
    ("shape", "named"),
    [((1, 1, 8, 8), "metamer must have two samples"), ((1, 8, 8), r"metamer must be of a picture \[1, C")],
)
def test_refused(shape, named):
    with pytest.raises(ValueError, match=named):
        export_experiment(Metamer(torch.square, noise(*shape)), "x", VIEW)
