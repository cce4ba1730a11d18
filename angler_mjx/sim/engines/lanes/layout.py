"""Worlds and their states as lanes, for the fused engine in plain JAX, and back as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import clearance, lanes
from angler_kernels.lanes.planes import is_table
from angler_mjx.errors import RunError
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.engines.lanes import steps as lane_steps
from angler_mjx.sim.engines.lanes.steps import Cells
from angler_mjx.sim.fleet import Fleet, VehicleGroup, laden_cruise
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import World, WorldState
from angler_mjx.sim.step import RobotState
from angler_mjx.sim.world_phases import WorldMemory
from angler_mjx.world.currents import Current, bind_fields
from angler_mjx.world.environment import Environment, region_corners
from angler_mjx.world.obstacles import Obstacles, ObstacleState

MAX_ELEMENTS = 2**31
"""Numbers of an array whose places can still be counted."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LaneState:
    """What changes from step to step, as lanes."""

    groups: tuple[RobotState, ...]
    obstacles: ObstacleState


@dataclass(frozen=True, kw_only=True)
class GroupConstants:
    """What stays the same of the robots of a group, as lanes."""

    group: VehicleGroup
    params: ControlParams
    laden: ControlParams | None
    """With their load; None where there are none. Elements that it does not change are the same
    objects."""
    path: Plan
    goal_m: jax.Array
    fails_at_s: jax.Array | None


@dataclass(frozen=True, kw_only=True)
class LaneScene:
    """What stays the same during a segment, as lanes."""

    groups: tuple[GroupConstants, ...]
    current: Current
    cells: Cells
    shape: lane_steps.GridShape
    obstacles: Obstacles
    reach: jax.Array
    """Of the obstacles, [n_obstacle, W]."""
    n_robot: int
    n_obstacle: int


def concatenate_groups[T](parts: Sequence[T], like: Sequence[jax.Array] = ()) -> T:
    """Trees of lanes [n, W] of the groups as one, [R, W].

    Where ``like`` gives lanes of each group, elements may be one number for all robots of a group;
    a constant that all groups have in common stays one.
    """
    if len(parts) == 1:
        return parts[0]

    def concatenate_lanes(items: Sequence[lanes.LaneValue]) -> lanes.LaneValue:
        if all(isinstance(x, np.generic) and x == items[0] for x in items):
            return items[0]
        if like:
            items = [jnp.broadcast_to(x, lane.shape) for x, lane in zip(items, like, strict=True)]
        return jnp.concatenate(items)

    def concatenate_leaf(*leaves: np.ndarray) -> np.ndarray:
        rows = zip(*(leaf.ravel() for leaf in leaves), strict=True)
        return lanes.pack([concatenate_lanes(row) for row in rows], leaves[0].shape)

    joined: T = jax.tree.map(concatenate_leaf, *parts)
    return joined


def lanes_of_group[T](tree: T, group: VehicleGroup) -> T:
    """The robots of a group of lanes [R, W]."""

    def select_rows(leaf: np.ndarray) -> np.ndarray:
        out = np.empty_like(leaf)
        for index in np.ndindex(*out.shape):
            out[index] = leaf[index][group.first : group.first + group.count]
        return out

    selected: T = jax.tree.map(select_rows, tree)
    return selected


def of_group[T](tree: T, group: VehicleGroup) -> T:
    """The robots of a group of arrays [W, R, ...]."""
    rows = slice(group.first, group.first + group.count)
    selected: T = jax.tree.map(lambda leaf: leaf[:, rows], tree)
    return selected


def broadcast_lanes(elements: np.ndarray, like: jax.Array) -> np.ndarray:
    """Object array whose lanes all have one shape."""
    out = np.empty_like(elements)
    for index in np.ndindex(*elements.shape):
        out[index] = jnp.broadcast_to(elements[index], like.shape)
    return out


def to_lanes[T](tree: T, lead: int, rows: jax.Array | None = None) -> T:
    """Arrays [W, ...] with ``lead`` axes of lanes as object arrays, worlds last.

    Long ones become tables. Of arrays of more worlds, ``rows`` int32 [W] says which are meant:
    tables are read where they stand, nothing long is copied.
    """

    def convert_leaf(leaf: jax.Array) -> lanes.LookupTable | np.ndarray:
        tail = leaf.shape[lead:]
        if is_table(tail):
            return _build_table(leaf, lead, rows)
        chosen = leaf if rows is None else leaf[rows]
        return lanes.split_leaf(jnp.swapaxes(chosen, 0, lead - 1), lead)

    converted: T = jax.tree.map(convert_leaf, tree)
    return converted


