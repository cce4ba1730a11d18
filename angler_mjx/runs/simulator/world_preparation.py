"""Worlds from their indices: drawn and furnished, and planned by planners on the device."""

import operator
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.clearance import cell_neighbours
from angler_mjx.errors import ConfigError, format_value
from angler_mjx.planning import grid as grid_planner
from angler_mjx.planning.build_problem import build_problems
from angler_mjx.planning.path_search.robot_search import PathSearchConfig
from angler_mjx.planning.planner import Path, PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.planning.routes import route_fields as fields_of_routes
from angler_mjx.robot.control.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.joint_trajectory import hold_position as hold_joints
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.control.trajectory import hold_position
from angler_mjx.runs.simulator.device_planning import (
    GRID,
    build_device_planner,
    has_obstacle_information,
    path_search_config,
)
from angler_mjx.sampling import fold_keys, scale_uniform, uniform_rows
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.task_table import task_positions
from angler_mjx.sim import fleet
from angler_mjx.sim.information import Information, obstacle_information
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.state import World, WorldFactors
from angler_mjx.world import currents, generate
from angler_mjx.world.config import WorldRecipe, resolve_world
from angler_mjx.world.environment import Environment
from angler_mjx.world.routes import Routes
from angler_mjx.world.tasks import sampling
from angler_mjx.world.tasks.reachability import reachable_cells
from angler_mjx.world.tasks.sampling import GoalSampling
from angler_mjx.world.tasks.spec import TaskWorld

MAX_BATCH = {"gpu": 16384}
DEFAULT_MAX_BATCH = 4096
"""Worlds drawn and planned in one go, by platform; memory grows with the planner's history. On an
H200 a quarter more worlds a second are made 16,384 at once than 4,096."""

PLANNING_KEY = 0x504C414E
"""Folded into a world's key for the planner's own draws: no child of the world's draws has it."""
BREAKDOWN_KEY = 0x4641494C
"""As `PLANNING_KEY`, for what breaks down."""

ACOUSTICS_KEY = 0x52414449
"""As `PLANNING_KEY`, for the channel that a world's robots share."""
TASK_KEY = 0x5441534B
"""As `PLANNING_KEY`, for the places of a task."""
TASK_MARGIN_M = 0.3
"""Beside the widest robot's radius at the places of a task, where no policy says more."""

type PrepareWorlds = Callable[[fleet.Fleet, jax.Array, jax.Array], World]
"""Worlds [tile] of a fleet, from the seed [] and the first world's index [1], both uint32."""


