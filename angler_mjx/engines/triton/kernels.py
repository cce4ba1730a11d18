"""The kernels of the fused engine: controller, motion, detection, and obstacles ahead of them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax

from angler_kernels import lanes
from angler_mjx.control import stack
from angler_mjx.engines.lanes import judge as lane_judge
from angler_mjx.engines.lanes import steps as lane_steps
from angler_mjx.engines.lanes.search import Met, Others
from angler_mjx.engines.triton import launch as triton
from angler_mjx.engines.triton.segment import (
    AHEAD,
    Arrays,
    ControlSample,
    Deed,
    Drift,
    MotionSample,
    ObstacleSample,
    Order,
    Segment,
)
from angler_mjx.sim.fleet import Group
from angler_mjx.sim.state import SimSpec

type Launch = Callable[[jax.Array, jax.Array, Arrays], Arrays]
"""What is done in control step ``base + k``."""


class Kernels:
    """The four kernels for one segment, each as one launch of it.

    Every launch is for control step ``base + k``, both int32 [1], counted from the segment's first.
    """

    def __init__(self, program: triton.Program, spec: SimSpec, part: Segment) -> None:
        """Bind them to a segment."""
        self._program, self._spec, self._part, self._tile = program, spec, part, part.tile

    def launches(self) -> tuple[Launch, Launch]:
        """The obstacles, `AHEAD` control steps of them, and what the robots do in one."""
        groups = self._tile.groups
        # Functions of their own, so that each is traced and lowered once for all launches.
        acts = [(jax.jit(partial(self.control, g)), jax.jit(partial(self.move, g))) for g in groups]
        judgements = [jax.jit(partial(self.judge, group)) for group in groups]
        go_ahead = jax.jit(self.go_ahead)

        def obstacles(base: jax.Array, at: jax.Array, x: Arrays) -> Arrays:
            if not self._tile.some_obstacle:
                return x
            bodies, track, seen = go_ahead(base, at, x)
            return replace(x, bodies=bodies, track=track, seen=seen)

        def robots(base: jax.Array, at: jax.Array, x: Arrays) -> Arrays:
            for control, move in acts:
                memory, order, said = control(base, at, x)
                x = replace(x, memory=memory, order=order, said=said)
                robots, deed, moved = move(base, at, x)
                x = replace(x, robots=robots, deed=deed, moved=moved)
            for judge in judgements:
                (tally,) = judge(base, at, x)
                x = replace(x, tally=tally)
            return x

        return obstacles, robots

    def control(
        self, group: Group, base: jax.Array, k: jax.Array, x: Arrays
    ) -> Sequence[jax.Array]:
        """The controllers of one control step, and their record."""
        tile = self._tile
        command = [data for _, data in self._part.command]
        own = x.robots if x.known is None else x.known
        layout = self._part.vehicle if self._part.known is None else self._part.known
        constant = [self._part.first, base, k, *tile.arrays, own, *command]

        def kernel(*refs: Any) -> None:
            (first, base, k), data = refs[:3], refs[3:8]
            state, *given = refs[8 : len(constant)]
            memory, order, said = refs[-3:]
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            constants = tile.robot(data, lane)
            vehicle = layout.read(triton.loader(state), lane)
            told, flow = constants.path, None
            if given:
                told = self._part.command[0][0].read(triton.loader(given[0]), lane)
            if self._part.known is not None:
                flow = vehicle.flow
            elif stack.wants_flow(self._spec.stages):
                current = tile.water(data, at).current
                flow = lane_steps.flow_at(current, vehicle.p, self._time(first[0] + count))
            carry, decision = lane_steps.control_robots(
                self._spec,
                tile.params(data, group, constants),
                vehicle,
                self._part.memory.read(triton.loader(memory), lane),
                told,
                flow,
            )

            def write_record() -> None:
                sample = ControlSample(pwm_us=decision.pwm_us, target_m=decision.target_m)
                self._part.said.write(store(said), count // self._part.every, row, at, sample)

            triton.when(count % self._part.every == 0, write_record)
            self._part.memory.write(store(memory), lane, carry)
            settled = Order(thrust_n=decision.thrust_n, power_w=decision.power_w)
            self._part.order.write(store(order), lane, settled)

        return self._run(kernel, group.count, constant, [x.memory, x.order, x.said])

    def move(self, group: Group, base: jax.Array, k: jax.Array, x: Arrays) -> Sequence[jax.Array]:
        """The physics of one control step, and the record of its beginning."""
        tile = self._tile
        constant = [self._part.first, base, k, *tile.arrays, x.tally, x.order]

        def kernel(*refs: Any) -> None:
            (first, base, k), data, (tally, order) = refs[:3], refs[3:8], refs[8:10]
            state, deed, moved = refs[-3:]
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            params = tile.params(data, group, tile.robot(data, lane))
            current = tile.water(data, at).current
            before = self._part.vehicle.read(triton.loader(state), lane)
            outcome = self._part.tally.read(triton.loader(tally), lane).outcome
            t = self._time(first[0] + count)

            def write_record() -> None:
                sample = MotionSample(
                    p=before.p,
                    q=before.q,
                    nu=before.nu,
                    current_mps=lane_steps.flow_at(current, before.p, t),
                    outcome=outcome,
                )
                self._part.moved.write(store(moved), count // self._part.every, row, at, sample)

            triton.when(count % self._part.every == 0, write_record)
            thrust = self._part.order.read(triton.loader(order), lane).thrust_n
            after, broken = lane_steps.move_robots(
                self._spec, params.vehicle, current, before, outcome, thrust, t
            )
            self._part.deed.write(store(deed), lane, Deed(before_m=before.p, broken=broken))
            self._part.vehicle.write(store(state), lane, after)

        return self._run(kernel, group.count, constant, [x.robots, x.deed, x.moved])

    def judge(self, group: Group, base: jax.Array, k: jax.Array, x: Arrays) -> Sequence[jax.Array]:
        """Detection and tally of one control step."""
        tile = self._tile
        constant = [self._part.first, base, k, *tile.arrays, x.robots, x.track, x.order, x.deed]

        def kernel(*refs: Any) -> None:
            (first, base, k), data, (state, track, order, deed) = refs[:3], refs[3:8], refs[8:12]
            tally = refs[-1]
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            constants = tile.robot(data, lane)
            done = self._part.deed.read(triton.loader(deed), lane)
            robots = [self._robots_met(data, state, at, other) for other in tile.groups]
            after = lane_judge.judge(
                self._spec,
                tile.grid,
                tile.params(data, group, constants).vehicle,
                constants.goal_m,
                tile.ground(data, tile.water(data, at), at),
                self._part.tally.read(triton.loader(tally), lane),
                done.before_m,
                self._part.vehicle.read(triton.loader(state), lane),
                self._part.order.read(triton.loader(order), lane).power_w,
                done.broken,
                self._obstacles_met(data, track, at, count),
                robots if tile.robots > 1 else [],
                row,
                self._time(first[0] + count),
            )
            self._part.tally.write(store(tally), lane, after)

        return self._run(kernel, group.count, constant, [x.tally])

    def _robots_met(self, data: Any, robots: Any, at: Any, other: Group) -> Others:
        """The robots of a group, as those of the same worlds meet them."""
        tile = self._tile

        def load(i: jax.Array) -> Met:
            place = (other.first + i) * tile.worlds + at
            state = partial(self._part.vehicle.read, triton.loader(robots), place)

            def details() -> Any:
                q, nu = state(lambda x: (x.q, x.nu))
                vehicle = tile.params_at(data, other, place).vehicle
                return vehicle, q, lane_judge.velocity(q, nu)

            reach = tile.params_at(data, other, place).vehicle.radius_m[()]
            return Met(p=state(lambda x: x.p), reach=reach, details=details)

        return Others(count=other.count, load=load, first=other.first)

    def _obstacles_met(self, data: Any, track: Any, at: Any, step: Any) -> Others:
        """The obstacles after a control step, as robots of the same worlds meet them."""
        tile = self._tile

        def load(i: jax.Array) -> Met:
            place = i * tile.worlds + at
            drift = partial(self._part.drift.read, triton.loader(track), self._ring(step) + place)

            def details() -> Any:
                return tile.body(data, place, lambda x: x.given), *drift(lambda x: (x.q, x.v))

            reach = tile.body(data, place, lambda x: x.reach)[()]
            return Met(p=drift(lambda x: x.p), reach=reach, details=details)

        return Others(count=tile.obstacles if tile.some_obstacle else 0, load=load)

    def go_ahead(self, base: jax.Array, k: jax.Array, x: Arrays) -> Sequence[jax.Array]:
        """`AHEAD` control steps of the obstacles, or those that are left, and their record."""
        tile = self._tile
        constant = [self._part.first, base, k, *tile.arrays]

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
                    sample = ObstacleSample(obstacle_p=now.p, obstacle_q=now.q)
                    self._part.seen.write(store(seen), step // self._part.every, row, at, sample)

                is_left = step < self._part.steps
                triton.when(is_left & (step % self._part.every == 0), write_record)
                after = lane_steps.advance_obstacles(
                    self._spec,
                    tile.grid,
                    given,
                    now,
                    water.current,
                    ground,
                    self._time(first[0] + step),
                )
                there = Drift(p=after.p, q=after.q, v=lane_judge.velocity(after.q, after.nu))
                self._part.drift.write(store(track), self._ring(step) + lane, there)
                return lanes.where(is_left, after, now)

            start = self._part.bodies.read(triton.loader(state), lane)
            self._part.bodies.write(store(state), lane, lanes.repeat(AHEAD, one, start))

        return self._run(kernel, tile.obstacles, constant, [x.bodies, x.track, x.seen])

    def _ring(self, step: Any) -> Any:
        """Where in the track a control step begins."""
        return step % AHEAD * self._part.drift.size

    def _run(
        self, kernel: Any, rows: int, constant: list[Any], changed: list[Any]
    ) -> Sequence[jax.Array]:
        """Run a kernel on ``rows`` x worlds."""
        return triton.call(kernel, self._program, self._tile.worlds, rows, constant, changed)

    def _place(self, first: int) -> tuple[Any, Any, Any, Any]:
        """Row, lanes and worlds of this program, and how its lanes are stored."""
        at, row = triton.place(self._program.lanes)
        row = first + row
        return row, row * self._tile.worlds + at, at, partial(triton.storer, like=at)

    def _time(self, step: Any) -> jax.Array:
        """Time at the beginning of a control step."""
        t: jax.Array = step.astype(self._tile.dtype) * self._spec.control_dt_s
        return t
