"""The fused engine in plain JAX: one array for every field, robots x worlds, in one loop.

Same equations, discretisation and random numbers as the mjx engine, with the closed form of a
rigid body in place of MJX. Lanes are [R, W] for robots, [n_obstacle, W] for obstacles and [W] for
worlds, so the worlds lie side by side in memory.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_mjx.control import stack
from angler_mjx.control.stack import Command
from angler_mjx.engines.lanes import judge as lane_judge
from angler_mjx.engines.lanes import pairs as pair_search
from angler_mjx.engines.lanes import steps as lane_steps
from angler_mjx.engines.lanes.layout import (
    Given,
    Moving,
    Robots,
    Scene,
    moving_of,
    of_group,
    scene_of,
    side_by_side,
    spread_out,
    to_arrays,
    to_lanes,
    vehicles_of,
    world_state,
)
from angler_mjx.engines.lanes.search import Met, Others
from angler_mjx.physics.closed_form import ClosedForm
from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import episode, senses
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import Belief, Sample, SimSpec, World, WorldState
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.world.obstacles import Obstacles, ObstacleState


class FusedEngine:
    """Closed-form rigid bodies on lanes, in plain JAX."""

    def reset(self, spec: SimSpec, fleet: Fleet, worlds: World) -> WorldState:
        """See `Engine.reset`."""
        one = partial(episode.reset, spec, ClosedForm(gravity_mps2=spec.water.gravity_mps2))
        state: WorldState = jax.vmap(one)(worlds.control.vehicle, worlds)
        return state

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: Command | None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        scene, number = scene_of(fleet, worlds), state.step[0]
        sensed, belief = state.senses, None
        if spec.crews:
            sensed, belief = senses.step_tile(spec, worlds, sensed, number, state.vehicles)
        moving = moving_of(fleet, state)
        after, sample = _control_step(spec, scene, moving, number, command, belief)
        seen: Sample = replace(to_arrays(sample, 2), belief=belief)
        return world_state(after, state.step + 1, sensed), seen

    def segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        *,
        n_sample: int,
        steps_per_sample: int,
        command: Command | None = None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        scene = scene_of(fleet, worlds)
        row, rebuild = lanes.flatten(moving_of(fleet, state))
        rebuilds: list[Any] = []

        @jax.jit  # traced once, for the types of its results and for the loop
        def step(row: list[jax.Array], sensed: Any, number: jax.Array) -> tuple[Any, Any, Any]:
            moving, belief = rebuild(row), None
            if spec.crews:
                there = vehicles_of(moving)
                sensed, belief = senses.step_tile(spec, worlds, sensed, number, there)
            after, sample = _control_step(spec, scene, moving, number, command, belief)
            now, again = lanes.flatten(sample)
            rebuilds.append(again)
            both = zip(lanes.flatten(after)[0], row, strict=True)
            return [lanes.spread(x, old) for x, old in both], sensed, (now, belief)

        template = jax.eval_shape(step, row, state.senses, state.step[0])[2]
        nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), template)

        def one(carry: Any, i: jax.Array) -> tuple[Any, None]:
            row, sensed, kept, number = carry
            row, sensed, now = step(row, sensed, number)
            kept = jax.tree.map(lambda new, old: jnp.where(i == 0, new, old), now, kept)
            return (row, sensed, kept, number + 1), None

        def recorded(carry: Any, _: None) -> tuple[Any, Any]:
            row, sensed, step = carry
            (row, sensed, kept, step), _ = jax.lax.scan(
                one, (row, sensed, nothing, step), jnp.arange(steps_per_sample)
            )
            return (row, sensed, step), kept

        start = (row, state.senses, state.step[0])
        (row, sensed, _), (kept, belief) = jax.lax.scan(recorded, start, length=n_sample)
        after = world_state(rebuild(row), state.step + n_sample * steps_per_sample, sensed)
        belief = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), belief)
        seen: Sample = replace(to_arrays(rebuilds[0](kept), 3), belief=belief)
        return after, seen


def _control_step(
    spec: SimSpec,
    scene: Scene,
    moving: Moving,
    step: jax.Array,
    command: Command | None,
    belief: Belief | None,
) -> tuple[Moving, Sample]:
    """One control step of all worlds.

    ``command`` [W, R, ...] stands in for the paths, ``belief`` [W, R, ...] for what the controllers
    know.
    """
    like = moving.groups[0].vehicle.p[0]
    t = jnp.asarray(step, like.dtype) * spec.control_dt_s
    moved, samples = [], []
    for given, robots in zip(scene.groups, moving.groups, strict=True):
        with jax.named_scope("robots"):
            after, said = lanes.shared(
                partial(_advance, spec, scene, given, robots, t, command, belief)
            )
        moved.append(after)
        samples.append(said)
    obstacles = moving.obstacles
    if scene.n_obstacle > 0:
        with jax.named_scope("obstacles"):
            obstacles = lanes.shared(
                partial(
                    lane_steps.advance_obstacles,
                    spec,
                    scene.shape,
                    scene.obstacles,
                    obstacles,
                    scene.current,
                    scene.cells,
                    t,
                )
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
            tally = lanes.shared(
                partial(
                    lane_judge.judge,
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
                    pair_search.among_listed,
                )
            )
        groups.append(Robots(vehicle=vehicle, carry=carry, tally=tally))
    sample = Sample(
        **side_by_side(samples),
        obstacle_p=moving.obstacles.p,
        obstacle_q=moving.obstacles.q,
    )
    return Moving(groups=tuple(groups), obstacles=obstacles), sample


def _advance(
    spec: SimSpec,
    scene: Scene,
    given: Given,
    robots: Robots,
    t: jax.Array,
    command: Command | None,
    belief: Belief | None,
) -> tuple[Any, dict[str, Any]]:
    """Controller and physics of a group: what it comes to, and its part of the sample."""
    before, outcome = robots.vehicle, robots.tally.outcome
    told = given.path if command is None else to_lanes(of_group(command, given.group), 2)
    flow = lane_steps.flow_at(scene.current, before.p, t)
    known, felt = before, flow if stack.wants_flow(spec.stages) else None
    if belief is not None:
        known = to_lanes(of_group(belief, given.group), 2)
        felt = known.flow
    carry, decision = lane_steps.control_robots(
        spec,
        given.params,
        known,
        robots.carry,
        told,
        felt,
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
        "current_mps": flow,
        "outcome": outcome,
    }
    like = before.p[0]
    spread = {name: spread_out(leaf, like) for name, leaf in sample.items()}
    # What a controller sets to a number is one number for all lanes.
    carry = jax.tree.map(lambda leaf: spread_out(leaf, like), carry)
    return (vehicle, carry, decision.power_w, broken), spread


def _met_robot(params: VehicleParams, state: VehicleState, index: Any) -> Met:
    """Robots of a group, at an index of lanes [n, W]."""
    vehicle, now = pair_search.pick((params, state), index)
    return Met(
        p=now.p,
        reach=vehicle.radius_m[()],
        details=lambda: (vehicle, now.q, lane_judge.velocity(now.q, now.nu)),
    )


def _met_obstacle(obstacles: Obstacles, reach: jax.Array, state: ObstacleState, index: Any) -> Met:
    """Obstacles, at an index of lanes [n, W]."""
    body, radius, now = pair_search.pick((obstacles, lanes.pack([reach], ()), state), index)
    return Met(
        p=now.p,
        reach=radius[()],
        details=lambda: (body, now.q, lane_judge.velocity(now.q, now.nu)),
    )
