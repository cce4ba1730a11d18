"""Worlds from their indices: sampled, and planned by planners on the device."""

import operator
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import SupportsIndex

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.threefry import seed_key
from angler_mjx.errors import ConfigError, format_value
from angler_mjx.planning.build_problem import build_problem
from angler_mjx.planning.device_planner import DevicePlanner, build_device_planner
from angler_mjx.planning.planner import Path, PathShape
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.planning.routes import route_fields as fields_of_routes
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.joint_trajectory import hold_position as hold_joints
from angler_mjx.robot.control.commands.trajectory import hold_position
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.runs.simulator.sampling_numbers import (
    BreakdownNumbers,
    FactorNumbers,
    SamplingNumbers,
)
from angler_mjx.sampling import fold_keys, uniform_rows
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.task_table import task_positions
from angler_mjx.sim import fleet
from angler_mjx.sim.cargo import sample_sensors
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.state import FleetWorld, World, WorldFactors
from angler_mjx.world import currents, generate
from angler_mjx.world.config import WorldRecipe, resolve_world
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import Obstacles
from angler_mjx.world.routes import Routes
from angler_mjx.world.tasks import sampling
from angler_mjx.world.tasks.reachability import reachable_cells
from angler_mjx.world.tasks.sampling import GoalSampling
from angler_mjx.world.tasks.spec import TaskWorld

MAX_BATCH = {"gpu": 16384}
DEFAULT_MAX_BATCH = 4096
"""Worlds sampled and planned at once, by platform; memory grows with the planner's history. On an
H200 a quarter more worlds a second are made 16,384 at once than 4,096."""

PLANNING_KEY = 0x504C414E
"""Folded into a world's key for the planner's draws; no key of the world's own draws has it."""
BREAKDOWN_KEY = 0x4641494C
"""As `PLANNING_KEY`, for breakdowns."""

ACOUSTICS_KEY = 0x52414449
"""Constant for the acoustic channel of a world, as `PLANNING_KEY`."""
GRIP_KEY = 0x47524950
"""Constant for the force-torque sensors of grips, as `PLANNING_KEY`."""
TASK_KEY = 0x5441534B
"""Constant for the positions of a task, as `PLANNING_KEY`."""
TASK_MARGIN_M = 0.3
"""Distance [m] beyond the widest robot's radius at places of a task, unless a policy sets it."""

type PrepareWorlds = Callable[[fleet.Fleet, SamplingNumbers, jax.Array, jax.Array], World]
"""Makes worlds [tile] of a fleet, from the scenario's numbers, the seed [] and the first world's
index [1], both uint32."""


