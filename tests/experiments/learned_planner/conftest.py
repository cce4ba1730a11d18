import jax
import numpy as np
import pytest

from angler_experiments.learned_planner.planner import LearnedPlanner, LearnedSettings
from angler_experiments.learned_planner.train import examples
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

WORLDS, ROBOTS = 4, 4


@pytest.fixture(scope="session")
def simulator():
    chosen = load_scenario(
        "reef_fleet",
        worlds=WORLDS,
        tile=WORLDS,
        seed=3,
        engine="fused",
        world={
            "preset": "dense",
            "shape": [8, 8, 8],
            "currents": [],
            "obstacles": {"dynamic": {"count": 3}},
        },
        time={"horizon_s": 60.0, "record_hz": 1.0},
        planner={"name": "grid", "information": {"obstacles": "observed"}},
    )
    return Simulator(chosen)


@pytest.fixture(scope="session")
def planned(simulator):
    worlds, problems = simulator.sample_problems(0)
    return worlds, problems


@pytest.fixture(scope="session")
def made(planned):
    worlds, problems = planned
    return jax.jit(examples.build_examples)(problems, worlds.path)


@pytest.fixture(scope="session")
def answered(planned):
    """Paths of the planner, in NumPy; of the shipped network."""
    planner = LearnedPlanner(LearnedSettings(samples=4, steps=2, rounds=2))
    path = jax.jit(planner.plan_batch)(planned[1])
    return jax.tree.map(np.asarray, path)
