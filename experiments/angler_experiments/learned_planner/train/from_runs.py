"""Examples of datasets and run folders, from their files alone."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner.train import examples as made_of
from angler_experiments.learned_planner.train.examples import Examples
from angler_mjx.errors import ConfigError
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets import manifest
from angler_mjx.planning.build_problem import build_team
from angler_mjx.planning.problem import Problem, Team
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.storage import environments
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.stored_arrays import stored_group
from angler_mjx.sim import fleet, information
from angler_mjx.world.environment import Environment


def read_folder(path: Path, split: str, report: Callable[[str], None]) -> Iterator[Examples]:
    """Yield examples of a dataset's split, or of a run folder, all of which is ``train``.

    Args:
        path: path of the folder.
        split: split of the dataset.
        report: receives the parts without usable flights.

    Raises:
        ConfigError: as `read_run`, or the dataset has faults.
    """
    if not (path / manifest.MANIFEST).is_file():
        if split == "train":
            yield from read_run(path)
        return
    if split not in set(datasets.open(path).index["split"].to_pylist()):
        return
    chosen = datasets.open(path, split=split)
    part, world = (chosen.index[name].to_numpy() for name in ("part", "world"))
    for number in np.unique(part):
        folder = chosen.parts[number]
        reason = _explain_unusable(chosen.run(number))
        if reason:
            report(f"{folder}: {reason}; left out")
        else:
            yield from read_run(folder, worlds=world[part == number])


def _explain_unusable(run: Run) -> str:
    """Return the reason why a run has no usable flights; empty if it has."""
    if run.scenario.policy.name != "none":
        return "a policy flew it, there are no plans"
    if "plan_yaw_rad" in run.trajectories:
        return "its plans have headings; examples are taken of lines only"
    return ""


def read_run(path: Path, tile: int = 64, worlds: np.ndarray | None = None) -> Iterator[Examples]:
    """Yield examples of a run folder, from its files alone.

    Args:
        path: path of the folder, with trajectories (``--record-hz 1`` is enough).
        tile: worlds at a time.
        worlds: number of its worlds; all if left out.

    Raises:
        ConfigError: the folder is damaged, has no trajectories, or its plans are not straight
            lines.
    """
    run = Run(path)
    group, chosen = run.trajectories, run.scenario
    reason = _explain_unusable(run)
    if reason:
        raise ConfigError(f"{path}: {reason}; name another folder")
    kinds = fleet.build_fleet(chosen.members(), multibody=False)
    variants = {
        (v.vehicle, v.parameter_set): i for i, v in enumerate(fleet.list_variants(chosen.members()))
    }
    labels = run.episodes.select(["vehicle", "parameter_set", "planned"]).to_pydict()
    robots = len(chosen.members())
    names = zip(labels["vehicle"], labels["parameter_set"], strict=True)
    of_row = np.array(
        [_find_variant(variants, vehicle, chosen_set) for vehicle, chosen_set in names]
    )
    planned = np.array(labels["planned"], bool).reshape(-1, robots)
    variant = of_row.reshape(-1, robots)
    stored_environments = stored_group(group, "environment")
    spec, levels = chosen.sim_spec(), chosen.planner.information.to_information()

    @jax.jit
    def make(environment: Environment, variant: jax.Array, path: Trajectory) -> Examples:
        def make_problem(environment: Environment, variant: jax.Array) -> Problem:
            control, _ = fleet.select_parameters(kinds, variant)
            speed = kinds.cruise_mps[jnp.arange(robots), variant]
            team = build_team(
                control, environment.start_m, environment.start_yaw_rad, environment.goal_m
            )
            horizon = chosen.time.horizon_s
            water = spec.water
            return Problem(
                grid=environment.grid,
                floor_z_m=environment.floor_z_m,
                team=_set_cruise_speed(team, speed),
                obstacles=information.obstacle_information(
                    environment,
                    levels,
                    horizon,
                    spec.control_dt_s,
                    water.density_kgpm3,
                    water.gravity_mps2,
                ),
                current=information.current_information(environment, levels.current),
                seed=jnp.uint32(0),
                horizon_s=horizon,
                goal_tolerance_m=spec.goal_tolerance_m,
                information=levels,
                deadline_s=chosen.planner.deadline_s,
            )

        return made_of.build_examples(jax.vmap(make_problem)(environment, variant), path)

    plan_time, plan_m = (jnp.asarray(group[name]) for name in ("plan_time_s", "plan_m"))
    for low in range(0, len(variant), tile):
        part = slice(low, low + tile)
        world_indices = np.arange(len(variant))[part]
        selected = (
            np.arange(len(world_indices))
            if worlds is None
            else np.flatnonzero(np.isin(world_indices, worlds))
        )
        if not len(selected):
            continue
        environment = environments.read_environments(stored_environments, part)
        plans = Trajectory(
            time_s=plan_time[part], position_m=plan_m[part], found=jnp.asarray(planned[part])
        )
        examples = make(environment, variant[part], plans)
        yield jax.tree.map(partial(_select_rows, selected), examples)


def _select_rows(rows: np.ndarray, leaf: jax.Array) -> jax.Array:
    return leaf[rows]


def _find_variant(variants: dict[tuple[str, str], int], vehicle: str, chosen: str) -> int:
    """Return the number of a variant; the vehicle is named by its file or as in tables."""
    for (name, parameter_set), number in variants.items():
        if parameter_set == chosen and vehicle in (name, Path(name).stem):
            return number
    raise ConfigError(f"vehicle {vehicle}, {chosen}: is not in the scenario of the run")


def _set_cruise_speed(team: Team, speed: jax.Array) -> Team:
    return replace(team, cruise_speed_mps=speed)