def check_key_number(name: str, value: SupportsIndex) -> np.uint32:
    """Return a seed or an index of a world as keys take it.

    Args:
        name: name for messages.
        value: any whole number, of Python or NumPy.

    Raises:
        ConfigError: the value is not a whole number, or keys cannot hold it.
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
    """Return the function that makes a tile of worlds.

    Args:
        scenario: of the worlds.
        spec: the planner, if it plans on the device; without one robots hold their starts.
        tile: number of worlds.
        shape: of the paths.
        policy: that will command them, which needs a key in each world, and may need routes.

    Raises:
        ConfigError: the planner cannot plan such worlds.
    """
    recipe = resolve_world(scenario.world)
    settings = problem_settings(scenario, scenario.planner.information.to_information())
    planner = None if spec is None else build_device_planner(spec, settings)

    def prepare_one(
        kinds: fleet.Fleet, numbers: SamplingNumbers, seed: jax.Array, index: jax.Array
    ) -> World:
        world = _prepare_world(scenario, recipe, shape, policy, kinds, numbers, seed, index)
        if planner is None or not planner.plans_alone:
            return world
        equipped = fleet.add_parameters(kinds, world)
        problem = build_problem(equipped, _planner_seed(seed, index), scenario.sim_spec(), settings)
        return replace_paths(world, planner.plan_one(problem), planner.reference.name, shape)

    def sample_tile(
        kinds: fleet.Fleet, numbers: SamplingNumbers, seed: jax.Array, first: jax.Array
    ) -> World:
        prepare_world = partial(prepare_one, kinds, numbers, seed)
        if tile == 1:  # batching a single world makes tracing and compiling take twice as long
            single: World = jax.tree.map(lambda leaf: leaf[None], prepare_world(first[0]))
            return single
        index = first[0] + jnp.arange(tile, dtype=jnp.uint32)
        max_batch = MAX_BATCH.get(jax.default_backend(), DEFAULT_MAX_BATCH)
        if tile <= max_batch:
            return jax.vmap(prepare_world)(index)
        worlds: World = jax.lax.map(prepare_world, index, batch_size=max_batch)
        return worlds

    if planner is None or planner.plans_alone:
        return sample_tile
    return partial(_sample_planned, scenario, planner, shape, sample_tile)


def _sample_planned(
    scenario: Scenario,
    planner: DevicePlanner,
    shape: PathShape,
    sample_tile: PrepareWorlds,
    kinds: fleet.Fleet,
    numbers: SamplingNumbers,
    seed: jax.Array,
    first: jax.Array,
) -> World:
    """Return a tile of worlds with the paths of a planner that plans the tile at once."""
    worlds = sample_tile(kinds, numbers, seed, first)
    information = scenario.planner.information.to_information()
    problems = build_tile_problems(scenario, information, kinds, worlds, seed, first)
    return replace_paths(worlds, planner.plan_batch(problems), planner.reference.name, shape)


def problem_settings(scenario: Scenario, information: Information) -> ProblemSettings:
    """Return the settings of the problems of a scenario, before the flight.

    Args:
        scenario: of the worlds.
        information: levels of the problems.
    """
    planner = scenario.planner
    return ProblemSettings(
        horizon_s=scenario.time.horizon_s,
        goal_tolerance_m=scenario.goal_tolerance_m,
        information=information,
        deadline_s=planner.deadline_s,
        margin_m=planner.margin_m,
        points=planner.points,
        max_cruise_speed_mps=max(entry.cruise_speed_mps for entry in scenario.fleet),
        cell_m=resolve_world(scenario.world).cell_m,
        water_or_obstacles_move=scenario.water_or_obstacles_move,
        by_end_effector=scenario.by_end_effector,
        joint_names=scenario.joint_names(),
    )


def check_planner(scenario: Scenario, spec: PlannerSpec | None = None) -> None:
    """Refuse scenarios whose problems a built-in planner of the device cannot plan.

    Args:
        scenario: of the worlds.
        spec: the planner; that of the scenario if left out.

    Raises:
        ConfigError: the planner refuses its problems.
    """
    spec = spec or scenario.planner.planner_spec()
    if spec.reference.is_built_in and spec.reference.on_device:
        information = scenario.planner.information.to_information()
        build_device_planner(spec, problem_settings(scenario, information))


def build_tile_problems(
    scenario: Scenario,
    information: Information,
    kinds: fleet.Fleet,
    worlds: World,
    seed: jax.Array,
    first: jax.Array,
) -> Problem:
    """Return the problems of a tile of worlds, [world] leading, traced.

    Args:
        scenario: of the worlds.
        information: levels of the problems.
        kinds: fleet of the worlds.
        worlds: sampled.
        seed: uint32 [] of the run.
        first: uint32 [1] index of the first world.
    """
    count = worlds.variant.shape[0]
    index = first[0] + jnp.arange(count, dtype=jnp.uint32)
    seeds = jax.vmap(lambda i: _planner_seed(seed, i))(index)
    settings = problem_settings(scenario, information)

    def build_one(world: FleetWorld, world_seed: jax.Array) -> Problem:
        return build_problem(world, world_seed, scenario.sim_spec(), settings)

    return jax.vmap(build_one)(fleet.add_parameters(kinds, worlds), seeds)


def replace_paths(worlds: World, path: Path, name: str, shape: PathShape) -> World:
    """Return worlds with other paths.

    Args:
        worlds: a batch, [world] leading, or one world.
        path: [world, robot] leading, or [robot] of one world.
        name: of the planner, for messages.
        shape: required of the paths.

    Raises:
        ConfigError: the paths have another shape.
    """
    if isinstance(path, JointTrajectory) != shape.joints:
        expected = "JointTrajectory" if shape.joints else "Trajectory"
        raise ConfigError(f"planner {name}: returns {type(path).__name__}; {expected} is required")
    lead = worlds.variant.shape
    axes = "[world, robot]" if len(lead) == 2 else "[robot]"
    for field in fields(path):
        leaf = getattr(path, field.name)
        if not hasattr(leaf, "shape"):
            continue
        if leaf.shape[: len(lead)] != lead or (
            field.name == "time_s" and leaf.shape != (*lead, shape.points)
        ):
            raise ConfigError(
                f"planner {name}: gives {field.name} of the shape {leaf.shape}; paths must have "
                f"{axes} = {list(lead)} leading, and {shape.points} points (planner.points)"
            )
    return replace(worlds, path=path)


def check_worlds(kinds: fleet.Fleet, worlds: World) -> None:
    """Refuse worlds that the programs of a fleet were not made for (host side).

    Args:
        kinds: the fleet.
        worlds: [world] leading; traced ones are not looked at.

    Raises:
        ConfigError: a robot cannot be its variant, or there is no code for the kind or motion of an
            obstacle.
    """
    obstacles = worlds.environment.obstacles
    looked_at = (worlds.variant, obstacles.kind, obstacles.motion, obstacles.exists)
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in looked_at):
        _check_variants(np.isfinite(np.asarray(kinds.log_weight)), np.asarray(worlds.variant))
        _check_obstacles(obstacles)


def _check_variants(possible: np.ndarray, variant: np.ndarray) -> None:
    """Refuse variants [W, R] that are not ``possible`` [R, n_variant]."""
    robots, kinds = possible.shape
    if variant.shape[1:] != (robots,):
        raise ConfigError(
            f"World.variant has the shape {variant.shape}: must be [world, robot] with "
            f"{robots} robots"
        )
    inside = (variant >= 0) & (variant < kinds)
    right = inside & possible[np.arange(robots), np.where(inside, variant, 0)]
    if not right.all():
        world, robot = np.argwhere(~right)[0]
        can = ", ".join(map(str, np.flatnonzero(possible[robot])))
        raise ConfigError(
            f"World.variant of world {world}, robot {robot} is {variant[world, robot]}: this "
            f"robot can be {can}; say in the scenario's [[fleet]] what it can be"
        )


def _check_obstacles(obstacles: Obstacles) -> None:
    """Refuse obstacles that `Obstacles.kinds` and ``motions`` do not name."""
    exists = np.asarray(obstacles.exists)
    for name, made in (("kind", obstacles.kinds), ("motion", obstacles.motions)):
        values = np.asarray(getattr(obstacles, name))
        wrong = exists & ~np.isin(values, made)
        if wrong.any():
            world, which = np.argwhere(wrong)[0]
            raise ConfigError(
                f"World.environment.obstacles.{name} of world {world}, obstacle {which} is "
                f"{values[world, which]}: obstacles.{name}s = {made} says what programs are made "
                f"for; replace {name}s too"
            )


def _planner_seed(seed: jax.Array, index: jax.Array) -> jax.Array:
    """Return the seed of a planner in one world, independent of the samples of the world."""
    key = jax.random.fold_in(seed_key(seed), index)
    return jax.random.bits(jax.random.fold_in(key, PLANNING_KEY), dtype=jnp.uint32)


def _prepare_world(
    scenario: Scenario,
    recipe: WorldRecipe,
    shape: PathShape,
    policy: Policy | None,
    kinds: fleet.Fleet,
    numbers: SamplingNumbers,
    seed: jax.Array,
    index: jax.Array,
) -> World:
    """Sample world ``index`` of a run; its key is the run's, folded with the global index."""
    key = jax.random.fold_in(seed_key(seed), index)
    of_fleet, of_world, of_senses, of_policy, of_factors = fold_keys(key, 5)
    variant, control = fleet.sample_variants(kinds, of_fleet)
    environment = generate.generate_world(
        recipe,
        numbers.world,
        fleet.radius_bound(kinds),
        of_world,
        numbers.density_kgpm3,
    )
    factors = _sample_factors(numbers.factors, of_factors, variant.shape[0])
    if factors is not None:
        environment = replace(
            environment, current=currents.scale_current(environment.current, factors.current)
        )
    path: Path
    if shape.joints:
        links = control.vehicle_model.links
        path = hold_joints(
            environment.start_m,
            environment.start_yaw_rad,
            shape.points,
            shape.arm,
            None if links is None or not shape.arm else links.home,
        )
    else:
        path = hold_position(environment.start_m, shape.points)
    # Folded with the robot's number, so that a robot more changes nothing for those before it.
    of_robot = fold_keys(of_senses, variant.shape[0])
    task = _sample_task(scenario, policy, key, environment, control)
    return World(
        environment=environment,
        variant=variant,
        cruise_speed_mps=control.cruise_speed_mps,
        path=path,
        sensing_key=jax.random.key_data(of_robot) if scenario.senses else None,
        policy_key=None if policy is None else jax.random.key_data(of_policy),
        acoustics_key=None
        if scenario.acoustics.model == "perfect"
        else jax.random.key_data(jax.random.fold_in(key, ACOUSTICS_KEY)),
        factors=factors,
        routes=_build_routes(policy, environment, control, task),
        task=task,
        fails_at_s=sample_breakdowns(numbers.breakdowns, key, variant.shape[0]),
        grip_sensors=None
        if scenario.grip_noise is None
        else sample_sensors(
            scenario.grip_noise, jax.random.fold_in(key, GRIP_KEY), variant.shape[0]
        ),
    )