def _build_table(leaf: jax.Array, lead: int, rows: jax.Array | None = None) -> lanes.LookupTable:
    """An array [W, (n,) ...] as a table of each body; lanes [W] or [n, W]; as `to_lanes`."""
    tail = leaf.shape[lead:]
    if leaf.size >= MAX_ELEMENTS:
        raise RunError(
            f"lanes count places in 31 bits, and an array of this tile has {leaf.size} numbers "
            f"({', '.join(map(str, leaf.shape))}): use a tile {leaf.size // MAX_ELEMENTS + 1} "
            "times smaller"
        )
    size = int(np.prod(tail))
    flat = leaf.reshape(-1)
    body = np.arange(leaf.size // size, dtype=np.int32).reshape(leaf.shape[:lead])
    base = jnp.asarray(body if rows is None else jnp.asarray(body)[rows]) * np.int32(size)
    base = jnp.swapaxes(base, 0, lead - 1)

    def load(index: lanes.MemoryIndex) -> jax.Array:
        return flat.at[index].get(mode="promise_in_bounds")

    return lanes.LookupTable(load, tail, leaf.dtype, base=base)


def to_arrays[T](tree: T, lead: int) -> T:
    """Object arrays of lanes [..., W] to arrays [W, ...]."""
    arrays: T = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, lead - 1, 0), lanes.join(tree))
    return arrays


def lane_state_of(fleet: Fleet, state: WorldState) -> LaneState:
    """The state of worlds as lanes."""

    def convert_group(group: VehicleGroup) -> RobotState:
        robots = RobotState(vehicle=state.vehicles, memory=state.carry, tally=state.tally)
        return to_lanes(of_group(robots, group), 2)

    return LaneState(
        groups=tuple(map(convert_group, fleet.groups)), obstacles=to_lanes(state.obstacles, 2)
    )


def vehicles_of(moving: LaneState) -> VehicleState:
    """Where all robots are, as arrays [W, R, ...]."""
    return to_arrays(concatenate_groups([robots.vehicle for robots in moving.groups]), 2)


def outcome_of(moving: LaneState) -> jax.Array:
    """How all robots ended so far, as an array int32 [W, R]."""
    return to_arrays(concatenate_groups([robots.tally.outcome for robots in moving.groups]), 2)


def world_state(moving: LaneState, step: jax.Array, memory: WorldMemory) -> WorldState:
    """The inverse of `lane_state_of`; ``step`` [W]."""
    robots = to_arrays(concatenate_groups(moving.groups), 2)
    return WorldState(
        vehicles=robots.vehicle,
        carry=robots.memory,
        obstacles=to_arrays(moving.obstacles, 2),
        tally=robots.tally,
        step=step,
        **vars(memory),
    )


def grid_shape(environment: Environment) -> lane_steps.GridShape:
    """Cells along x, y and z of environments [W, ...]."""
    nx, ny, nz = environment.grid.occupied.shape[1:]
    return nx, ny, nz


def pack_cells(worlds: World) -> jax.Array:
    """Return `clearance.cell_neighbours` of worlds [W, ...]."""
    return jax.vmap(clearance.cell_neighbours)(worlds.environment.grid.occupied)


def scene_of(
    fleet: Fleet, worlds: World, rows: jax.Array | None = None, cells: jax.Array | None = None
) -> LaneScene:
    """Everything that stays the same, laid out as lanes; ``rows`` as in `to_lanes`.

    ``cells`` are those of `pack_cells`; packed now if left out.
    """
    environment = worlds.environment
    neighbours = pack_cells(worlds) if cells is None else cells

    def group_constants(group: VehicleGroup) -> GroupConstants:
        params, laden = _select_params(fleet, group, worlds, rows)
        return GroupConstants(
            group=group,
            params=params,
            laden=laden,
            path=to_lanes(of_group(worlds.path, group), 2, rows),
            goal_m=to_lanes(of_group(environment.goal_m, group), 2, rows),
            fails_at_s=to_lanes(of_group(worlds.fails_at_s, group), 2, rows),
        )

    obstacles = to_lanes(environment.obstacles, 2, rows)
    return LaneScene(
        groups=tuple(map(group_constants, fleet.groups)),
        current=_current_lanes(environment.current, rows),
        cells=_cell_lanes(environment, neighbours, rows),
        shape=grid_shape(environment),
        obstacles=obstacles,
        reach=lane_judge.bounding_reach(obstacles),
        n_robot=environment.start_m.shape[1],
        n_obstacle=environment.obstacles.kind.shape[1] if environment.obstacles.kinds else 0,
    )


