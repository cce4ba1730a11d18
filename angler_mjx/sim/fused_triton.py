"""The fused engine as Pallas kernels, lowered by Triton: a control period in registers.

Four kernels make a control step: controller, physics steps, obstacles, and detection with the
tally. A program works on neighbouring worlds of one robot of the fleet; its state stays in
registers over all physics steps of the control period, and it writes the record itself. Other
shapes are read from memory, so fleets of any size fit. Robots of one vehicle share a program.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import clearance, lanes
from angler_mjx.control.cascade import CascadeParams
from angler_mjx.control.commands import ThrusterPwm
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.sim import episode, lane_steps, triton
from angler_mjx.sim.fleet import Fleet, Group
from angler_mjx.sim.fused import FusedEngine, grid_shape
from angler_mjx.sim.lane_steps import Cells, Met, Others
from angler_mjx.sim.planes import Layout, Shelf, is_table, typed
from angler_mjx.sim.state import Sample, SimSpec, World, WorldState
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.world.obstacle_types import bounding_radius

AHEAD = 5
"""Most control steps that obstacles, which nothing can disturb, are moved ahead of the robots."""

LANES = 32
"""Lanes of one program: one warp, so that a program skips what none of its lanes needs."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _RobotConstants:
    variant: Any
    path: Trajectory
    goal_m: Any
    cruise_speed_mps: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _WorldConstants:
    current: Any
    origin_m: Any
    cell_m: Any
    floor_z_m: Any
    lo: Any
    hi: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Order:
    """What the controller hands to the physics and the tally."""

    thrust_n: Any
    power_w: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Deed:
    """What the physics hands to the tally."""

    before_m: Any
    broken: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _ControlRecord:
    pwm_us: Any
    target_m: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _MotionRecord:
    p: Any
    q: Any
    nu: Any
    current_mps: Any
    outcome: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Drift:
    """Where an obstacle is after a control step: what detection wants to know."""

    p: Any
    q: Any
    v: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _ObstacleRecord:
    obstacle_p: Any
    obstacle_q: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Bodies:
    """Obstacles, and the radius of their bounding spheres (-inf for padding)."""

    given: Any
    reach: Any


@dataclass(frozen=True, kw_only=True)
class _Bank:
    """The fleet's parameters in one flat array, all variants of an element side by side."""

    tree: Any
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[Any, ...]
    firsts: tuple[int, ...]

    @classmethod
    def of(cls, fleet: Fleet, dtype: Any) -> tuple["_Bank", jax.Array]:
        leaves, tree = jax.tree.flatten(fleet.cascade)
        sizes = [leaf.size for leaf in leaves]
        bank = cls(
            tree=tree,
            shapes=tuple(leaf.shape[1:] for leaf in leaves),
            dtypes=tuple(np.dtype(leaf.dtype) for leaf in leaves),
            firsts=tuple(np.cumsum([0, *sizes[:-1]]).tolist()),
        )
        return bank, jnp.concatenate([leaf.reshape(-1).astype(dtype) for leaf in leaves])

    def read(self, load: Callable[[Any], Any], group: Group, variant: Any) -> CascadeParams:
        """Parameters of lanes of robots of a group, by their variants."""
        out = []
        for shape, dtype, first, letters, shared in zip(
            self.shapes, self.dtypes, self.firsts, group.sameness, group.shared, strict=True
        ):
            size = len(letters)
            if is_table(shape):
                base = first + (variant if "v" in letters else group.variant) * np.int32(size)
                out.append(lanes.Table(load, shape, dtype, base=base))
                continue
            row = [
                typed(load(first + variant * size + k), dtype)
                if letter == "v"
                else np.asarray(shared[k], dtype)[()]
                for k, letter in enumerate(letters)
            ]
            out.append(lanes.pack(row, shape))
        params: CascadeParams = jax.tree.unflatten(self.tree, out)
        return params


