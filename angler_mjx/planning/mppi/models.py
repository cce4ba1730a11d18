"""Response of a robot to commanded velocities, in samples; two models of one step.

`ThrusterLag` takes the velocity loop of the controllers as a lag of first order, towards the
velocity that thrust can hold in the current. `ForceModel` computes the forces of thrusters, within
their limits, and moves the robot by its mass, added mass, drag and net weight.
"""

from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp

from angler_mjx.planning.mppi import drag
from angler_mjx.planning.mppi.drag import DragHull


class RobotModel(Protocol):
    """Of one robot."""

    def step(
        self, v: jax.Array, target_mps: jax.Array, flow: jax.Array, dt_s: float
    ) -> tuple[jax.Array, jax.Array]:
        """Advance samples by one step.

        Args:
            v: [3, S] velocities over ground, in W.
            target_mps: [3, S] velocities over ground to have, in W.
            flow: [3] velocity of the water, in W.
            dt_s: of the step.

        Returns:
            Velocities [3, S] after it, and power [S] over that of cruising.
        """
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ThrusterLag:
    """The velocity loop as a lag of first order."""

    hull: DragHull
    response_s: jax.Array | float

    def step(
        self, v: jax.Array, target_mps: jax.Array, flow: jax.Array, dt_s: float
    ) -> tuple[jax.Array, jax.Array]:
        """See `RobotModel.step`; the power is that of holding the velocity."""
        stream = flow[:, None]
        velocity_through_water = drag.limit_velocity(
            self.hull, drag.to_body(self.hull, target_mps - stream)
        )
        reachable_mps = stream + drag.to_world(self.hull, velocity_through_water)
        force = drag.drag_coefficient(
            self.hull, velocity_through_water
        ) * velocity_through_water - drag.lift_force(self.hull)
        _, thrust = drag.allocate_thrust(self.hull, force)
        decay = jnp.exp(-dt_s / self.response_s)
        return reachable_mps + (v - reachable_mps) * decay, drag.relative_power(self.hull, thrust)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ForceModel:
    """Thrusters' forces on a mass in water; heading and attitude are held, whatever that takes."""

    hull: DragHull
    response_s: jax.Array | float

    def step(
        self, v: jax.Array, target_mps: jax.Array, flow: jax.Array, dt_s: float
    ) -> tuple[jax.Array, jax.Array]:
        """See `RobotModel.step`.

        The force follows the commanded velocity as a lag would. Drag is taken at the end of
        the step, by its slope at the beginning: within limits the velocity then is that of the lag.
        """
        hull = self.hull
        velocity_through_water = drag.to_body(hull, v - flow[:, None])
        gain = (1.0 - jnp.exp(-dt_s / self.response_s)) / dt_s
        acceleration_mps2 = drag.to_body(hull, target_mps - v) * gain
        damping = drag.drag_coefficient(hull, velocity_through_water)
        inertia = hull.inertia_kg[:, None]
        lift = drag.lift_force(hull)
        force = (
            inertia * acceleration_mps2
            + damping * (velocity_through_water + dt_s * acceleration_mps2)
            - lift
        )
        achieved_n, thrust = drag.allocate_thrust(hull, force)
        next_through_water = (inertia * velocity_through_water + dt_s * (achieved_n + lift)) / (
            inertia + dt_s * damping
        )
        return flow[:, None] + drag.to_world(hull, next_through_water), drag.relative_power(
            hull, thrust
        )
