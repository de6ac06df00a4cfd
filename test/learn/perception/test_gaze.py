"""Traces of the eye: main sequence, detection of fixations, angles on the display, and tables of eye trackers."""

import math

import pytest
import torch

from odak.learn.perception import GazeTrace, Viewing, read_gaze, saccade_duration, simulate_gaze

VIEW = Viewing(0.7, 0.7, (108, 192))


def test_saccades_keep_to_the_main_sequence():
    assert saccade_duration(torch.tensor([0.0, 5.0, 20.0])).tolist() == pytest.approx([0.021, 0.032, 0.065])
    places = [(0.5, 0.5), (0.6, 0.5), (0.2, 0.3)]
    trace = simulate_gaze(places, VIEW, rate=4000.0, seed=3)
    found = trace.fixations(1.0)
    assert len(found) == 3
    for (_, _, x, y), place in zip(found, places, strict=True):
        assert (x, y) == pytest.approx(place, abs=1e-3)
    # The first saccade: along the row of the gaze from straight ahead, by atan of its length over the distance.
    amplitude = math.degrees(math.atan(0.1))
    duration = 0.021 + 0.0022 * amplitude
    assert found[1][0] - found[0][1] == pytest.approx(duration, abs=4e-3)
    moving = (trace.seconds[:-1] >= found[0][1] - 1e-9) & (trace.seconds[:-1] < found[1][0])
    assert float(trace.speed()[moving].max()) == pytest.approx(1.875 * amplitude / duration, rel=0.01)
    distance = (trace.speed() * trace.seconds.diff())[moving].sum()
    assert float(distance) == pytest.approx(amplitude, rel=1e-3)


def test_times_of_fixations_have_the_mean_that_is_asked_for():
    trace = simulate_gaze([(0.4 + 0.2 * (k % 2), 0.5) for k in range(400)], VIEW, rate=200.0, mean_fixation=0.25)
    moves = 399 * float(saccade_duration(math.degrees(2 * math.atan(0.1))))
    assert (float(trace.seconds[-1]) - moves) / 400 == pytest.approx(0.25, rel=0.1)
    again = simulate_gaze([(0.4, 0.5), (0.6, 0.5)], VIEW, seed=1)
    assert torch.equal(again.gaze, simulate_gaze([(0.4, 0.5), (0.6, 0.5)], VIEW, seed=1).gaze)
    assert len(again.seconds) != len(simulate_gaze([(0.4, 0.5), (0.6, 0.5)], VIEW, seed=2).seconds)


def test_the_gaze_between_samples_is_differentiable():
    seconds, gaze = torch.tensor([0.0, 1.0, 3.0]).double(), torch.rand(3, 2, dtype=torch.float64).requires_grad_()
    trace = GazeTrace(seconds, gaze, VIEW)
    torch.testing.assert_close(trace.at([-1.0, 2.0, 9.0]), torch.stack([gaze[0], (gaze[1] + gaze[2]) / 2, gaze[2]]))
    times = torch.tensor([0.3, 1.7], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda g, t: GazeTrace(seconds, g, VIEW).at(t), (gaze, times), fast_mode=True)


@pytest.mark.parametrize(("name", "mark"), [("a.csv", ","), ("a.csv", ";"), ("a.tsv", "\t")])
def test_tables_of_eye_trackers(tmp_path, name, mark):
    path = tmp_path / name
    rows = [("x", " t ", "y"), ("96", "1000", "27"), ("", "1500", ""), ("192", "2000", "108")]
    path.write_text("\n".join(mark.join(row) for row in rows) + "\n")
    trace = read_gaze(path, VIEW, columns=("t", "x", "y"), unit="ms", pixels=True)
    assert trace.seconds.tolist() == [0.0, 1.0]
    assert trace.gaze.tolist() == [[0.5, 0.25], [1.0, 1.0]]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("time,x,z\n0,1,1\n", r"columns must be among \['time', 'x', 'z'\], got \['y'\] beside"),
        ("time,x,y\n0,1,up\n", "path must hold numbers, line 2"),
        ("time,x,y\n0,1,1\n", "path must hold two rows"),
        ("time,x,y\n1,1,1\n0,1,1\n", "seconds must rise"),
        ("", "columns must be among"),
    ],
)
def test_tables_that_are_refused(tmp_path, text, named):
    path = tmp_path / "gaze.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=named):
        read_gaze(path, VIEW)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: saccade_duration(-1.0), "amplitude"),
        (lambda: simulate_gaze([(0.5, 0.5)], VIEW), "fixations must be two or more places"),
        (lambda: simulate_gaze([(0.5, 0.5), (0.1, 0.1)], VIEW, rate=0.0), "rate"),
        (lambda: GazeTrace(torch.zeros(3), torch.zeros(2, 2), VIEW), "gaze must have a row for each"),
        (lambda: read_gaze("a.csv", Viewing(), pixels=True), "viewing must have a resolution"),
    ],
)
def test_refused(call, named):
    with pytest.raises((ValueError, TypeError), match=named):
        call()