class TritonEngine:
    """Closed-form rigid bodies in Pallas kernels."""

    def __init__(self, *, lanes: int = LANES, warps: int = 1, interpret: bool = False) -> None:
        """Choose the shape of a program.

        Args:
            lanes: robots in one program, a power of two.
            warps: warps in one program.
            interpret: run the kernels as ordinary JAX, on any device.
        """
        self.lanes = lanes
        self.warps = warps
        self.interpret = interpret

    def reset(self, spec: SimSpec, fleet: Fleet, worlds: World) -> WorldState:
        """See `Engine.reset`."""
        return FusedEngine().reset(spec, fleet, worlds)

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: ThrusterPwm | None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        after, sample = self._segment(spec, fleet, worlds, state, 1, 1, command)
        return after, jax.tree.map(lambda leaf: leaf[:, 0], sample)

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

        def plain(fleet: Fleet, worlds: World, state: WorldState) -> tuple[WorldState, Sample]:
            return FusedEngine().segment(
                spec, fleet, worlds, state, n_sample=n_sample, steps_per_sample=steps_per_sample
            )

        def fast(fleet: Fleet, worlds: World, state: WorldState) -> tuple[WorldState, Sample]:
            return self._segment(spec, fleet, worlds, state, n_sample, steps_per_sample, None)

        both = triton.with_gradient_of(plain, fast)
        after: tuple[WorldState, Sample] = both(fleet, worlds, state)
        return after

    def _segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        n_sample: int,
        steps_per_sample: int,
        command: ThrusterPwm | None,
    ) -> tuple[WorldState, Sample]:
        """Whole programs: the last world is repeated until they are full, and cut off again."""
        count = state.step.shape[0]
        extra = -count % self.lanes

        def fill(leaf: jax.Array) -> jax.Array:
            return jnp.concatenate([leaf, jnp.repeat(leaf[-1:], extra, axis=0)]) if extra else leaf

        worlds, state, command = jax.tree.map(fill, (worlds, state, command))
        scene = _Scene(self, spec, fleet, worlds)
        after = scene.segment(state, n_sample, steps_per_sample, command)
        cut: tuple[WorldState, Sample] = jax.tree.map(lambda leaf: leaf[:count], after)
        return cut


