"""Many vehicles of one kind in still water under constant thrust: the equations of motion alone.

What remains of a simulation without control, currents, worlds and detection: it shows how fast the
physics can be.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_kernels.lanes.planes import PlaneLayout
from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.engines.lanes import steps as lane_steps
from angler_mjx.sim.physics.step import VehicleState, Water

type Kernels = Literal["xla", "cuda"]
"""Compiler of the equations of motion."""


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """One vehicle in still water."""

    vehicle: VehicleParams
    """Numbers that programs hold, not arrays that they read."""
    water: Water
    physics_dt_s: float

    def simulate(
        self, state: VehicleState, thrust_n: jax.Array, n_steps: int, kernels: Kernels = "xla"
    ) -> VehicleState:
        """Physics steps of independent vehicles.

        Args:
            state: [N] leads.
            thrust_n: [N, n_thruster] N, what the thrusters settle at.
            n_steps: physics steps.
            kernels: ``xla``, or ``cuda`` for one kernel that keeps the state in registers.

        Returns:
            State at the end, [N] leads; derivatives are those of ``xla``.
        """
        plain = partial(self._simulate_jax, n_steps=n_steps)
        if kernels == "xla":
            return plain(state, thrust_n)
        run = partial(self._simulate_in_kernel, n_steps=n_steps)
        fast = launch.with_gradient_of(plain, run)
        return fast(state, thrust_n)

    def _simulate_jax(self, state: VehicleState, thrust_n: jax.Array, n_steps: int) -> VehicleState:
        after = self._run_steps(lanes.split(state), lanes.split(thrust_n), n_steps)
        return lanes.join(after)

    def _simulate_in_kernel(
        self, state: VehicleState, thrust_n: jax.Array, n_steps: int
    ) -> VehicleState:
        layout, order = PlaneLayout.of(state, 1), PlaneLayout.of(thrust_n, 1)
        dtype, count = state.p.dtype, state.p.shape[0]

        def kernel(lane: jax.Array, _: jax.Array, order_ref: jax.Ref, state_ref: jax.Ref) -> None:
            now = layout.read_lanes(launch.make_loader(state_ref), lane)
            thrust = order.read_lanes(launch.make_loader(order_ref), lane)
            after = self._run_steps(now, thrust, n_steps)
            layout.write_lanes(launch.make_storer(state_ref, lane), lane, after)

        if count % BLOCK:
            raise ConfigError(f"{count} vehicles: kernels = cuda takes multiples of {BLOCK}")
        constant, changed = [order.pack(thrust_n, dtype)], [layout.pack(state, dtype)]
        shape = launch.LaunchShape(block=BLOCK)
        (flat,) = launch.call_kernel(kernel, shape, count, 1, constant, changed)
        return layout.unpack(flat, (count,))

    def _run_steps(self, state: VehicleState, thrust_n: jax.Array, n_steps: int) -> VehicleState:
        """The same on lanes."""
        zero = jnp.zeros((), state.p[0].dtype)

        def advance(_: jax.Array, now: VehicleState) -> VehicleState:
            step = partial(lane_steps.physics_step, self.physics_dt_s, self.water)
            return lanes.apply(step, self.vehicle, now, thrust_n, (), zero)

        return lanes.repeat(n_steps, advance, state)


BLOCK = 128
"""Vehicles of a block."""


def build_dynamics(
    vehicle: str,
    parameter_set: str | None = None,
    *,
    battery_v: float = 16.0,
    physics_dt_s: float = 0.01,
) -> Dynamics:
    """One vehicle with one of its parameter sets (host side).

    Raises:
        ConfigError: unknown vehicle or set, or a file with faults.
    """
    vehicle_params = params.build_vehicle(library.load_vehicle(vehicle), parameter_set, battery_v)
    empty_table = jnp.zeros(1)  # tables are for the controller
    vehicle_params = replace(vehicle_params, thrust_n=empty_table, power_w=empty_table)

    def hold(leaf: jax.Array) -> np.ndarray:
        value = np.asarray(leaf)
        return lanes.pack([*value.ravel()], value.shape)

    return Dynamics(
        vehicle=jax.tree.map(hold, vehicle_params), water=Water(), physics_dt_s=physics_dt_s
    )
