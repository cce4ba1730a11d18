"""The fused engine as Pallas kernels, lowered by Triton: a control period in registers.

Four kernels make a control step: controller, physics steps, obstacles, and detection with the
tally. A program works on neighbouring worlds of one robot of the fleet; its state stays in
registers over all physics steps of the control period, and it writes the record itself. Other
shapes are read from memory, so fleets of any size fit. Robots of one vehicle share a program.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels import lanes
from angler_mjx.control.commands import ThrusterPwm
from angler_mjx.sim import lane_steps, triton
from angler_mjx.sim.fleet import Fleet, Group
from angler_mjx.sim.fused import FusedEngine
from angler_mjx.sim.lane_steps import Met, Others
from angler_mjx.sim.state import Sample, SimSpec, World, WorldState
from angler_mjx.sim.tile import Tile

AHEAD = 5
"""Control steps that obstacles are moved ahead of the robots."""

UNROLLED = 10
"""Control steps in the body of the loop, whose bookkeeping costs launches; `AHEAD` divides it."""

LANES = 32
"""Lanes of one program: one warp, so that a program skips what none of its lanes needs."""


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
class _ControlSample:
    """The controller's part of a `Sample`."""

    pwm_us: Any
    target_m: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _MotionSample:
    """The physics' part of a `Sample`."""

    p: Any
    q: Any
    nu: Any
    current_mps: Any
    outcome: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _ObstacleSample:
    """The obstacles' part of a `Sample`."""

    obstacle_p: Any
    obstacle_q: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Drift:
    """Where an obstacle is after a control step: what detection wants to know."""

    p: Any
    q: Any
    v: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Arrays:
    """Flat arrays that change from launch to launch."""

    robots: jax.Array
    """`VehicleState`."""
    memory: jax.Array
    """The controllers'."""
    tally: jax.Array
    order: jax.Array
    deed: jax.Array
    said: jax.Array
    """Record of the controllers."""
    moved: jax.Array
    """Record of the motion."""
    bodies: jax.Array
    """`ObstacleState`, as far ahead as they were moved."""
    track: jax.Array
    """`_Drift` of `AHEAD` steps."""
    seen: jax.Array
    """Record of the obstacles."""


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
        run = _Run(self, spec, Tile(fleet, worlds), state, n_sample, steps_per_sample, command)
        cut: tuple[WorldState, Sample] = jax.tree.map(lambda leaf: leaf[:count], run.all_steps())
        return cut


