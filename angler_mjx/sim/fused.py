"""The fused engine in plain JAX: one array for every field, robots x worlds, in one loop.

Same equations, discretisation and random numbers as the mjx engine, with the closed form of a
rigid body in place of MJX. Lanes are [R, W] for robots, [n_obstacle, W] for obstacles and [W] for
worlds, so the worlds lie side by side in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import clearance, lanes
from angler_mjx.control.cascade import CascadeCarry, CascadeParams
from angler_mjx.control.commands import ThrusterPwm
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.physics.closed_form import ClosedForm
from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import episode, lane_steps
from angler_mjx.sim.fleet import Fleet, Group
from angler_mjx.sim.lane_steps import Cells, Met, Others
from angler_mjx.sim.planes import is_table
from angler_mjx.sim.state import Sample, SimSpec, Tally, World, WorldState
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import Obstacles, ObstacleState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Robots:
    """What changes from step to step of the robots of a group, as lanes."""

    vehicle: VehicleState
    carry: CascadeCarry
    tally: Tally


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Moving:
    """What changes from step to step, as lanes."""

    groups: tuple[_Robots, ...]
    obstacles: ObstacleState


@dataclass(frozen=True, kw_only=True)
class _Given:
    """What stays the same of the robots of a group, as lanes."""

    group: Group
    params: CascadeParams
    path: Trajectory
    goal_m: Any


@dataclass(frozen=True, kw_only=True)
class _Scene:
    """What stays the same during a segment, as lanes."""

    groups: tuple[_Given, ...]
    current: Any
    cells: Cells
    shape: lane_steps.Shape
    obstacles: Obstacles
    reach: jax.Array
    """Of the obstacles, [n_obstacle, W]."""
    n_robot: int
    n_obstacle: int


class FusedEngine:
    """Closed-form rigid bodies on lanes, in plain JAX."""

    def reset(self, spec: SimSpec, fleet: Fleet, worlds: World) -> WorldState:
        """See `Engine.reset`."""
        one = partial(episode.reset, spec, ClosedForm(gravity_mps2=spec.water.gravity_mps2))
        state: WorldState = jax.vmap(one)(worlds.cascade.vehicle, worlds)
        return state

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: ThrusterPwm | None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        scene = _scene(fleet, worlds)
        signals = None if command is None else command.pwm_us
        after, sample = _control_step(spec, scene, _moving(fleet, state), state.step[0], signals)
        return _world_state(after, state.step + 1), _arrays(sample, 2)

    def segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        *,
        n_sample: int,
        steps_per_sample: int,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        scene = _scene(fleet, worlds)
        row, rebuild = lanes.flatten(_moving(fleet, state))
        rebuild_sample: list[Any] = []

        def sampled(row: list[jax.Array]) -> list[jax.Array]:
            flat, again = lanes.flatten(
                _control_step(spec, scene, rebuild(row), jnp.int32(0), None)[1]
            )
            rebuild_sample.append(again)
            return flat

        template = jax.eval_shape(sampled, row)
        nothing = [jnp.zeros(leaf.shape, leaf.dtype) for leaf in template]

        def one(carry: Any, i: jax.Array) -> tuple[Any, None]:
            row, kept, step = carry
            after, sample = _control_step(spec, scene, rebuild(row), step, None)
            row = [
                lanes.spread(x, old) for x, old in zip(lanes.flatten(after)[0], row, strict=True)
            ]
            now = lanes.flatten(sample)[0]
            kept = [jnp.where(i == 0, new, old) for new, old in zip(now, kept, strict=True)]
            return (row, kept, step + 1), None

        def recorded(carry: Any, _: None) -> tuple[Any, Any]:
            row, step = carry
            (row, kept, step), _ = jax.lax.scan(
                one, (row, nothing, step), jnp.arange(steps_per_sample)
            )
            return (row, step), kept

        (row, _), kept = jax.lax.scan(recorded, (row, state.step[0]), length=n_sample)
        after = _world_state(rebuild(row), state.step + n_sample * steps_per_sample)
        return after, _arrays(rebuild_sample[0](kept), 3)


def _control_step(
    spec: SimSpec, scene: _Scene, moving: _Moving, step: jax.Array, command: jax.Array | None
) -> tuple[_Moving, Sample]:
    """One control step of all worlds; ``command`` [W, R, n_thruster] instead of the controller."""
    like = moving.groups[0].vehicle.p[0]
    t = jnp.asarray(step, like.dtype) * spec.control_dt_s
    moved, samples = [], []
    for given, robots in zip(scene.groups, moving.groups, strict=True):
        with jax.named_scope("robots"):
            after, said = _advance(spec, scene, given, robots, t, command)
        moved.append(after)
        samples.append(said)
    obstacles = moving.obstacles
    if scene.n_obstacle > 0:
        with jax.named_scope("obstacles"):
            obstacles = lane_steps.advance_obstacles(
                spec, scene.shape, scene.obstacles, obstacles, scene.current, scene.cells, t
            )
    others = [
        Others(
            count=given.group.count,
            load=partial(_met_robot, given.params.vehicle, vehicle),
            first=given.group.first,
        )
        for given, (vehicle, *_) in zip(scene.groups, moved, strict=True)
    ]
    met = partial(_met_obstacle, scene.obstacles, scene.reach, obstacles)
    groups = []
    for given, before, (vehicle, carry, power, broken) in zip(
        scene.groups, moving.groups, moved, strict=True
    ):
        with jax.named_scope("detection"):
            tally = lane_steps.judge(
                spec,
                scene.shape,
                given.params.vehicle,
                given.goal_m,
                scene.cells,
                before.tally,
                before.vehicle.p,
                vehicle,
                power,
                broken,
                Others(count=scene.n_obstacle, load=met),
                others if scene.n_robot > 1 else [],
                given.group.first + np.arange(given.group.count)[:, None],
                t,
            )
        groups.append(_Robots(vehicle=vehicle, carry=carry, tally=tally))
    sample = Sample(
        **_side_by_side(samples),
        obstacle_p=moving.obstacles.p,
        obstacle_q=moving.obstacles.q,
    )
    return _Moving(groups=tuple(groups), obstacles=obstacles), sample


def _advance(
    spec: SimSpec,
    scene: _Scene,
    given: _Given,
    robots: _Robots,
    t: jax.Array,
    command: jax.Array | None,
) -> tuple[Any, dict[str, Any]]:
    """Controller and physics of a group: what it comes to, and its part of the sample."""
    before, outcome = robots.vehicle, robots.tally.outcome
    signals = None if command is None else _lanes(_of_group(command, given.group), 2)
    carry, decision = lane_steps.control_robots(
        spec, given.params, given.path, before, robots.carry, signals
    )
    vehicle, broken = lane_steps.move_robots(
        spec, given.params.vehicle, scene.current, before, outcome, decision.thrust_n, t
    )
    sample = {
        "p": before.p,
        "q": before.q,
        "nu": before.nu,
        "pwm_us": decision.pwm_us,
        "target_m": decision.target_m,
        "current_mps": lane_steps.flow_at(scene.current, before.p, t),
        "outcome": outcome,
    }
    like = before.p[0]
    spread = {name: _spread(leaf, like) for name, leaf in sample.items()}
    return (vehicle, carry, decision.power_w, broken), spread


def _side_by_side(parts: Sequence[Any]) -> Any:
    """Trees of lanes [n, W] of the groups as one, [R, W]."""

    def one(*leaves: np.ndarray) -> np.ndarray:
        out = np.empty_like(leaves[0])
        for index in np.ndindex(*out.shape):
            out[index] = jnp.concatenate([leaf[index] for leaf in leaves])
        return out

    return jax.tree.map(one, *parts)


def _of_group(tree: Any, group: Group) -> Any:
    """The robots of a group of arrays [W, R, ...]."""
    return jax.tree.map(lambda leaf: leaf[:, group.first : group.first + group.count], tree)


def _spread(elements: np.ndarray, like: jax.Array) -> np.ndarray:
    """Object array whose lanes all have one shape."""
    out = np.empty_like(elements)
    for index in np.ndindex(*elements.shape):
        out[index] = jnp.broadcast_to(elements[index], like.shape)
    return out


def _met_robot(params: VehicleParams, state: VehicleState, i: jax.Array) -> Met:
    """Robot i of a group."""
    vehicle, now = _row((params, state), i)
    return Met(
        p=now.p,
        reach=vehicle.radius_m[()],
        details=lambda: (vehicle, now.q, lane_steps.velocity(now.q, now.nu)),
    )


def _met_obstacle(
    obstacles: Obstacles, reach: jax.Array, state: ObstacleState, i: jax.Array
) -> Met:
    """Obstacle i."""
    body, radius, now = _row((obstacles, lanes.pack([reach], ()), state), i)
    return Met(
        p=now.p,
        reach=radius[()],
        details=lambda: (body, now.q, lane_steps.velocity(now.q, now.nu)),
    )


def _row(tree: Any, i: jax.Array) -> Any:
    """Row i of lanes [n, W], as lanes [W]; what has no rows stays as it is."""

    def one(leaf: Any) -> Any:
        if isinstance(leaf, lanes.Table):
            return leaf
        out = np.empty_like(leaf)
        for index in np.ndindex(*leaf.shape):
            x = leaf[index]
            rows = np.ndim(x) == 2
            out[index] = jax.lax.dynamic_index_in_dim(x, i, keepdims=False) if rows else x
        return out

    return jax.tree.map(one, tree)


def _lanes(tree: Any, lead: int) -> Any:
    """Arrays [W, ...] with ``lead`` axes of lanes as object arrays, worlds last.

    Long ones become tables.
    """

    def one(leaf: jax.Array) -> Any:
        tail = leaf.shape[lead:]
        if is_table(tail):
            return _table(leaf, lead)
        return lanes.split(jnp.swapaxes(leaf, 0, lead - 1), lead)

    return jax.tree.map(one, tree)


def _table(leaf: jax.Array, lead: int) -> lanes.Table:
    """An array [W, (n,) ...] as a table of each body; lanes [W] or [n, W]."""
    tail = leaf.shape[lead:]
    size = int(np.prod(tail))
    flat = leaf.reshape(-1)
    body = np.arange(leaf.size // size, dtype=np.int32).reshape(leaf.shape[:lead])
    base = jnp.asarray(np.swapaxes(body, 0, lead - 1) * np.int32(size))

    def load(place: Any) -> jax.Array:
        return flat.at[place].get(mode="promise_in_bounds")

    return lanes.Table(load, tail, leaf.dtype, base=base)


def _arrays(tree: Any, lead: int) -> Any:
    """Object arrays of lanes [..., W] to arrays [W, ...]."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, lead - 1, 0), lanes.join(tree))


