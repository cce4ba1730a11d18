"""The benchmark in which the learned planner stands beside the others."""

from pathlib import Path

from angler_experiments import benchmarks
from angler_mjx.studies.benchmark import problem_settings

FILE = Path(benchmarks.__file__).with_name("learned.toml")


def test_all_are_asked_in_distribution_and_shifted():
    made = problem_settings.read_benchmark(FILE)
    requested = {}
    for setting in made.settings:
        where = (setting.scene, setting.robots)
        requested.setdefault(where, set()).update(
            one.label for one in made.select_planners(setting)
        )
    assert {("reef still", 8), ("reef moving", 8), ("dense stronger", 16)} <= set(requested)
    for labels in requested.values():
        assert {"learned", "grid", "RRTConnect, one by one", "current", "mppi"} <= labels