class _Run:
    """Control steps of one tile, with a sample of the first of every ``every``."""

    def __init__(
        self,
        engine: TritonEngine,
        spec: SimSpec,
        tile: Tile,
        state: WorldState,
        n_sample: int,
        every: int,
        command: ThrusterPwm | None,
    ) -> None:
        self._engine, self._spec, self._tile, self._state = engine, spec, tile, state
        self._samples, self._every, self._steps = n_sample, every, n_sample * every
        self._first = state.step[:1]
        self._vehicle, robots = tile.pack(state.vehicles, 2)
        self._memory, memory = tile.pack(state.carry, 2)
        self._tally, tally = tile.pack(state.tally, 2)
        self._bodies, bodies = tile.pack(state.obstacles, 2)
        self._signals = [] if command is None else [tile.pack(command.pwm_us, 2)]
        number, three, four = tile.shape(), tile.shape(3), tile.shape(4)
        each = tile.shape(state.vehicles.thrust.shape[-1])
        broken = jax.ShapeDtypeStruct((), jnp.bool_)
        self._order = tile.layout(_Order(thrust_n=each, power_w=number), tile.robots)
        self._deed = tile.layout(_Deed(before_m=three, broken=broken), tile.robots)
        self._drift = tile.layout(_Drift(p=three, q=four, v=three), tile.obstacles)
        motion = _MotionSample(
            p=three,
            q=four,
            nu=tile.shape(6),
            current_mps=three,
            outcome=jax.ShapeDtypeStruct((), jnp.int32),
        )
        control = _ControlSample(pwm_us=each, target_m=three)
        obstacle = _ObstacleSample(obstacle_p=three, obstacle_q=four)
        self._said = tile.shelf(tile.layout(control, tile.robots), n_sample)
        self._moved = tile.shelf(tile.layout(motion, tile.robots), n_sample)
        self._seen = tile.shelf(tile.layout(obstacle, tile.obstacles), n_sample)
        # Written before it is read: it need not be filled.
        room = partial(_room, dtype=tile.dtype)
        self._start = _Arrays(
            robots=robots,
            memory=memory,
            tally=tally,
            order=room(self._order.size),
            deed=room(self._deed.size),
            said=room(self._said.size),
            moved=room(self._moved.size),
            bodies=bodies,
            track=room(AHEAD * self._drift.size if tile.some_obstacle else 1),
            seen=room(self._seen.size if tile.some_obstacle else 1),
        )

    def all_steps(self) -> tuple[WorldState, Sample]:
        """The state after all steps, and the samples."""
        groups = self._tile.groups
        # Functions of their own, so that each is traced and lowered once for all launches.
        acts = [
            (jax.jit(partial(self._control, g)), jax.jit(partial(self._move, g))) for g in groups
        ]
        judgements = [jax.jit(partial(self._judge, group)) for group in groups]
        go_ahead = jax.jit(self._go_ahead)

        def step(base: jax.Array, k: int, x: _Arrays) -> _Arrays:
            at = jnp.array([k], jnp.int32)
            if self._tile.some_obstacle and k % AHEAD == 0:
                bodies, track, seen = go_ahead(base, at, x)
                x = replace(x, bodies=bodies, track=track, seen=seen)
            for control, move in acts:
                memory, order, said = control(base, at, x)
                x = replace(x, memory=memory, order=order, said=said)
                robots, deed, moved = move(base, at, x)
                x = replace(x, robots=robots, deed=deed, moved=moved)
            for judge in judgements:
                (tally,) = judge(base, at, x)
                x = replace(x, tally=tally)
            return x

        def some(carry: tuple[jax.Array, _Arrays], _: None) -> tuple[Any, None]:
            base, x = carry
            for k in range(UNROLLED):
                x = step(base, k, x)
            return (base + UNROLLED, x), None

        chunks, rest = divmod(self._steps, UNROLLED)
        base, x = jnp.zeros(1, jnp.int32), self._start
        if chunks:
            (base, x), _ = jax.lax.scan(some, (base, x), length=chunks)
        for k in range(rest):
            x = step(base, k, x)
        return self._result(x)

    def _result(self, end: _Arrays) -> tuple[WorldState, Sample]:
        tile, state = self._tile, self._state
        of_robot, of_body = (tile.worlds, tile.robots), (tile.worlds, tile.obstacles)
        if tile.some_obstacle:
            seen = self._seen.unpack(end.seen)
        else:  # rows of padding stay where they are
            seen = _ObstacleSample(
                obstacle_p=_repeated(state.obstacles.p, self._samples),
                obstacle_q=_repeated(state.obstacles.q, self._samples),
            )
        after = WorldState(
            vehicles=self._vehicle.unpack(end.robots, of_robot),
            carry=self._memory.unpack(end.memory, of_robot),
            obstacles=self._bodies.unpack(end.bodies, of_body),
            tally=self._tally.unpack(end.tally, of_robot),
            step=state.step + self._steps,
        )
        said, moved = self._said.unpack(end.said), self._moved.unpack(end.moved)
        return after, Sample(**vars(said), **vars(moved), **vars(seen))

    def _control(
        self, group: Group, base: jax.Array, k: jax.Array, x: _Arrays
    ) -> Sequence[jax.Array]:
        """The controller of one control step, and its record."""
        tile = self._tile
        command = [data for _, data in self._signals]
        constant = [self._first, base, k, *tile.arrays, x.robots, *command]

        def kernel(*refs: Any) -> None:
            (_, base, k), data = refs[:3], refs[3:8]
            state, *signals = refs[8 : len(constant)]
            memory, order, said = refs[-3:]
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            constants = tile.robot(data, lane)
            carry, decision = lane_steps.control_robots(
                self._spec,
                tile.params(data, group, constants),
                constants.path,
                self._vehicle.read(triton.loader(state), lane),
                self._memory.read(triton.loader(memory), lane),
                self._signals[0][0].read(triton.loader(signals[0]), lane) if signals else None,
            )

            def write_record() -> None:
                sample = _ControlSample(pwm_us=decision.pwm_us, target_m=decision.target_m)
                self._said.write(store(said), count // self._every, row, at, sample)

            triton.when(count % self._every == 0, write_record)
            self._memory.write(store(memory), lane, carry)
            given = _Order(thrust_n=decision.thrust_n, power_w=decision.power_w)
            self._order.write(store(order), lane, given)

        return self._run(kernel, group.count, constant, [x.memory, x.order, x.said])

    def _move(self, group: Group, base: jax.Array, k: jax.Array, x: _Arrays) -> Sequence[jax.Array]:
        """The physics of one control step, and the record of its beginning."""
        tile = self._tile
        constant = [self._first, base, k, *tile.arrays, x.tally, x.order]

        def kernel(*refs: Any) -> None:
            (first, base, k), data, (tally, order) = refs[:3], refs[3:8], refs[8:10]
            state, deed, moved = refs[-3:]
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            params = tile.params(data, group, tile.robot(data, lane))
            current = tile.water(data, at).current
            before = self._vehicle.read(triton.loader(state), lane)
            outcome = self._tally.read(triton.loader(tally), lane).outcome
            t = self._time(first[0] + count)

            def write_record() -> None:
                sample = _MotionSample(
                    p=before.p,
                    q=before.q,
                    nu=before.nu,
                    current_mps=lane_steps.flow_at(current, before.p, t),
                    outcome=outcome,
                )
                self._moved.write(store(moved), count // self._every, row, at, sample)

            triton.when(count % self._every == 0, write_record)
            thrust = self._order.read(triton.loader(order), lane).thrust_n
            after, broken = lane_steps.move_robots(
                self._spec, params.vehicle, current, before, outcome, thrust, t
            )
            self._deed.write(store(deed), lane, _Deed(before_m=before.p, broken=broken))
            self._vehicle.write(store(state), lane, after)

        return self._run(kernel, group.count, constant, [x.robots, x.deed, x.moved])

    def _judge(
        self, group: Group, base: jax.Array, k: jax.Array, x: _Arrays
    ) -> Sequence[jax.Array]:
        """Detection and tally of one control step."""
        tile = self._tile
        constant = [self._first, base, k, *tile.arrays, x.robots, x.track, x.order, x.deed]

        def kernel(*refs: Any) -> None:
            (first, base, k), data, (state, track, order, deed) = refs[:3], refs[3:8], refs[8:12]
            tally = refs[-1]
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            constants = tile.robot(data, lane)
            done = self._deed.read(triton.loader(deed), lane)
            robots = [self._robots_met(data, state, at, other) for other in tile.groups]
            after = lane_steps.judge(
                self._spec,
                tile.grid,
                tile.params(data, group, constants).vehicle,
                constants.goal_m,
                tile.ground(data, tile.water(data, at), at),
                self._tally.read(triton.loader(tally), lane),
                done.before_m,
                self._vehicle.read(triton.loader(state), lane),
                self._order.read(triton.loader(order), lane).power_w,
                done.broken,
                self._obstacles_met(data, track, at, count),
                robots if tile.robots > 1 else [],
                row,
                self._time(first[0] + count),
            )
            self._tally.write(store(tally), lane, after)

        return self._run(kernel, group.count, constant, [x.tally])

    def _robots_met(self, data: Any, robots: Any, at: Any, other: Group) -> Others:
        """The robots of a group, as those of the same worlds meet them."""
        tile = self._tile

        def load(i: jax.Array) -> Met:
            place = (other.first + i) * tile.worlds + at
            state = partial(self._vehicle.read, triton.loader(robots), place)

            def details() -> Any:
                q, nu = state(lambda x: (x.q, x.nu))
                vehicle = tile.params_at(data, other, place).vehicle
                return vehicle, q, lane_steps.velocity(q, nu)

            reach = tile.params_at(data, other, place).vehicle.radius_m[()]
            return Met(p=state(lambda x: x.p), reach=reach, details=details)

        return Others(count=other.count, load=load, first=other.first)

    def _obstacles_met(self, data: Any, track: Any, at: Any, step: Any) -> Others:
        """The obstacles after a control step, as robots of the same worlds meet them."""
        tile = self._tile

        def load(i: jax.Array) -> Met:
            place = i * tile.worlds + at
            drift = partial(self._drift.read, triton.loader(track), self._ring(step) + place)

            def details() -> Any:
                return tile.body(data, place, lambda x: x.given), *drift(lambda x: (x.q, x.v))

            reach = tile.body(data, place, lambda x: x.reach)[()]
            return Met(p=drift(lambda x: x.p), reach=reach, details=details)

        return Others(count=tile.obstacles if tile.some_obstacle else 0, load=load)

    def _go_ahead(self, base: jax.Array, k: jax.Array, x: _Arrays) -> Sequence[jax.Array]:
        """`AHEAD` control steps of the obstacles, or those that are left, and their record."""
        tile = self._tile
        constant = [self._first, base, k, *tile.arrays]

        def kernel(*refs: Any) -> None:
            (first, base, k), data = refs[:3], refs[3:8]
            state, track, seen = refs[-3:]
            row, lane, at, store = self._place(0)
            count = base[0] + k[0]
            water = tile.water(data, at)
            given = tile.body(data, lane, lambda x: x.given)
            ground = tile.ground(data, water, at)

            def one(i: jax.Array, now: Any) -> Any:
                step = count + i

                def write_record() -> None:
                    sample = _ObstacleSample(obstacle_p=now.p, obstacle_q=now.q)
                    self._seen.write(store(seen), step // self._every, row, at, sample)

                is_left = step < self._steps
                triton.when(is_left & (step % self._every == 0), write_record)
                after = lane_steps.advance_obstacles(
                    self._spec,
                    tile.grid,
                    given,
                    now,
                    water.current,
                    ground,
                    self._time(first[0] + step),
                )
                there = _Drift(p=after.p, q=after.q, v=lane_steps.velocity(after.q, after.nu))
                self._drift.write(store(track), self._ring(step) + lane, there)
                return lanes.where(is_left, after, now)

            start = self._bodies.read(triton.loader(state), lane)
            self._bodies.write(store(state), lane, lanes.repeat(AHEAD, one, start))

        return self._run(kernel, tile.obstacles, constant, [x.bodies, x.track, x.seen])

    def _ring(self, step: Any) -> Any:
        """Where in the track a control step begins."""
        return step % AHEAD * self._drift.size

    def _run(
        self, kernel: Any, rows: int, constant: list[Any], changed: list[Any]
    ) -> Sequence[jax.Array]:
        """Run a kernel on ``rows`` x worlds."""
        engine = self._engine
        return triton.call(
            kernel,
            (self._tile.worlds // engine.lanes, rows),
            constant,
            changed,
            warps=engine.warps,
            interpret=engine.interpret,
        )

    def _place(self, first: int) -> tuple[Any, Any, Any, Any]:
        """Row, lanes and worlds of this program, and how its lanes are stored."""
        at, row = triton.place(self._engine.lanes)
        row = first + row
        return row, row * self._tile.worlds + at, at, partial(triton.storer, like=at)

    def _time(self, step: Any) -> jax.Array:
        """Time at the beginning of a control step."""
        t: jax.Array = step.astype(self._tile.dtype) * self._spec.control_dt_s
        return t


def _room(size: int, dtype: Any) -> jax.Array:
    """An array [size] that holds anything."""
    room: jax.Array = jax.lax.empty((size,), dtype)
    return room


def _repeated(values: jax.Array, times: int) -> jax.Array:
    """Arrays [W, ...] as samples [W, times, ...]."""
    return jnp.broadcast_to(values[:, None], (values.shape[0], times, *values.shape[1:]))