def _moving(fleet: Fleet, state: WorldState) -> _Moving:
    def of(group: Group) -> _Robots:
        robots = _Robots(vehicle=state.vehicles, carry=state.carry, tally=state.tally)
        lanes_of: _Robots = _lanes(_of_group(robots, group), 2)
        return lanes_of

    return _Moving(groups=tuple(map(of, fleet.groups)), obstacles=_lanes(state.obstacles, 2))


def _world_state(moving: _Moving, step: jax.Array) -> WorldState:
    robots = _arrays(_side_by_side(moving.groups), 2)
    return WorldState(
        vehicles=robots.vehicle,
        carry=robots.carry,
        obstacles=_arrays(moving.obstacles, 2),
        tally=robots.tally,
        step=step,
    )


def grid_shape(environment: Environment) -> lane_steps.Shape:
    """Cells along x, y and z of environments [W, ...]."""
    nx, ny, nz = environment.grid.occupied.shape[1:]
    return nx, ny, nz


def packed_cells(worlds: World) -> jax.Array:
    """`clearance.cell_neighbours` of worlds [W, ...], packed now if that was not done before."""
    if worlds.cell_neighbours is not None:
        return worlds.cell_neighbours
    return jax.vmap(clearance.cell_neighbours)(worlds.environment.grid.occupied)


