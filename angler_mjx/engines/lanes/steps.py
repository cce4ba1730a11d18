"""Control, motion and obstacles on lanes: every function here works on any number side by side.

The physics and the controller are those of one robot (`angler_kernels.lanes` turns them into
lanes). Where the lanes come from is not known here: from arrays, or from the memory of a kernel.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax

from angler_kernels import clearance, lanes
from angler_kernels.table import take
from angler_mjx.control.stack import Command, ControlParams, Memory
from angler_mjx.physics import step as physics
from angler_mjx.physics.closed_form import ClosedForm
from angler_mjx.physics.step import VehicleState, Water
from angler_mjx.sim import robot
from angler_mjx.sim.state import Belief, SimSpec
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.world import currents
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import Obstacles, ObstacleState
from angler_mjx.world.obstacles import motion as obstacle_motion

type Lanes = Any
"""A pytree whose leaves are object arrays of lanes, or tables."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Cells:
    """The static cells of a world, as the look-up of `clearance.neighbour_window` wants them."""

    neighbours: Any
    """int32 [m] flattened `clearance.cell_neighbours`."""
    origin_m: Any
    """[3]."""
    cell_m: Any
    """[]."""
    floor_z_m: Any
    """[]."""
    lo: Any
    """[3] lower corner of the region, m."""
    hi: Any
    """[3] upper corner."""


type Shape = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What a controller decides."""

    pwm_us: Lanes
    target_m: Lanes
    thrust_n: Lanes
    power_w: Lanes


def control_robots(
    spec: SimSpec,
    params: ControlParams,
    vehicle: VehicleState | Belief,
    carry: Memory,
    command: Command,
    flow: Lanes | None,
) -> tuple[Memory, Decision]:
    """The controllers' part of a control step.

    Args:
        spec: settings.
        params: of the robots.
        vehicle: state, or what is believed of it.
        carry: memory of the controllers.
        command: to the controllers: the robots' paths, or what drives them instead.
        flow: velocity [3] of the water where the robots are, if the controllers want it.
    """
    carry, target, pwm = lanes.apply(
        partial(robot.decide, spec), params, carry, vehicle, command, flow
    )
    settled, power = lanes.apply(robot.thrust_and_power, params.vehicle, pwm)
    return carry, Decision(pwm_us=pwm.pwm_us, target_m=target, thrust_n=settled, power_w=power)


def move_robots(
    spec: SimSpec,
    params: VehicleParams,
    current: Current,
    vehicle: VehicleState,
    outcome: Lanes,
    thrust_n: Lanes,
    t: jax.Array,
) -> tuple[VehicleState, Lanes]:
    """The physics of a control step.

    Args:
        spec: settings.
        params: of the robots.
        current: of their worlds.
        vehicle: state.
        outcome: int32 before the step.
        thrust_n: [n_thruster] what the thrusters settle at.
        t: [] s.

    Returns:
        The state one control period later, and which robots diverged.
    """

    def one(i: jax.Array, state: VehicleState) -> Any:
        now = t + i.astype(t.dtype) * spec.physics_dt_s
        step = partial(physics_step, spec.physics_dt_s, spec.water)
        return lanes.apply(step, params, state, thrust_n, current, now)

    after = lanes.repeat(spec.physics_steps, one, vehicle)
    held, broken = lanes.apply(robot.hold_if_ended, outcome, vehicle, after)
    return held, broken


def flow_at(current: Current, p: Lanes, t: jax.Array) -> Lanes:
    """Velocity [3] of the water at points."""
    return lanes.apply(currents.velocity, current, p, t)


def physics_step(
    dt_s: float,
    water: Water,
    vehicle: VehicleParams,
    state: VehicleState,
    settled: jax.Array,
    current: Current,
    t: jax.Array,
) -> VehicleState:
    """One physics step of one robot in closed form."""
    engine = ClosedForm(gravity_mps2=water.gravity_mps2)
    return physics.step(engine, vehicle, vehicle, state, settled, current, t, dt_s, water)


def advance_obstacles(
    spec: SimSpec,
    shape: Shape,
    body: Obstacles,
    state: ObstacleState,
    current: Current,
    cells: Cells,
    t: jax.Array,
) -> Any:
    """One control step of obstacles.

    Args:
        spec: settings.
        shape: of the grid.
        body: what they are.
        state: of them.
        current: of their worlds.
        cells: of their worlds.
        t: [] s.
    """

    def one(
        body: Obstacles, now: ObstacleState, current: Current, cells: Cells, t: jax.Array
    ) -> ObstacleState:
        return obstacle_motion.advance(
            body,
            now,
            current,
            t,
            spec.control_dt_s,
            cells.lo,
            cells.hi,
            partial(_nearest_cell, shape, cells),
            spec.water.density_kgpm3,
            spec.water.gravity_mps2,
        )

    return lanes.apply(one, body, state, current, cells, t)


def _nearest_cell(shape: Shape, cells: Cells, p: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Distance [] of a point [3] to the cells of one world and the direction [3] away."""
    index, lo = clearance.neighbour_window(p, cells.origin_m, cells.cell_m, shape)
    return clearance.point_neighbours(p, lo, take(cells.neighbours, index), cells.cell_m)
