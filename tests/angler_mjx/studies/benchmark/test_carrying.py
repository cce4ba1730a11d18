"""A benchmark of robots that carry a body: planners of others enter by the contract."""

import pyarrow.parquet as pq
import pytest

from angler_mjx.cli import main

SHIFT = '''
"""The body goes straight to its goal, and the robots with it; Beside stops half a metre off."""

import numpy as np

from angler_mjx import joint_path


class Shift:
    joints = True
    beside_m = 0.0

    def plan(self, problem):
        cargo, team = problem.cargo, problem.team
        travel = cargo.goal_m - cargo.start_m + [self.beside_m, 0.0, 0.0]
        share = np.linspace(0.0, 1.0, 16)
        eased = share * share * (3.0 - 2.0 * share)
        reach_m = np.linalg.norm(team.start_m - cargo.start_m, axis=1).max()
        far_m = np.linalg.norm(travel) + reach_m * abs(cargo.turn_rad)
        seconds = 1.6 * far_m / team.cruise_speed_mps.min()
        angle = float(cargo.turn_rad) * eased
        paths = []
        for start, yaw in zip(team.start_m, team.start_yaw_rad):
            x, y, z = start - cargo.start_m
            turned = np.stack(
                [
                    np.cos(angle) * x - np.sin(angle) * y,
                    np.sin(angle) * x + np.cos(angle) * y,
                    0.0 * angle + z,
                ],
                axis=1,
            )
            body = cargo.start_m + eased[:, None] * travel
            paths.append(joint_path(share * seconds, body + turned, yaw + angle))
        return paths


class Beside(Shift):
    beside_m = 0.5
'''
FILE = """
schema_version = 1
name = "carriers"
scenario = "small_carry.toml"
problems = 1
deadline_s = 60.0
set.time.horizon_s = 8.0
set.task.turn_deg = 10.0

[[planner]]
name = "carry"

[[planner]]
name = "shift.py:Shift"

[[planner]]
name = "shift.py:Beside"
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory, pytestconfig):
    folder = tmp_path_factory.mktemp("carriers")
    scenario = pytestconfig.rootpath / "tests/commands/small_carry.toml"
    (folder / "small_carry.toml").write_text(scenario.read_text(encoding="utf-8"))
    (folder / "shift.py").write_text(SHIFT)
    (folder / "carriers.toml").write_text(FILE)
    out = folder / "out"
    main.main(["benchmark", str(folder / "carriers.toml"), "--out", str(out)])
    return {row["planner"]: row for row in pq.read_table(out / "runs.parquet").to_pylist()}


def test_planners_of_others_plan_the_body_and_are_judged_by_it(runs):
    assert {name: row["planned"] for name, row in runs.items()} == dict.fromkeys(runs, True)
    assert {name: row["success"] for name, row in runs.items()} == {
        "carry": True,
        "Shift": True,
        "Beside": False,
    }
    assert runs["Beside"]["failure"] == "timeout"
    # It is planned for two robots that go 0.3 m each, and turn by 10 degrees a metre away.
    assert 0.6 < runs["Shift"]["plan_length_m"] < 1.2
    assert runs["Shift"]["makespan_s"] < 8.0