class _Scene:
    """One tile of worlds laid out for the kernels."""

    def __init__(self, engine: TritonEngine, spec: SimSpec, fleet: Fleet, worlds: World) -> None:
        environment = worlds.environment
        self._engine, self._spec = engine, spec
        self._dtype = environment.start_m.dtype
        self._worlds, self._robots = environment.start_yaw_rad.shape
        self._obstacles = environment.obstacles.kind.shape[1]
        self._some_obstacle = bool(environment.obstacles.kinds)
        self._grid = grid_shape(environment)
        self._groups = fleet.groups
        self._bank, self._fleet_data = _Bank.of(fleet, self._dtype)
        neighbours = jax.vmap(clearance.cell_neighbours)(environment.grid.occupied)
        self._cells = neighbours[0].size
        self._cell_data = neighbours.reshape(-1)
        lo, hi = jax.vmap(episode.region)(environment)
        robots = _RobotConstants(
            variant=worlds.variant,
            path=worlds.path,
            goal_m=environment.goal_m,
            cruise_speed_mps=worlds.cascade.cruise_speed_mps,
        )
        water = _WorldConstants(
            current=environment.current,
            origin_m=environment.grid.origin_m,
            cell_m=environment.grid.cell_m,
            floor_z_m=environment.floor_z_m,
            lo=lo,
            hi=hi,
        )
        self._robot, self._robot_data = self._pack(robots, 2)
        self._world, self._world_data = self._pack(water, 1)
        given = environment.obstacles
        radius = jax.vmap(jax.vmap(bounding_radius))(given.kind, given.size_m)
        bodies = _Bodies(given=given, reach=jnp.where(given.exists, radius, -jnp.inf))
        self._body, self._body_data = self._pack(bodies, 2)
        n_thruster = fleet.cascade.vehicle.B.shape[-1]
        count = self._robots
        self._order = self._layout(_Order(thrust_n=(n_thruster,), power_w=()), count)
        self._deed = self._layout(_Deed(before_m=(3,), broken=()), count)
        self._said = self._layout(_ControlRecord(pwm_us=(n_thruster,), target_m=(3,)), count)
        motion = _MotionRecord(p=(3,), q=(4,), nu=(6,), current_mps=(3,), outcome=())
        self._moved = self._layout(motion, count)
        self._seen = self._layout(
            _ObstacleRecord(obstacle_p=(3,), obstacle_q=(4,)), self._obstacles
        )
        self._drift = self._layout(_Drift(p=(3,), q=(4,), v=(3,)), self._obstacles)

    def segment(
        self, state: WorldState, n_sample: int, steps_per_sample: int, command: ThrusterPwm | None
    ) -> tuple[WorldState, Sample]:
        """Control steps, with a sample of the first of every ``steps_per_sample``."""
        self._vehicle, robots = self._pack(state.vehicles, 2)
        self._memory, memory = self._pack(state.carry, 2)
        self._tally, tally = self._pack(state.tally, 2)
        self._body_state, bodies = self._pack(state.obstacles, 2)
        self._signals = [] if command is None else [self._pack(command.pwm_us, 2)]
        self._every = steps_per_sample
        self._ahead = max(n for n in range(1, AHEAD + 1) if steps_per_sample % n == 0)
        self._first = state.step[:1]
        said, moved, seen = (
            self._shelf(x, n_sample) for x in (self._said, self._moved, self._seen)
        )
        self._shelves = said, moved, seen
        track = jnp.zeros(self._ahead * self._drift.planes * self._drift.lanes, self._dtype)
        scratch = [self._zeros(self._order), self._zeros(self._deed), track]
        records = [jnp.zeros(shelf.size, self._dtype) for shelf in self._shelves]

        def one(carry: Any, _: None) -> tuple[Any, None]:
            count, robots, memory, tally, bodies, (order, deed, track), (said, moved, seen) = carry
            for group in self._groups:
                memory, order, said = self._control(group, count, robots, memory, order, said)
                robots, deed, moved = self._move(group, count, robots, tally, order, deed, moved)
            for group in self._groups:
                tally = self._judge(group, count, robots, track, order, deed, tally)
            scratch, records = [order, deed, track], [said, moved, seen]
            return (count + 1, robots, memory, tally, bodies, scratch, records), None

        def some(carry: Any, _: None) -> tuple[Any, None]:
            count, robots, memory, tally, bodies, (order, deed, track), (said, moved, seen) = carry
            if self._some_obstacle:
                bodies, track, seen = self._go_ahead(count, bodies, track, seen)
            scratch, records = [order, deed, track], [said, moved, seen]
            carry = (count, robots, memory, tally, bodies, scratch, records)
            return jax.lax.scan(one, carry, length=self._ahead)

        start = (jnp.zeros_like(self._first), robots, memory, tally, bodies, scratch, records)
        chunks = n_sample * steps_per_sample // self._ahead
        end, _ = jax.lax.scan(some, start, length=chunks)
        count, robots, memory, tally, bodies, _, records = end
        of_robot = (self._worlds, self._robots)
        of_body = (self._worlds, self._obstacles)
        robot_said, robot_moved, body_seen = (
            shelf.unpack(record) for shelf, record in zip(self._shelves, records, strict=True)
        )
        after = WorldState(
            vehicles=self._vehicle.unpack(robots, of_robot),
            carry=self._memory.unpack(memory, of_robot),
            obstacles=self._body_state.unpack(bodies, of_body),
            tally=self._tally.unpack(tally, of_robot),
            step=state.step + count,
        )
        if not self._some_obstacle:  # rows of padding stay where they are
            body_seen = _ObstacleRecord(
                obstacle_p=_repeated(state.obstacles.p, n_sample),
                obstacle_q=_repeated(state.obstacles.q, n_sample),
            )
        return after, Sample(**vars(robot_said), **vars(robot_moved), **vars(body_seen))

    def _control(
        self, group: Group, count: Any, robots: Any, memory: Any, order: Any, said: Any
    ) -> Any:
        """The controller of one control step, and its record."""

        def kernel(*refs: Any) -> None:
            _, count, bank, robot, state, *command, _, _, _, memory, order, said = refs
            row, lane, at, store = self._place(group.first)
            constants = self._robot.read(triton.loader(robot), lane)
            carry, decision = lane_steps.control_robots(
                self._spec,
                self._params(bank, group, constants),
                constants.path,
                self._vehicle.read(triton.loader(state), lane),
                self._memory.read(triton.loader(memory), lane),
                self._signals[0][0].read(triton.loader(command[0]), lane) if command else None,
            )

            def record_control() -> None:
                record = _ControlRecord(pwm_us=decision.pwm_us, target_m=decision.target_m)
                self._shelves[0].write(store(said), count[0] // self._every, row, at, record)

            triton.when(count[0] % self._every == 0, record_control)

            self._memory.write(store(memory), lane, carry)
            given = _Order(thrust_n=decision.thrust_n, power_w=decision.power_w)
            self._order.write(store(order), lane, given)

        command = [data for _, data in self._signals]
        constant = [self._first, count, self._fleet_data, self._robot_data, robots, *command]
        return self._run(kernel, group.count, constant, [memory, order, said])

    def _move(
        self, group: Group, count: Any, robots: Any, tally: Any, order: Any, deed: Any, moved: Any
    ) -> Any:
        """The physics of one control step; the record of its beginning."""

        def kernel(*refs: Any) -> None:
            first, count, bank, robot, world, tally, order, _, _, _, state, deed, moved = refs
            row, lane, at, store = self._place(group.first)
            params = self._params(bank, group, self._robot.read(triton.loader(robot), lane))
            current = self._world.read(triton.loader(world), at).current
            before = self._vehicle.read(triton.loader(state), lane)
            outcome = self._tally.read(triton.loader(tally), lane).outcome
            t = self._time(first, count)

            def record_motion() -> None:
                record = _MotionRecord(
                    p=before.p,
                    q=before.q,
                    nu=before.nu,
                    current_mps=lane_steps.flow_at(current, before.p, t),
                    outcome=outcome,
                )
                self._shelves[1].write(store(moved), count[0] // self._every, row, at, record)

            triton.when(count[0] % self._every == 0, record_motion)

            thrust = self._order.read(triton.loader(order), lane).thrust_n
            after, broken = lane_steps.move_robots(
                self._spec, params.vehicle, current, before, outcome, thrust, t
            )
            self._deed.write(store(deed), lane, _Deed(before_m=before.p, broken=broken))
            self._vehicle.write(store(state), lane, after)

        constant = [
            self._first,
            count,
            self._fleet_data,
            self._robot_data,
            self._world_data,
            tally,
            order,
        ]
        return self._run(kernel, group.count, constant, [robots, deed, moved])

    def _go_ahead(self, count: Any, bodies: Any, track: Any, seen: Any) -> Any:
        """Control steps of the obstacles, which no robot can change, and their record.

        The track holds where they are after each step.
        """

        def kernel(*refs: Any) -> None:
            first, count, body, world, cells, *_, state, track, seen = refs
            row, lane, at, store = self._place(0)
            start = self._body_state.read(triton.loader(state), lane)
            water = self._world.read(triton.loader(world), at)
            given = self._body.read(triton.loader(body), lane).given
            ground = self._ground(water, cells, at)

            def record_obstacle() -> None:
                record = _ObstacleRecord(obstacle_p=start.p, obstacle_q=start.q)
                self._shelves[2].write(store(seen), count[0] // self._every, row, at, record)

            triton.when(count[0] % self._every == 0, record_obstacle)

            def one(i: jax.Array, now: Any) -> Any:
                t = (first[0] + count[0] + i).astype(self._dtype) * self._spec.control_dt_s
                after = lane_steps.advance_obstacles(
                    self._spec, self._grid, given, now, water.current, ground, t
                )
                there = _Drift(p=after.p, q=after.q, v=lane_steps.velocity(after.q, after.nu))
                self._drift.write(store(track), self._step(i) + lane, there)
                return after

            self._body_state.write(store(state), lane, lanes.repeat(self._ahead, one, start))

        constant = [self._first, count, self._body_data, self._world_data, self._cell_data]
        return self._run(kernel, self._obstacles, constant, [bodies, track, seen])

    def _step(self, i: jax.Array) -> jax.Array:
        """Where in the track step i begins."""
        return i * (self._drift.planes * self._drift.lanes)

    def _judge(
        self,
        group: Group,
        count: Any,
        robots: Any,
        track: Any,
        order: Any,
        deed: Any,
        tally: Any,
    ) -> Any:
        """Detection and tally of one control step."""

        def kernel(*refs: Any) -> None:
            (
                first,
                count,
                bank,
                robot,
                body_ref,
                world,
                cells,
                state,
                track,
                order,
                deed,
                _,
                tally,
            ) = refs
            row, lane, at, store = self._place(group.first)

            def robots_of(other: Group) -> Others:
                def load(i: jax.Array) -> Met:
                    place = (other.first + i) * self._worlds + at

                    def params() -> VehicleParams:
                        load = triton.loader(robot)
                        variant = self._robot.read(load, place, lambda x: x.variant)
                        return self._bank.read(triton.loader(bank), other, variant[()]).vehicle

                    def details() -> Any:
                        q, nu = self._vehicle.read(
                            triton.loader(state), place, lambda x: (x.q, x.nu)
                        )
                        return params(), q, lane_steps.velocity(q, nu)

                    p = self._vehicle.read(triton.loader(state), place, lambda x: x.p)
                    return Met(p=p, reach=params().radius_m[()], details=details)

                return Others(count=other.count, load=load, first=other.first)

            def obstacle(i: jax.Array) -> Met:
                place = i * self._worlds + at
                now = partial(
                    self._drift.read,
                    triton.loader(track),
                    self._step(count[0] % self._ahead) + place,
                )
                body = partial(self._body.read, triton.loader(body_ref), place)

                def details() -> Any:
                    return body(lambda x: x.given), *now(lambda x: (x.q, x.v))

                return Met(p=now(lambda x: x.p), reach=body(lambda x: x.reach)[()], details=details)

            constants = self._robot.read(triton.loader(robot), lane)
            done = self._deed.read(triton.loader(deed), lane)
            after = lane_steps.judge(
                self._spec,
                self._grid,
                self._params(bank, group, constants).vehicle,
                constants.goal_m,
                self._ground(self._world.read(triton.loader(world), at), cells, at),
                self._tally.read(triton.loader(tally), lane),
                done.before_m,
                self._vehicle.read(triton.loader(state), lane),
                self._order.read(triton.loader(order), lane).power_w,
                done.broken,
                Others(count=self._obstacles if self._some_obstacle else 0, load=obstacle),
                [robots_of(other) for other in self._groups] if self._robots > 1 else [],
                row,
                self._time(first, count),
            )
            self._tally.write(store(tally), lane, after)

        constant = [
            self._first,
            count,
            self._fleet_data,
            self._robot_data,
            self._body_data,
            self._world_data,
            self._cell_data,
            robots,
            track,
            order,
            deed,
        ]
        return self._run(kernel, group.count, constant, [tally])[0]

    def _run(self, kernel: Any, rows: int, constant: list[Any], changed: list[Any]) -> Any:
        """Run a kernel on ``rows`` x worlds."""
        engine = self._engine
        return triton.call(
            kernel,
            (self._worlds // engine.lanes, rows),
            constant,
            changed,
            warps=engine.warps,
            interpret=engine.interpret,
        )

    def _place(self, first: int) -> tuple[Any, Any, Any, Any]:
        """Row, lanes and worlds of this program, and how its lanes are stored."""
        at, row = triton.place(self._engine.lanes)
        row = first + row
        return row, row * self._worlds + at, at, partial(triton.storer, like=at)

    def _time(self, first: Any, count: Any) -> jax.Array:
        """Time at the beginning of the control step."""
        t: jax.Array = (first[0] + count[0]).astype(self._dtype) * self._spec.control_dt_s
        return t

    def _params(self, bank: Any, group: Group, constants: _RobotConstants) -> CascadeParams:
        params = self._bank.read(triton.loader(bank), group, constants.variant[()])
        return replace(params, cruise_speed_mps=constants.cruise_speed_mps)

    def _ground(self, water: "_WorldConstants", cells: Any, at: Any) -> Cells:
        return Cells(
            neighbours=lanes.Table(
                triton.loader(cells), (self._cells,), np.int32, base=at * np.int32(self._cells)
            ),
            origin_m=water.origin_m,
            cell_m=water.cell_m,
            floor_z_m=water.floor_z_m,
            lo=water.lo,
            hi=water.hi,
        )

    def _pack(self, tree: Any, lead: int) -> tuple[Layout, jax.Array]:
        layout = Layout.of(tree, lead)
        return layout, layout.pack(tree, self._dtype)

    def _zeros(self, layout: Layout) -> jax.Array:
        return jnp.zeros(layout.planes * layout.lanes, self._dtype)

    def _shelf(self, layout: Layout, samples: int) -> Shelf:
        rows = layout.lanes // self._worlds
        return Shelf(layout=layout, samples=samples, rows=rows, worlds=self._worlds)

    def _layout(self, tails: Any, rows: int) -> Layout:
        """Layout of arrays [W, rows, ...] given by their shapes of one body."""
        whole = {"outcome": jnp.int32, "broken": jnp.bool_}
        shapes = {
            name: jax.ShapeDtypeStruct((self._worlds, rows, *tail), whole.get(name, self._dtype))
            for name, tail in vars(tails).items()
        }
        return Layout.of(type(tails)(**shapes), 2)


def _repeated(values: jax.Array, times: int) -> jax.Array:
    """Arrays [W, ...] as samples [W, times, ...]."""
    return jnp.broadcast_to(values[:, None], (values.shape[0], times, *values.shape[1:]))
