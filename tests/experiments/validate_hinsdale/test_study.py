"""The study's results: comparisons by run, and their file."""

import json
import math

from angler_experiments.validate_hinsdale import study


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
