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
from angler_mjx.errors import ConfigError, shown
from angler_mjx.planning import grid as grid_planner
from angler_mjx.planning.build_problem import build_problems
from angler_mjx.planning.path_search.robot import WayConfig
from angler_mjx.planning.planner import Path, PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.planning.routes import fields as fields_of_routes
from angler_mjx.robot.control.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.joint_trajectory import hold as hold_joints
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.control.trajectory import hold
from angler_mjx.runs.simulator.on_device import GRID, device_planner, foresees, ways_config
from angler_mjx.sampling import between, children, uniforms
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.task_table import drawn_places
from angler_mjx.sim import fleet
from angler_mjx.sim.information import Information, obstacles
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.state import Factors, World
from angler_mjx.world import currents, generate
from angler_mjx.world.config import WorldRecipe, resolve
from angler_mjx.world.environment import Environment
from angler_mjx.world.routes import Routes
from angler_mjx.world.tasks import sampling
from angler_mjx.world.tasks.reach import reachable_cells
from angler_mjx.world.tasks.sampling import GoalSampling
from angler_mjx.world.tasks.spec import TaskWorld

AT_ONCE = {"gpu": 16384}
AT_ONCE_ELSEWHERE = 4096
"""Worlds drawn and planned in one go, by platform; memory grows with the planner's history. On an
H200 a quarter more worlds a second are made 16,384 at once than 4,096."""

PLANNING = 0x504C414E
"""Folded into a world's key for the planner's own draws: no child of the world's draws has it."""
FAILING = 0x4641494C
"""As `PLANNING`, for what breaks down."""

RADIO = 0x52414449
"""As `PLANNING`, for the channel that a world's robots share."""
TASK = 0x5441534B
"""As `PLANNING`, for the places of a task."""
MARGIN_M = 0.3
"""Beside the widest robot's radius at the places of a task, where no policy says more."""

type Prepare = Callable[[fleet.Fleet, jax.Array, jax.Array], World]
"""Worlds [tile] of a fleet, from the seed [] and the first world's index [1], both uint32."""


def key_number(name: str, value: Any) -> np.uint32:
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
        raise ConfigError(f"{name} = {shown(value)}: give a whole number from 0 to {2**32 - 1}")
    return np.uint32(number)


def preparer(
    scenario: Scenario,
    spec: PlannerSpec | None,
    tile: int,
    *,
    shape: PathShape,
    policy: Policy | None = None,
) -> Prepare:
    """The function that makes a tile of worlds.

    Args:
        scenario: whose worlds.
        spec: the planner, if it plans on the device; without one robots are told to hold their
            starts.
        tile: how many at once.
        shape: of the paths.
        policy: that is to command them, which needs a key in each, and may ask for routes.
    """
    recipe = resolve(scenario.world)
    built_in = (
        ways_config(scenario, spec) if spec is not None and spec.reference.name == GRID else None
    )

    def furnished(kinds: fleet.Fleet, seed: jax.Array, index: jax.Array) -> World:
        return _one_world(scenario, recipe, shape, built_in, policy, kinds, seed, index)

    def drawn(kinds: fleet.Fleet, seed: jax.Array, first: jax.Array) -> World:
        one = partial(furnished, kinds, seed)
        if tile == 1:  # batching a single world makes tracing and compiling take twice as long
            alone: World = jax.tree.map(lambda leaf: leaf[None], one(first[0]))
            return alone
        index = first[0] + jnp.arange(tile, dtype=jnp.uint32)
        most = AT_ONCE.get(jax.default_backend(), AT_ONCE_ELSEWHERE)
        if tile <= most:
            return jax.vmap(one)(index)
        worlds: World = jax.lax.map(one, index, batch_size=most)
        return worlds

    if spec is None or built_in is not None:
        return drawn
    planner, knows = device_planner(scenario, spec), scenario.planner.knows.knows()

    def planned(kinds: fleet.Fleet, seed: jax.Array, first: jax.Array) -> World:
        worlds = drawn(kinds, seed, first)
        problems = ask_all(scenario, knows, worlds, seed, first)
        return with_paths(worlds, planner(worlds, problems), spec.reference.name, shape)

    return planned


def ask_all(
    scenario: Scenario,
    knows: Information,
    worlds: World,
    seed: jax.Array,
    first: jax.Array,
) -> Problem:
    """The problems of a tile of worlds, [world] leading; to be traced.

    Args:
        scenario: whose worlds.
        knows: what may be known of them.
        worlds: drawn.
        seed: [] of the run.
        first: [1] index of the first world.
    """
    count = worlds.variant.shape[0]
    index = first[0] + jnp.arange(count, dtype=jnp.uint32)
    seeds = jax.vmap(lambda i: _planner_seed(seed, i))(index)
    horizon_s, deadline_s = scenario.time.horizon_s, scenario.planner.deadline_s

    def one(world: World, number: jax.Array) -> Problem:
        return build_problems(world, number, scenario.sim_spec(), knows, horizon_s, deadline_s)

    return jax.vmap(one)(worlds, seeds)


def with_paths(worlds: World, path: Path, name: str, shape: PathShape) -> World:
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
        wanted = "JointTrajectory" if shape.joints else "Trajectory"
        raise ConfigError(f"planner {name}: gives {type(path).__name__}; {wanted} is flown here")
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
    return jax.random.bits(jax.random.fold_in(key, PLANNING), dtype=jnp.uint32)