def check_key_number(name: str, value: Any) -> np.uint32:
    """A seed or an index of a world, as keys take it.

    Args:
        name: for messages.
        value: any whole number, of Python or NumPy.

    Raises:
        ConfigError: it is none, or keys cannot hold it.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < 2**32:
        raise ConfigError(
            f"{name} = {format_value(value)}: give a whole number from 0 to {2**32 - 1}"
        )
    return np.uint32(number)


def build_preparer(
    scenario: Scenario,
    spec: PlannerSpec | None,
    tile: int,
    *,
    shape: PathShape,
    policy: Policy | None = None,
) -> PrepareWorlds:
    """The function that makes a tile of worlds.

    Args:
        scenario: whose worlds.
        spec: the planner, if it plans on the device; without one robots are told to hold their
            starts.
        tile: how many at once.
        shape: of the paths.
        policy: that is to command them, which needs a key in each, and may ask for routes.
    """
    recipe = resolve_world(scenario.world)
    grid_config = (
        path_search_config(scenario, spec)
        if spec is not None and spec.reference.name == GRID
        else None
    )

    def prepare_one(kinds: fleet.Fleet, seed: jax.Array, index: jax.Array) -> World:
        return _prepare_world(scenario, recipe, shape, grid_config, policy, kinds, seed, index)

    def sample_tile(kinds: fleet.Fleet, seed: jax.Array, first: jax.Array) -> World:
        prepare_world = partial(prepare_one, kinds, seed)
        if tile == 1:  # batching a single world makes tracing and compiling take twice as long
            single: World = jax.tree.map(lambda leaf: leaf[None], prepare_world(first[0]))
            return single
        index = first[0] + jnp.arange(tile, dtype=jnp.uint32)
        max_batch = MAX_BATCH.get(jax.default_backend(), DEFAULT_MAX_BATCH)
        if tile <= max_batch:
            return jax.vmap(prepare_world)(index)
        worlds: World = jax.lax.map(prepare_world, index, batch_size=max_batch)
        return worlds

    if spec is None or grid_config is not None:
        return sample_tile
    planner, information = (
        build_device_planner(scenario, spec),
        scenario.planner.information.to_information(),
    )

    def sample_planned(kinds: fleet.Fleet, seed: jax.Array, first: jax.Array) -> World:
        worlds = sample_tile(kinds, seed, first)
        problems = build_tile_problems(scenario, information, worlds, seed, first)
        return replace_paths(worlds, planner(worlds, problems), spec.reference.name, shape)

    return sample_planned


def build_tile_problems(
    scenario: Scenario,
    information: Information,
    worlds: World,
    seed: jax.Array,
    first: jax.Array,
) -> Problem:
    """The problems of a tile of worlds, [world] leading; to be traced.

    Args:
        scenario: whose worlds.
        information: what may be known of them.
        worlds: drawn.
        seed: [] of the run.
        first: [1] index of the first world.
    """
    count = worlds.variant.shape[0]
    index = first[0] + jnp.arange(count, dtype=jnp.uint32)
    seeds = jax.vmap(lambda i: _planner_seed(seed, i))(index)
    horizon_s, deadline_s = scenario.time.horizon_s, scenario.planner.deadline_s

    def build_one(world: World, number: jax.Array) -> Problem:
        return build_problems(
            world, number, scenario.sim_spec(), information, horizon_s, deadline_s
        )

    return jax.vmap(build_one)(worlds, seeds)


def replace_paths(worlds: World, path: Path, name: str, shape: PathShape) -> World:
    """Worlds whose robots are told other paths.

    Args:
        worlds: [world] leading.
        path: [world, robot] leading.
        name: of the planner, for messages.
        shape: that they must have.

    Raises:
        ConfigError: the paths have other shapes.
    """
    if isinstance(path, JointTrajectory) != shape.joints:
        expected = "JointTrajectory" if shape.joints else "Trajectory"
        raise ConfigError(f"planner {name}: gives {type(path).__name__}; {expected} is flown here")
    lead = worlds.variant.shape
    for field in fields(path):
        leaf = getattr(path, field.name)
        if not hasattr(leaf, "shape"):
            continue
        if leaf.shape[:2] != lead or (
            field.name == "time_s" and leaf.shape != (*lead, shape.points)
        ):
            raise ConfigError(
                f"planner {name}: gives {field.name} of the shape {leaf.shape}; paths must have "
                f"[world, robot] = {list(lead)} leading, and {shape.points} points (planner.points)"
            )
    return replace(worlds, path=path)


def _planner_seed(seed: jax.Array, index: jax.Array) -> jax.Array:
    """What a planner draws from in one world; independent of what the world is drawn from."""
    key = jax.random.fold_in(jax.random.key(seed), index)
    return jax.random.bits(jax.random.fold_in(key, PLANNING_KEY), dtype=jnp.uint32)


def _prepare_world(
    scenario: Scenario,
    recipe: WorldRecipe,
    shape: PathShape,
    planner: PathSearchConfig | None,
    policy: Policy | None,
    kinds: fleet.Fleet,
    seed: jax.Array,
    index: jax.Array,
) -> World:
    """World ``index`` of a run: its key is the run's, folded with the global index."""
    key = jax.random.fold_in(jax.random.key(seed), index)
    of_fleet, of_world, of_senses, of_policy, of_factors = fold_keys(key, 5)
    variant, control, body = fleet.sample_variants(kinds, of_fleet)
    environment = generate.generate_world(
        recipe,
        fleet.radius_bound(kinds),
        of_world,
        scenario.time.horizon_s,
        scenario.water.density_kgpm3,
    )
    factors = _sample_factors(scenario.randomise, of_factors, variant.shape[0])
    if factors is not None:
        environment = replace(
            environment, current=currents.scale_current(environment.current, factors.current)
        )
    path: Path
    if shape.joints:
        path = hold_joints(environment.start_m, environment.start_yaw_rad, shape.points)
    elif planner is None:
        path = hold_position(environment.start_m, shape.points)
    else:
        obstacles = None
        if has_obstacle_information(scenario):
            spec = scenario.sim_spec()
            obstacles = obstacle_information(
                environment,
                scenario.planner.information.to_information(),
                scenario.time.horizon_s,
                spec.control_dt_s,
                spec.water.density_kgpm3,
                spec.water.gravity_mps2,
            )
        path = grid_planner.plan_grid(
            environment, control.vehicle.radius_m, control.cruise_speed_mps, planner, obstacles
        )
    # Folded with the robot's number, so that a robot more changes nothing for those before it.
    of_robot = fold_keys(of_senses, variant.shape[0])
    uses_neighbours = scenario.engine == "fused"
    task = _sample_task(scenario, policy, key, environment, control)
    return World(
        environment=environment,
        variant=variant,
        body=body,
        control=control,
        path=path,
        cell_neighbours=cell_neighbours(environment.grid.occupied) if uses_neighbours else None,
        sensing_key=jax.random.key_data(of_robot) if scenario.senses else None,
        policy_key=None if policy is None else jax.random.key_data(of_policy),
        acoustics_key=None
        if scenario.acoustics.model == "perfect"
        else jax.random.key_data(jax.random.fold_in(key, ACOUSTICS_KEY)),
        factors=factors,
        routes=_build_routes(policy, environment, control, task),
        task=task,
        fails_at_s=sample_breakdowns(scenario, key, variant.shape[0]),
    )