def _scene(fleet: Fleet, worlds: World) -> _Scene:
    """Everything that stays the same, laid out as lanes."""
    environment = worlds.environment

    def given(group: Group) -> _Given:
        return _Given(
            group=group,
            params=_params(fleet, group, worlds),
            path=_lanes(_of_group(worlds.path, group), 2),
            goal_m=_lanes(_of_group(environment.goal_m, group), 2),
        )

    obstacles = _lanes(environment.obstacles, 2)
    return _Scene(
        groups=tuple(map(given, fleet.groups)),
        current=_lanes(environment.current, 1),
        cells=_cells(worlds),
        shape=grid_shape(environment),
        obstacles=obstacles,
        reach=lane_steps.reach(obstacles),
        n_robot=environment.start_m.shape[1],
        n_obstacle=environment.obstacles.kind.shape[1] if environment.obstacles.kinds else 0,
    )


def _cells(worlds: World) -> Cells:
    environment, neighbours = worlds.environment, packed_cells(worlds)
    grid = environment.grid
    lo, hi = jax.vmap(episode.region)(environment)
    return Cells(
        neighbours=_table(neighbours.reshape(neighbours.shape[0], -1), 1),
        origin_m=_lanes(grid.origin_m, 1),
        cell_m=_lanes(grid.cell_m, 1),
        floor_z_m=_lanes(environment.floor_z_m, 1),
        lo=_lanes(lo, 1),
        hi=_lanes(hi, 1),
    )


def _params(fleet: Fleet, group: Group, worlds: World) -> CascadeParams:
    """Parameters of a group's robots; an element that no variant changes is one number for all."""
    variant = jnp.swapaxes(_of_group(worlds.variant, group), 0, 1)
    leaves, tree = jax.tree.flatten(fleet.cascade)
    possible = [
        _parameter(leaf, letters, group.variant, variant)
        for leaf, letters in zip(leaves, group.sameness, strict=True)
    ]
    params: CascadeParams = jax.tree.unflatten(tree, possible)
    cruise = _lanes(_of_group(worlds.cascade.cruise_speed_mps, group), 2)
    return replace(params, cruise_speed_mps=cruise)


def _parameter(leaf: jax.Array, letters: str, common: int, variant: jax.Array) -> Any:
    """One leaf [n_variant, ...] of the parameters, by the variant of each robot of a group."""
    tail = leaf.shape[1:]
    flat = leaf.reshape(-1)

    def load(place: Any) -> jax.Array:
        return flat.at[place].get(mode="promise_in_bounds")

    if is_table(tail):
        chosen = variant if "v" in letters else common
        base = chosen * np.int32(len(letters))
        return lanes.Table(load, tail, leaf.dtype, base=base)
    out = np.empty(len(letters), object)
    for k, letter in enumerate(letters):
        if letter == "z":
            out[k] = np.zeros((), leaf.dtype)[()]
        elif letter == "s":
            out[k] = flat[common * len(letters) + k]
        else:
            out[k] = load(variant * np.int32(len(letters)) + k)
    return out.reshape(tail)