def _one_world(
    scenario: Scenario,
    recipe: WorldRecipe,
    shape: PathShape,
    planner: WayConfig | None,
    policy: Policy | None,
    kinds: fleet.Fleet,
    seed: jax.Array,
    index: jax.Array,
) -> World:
    """World ``index`` of a run: its key is the run's, folded with the global index."""
    key = jax.random.fold_in(jax.random.key(seed), index)
    of_fleet, of_world, of_senses, of_policy, of_factors = children(key, 5)
    variant, control, body = fleet.draw(kinds, of_fleet)
    environment = generate.generate(
        recipe,
        fleet.radius_bound(kinds),
        of_world,
        scenario.time.horizon_s,
        scenario.water.density_kgpm3,
    )
    factors = _factors(scenario.randomise, of_factors, variant.shape[0])
    if factors is not None:
        environment = replace(
            environment, current=currents.scaled(environment.current, factors.current)
        )
    path: Path
    if shape.joints:
        path = hold_joints(environment.start_m, environment.start_yaw_rad, shape.points)
    elif planner is None:
        path = hold(environment.start_m, shape.points)
    else:
        known = None
        if foresees(scenario):
            spec = scenario.sim_spec()
            known = obstacles(
                environment,
                scenario.planner.knows.knows(),
                scenario.time.horizon_s,
                spec.control_dt_s,
                spec.water.density_kgpm3,
                spec.water.gravity_mps2,
            )
        path = grid_planner.plan(
            environment, control.vehicle.radius_m, control.cruise_speed_mps, planner, known
        )
    # Folded with the robot's number, so that a robot more changes nothing for those before it.
    of_robot = children(of_senses, variant.shape[0])
    looked_up = scenario.engine == "fused"
    task = _task(scenario, policy, key, environment, control)
    return World(
        environment=environment,
        variant=variant,
        body=body,
        control=control,
        path=path,
        cell_neighbours=cell_neighbours(environment.grid.occupied) if looked_up else None,
        sensing_key=jax.random.key_data(of_robot) if scenario.senses else None,
        policy_key=None if policy is None else jax.random.key_data(of_policy),
        radio_key=None
        if scenario.acoustics.model == "perfect"
        else jax.random.key_data(jax.random.fold_in(key, RADIO)),
        factors=factors,
        routes=_routes(policy, environment, control, task),
        task=task,
        fails_at_s=breakdowns(scenario, key, variant.shape[0]),
    )


def water_and_breakdowns(
    scenario: Scenario, seed: jax.Array, index: jax.Array
) -> tuple[currents.Current, jax.Array | None]:
    """The current of a world and its robots' breakdowns alone, as drawn with all else.

    To be traced. Nothing else that is drawn hangs on them, but for what planners know of a current.

    Args:
        scenario: whose world.
        seed: [] of the run.
        index: [] of the world.

    Returns:
        The current, and times as of `breakdowns`.
    """
    key = jax.random.fold_in(jax.random.key(seed), index)
    _, of_world, _, _, of_factors = children(key, 5)
    recipe = resolve(scenario.world)
    current = generate.draw_current(recipe, of_world, scenario.time.horizon_s)
    factors = _factors(scenario.randomise, of_factors, 1)
    if factors is not None:
        current = currents.scaled(current, factors.current)
    return current, breakdowns(scenario, key, len(scenario.members()))


def _routes(
    policy: Policy | None,
    environment: Environment,
    control: ControlParams,
    task: TaskWorld | None,
) -> Routes | None:
    """Ways to the goals or the task's places, where a policy asks; the widest robot can go them."""
    if policy is None or policy.routes_margin_m is None:
        return None
    clearance_m = jnp.max(control.vehicle.radius_m) + policy.routes_margin_m
    place_m = environment.goal_m if task is None else task.place_m
    return fields_of_routes.draw(environment, place_m, clearance_m)


def _task(
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
    margin_m = MARGIN_M if policy is None else policy.routes_margin_m or MARGIN_M
    clearance_m = jnp.max(control.vehicle.radius_m) + margin_m
    places = [where for _, where, _ in drawn_places(scenario.task)] or [GoalSampling()]
    return sampling.draw(
        spec,
        places[0],
        places[-1],
        jax.random.fold_in(key, TASK),
        environment,
        reachable_cells(environment, clearance_m),
    )


def breakdowns(scenario: Scenario, key: jax.Array, robots: int) -> jax.Array | None:
    """When each robot of a world breaks down.

    Args:
        scenario: which may let some.
        key: of the world.
        robots: of the fleet; one more changes nothing for those before it.

    Returns:
        [robots] s, inf for never; None where none can.
    """
    given = scenario.breakdowns
    if given.share == 0.0:
        return None
    of_robot = children(jax.random.fold_in(key, FAILING), robots)
    chance, when = uniforms(of_robot, 2).T
    at_s = between(when, *given.span_s(scenario.time.horizon_s))
    return jnp.where(chance < given.share, at_s, jnp.inf)


def _factors(given: RandomiseConfig, key: jax.Array, robots: int) -> Factors | None:
    """What is drawn for one world; a robot more changes nothing for those before it."""
    if not given.of_worlds:
        return None
    of_current, of_noise = uniforms(children(key, 2), max(robots, 1))
    return Factors(
        current=between(of_current[0], *given.current),
        sensor_noise=between(of_noise, *given.sensor_noise),
    )