def _current_lanes(current: Current, rows: jax.Array | None) -> Current:
    """Components as lanes; what they look up is one table for all worlds."""
    dtypes = [leaf.dtype for leaf in jax.tree.leaves(current) if leaf.dtype.kind == "f"]

    def build_table(values: np.ndarray) -> lanes.LookupTable:
        flat = jnp.asarray(values, dtypes[0])
        return lanes.LookupTable(
            lambda at: flat.at[at].get(mode="promise_in_bounds"), flat.shape, flat.dtype
        )

    current_lanes: Current = to_lanes(current, 1, rows)
    return bind_fields(
        current_lanes, lambda field: [build_table(values) for values in field.numbers]
    )


def _cell_lanes(environment: Environment, neighbours: jax.Array, rows: jax.Array | None) -> Cells:
    grid = environment.grid
    lo, hi = jax.vmap(region_corners)(environment)
    return Cells(
        neighbours=_build_table(neighbours.reshape(neighbours.shape[0], -1), 1, rows),
        origin_m=to_lanes(grid.origin_m, 1, rows),
        cell_m=to_lanes(grid.cell_m, 1, rows),
        floor_z_m=to_lanes(environment.floor_z_m, 1, rows),
        lo=to_lanes(lo, 1, rows),
        hi=to_lanes(hi, 1, rows),
    )


def _select_params(
    fleet: Fleet, group: VehicleGroup, worlds: World, rows: jax.Array | None = None
) -> tuple[ControlParams, ControlParams | None]:
    """Parameters of a group's robots, and with their load, if they can carry one.

    An element that no variant changes is one number for all.
    """
    of_world = worlds.variant if rows is None else worlds.variant[rows]
    variant = jnp.swapaxes(of_group(of_world, group), 0, 1)
    leaves, tree = jax.tree.flatten(fleet.control)
    now = (
        [variant, fleet.loaded_variant(variant, jnp.asarray(True))]
        if fleet.can_carry
        else [variant]
    )
    selected = [
        _select_parameter(leaf, letters, group.variant, now)
        for leaf, letters in zip(leaves, group.sameness, strict=True)
    ]
    speeds = [worlds.cruise_speed_mps]
    if fleet.can_carry:
        speeds.append(laden_cruise(fleet, worlds))

    def params(which: int) -> ControlParams:
        each: ControlParams = jax.tree.unflatten(tree, [choices[which] for choices in selected])
        cruise = to_lanes(of_group(speeds[which], group), 2, rows)
        return replace(each, cruise_speed_mps=cruise)

    return params(0), params(1) if fleet.can_carry else None


def _select_parameter(
    leaf: jax.Array, letters: str, common: int, variants: Sequence[jax.Array]
) -> list[lanes.LookupTable | np.ndarray]:
    """One leaf [n_variant, ...] of the parameters, by each of the numbers [n, W] of robots."""
    tail = leaf.shape[1:]
    flat = leaf.reshape(-1)

    def load(index: lanes.MemoryIndex) -> jax.Array:
        return flat.at[index].get(mode="promise_in_bounds")

    if is_table(tail):
        bases = [
            (robot_variant if "v" in letters else common) * np.int32(len(letters))
            for robot_variant in variants
        ]
        return [lanes.LookupTable(load, tail, leaf.dtype, base=start) for start in bases]
    same: dict[int, lanes.LaneValue] = {}
    for k, letter in enumerate(letters):
        if letter == "z":
            same[k] = np.zeros(1, leaf.dtype)[0]
        elif letter == "s":
            same[k] = flat[common * len(letters) + k]

    def row(variant: jax.Array) -> np.ndarray:
        items = [
            load(variant * np.int32(len(letters)) + k) if letter == "v" else same[k]
            for k, letter in enumerate(letters)
        ]
        return lanes.pack(items, tail)

    return [row(robot_variant) for robot_variant in variants]


def apply_load(loaded: jax.Array, laden: ControlParams, params: ControlParams) -> ControlParams:
    """Parameters of robots with their load where they have one; ``loaded`` is lanes [] of bool."""

    def select_leaf(with_load: lanes.Elements, without: lanes.Elements) -> lanes.Elements:
        if isinstance(without, lanes.LookupTable):
            if not isinstance(with_load, lanes.LookupTable):
                raise TypeError("a table with a load is an array without it")
            return with_load.where(loaded[()], without)
        pairs = zip(lanes.read_elements(with_load).ravel(), without.ravel(), strict=True)
        items = [y if x is y else jnp.where(loaded[()], x, y) for x, y in pairs]
        return lanes.pack(items, without.shape)

    chosen: ControlParams = jax.tree.map(select_leaf, laden, params)
    return chosen