def sample_water_and_breakdowns(
    scenario: Scenario, numbers: SamplingNumbers, seed: jax.Array, index: jax.Array
) -> tuple[currents.Current, jax.Array | None]:
    """Sample the current of a world and its robots' breakdowns alone, equal to those of the world.

    Traced. No other sample depends on them, except information of planners on a current.

    Args:
        scenario: of the world.
        numbers: of the scenario.
        seed: [] of the run.
        index: [] of the world.

    Returns:
        The current, and times as of `sample_breakdowns`.
    """
    key = jax.random.fold_in(seed_key(seed), index)
    _, of_world, _, _, of_factors = fold_keys(key, 5)
    recipe = resolve_world(scenario.world)
    current = generate.sample_current(recipe, numbers.world, of_world)
    factors = _sample_factors(numbers.factors, of_factors, 1)
    if factors is not None:
        current = currents.scale_current(current, factors.current)
    return current, sample_breakdowns(numbers.breakdowns, key, len(scenario.members()))


def _build_routes(
    policy: Policy | None,
    environment: Environment,
    control: ControlParams,
    task: TaskWorld | None,
) -> Routes | None:
    """Compute routes of the widest robot to goals or places of the task, if a policy needs them."""
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
    """Sample the task of a world from a key of its own; the rest of the world is independent."""
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


def sample_breakdowns(
    numbers: BreakdownNumbers | None, key: jax.Array, robots: int
) -> jax.Array | None:
    """Sample the time at which each robot of a world breaks down.

    Args:
        numbers: of the breakdowns; None without them.
        key: of the world.
        robots: of the fleet; one more changes nothing for those before it.

    Returns:
        [robots] s, inf for never; None without breakdowns.
    """
    if numbers is None:
        return None
    of_robot = fold_keys(jax.random.fold_in(key, BREAKDOWN_KEY), robots)
    chance, time_sample = uniform_rows(of_robot, 2).T
    return jnp.where(chance < numbers.fraction, numbers.time_s.scale(time_sample), jnp.inf)


def _sample_factors(
    numbers: FactorNumbers | None, key: jax.Array, robots: int
) -> WorldFactors | None:
    """Sample the factors of one world; one more robot changes nothing for those before it."""
    if numbers is None:
        return None
    of_current, of_noise = uniform_rows(fold_keys(key, 2), max(robots, 1))
    return WorldFactors(
        current=numbers.current.scale(of_current[0]),
        sensor_noise=numbers.sensor_noise.scale(of_noise),
    )
