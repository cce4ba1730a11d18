"""What the learned planner takes from a dataset: its splits, judged by the reader of episodes."""

import numpy as np
import pytest

from angler_experiments.learned_planner.train import from_runs
from angler_mjx.learning import datasets


def _taken(made, split, report):
    parts = list(from_runs.read_folder(made, split, report.append))
    return (
        np.concatenate([20.0 * np.asarray(part.scenes.own)[..., 0] for part in parts]),
        np.concatenate([np.asarray(part.has_path) for part in parts]),
    )


@pytest.mark.parametrize("split", ["train", "test_there"])
def test_a_split_is_its_episodes_and_no_others(made, split):
    report = []
    length_m, planned = _taken(made, split, report)
    chosen = datasets.open(made, split=split)
    expected = [chosen.episode(i) for i in range(len(chosen))]
    assert len(expected) < len(datasets.open(made))
    straight = [np.linalg.norm(one.goal_m - one.start_m, axis=-1) for one in expected]
    np.testing.assert_allclose(length_m, straight, rtol=1e-4)
    assert planned.sum() == sum(one.about["planned"] for one in expected)
    assert not report


def test_a_split_that_is_not_there_gives_nothing(made):
    assert list(from_runs.read_folder(made, "nowhere", print)) == []
