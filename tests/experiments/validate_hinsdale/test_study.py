"""The study's results: comparisons by run, and their file."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from angler_experiments.validate_hinsdale import identify, study
from angler_experiments.validate_hinsdale.parameters import LABELS
from angler_mjx.progress import Progress


def _run(roll, heave):
    return {"roll": roll, "pitch": 0.01, "heave": heave}


def test_better_runs_are_counted_over_the_test_half():
    scores = {
        study.IDENTIFIED: {"a": _run(0.1, 0.1), "b": _run(0.1, 0.3), "c": _run(0.1, 0.1)},
        "balance": {"a": _run(0.2, math.nan), "b": _run(0.05, math.nan), "c": _run(9.0, 9.0)},
    }
    better = study.count_better(scores, {"c"})
    assert better == {"balance": {"runs": 2, "roll": 1, "pitch": 0, "heave": 0}}
    assert study.count_better({"balance": scores["balance"]}, {"c"}) == {}


def test_results_are_json_with_five_digits_and_none_for_no_number():
    results = {"runs": {"a": {"begin_s": 1.23456789, "half": "test"}}, "scores": {"b": [math.nan]}}
    text = study.format_results(results)
    assert json.loads(text) == {
        "runs": {"a": {"begin_s": 1.2346, "half": "test"}},
        "scores": {"b": [None]},
    }
    assert len(text.splitlines()) == 8


class Recorder(Progress):
    """Progress as a list, in which tests note the work too."""

    def __init__(self):
        self.events = []

    def start(self, total, done=0, unit="worlds"):
        self.events.append(f"{total} {unit}")

    def describe(self, text):
        self.events.append(text)

    def advance(self, amount, vehicle_steps=0):
        self.events.append(amount)

    def note(self, name, result=None):
        """Return a function that notes its name and returns a result."""

        def work(*_):
            self.events.append(f"<{name}>")
            return result

        return work


@pytest.mark.parametrize("refits", [False, True])
def test_stages_of_the_identification_are_said_before_their_work(monkeypatch, refits):
    k, n = len(LABELS), 4
    seen = Recorder()
    fit = identify.Fit(np.zeros(k), np.zeros(()), np.eye(k))
    monkeypatch.setattr(identify, "identify", seen.note("fit", fit))
    monkeypatch.setattr(identify, "linearised_samples", seen.note("step", np.zeros((n, k))))

    def refit(vehicle, batch, sample, iterations, progress):
        for amount in (3, 1):
            seen.events.append("<part>")
            progress(amount)
        return np.zeros((n, k))

    monkeypatch.setattr(identify, "identify_samples", refit)
    simulated = SimpleNamespace(angles_rad=np.zeros((n, 3, 5, 3)), p_m=np.zeros((n, 3, 5, 3)))
    monkeypatch.setattr(study.bands, "simulate_samples", seen.note("bands", simulated))
    monkeypatch.setattr(study.bands, "out_of_bag_errors", seen.note("errors", np.zeros((2, 5, 3))))
    tracks = [SimpleNamespace(stem=stem) for stem in "abc"]
    settings = study.StudySettings(samples=n, iterations=7, refits=refits)
    study.identify_runs(tracks, np.zeros(3), {"a", "c"}, settings, seen)
    how, work = (
        ("fitted anew", ["<part>", 3, "<part>", 1])
        if refits
        else ("by one step from the fit", ["<step>", 4])
    )
    assert seen.events == [
        "fit of 2 runs, 7 iterations",
        "<fit>",
        f"4 bootstrap samples, {how}",
        "4 bootstrap samples",
        *work,
        "bands of 4 samples in 3 runs",
        "<bands>",
        "<errors>",
    ]


def test_the_study_says_what_it_reads_predicts_and_plots(tmp_path, monkeypatch):
    seen = Recorder()
    run = SimpleNamespace(stem="a", copy_of="b")
    monkeypatch.setattr(study, "read_campaign", seen.note("read", [run]))
    monkeypatch.setattr(study, "build_batch", lambda tracks: None)
    monkeypatch.setattr(study, "build_campaign_vehicle", lambda name: name)
    monkeypatch.setattr(study, "predict_set", lambda vehicle, *_: seen.events.append(vehicle) or [])
    monkeypatch.setattr(study, "_describe_horizons", seen.note("horizons", {}))
    monkeypatch.setattr(study.figures, "plot_overlays", seen.note("plot"))
    monkeypatch.setattr(study, "summarise", lambda *_: {"test": {}})
    table = study.run_study(tmp_path, tmp_path / "out", study.StudySettings(samples=0), seen)
    assert table.startswith("median over test runs")
    published = [
        event for name in study.PUBLISHED for event in (f"predictions of the set {name}", name)
    ]
    assert seen.events == [
        "reading the recordings",
        "<read>",
        "predictions without simulation of 0 runs",
        *published,
        "errors after a few steps",
        "<horizons>",
        "figures",
        "<plot>",
    ]
