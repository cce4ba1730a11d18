"""Spot checks of runs whose end effectors are brought to the goals.

The stand-in passes signals through and measures without faults: at the level `thrusters` the same
controllers fly through its packets, clocks and outputs as flew in the run.
"""

import pytest

from angler_mjx.progress import Progress
from angler_mjx.robot.control.commands.whole_body import EndEffectorTarget
from angler_mjx.robot.control.stages import find_stage
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import Scenario
from angler_sitl.spotcheck import rebuilt_worlds, runner, world_flyers
from angler_sitl.spotcheck.results import SpotcheckSettings

SCENARIO = {
    "name": "short_reach",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "goal_tolerance_m": 0.05,
    "time": {"horizon_s": 20.0, "record_hz": 10.0},
    "world": {
        "preset": "open",
        "placement": "given",
        "start_m": [[0.0, 0.0, -10.0]],
        "goal_m": [[2.0, 0.3, -10.2]],
    },
    "task": {"type": "goal", "reached_by": "end_effector"},
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
}


class Silent(Progress):
    def start(self, total, done=0, unit="worlds"):
        pass

    def advance(self, amount, vehicle_steps=0):
        pass


@pytest.fixture(scope="module")
def scenario():
    return Scenario.model_validate(SCENARIO)


@pytest.fixture(scope="module")
def run(scenario, tmp_path_factory):
    made = rollout(scenario, out=tmp_path_factory.mktemp("reach") / "run")
    (row,) = made.episodes.to_pylist()
    assert row["outcome"] == "reached"
    return made


def test_references_take_targets_of_the_end_effector(scenario):
    """Each by a stage of inverse kinematics, on the engine that knows joints."""
    assert rebuilt_worlds.single_world_scenario(scenario).engine == "mjx"
    for names in world_flyers.ARM_STACKS.values():
        stages = [find_stage(name) for name in names]
        assert any(EndEffectorTarget in stage.takes for stage in stages)


def test_a_run_of_reach_is_flown_again(run, stand_in, tmp_path):
    settings = SpotcheckSettings(
        episodes=1, against=("surrogate",), levels=("thrusters",), binary=stand_in.path
    )
    result = runner.run_spot_check(run.path, settings, tmp_path / "check", Silent())
    assert result.complete
    assert all("byte by byte" in text for text in result.likeness.values())
    for name in ("surrogate", "thrusters"):
        (row,) = result.flights[0, name, 1].rows
        assert row["outcome"] == "reached", name
    # The run was flown by the same controllers.
    (gap,) = result.list_gaps("thrusters", 1, "recorded")
    assert gap.track_rms_m < 0.05
    assert abs(gap.arrival_s) < 2.0
    report = (tmp_path / "check" / "report.md").read_text()
    assert "left 1.2 m from the goals for targets of the end effectors" in report


@pytest.mark.sitl
def test_a_real_autopilot_brings_the_end_effector_to_its_goal(run, ardusub, tmp_path):
    settings = SpotcheckSettings(
        episodes=1, against=("surrogate",), levels=("guided", "thrusters"), binary=ardusub.path
    )
    result = runner.run_spot_check(run.path, settings, tmp_path / "check", Silent())
    for level in ("guided", "thrusters"):
        for gap in result.list_gaps(level, 1, "recorded"):
            assert gap.agrees
            assert gap.track_rms_m < 0.3
