"""A vehicle in closed form: what the fused engine takes where MJX takes a multibody model.

Also the base of a vehicle with links, whose links `angler_mjx.robot.vehicles.link_motion` adds.
This form has derivatives by all parameters, which `VehicleParams` holds.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import rigid_body
from angler_mjx.robot.vehicles.params import VehicleParams


@dataclass(frozen=True, kw_only=True)
class ClosedForm:
    """A rigid body about its centre of mass; its body is the `VehicleParams`."""

    gravity_mps2: jax.Array | float

    def inertia_and_force(
        self, body: VehicleParams, p: jax.Array, q: jax.Array, nu: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """M_RB = diag(m, I_cm) and f = weight - C_RB(nu) nu; see `Multibody`."""
        identity, zero = jnp.eye(3, dtype=nu.dtype), jnp.zeros((3, 3), nu.dtype)
        M_RB = jnp.block([[body.mass_kg * identity, zero], [zero, body.inertia_kgm2]])
        weight = rigid_body.buoyancy_wrench(q, -body.mass_kg * self.gravity_mps2, jnp.zeros_like(p))
        return M_RB, weight - rigid_body.rigid_body_coriolis(body.mass_kg, body.inertia_kgm2, nu)
