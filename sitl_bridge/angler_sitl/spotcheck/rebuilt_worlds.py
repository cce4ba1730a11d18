"""Worlds of a run rebuilt from its scenario and seed, and compared with the recorded ones.

Plans are not rebuilt: the recorded plans are flown, whatever planned them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
import pyarrow.compute as pc

from angler_mjx.errors import RunError
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.stored_arrays import stored_array
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World

MAX_DIFFERENCE = 1e-3
"""Max difference of a number of a rebuilt world, in its own unit: m, m/s, s.

Rounding differs between kinds of device; a larger difference means another world."""


@dataclass(frozen=True, kw_only=True)
class WorldLikeness:
    """Likeness of a rebuilt world to the recorded one."""

    arrays: int
    """Number of compared arrays."""
    identical: int
    """Number of arrays that are the same byte by byte."""
    difference: float
    """Max difference of the other arrays; 0 if there are none."""
    where: str
    """Name of the array with that difference."""

    def describe(self) -> str:
        """Return a short description."""
        if self.identical == self.arrays:
            return f"identical, all {self.arrays} arrays byte by byte"
        return (
            f"{self.identical} of {self.arrays} arrays identical, the others within "
            f"{self.difference:.1e} ({self.where})"
        )


def single_world_scenario(scenario: Scenario) -> Scenario:
    """Return a scenario for one world at a time on any device: plain XLA, fused where it can be."""
    engine = "mjx" if scenario.contacts or scenario.joint_names() else "fused"
    return scenario.model_copy(update={"tile": 1, "engine": engine, "kernels": "xla"})


def sample_worlds(scenario: Scenario, indices: Sequence[int]) -> dict[int, World]:
    """Sample worlds by their global indices; [1] leads."""
    simulator = Simulator(single_world_scenario(scenario))
    return {index: simulator.worlds(index) for index in indices}


def add_recorded_plans(run: Run, index: int, worlds: World) -> World:
    """Return a world with its recorded plans.

    Args:
        run: with trajectories.
        index: of the world.
        worlds: rebuilt; [1] leads.

    Raises:
        ConfigError: the recorded data are damaged.
    """
    rows = run.episodes.filter(pc.field("world") == index)
    stored: Any = run.trajectories
    with wrap_read_errors(run.path / TRAJECTORIES):
        plan = trajectory_layout.read_plan(
            stored, index, rows["planned"].to_numpy(zero_copy_only=False)
        )
    # Same device as the other arrays: another device would compile the programs once more.
    sharding = getattr(worlds.variant, "sharding", None)
    path: Plan = jax.tree.map(lambda leaf: jax.device_put(leaf[None], sharding), plan)
    return replace(worlds, path=path)


def compare_world(run: Run, index: int, worlds: World) -> WorldLikeness:
    """Compare a rebuilt world with the recorded one.

    Args:
        run: with trajectories.
        index: of the world.
        worlds: rebuilt; [1] leads.

    Raises:
        ConfigError: the recorded data are damaged.
        RunError: it is another world.
    """
    with wrap_read_errors(run.path / TRAJECTORIES):
        return _compare_arrays(run, index, worlds)


def _compare_arrays(run: Run, index: int, worlds: World) -> WorldLikeness:
    arrays = {
        f"environment/{name}": leaf for name, leaf in store.named_leaves(worlds.environment).items()
    }
    identical, worst, worst_name = 0, 0.0, ""
    for name, leaf in arrays.items():
        rebuilt = np.asarray(leaf)[0]
        if rebuilt.size == 0:
            identical += 1
            continue
        recorded = np.asarray(stored_array(run.trajectories, name)[index])
        if recorded.shape != rebuilt.shape:
            raise _make_mismatch_error(
                run, index, f"{name} has the shape {rebuilt.shape}, not {recorded.shape}"
            )
        if np.array_equal(recorded, rebuilt, equal_nan=recorded.dtype.kind == "f"):
            identical += 1
            continue
        difference = _max_difference(recorded, rebuilt)
        if not difference <= MAX_DIFFERENCE:
            raise _make_mismatch_error(run, index, f"{name} differs by {difference:g}")
        if difference > worst:
            worst, worst_name = difference, name
    return WorldLikeness(
        arrays=len(arrays), identical=identical, difference=worst, where=worst_name
    )


def _max_difference(recorded: np.ndarray, rebuilt: np.ndarray) -> float:
    """Return the max difference; infinite if only one is finite, or if whole numbers differ."""
    if recorded.dtype.kind != "f":
        return float("inf")
    is_finite = np.isfinite(recorded)
    if not np.array_equal(is_finite, np.isfinite(rebuilt)):
        return float("inf")
    return float(
        np.max(np.abs(recorded[is_finite].astype(float) - rebuilt[is_finite]), initial=0.0)
    )


def _make_mismatch_error(run: Run, index: int, reason: str) -> RunError:
    return RunError(
        f"{run.path}: world {index} cannot be made again: {reason}. Another version of this "
        "program, "
        "or another kind of device, made the run; make it again here with angler rollout"
    )


def select_robots(worlds: World, template: World, robots: int) -> World:
    """Return a world reduced to its first robots.

    Rocks, water, obstacles, the robots' parameters and their plans stay; the other robots are
    removed.

    Args:
        worlds: [1] leads.
        template: of a scenario with that number of robots: thruster padding is cut to its size.
        robots: number of robots that stay.
    """
    if worlds.variant.shape[1] == robots:
        return worlds

    def first(leaf: jax.Array, shape: jax.Array) -> jax.Array:
        return leaf[tuple(slice(0, n) for n in shape.shape)]

    # Not as the planner of the scenario would give them.
    path = jax.tree.map(lambda leaf: leaf[:, :robots], worlds.path)
    selected: World = jax.tree.map(first, replace(worlds, path=path), replace(template, path=path))
    return selected
