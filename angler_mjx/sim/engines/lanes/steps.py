"""The phases of a control step on lanes: every function here works on any number side by side.

The physics and the controllers are those of one robot (`angler_kernels.lanes` turns them into
lanes). Where the lanes come from is not known here: from arrays, or from the memory of a kernel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

from angler_kernels import clearance, lanes
from angler_kernels.table import take_row
from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.sim.state import SimSpec
from angler_mjx.world import currents
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import Obstacles, ObstacleState
from angler_mjx.world.obstacles import motion as obstacle_motion

type Lanes = jax.Array | np.ndarray
"""An array of one body as an object array of lanes; fields of states and parameters, arrays by
their type, hold these on lanes."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Cells:
    """The static cells of a world, as the look-up of `clearance.neighbour_window` wants them."""

    neighbours: Any
    """int32 [m] flattened `clearance.cell_neighbours`."""
    origin_m: jax.Array
    """[3]."""
    cell_m: jax.Array
    """[]."""
    floor_z_m: jax.Array
    """[]."""
    lo: jax.Array
    """[3] lower corner of the region, m."""
    hi: jax.Array
    """[3] upper corner."""


type GridShape = tuple[int, int, int]


class LaneBatch:
    """Bodies on lanes; a `angler_mjx.sim.phase.BodyBatch`.

    ``current``, ``cells`` and ``obstacles`` are for batches of obstacles.
    """

    spec: SimSpec
    t: jax.Array
    shape: GridShape
    """Of the grid."""

    @property
    def current(self) -> Current:
        """Of their worlds."""
        raise NotImplementedError

    @property
    def cells(self) -> Cells:
        """Of their worlds."""
        raise NotImplementedError

    @property
    def obstacles(self) -> Obstacles:
        """What they are."""
        raise NotImplementedError

    def flow(self, current: Current, vehicle: VehicleState) -> jax.Array:
        """See `phase.BodyBatch`."""
        return lanes.apply(currents.velocity, current, vehicle.p, self.t)

    def map_bodies[T](
        self, function: Callable[..., T], *bodies: object, shared: tuple[object, ...] = ()
    ) -> T:
        """See `phase.BodyBatch`.

        Raises:
            ConfigError: the function uses an operation of JAX that lanes have no rule for.
        """
        try:
            return lanes.apply(function, *bodies, *shared)
        except lanes.UnsupportedOperationError as error:
            source = error.source or "a control law"
            raise ConfigError(
                f"{source}: the fused engine has no rule for {error.operation}; take engine = "
                '"mjx" (--engine mjx), or the operations that CONTRIBUTING.md lists for control '
                "laws"
            ) from error

    def repeat[T](self, times: int, body: Callable[[jax.Array, T], T], tree: T) -> T:
        """See `phase.BodyBatch`."""
        return lanes.repeat(times, body, tree)

    def physics_step(
        self,
        params: ControlParams,
        vehicle: VehicleState,
        thrust_n: jax.Array,
        current: Current,
        t: jax.Array,
        joints: JointMotion | None,
    ) -> VehicleState:
        """See `phase.BodyBatch`; robots on lanes have no joints."""
        del joints
        step = partial(physics_step, self.spec.physics_dt_s, self.spec.water)
        return lanes.apply(step, params.vehicle, vehicle, thrust_n, current, t)

    def advance(self, obstacles: ObstacleState) -> ObstacleState:
        """See `phase.BodyBatch`."""
        return advance_obstacles(
            self.spec, self.shape, self.obstacles, obstacles, self.current, self.cells, self.t
        )


def physics_step(
    dt_s: float,
    water: Water,
    vehicle: VehicleParams,
    state: VehicleState,
    settled: jax.Array,
    current: Current,
    t: jax.Array,
) -> VehicleState:
    """One physics step of one rigid robot in closed form.

    Raises:
        UnsupportedError: the robot has joints.
    """
    refuse_joints(vehicle)
    engine = ClosedForm(gravity_mps2=water.gravity_mps2)
    return physics.step(engine, vehicle, vehicle, state, settled, current, t, dt_s, water)


def refuse_joints(vehicle: VehicleParams) -> None:
    """Refuse vehicles with joints, which lanes do not fly.

    Raises:
        UnsupportedError: a vehicle has links or joints.
    """
    if vehicle.links is not None:
        raise UnsupportedError(
            'engine = "fused" flies rigid vehicles, and a vehicle of this fleet has joints; use '
            'engine = "mjx"'
        )


def advance_obstacles(
    spec: SimSpec,
    shape: GridShape,
    body: Obstacles,
    state: ObstacleState,
    current: Current,
    cells: Cells,
    t: jax.Array,
) -> ObstacleState:
    """Move obstacles on by a control step.

    Args:
        spec: settings.
        shape: of the grid.
        body: what they are.
        state: of them.
        current: of their worlds.
        cells: of their worlds.
        t: [] s.
    """

    def advance_body(
        body: Obstacles, now: ObstacleState, current: Current, cells: Cells, t: jax.Array
    ) -> ObstacleState:
        return obstacle_motion.advance_obstacle(
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

    return lanes.apply(advance_body, body, state, current, cells, t)


def _nearest_cell(shape: GridShape, cells: Cells, p: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Distance [] of a point [3] to the cells of one world and the direction [3] away."""
    index, lo = clearance.neighbour_window(p, cells.origin_m, cells.cell_m, shape)
    return clearance.point_neighbours(p, lo, take_row(cells.neighbours, index), cells.cell_m)
