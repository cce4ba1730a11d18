"""Outcome of a control period for every robot of one world, as the simulator itself judges it.

The phases of a control step (`angler_mjx.sim.step`) that follow the motion of the vehicles:
obstacles, and the judgement of each robot.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.sim import robot
from angler_mjx.sim.engines.mjx import SingleWorld, judge_world, measure_cargo
from angler_mjx.sim.phase import Record, run_phase
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import FleetWorld, SimSpec, WorldState
from angler_mjx.sim.step import OBSTACLES, MovedRobots, record_obstacles
from angler_sitl.scene.flat_arrays import Arrays, FlatLayout
from angler_sitl.scene.motion import (
    N_INPUTS,
    SINGLE_THREAD_OPTIONS,
    ContactBodies,
    SceneMotion,
    to_thruster_pwm,
)


@dataclass(frozen=True, kw_only=True)
class OutcomeJudge:
    """`judge_outcomes`, compiled for worlds of one shape, with few arrays in and out."""

    step: Callable[
        [Arrays, Arrays, np.ndarray, np.ndarray, NDArray[np.int32], NDArray[np.bool_]],
        tuple[Arrays, Arrays],
    ]
    """Compiled step.

    Constants, state, vehicles and bodies of `SceneMotion.extract_rows` and ``extract_bodies``,
    inputs of the last step, and the mask of robots on their last approach, to state and record."""
    world: FlatLayout[FleetWorld]
    state: FlatLayout[WorldState]
    record: FlatLayout[Record]
    """Layout of the record of the phases, by field; [1] leads there."""

    def pack_constants(self, world: FleetWorld) -> Arrays:
        """Return the constants of a world for the step; [1] leads there."""
        return self.world.pack_on_device(_remove_plans(world))

    def to_arrays(self, state: WorldState) -> Arrays:
        """Return a state in the form of the step; [1] leads there."""
        return self.state.pack_on_device(state)

    def from_arrays(self, state: Arrays) -> WorldState:
        """Invert `to_arrays`, with NumPy arrays."""
        return self.state.unpack(tuple(map(np.asarray, state)))


def compile_judge(
    spec: SimSpec, motion: SceneMotion, world: FleetWorld, state: WorldState
) -> OutcomeJudge:
    """Compile for worlds like this one.

    Args:
        spec: settings.
        motion: of the vehicles.
        world: [1] leads; another of the same scenario has the same shapes, but for its plans.
        state: [1] leads.
    """
    world_layout, state_layout = (
        FlatLayout.from_tree(_remove_plans(world)),
        FlatLayout.from_tree(state),
    )
    thrusters = world.control.vehicle.B.shape[-1]
    at_start = motion.to_arrays(state)
    example_rows, example_bodies = motion.extract_rows(at_start), motion.extract_bodies(at_start)

    records: list[FlatLayout[Record]] = []

    def step(
        world: Arrays,
        state: Arrays,
        vehicle_rows: jax.Array,
        flat_bodies: jax.Array,
        inputs: jax.Array,
        approaching: jax.Array,
    ) -> tuple[Arrays, Arrays]:
        # One world is not batched: batching makes tracing half as long again.
        judged, record = judge_outcomes(
            spec,
            jax.tree.map(lambda x: x[0], world_layout.unpack(world)),
            jax.tree.map(lambda x: x[0], state_layout.unpack(state)),
            jax.vmap(motion.vehicles.unpack_row)(vehicle_rows[:, 1:]),
            inputs[:, :thrusters],
            vehicle_rows[:, 0] > 0,
            approaching,
            motion.unpack_bodies(flat_bodies),
        )
        record = jax.tree.map(lambda x: x[None], record)
        records.append(FlatLayout.from_tree(record))
        return state_layout.pack(judged), records[-1].pack(record)

    inputs = jax.ShapeDtypeStruct((len(example_rows), N_INPUTS), jnp.int32)
    approaching = jax.ShapeDtypeStruct((len(example_rows),), jnp.bool_)
    lowered = jax.jit(step).lower(
        world_layout.array_specs,
        state_layout.array_specs,
        example_rows,
        example_bodies,
        inputs,
        approaching,
    )
    return OutcomeJudge(
        step=lowered.compile(SINGLE_THREAD_OPTIONS),
        world=world_layout,
        state=state_layout,
        record=records[-1],
    )


def _remove_plans(world: FleetWorld) -> FleetWorld:
    """Return a world [1] without its plans, whose types and lengths vary.

    The judgement needs only the mask of robots on the last approach.
    """
    robots, real = world.variant.shape, world.environment.start_m.dtype
    empty = Trajectory(
        time_s=as_leaf(np.zeros((*robots, 0), real)),
        position_m=as_leaf(np.zeros((*robots, 0, 3), real)),
        found=as_leaf(np.zeros(robots, bool)),
    )
    return replace(world, path=empty)


def judge_outcomes(
    spec: SimSpec,
    world: FleetWorld,
    state: WorldState,
    vehicles: VehicleState,
    pulses: jax.Array,
    broken: jax.Array,
    approaching: jax.Array,
    bodies: ContactBodies | None = None,
) -> tuple[WorldState, Record]:
    """Judge one world at the end of a control period.

    Args:
        spec: settings.
        world: its constants.
        state: at the beginning of the period.
        vehicles: [N] at its end.
        pulses: int32 [N, n_thruster] us, last pulses of the autopilots; for the energy.
        broken: bool [N] robots that diverged in the period.
        approaching: bool [N] robots on the last approach of their plans.
        bodies: what moved with the vehicles; None where the first touch ends an episode.

    Returns:
        The state at the end of the period, and the record of the phases.
    """
    before = state.vehicles
    t = state.step.astype(before.p.dtype) * spec.control_dt_s
    batch = SingleWorld(spec=spec, world=world, t=t)
    thruster_signals = to_thruster_pwm(pulses, before.p.dtype)
    _, power = batch.map_bodies(robot.thrust_and_power, world.control.vehicle, thruster_signals)
    moved = MovedRobots(
        vehicle=vehicles,
        memory=state.carry,
        tally=state.tally,
        before_m=before.p,
        power_w=power,
        broken=broken,
    )
    impacts, grips, finished = None, None, None
    if bodies is None:
        obstacles, record = run_phase(OBSTACLES, batch, state.obstacles)
    else:
        obstacles, record = bodies.obstacles, record_obstacles(state.obstacles)
        impacts, grips, finished = measure_cargo(batch, obstacles, bodies.grips, bodies.impacts)
    judgement = judge_world(
        batch, moved, obstacles, finished=finished, approach=approaching, impacts=impacts
    )
    after = replace(
        state,
        vehicles=vehicles,
        obstacles=obstacles,
        tally=judgement.tally,
        step=state.step + 1,
        grips=grips,
    )
    return after, record
