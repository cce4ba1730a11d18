"""How a robot answers the velocities that it is asked for, in samples; two models of one step.

`ThrusterLag` takes the velocity loop of the controllers as a lag of first order, towards the
velocity that thrust can hold in the current. `Forces` works out the forces of thrusters, within
their limits, and moves the robot by its mass, added mass, drag and net weight.
"""

from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp

from angler_mjx.planning.mppi import drag
from angler_mjx.planning.mppi.drag import DragHull


class Model(Protocol):
    """Of one robot."""

    def step(
        self, v: jax.Array, asked: jax.Array, flow: jax.Array, dt_s: float
    ) -> tuple[jax.Array, jax.Array]:
        """One step of samples.

        Args:
            v: [3, S] velocities over ground, in W.
            asked: [3, S] velocities over ground to have, in W.
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
        self, v: jax.Array, asked: jax.Array, flow: jax.Array, dt_s: float
    ) -> tuple[jax.Array, jax.Array]:
        """See `Model.step`; the power is that of holding the velocity."""
        stream = flow[:, None]
        through = drag.reachable(self.hull, drag.to_body(self.hull, asked - stream))
        held = stream + drag.to_world(self.hull, through)
        force = drag.resistance(self.hull, through) * through - drag.lift(self.hull)
        _, thrust = drag.thrusts(self.hull, force)
        keep = jnp.exp(-dt_s / self.response_s)
        return held + (v - held) * keep, drag.power(self.hull, thrust)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Forces:
    """Thrusters' forces on a mass in water; heading and attitude are held, whatever that takes."""

    hull: DragHull
    response_s: jax.Array | float

    def step(
        self, v: jax.Array, asked: jax.Array, flow: jax.Array, dt_s: float
    ) -> tuple[jax.Array, jax.Array]:
        """See `Model.step`.

        The force is what takes up the asked velocity as a lag would. Drag is taken at the end of
        the step, by its slope at the beginning: within limits the velocity then is that of the lag.
        """
        hull = self.hull
        through = drag.to_body(hull, v - flow[:, None])
        gain = (1.0 - jnp.exp(-dt_s / self.response_s)) / dt_s
        wanted = drag.to_body(hull, asked - v) * gain
        damping = drag.resistance(hull, through)
        inertia = hull.inertia_kg[:, None]
        lift = drag.lift(hull)
        force = inertia * wanted + damping * (through + dt_s * wanted) - lift
        given, thrust = drag.thrusts(hull, force)
        after = (inertia * through + dt_s * (given + lift)) / (inertia + dt_s * damping)
        return flow[:, None] + drag.to_world(hull, after), drag.power(hull, thrust)