def sample_water_and_breakdowns(
    scenario: Scenario, seed: jax.Array, index: jax.Array
) -> tuple[currents.Current, jax.Array | None]:
    """The current of a world and its robots' breakdowns alone, as drawn with all else.

    To be traced. Nothing else that is drawn hangs on them, but for what planners know of a current.

    Args:
        scenario: whose world.
        seed: [] of the run.
        index: [] of the world.

    Returns:
        The current, and times as of `sample_breakdowns`.
    """
    key = jax.random.fold_in(jax.random.key(seed), index)
    _, of_world, _, _, of_factors = fold_keys(key, 5)
    recipe = resolve_world(scenario.world)
    current = generate.sample_current(recipe, of_world, scenario.time.horizon_s)
    factors = _sample_factors(scenario.randomise, of_factors, 1)
    if factors is not None:
        current = currents.scale_current(current, factors.current)
    return current, sample_breakdowns(scenario, key, len(scenario.members()))


def _build_routes(
    policy: Policy | None,
    environment: Environment,
    control: ControlParams,
    task: TaskWorld | None,
) -> Routes | None:
    """Ways to the goals or the task's places, where a policy asks; the widest robot can go them."""
    if policy is None or policy.routes_margin_m is None:
        return None
    clearance_m = jnp.max(control.vehicle.radius_m) + policy.routes_margin_m
    goal_m = environment.goal_m if task is None else task.position_m
    return fields_of_routes.compute_routes(environment, goal_m, clearance_m)


def _sample_task(
    scenario: Scenario,
    policy: Policy | None,
    key: jax.Array,
    environment: Environment,
    control: ControlParams,
) -> TaskWorld | None:
    """The task of a world, from a key of its own: the rest of the world is the same without it."""
    spec = scenario.task_spec()
    if spec is None:
        return None
    margin_m = TASK_MARGIN_M if policy is None else policy.routes_margin_m or TASK_MARGIN_M
    clearance_m = jnp.max(control.vehicle.radius_m) + margin_m
    goal_samplings = [goal_sampling for _, goal_sampling, _ in task_positions(scenario.task)] or [
        GoalSampling()
    ]
    return sampling.sample_task(
        spec,
        goal_samplings[0],
        goal_samplings[-1],
        jax.random.fold_in(key, TASK_KEY),
        environment,
        reachable_cells(environment, clearance_m),
    )


def sample_breakdowns(scenario: Scenario, key: jax.Array, robots: int) -> jax.Array | None:
    """When each robot of a world breaks down.

    Args:
        scenario: which may let some.
        key: of the world.
        robots: of the fleet; one more changes nothing for those before it.

    Returns:
        [robots] s, inf for never; None where none can.
    """
    settings = scenario.breakdowns
    if settings.fraction == 0.0:
        return None
    of_robot = fold_keys(jax.random.fold_in(key, BREAKDOWN_KEY), robots)
    chance, time_sample = uniform_rows(of_robot, 2).T
    failure_s = scale_uniform(time_sample, *settings.span_s(scenario.time.horizon_s))
    return jnp.where(chance < settings.fraction, failure_s, jnp.inf)


def _sample_factors(config: RandomiseConfig, key: jax.Array, robots: int) -> WorldFactors | None:
    """What is drawn for one world; a robot more changes nothing for those before it."""
    if not config.changes_worlds:
        return None
    of_current, of_noise = uniform_rows(fold_keys(key, 2), max(robots, 1))
    return WorldFactors(
        current=scale_uniform(of_current[0], *config.current),
        sensor_noise=scale_uniform(of_noise, *config.sensor_noise),
    )
