"""External navigation: motion estimates that an autopilot receives from outside.

By default they are the truth; where a scenario's fleet has instruments and filters of its own
(`angler_mjx.robot.sensing`), they are the filters' estimates, with their spread. SITL adds its own
noise to gyroscopes and accelerometers in either case, but none to external navigation.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.frames import quaternion_enu_to_ned, vector_enu_to_ned
from angler_mjx.runs.session.interface import Floats
from angler_mjx.runs.session.state_view import rotate_vectors
from angler_mjx.sim import sensing
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import FleetWorld, SensingMemory, SimSpec
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering.autopilot_commander import NavigationFix

type InstrumentMemory = tuple[SensingMemory | None, ...]


class Navigation:
    """Navigation systems of all robots of a scene."""

    def __init__(self, scene: AutopilotScene, spec: SimSpec) -> None:
        """Create the systems; nothing is compiled where robots receive the truth."""
        self._scene, self._spec = scene, spec
        self._sense = jax.jit(partial(_step_sensing, spec))
        self._begin = jax.jit(partial(_reset_sensing, spec))
        self.reset()

    def reset(self) -> None:
        """Switch the instruments on, at the vehicles' starts."""
        scene, self._measurement_count = self._scene, 0
        self._memory: InstrumentMemory = (
            self._begin(scene.worlds, scene.state.vehicles) if self._spec.instrumented else ()
        )

    def build_fixes(self) -> list[NavigationFix]:
        """Return the current navigation fix of each robot; once in a control period."""
        if not self._spec.instrumented:
            states = self._scene.states
            zeros = np.zeros_like(states.p_ned)
            values: tuple[Floats, ...]
            values = (states.p_ned, states.q, states.v_ned, zeros, zeros, zeros)
        else:
            values = self._estimate_motion()
        return [
            NavigationFix(
                p=p,
                q=q,
                velocity_mps=velocity,
                position_std_m=position_std,
                velocity_std_mps=velocity_std,
                attitude_std_rad=attitude_std,
            )
            for p, q, velocity, position_std, velocity_std, attitude_std in zip(
                *values, strict=True
            )
        ]

    def _estimate_motion(self) -> tuple[Floats, ...]:
        """Return the filters' estimates of the motion, NED and FRD, [R] leading."""
        scene, number = self._scene, np.int32(self._measurement_count)
        self._measurement_count += 1
        self._memory, belief = self._sense(scene.worlds, self._memory, number, scene.state.vehicles)
        q, nu = np.asarray(belief.q, float), np.asarray(belief.nu, float)
        spreads = (belief.position_std_m, belief.velocity_std_mps, belief.attitude_std_rad)
        return (
            vector_enu_to_ned(np.asarray(belief.p, float)),
            quaternion_enu_to_ned(q),
            vector_enu_to_ned(rotate_vectors(q, nu[..., :3])),
            # A standard deviation has no sign.
            *(np.abs(vector_enu_to_ned(np.asarray(spread, float))) for spread in spreads),
        )


def _reset_sensing(spec: SimSpec, worlds: FleetWorld, vehicles: VehicleState) -> InstrumentMemory:
    world, now = jax.tree.map(lambda leaf: leaf[0], (worlds, vehicles))
    return sensing.reset(spec, world, now)


def _step_sensing(
    spec: SimSpec,
    worlds: FleetWorld,
    memory: InstrumentMemory,
    number: jax.Array,
    vehicles: VehicleState,
) -> tuple[InstrumentMemory, Belief]:
    world, now = jax.tree.map(lambda leaf: leaf[0], (worlds, vehicles))
    flow = jnp.zeros_like(now.p)
    return sensing.step(spec, world, memory, number, now, flow)
