"""Planners of the device: their paths depend on their problem alone, before and during a flight."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.errors import ConfigError
from angler_mjx.planning import register
from angler_mjx.planning.device_planner import build_device_planner
from angler_mjx.planning.planner import joint_path
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.scenario.scenario import load_scenario

from .problems import problem

TRUTH = """
name = "hidden"
seed = 3
worlds = 1

[time]
horizon_s = 120.0

[world]
preset = "open"

[[world.currents]]
type = "uniform"
velocity_mps = [{speed}, 0.0, 0.0]

[[world.obstacles.explicit]]
type = "sphere"
radius_m = 0.5
position_m = [0.0, 0.0, -8.0]
motion = {{ type = "straight", velocity_mps = [{scripted}, 0.0, 0.0] }}

[world.obstacles.dynamic]
count = 1
rise_fraction = 1.0
sink_fraction = 0.0
vertical_speed_mps = [{speed}, {speed}]

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2

[planner]
name = "{planner}"
"""


@pytest.mark.parametrize(
    ("planner", "is_scripted_alike"), [("grid", False), ("priority", False), ("current", True)]
)
def test_paths_do_not_depend_on_what_the_problem_hides(tmp_path, planner, is_scripted_alike):
    """Worlds that differ in current and motion of obstacles, which the planner may not know.

    A script is a constant of the program, the rest are numbers. `current` takes longest to compile:
    its scripts are equal, and its problems are built as those of `priority`.
    """
    results = []
    for speed in (0.05, 0.3):
        file = tmp_path / f"{speed}.toml"
        scripted = 0.1 if is_scripted_alike else speed
        file.write_text(TRUTH.format(speed=speed, scripted=scripted, planner=planner))
        simulator = angler.Simulator(load_scenario(file), tile=1)
        worlds, problems = simulator.worlds(0), simulator.sample_problems(0)[1]
        results.append(jax.device_get((worlds, problems)))
    (slow, slow_problems), (fast, fast_problems) = results
    assert not np.array_equal(
        slow.environment.current[0].velocity_mps, fast.environment.current[0].velocity_mps
    )
    slow_obstacles, fast_obstacles = slow.environment.obstacles, fast.environment.obstacles
    assert np.array_equal(slow_obstacles.path, fast_obstacles.path) == is_scripted_alike
    assert not np.array_equal(slow_obstacles.mass_kg, fast_obstacles.mass_kg)
    assert jax.tree.structure(slow_problems) == jax.tree.structure(fast_problems)
    for a, b in zip(
        jax.tree.leaves((slow.path, slow_problems)),
        jax.tree.leaves((fast.path, fast_problems)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
    assert slow.path.found.any()


class Joints:
    def plan_batch(self, problems):
        path = joint_path([0.0, 1.0], np.zeros((2, 3)), [0.0, 0.0])
        return jax.tree.map(lambda leaf: np.asarray(leaf)[None, None], path)


class Failing:
    def plan_batch(self, problems):
        raise KeyError("no way")


class Holding:
    def check_problem(self, settings):
        if settings.points > 100:
            raise ConfigError("too many points")

    def plan_batch(self, problems):
        start = problems.team.start_m
        points = jnp.repeat(start[:, :, None], problems.points, axis=2)
        found = jnp.ones(start.shape[:2], bool)
        return Trajectory(time_s=jnp.zeros(points.shape[:3]), position_m=points, found=found)


def spec_of(planner):
    reference = register.PlannerReference(
        name=planner.__name__, module=__name__, qualname=planner.__name__
    )
    return PlannerSpec(reference=reference)


def test_a_planner_refuses_problems_before_it_is_traced():
    with pytest.raises(ConfigError, match="too many points"):
        build_device_planner(spec_of(Holding), replace(problem(), points=101))


def test_one_problem_is_planned_as_a_batch_of_one():
    planner = build_device_planner(spec_of(Holding), problem())
    assert not planner.plans_alone
    path = planner(problem())
    assert path.position_m.shape == (1, 32, 3)
    assert planner == build_device_planner(spec_of(Holding), problem())


@pytest.mark.parametrize(
    ("planner", "message"),
    [(Failing, "Failing: plan_batch raised KeyError"), (Joints, "takes a Trajectory")],
)
def test_faults_of_a_planner_name_it(planner, message):
    with pytest.raises(ConfigError, match=message):
        build_device_planner(spec_of(planner), problem())(problem())


def test_an_install_without_the_built_in_planners_is_named(monkeypatch):
    monkeypatch.setattr(register, "entry_points", lambda group: ())
    with pytest.raises(ConfigError, match=r"planner 'grid'.*install it again"):
        register.find("grid")
