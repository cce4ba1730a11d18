"""A run with a task: what stands in its folder, and what is drawn of it."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.report.viewing import figures
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.policy import Policy

SCENARIO = """
schema_version = 1
name = "brief_tour"
worlds = 2
seed = 3
tile = 2
engine = "fused"
kernels = "xla"

[time]
horizon_s = 2.0
record_hz = 5.0

[world]
preset = "open"
placement = "given"
start_m = [[-6.0, -6.0, -10.0], [-6.0, 6.0, -10.0]]
goal_m = [[6.0, -6.0, -10.0], [6.0, 6.0, -10.0]]

[task]
type = "tour"
positions_m = [[-6.0, 5.8, -10.0], [5.0, 2.0, -12.0]]

[policy]
name = "none"

[[fleet]]
vehicle = "bluerov2"
parameter_set = "blue_gazebo"
count = 2
"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Still(Policy):
    """Stops all thrusters."""

    def act(self, carry, known, key, step):
        lead = known.params.vehicle.B.shape
        return carry, ThrusterPwm(pwm_us=jnp.full((lead[0], lead[-1]), 1500.0))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Robot 1 is at the first place from the start; nobody comes to the second."""
    path = tmp_path_factory.mktemp("tour") / "tour.toml"
    path.write_text(SCENARIO)
    return rollout(load_scenario(path), out=path.parent / "run", policy=Still(), devices=1)


def test_episodes_and_summary_say_who_did_what(run):
    rows = run.episodes.to_pylist()
    assert [row["jobs_done"] for row in rows] == [0, 1, 0, 1]
    assert [row["task_progress"] for row in rows] == [0.5] * 4
    assert [row["task_completed_s"] for row in rows] == [None] * 4
    assert [row["outcome"] for row in rows] == ["timeout"] * 4
    task = run.summary["task"]
    assert task["completed"]["count"] == 0
    assert task["completed"]["high"] < 0.7  # Wilson, 0 of 2
    assert task["completed_s"]["mean"] is None
    assert task["progress"] == 0.5


def test_trajectories_hold_the_task_and_its_course(run):
    task = run.trajectories["task"]
    places = np.asarray(task["place_m"])
    assert places.shape == (2, 4, 3)
    assert np.allclose(places[0, :2], [[-6.0, 5.8, -10.0], [5.0, 2.0, -12.0]])
    assert np.allclose(places[0, 2:], [[-6.0, -6.0, -10.0], [-6.0, 6.0, -10.0]])
    assert np.asarray(task["by"]).tolist() == [[1, -1]] * 2
    assert np.asarray(task["done_at_s"])[0, 0] == 0.0
    assert np.isnan(np.asarray(task["done_at_s"])[0, 1])
    assert np.allclose(np.asarray(task["share"]), 0.5)
    # Both are the first to be thought of: robot 1 is nearer to what is left.
    assert (np.asarray(task["target"])[:, :, 1] == 1).all()
    assert (np.asarray(task["target"])[:, :, 0] == -1).all()
    assert (np.asarray(task["carrying"]) == -1).all()
    assert np.asarray(task["done"])[0, -1].tolist() == [0, 1]


def test_figures_show_the_task(run):
    drawn = {path.name for path in figures.plot_figures(run, worlds=[1])}
    assert {"map_world_1.png", "task_world_1.png"} <= drawn
    assert (run.path / "figures" / "task_world_1.png").stat().st_size > 10_000
