"""Motion of a vehicle whose joints move as prescribed: what identification compares to recordings.

The joints are moved by motors of any strength, so that their effort drops out: of the equation of
the whole vehicle the six rows of the base remain, with the joints' acceleration known.
"""

import jax
import jax.numpy as jnp

from angler_kernels import rigid_body, spd_solve
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics.step import VehicleState, Water, join_forces


def accelerate_base(
    params: VehicleParams,
    p: jax.Array,
    q: jax.Array,
    nu: jax.Array,
    joints: JointMotion,
    joint_acceleration: jax.Array,
    *,
    wrench: jax.Array | float = 0.0,
    v_c: jax.Array | float = 0.0,
    Dv_c: jax.Array | float = 0.0,
    water: Water | None = None,
) -> jax.Array:
    """Acceleration nu' [6] of the base of a vehicle with links whose joints move as prescribed.

    A smooth function of all arrays of ``params`` but the thrusters', which are still: masses,
    centres of mass, inertias, volumes, centres of buoyancy, added mass and damping of the base
    (``mass_kg``, ``inertia_kgm2``, ``volume_m3``, ``p_cb_m``, ``M_A``, ``D_l``, ``D_q``) and of its
    links (``params.links``: the same, drag areas and added volumes, mounts and zeros of joints).
    It has derivatives with respect to them, and batches by ``vmap``. One robot:

        params = build_vehicle(load_vehicle("bluerov2_heavy_alpha5"), None, 16.0)
        heavier = replace(params, links=replace(params.links, mass_kg=1.1 * params.links.mass_kg))
        nu_dot = accelerate_base(heavier, p, q, nu, joints, joint_acceleration)
        p_dot, q_dot = quaternion.rotate(q, nu[:3]), 0.5 * quaternion.multiply(q, [0, *nu[3:]])

    Args:
        params: of the vehicle; one with links. The origin of F is the base's own centre of mass,
            from which ``p_cb_m`` and the mounts of links count.
        p: [3] position, m, in W; z = 0 at the surface.
        q: [4] attitude, wxyz, F to W.
        nu: [6] velocity over ground, in F.
        joints: [J] positions and speeds of the joints, in the order of `VehicleConfig.find_joints`.
        joint_acceleration: [J] rad/s^2 or m/s^2.
        wrench: [6] further wrench on the base at its centre of mass, in F, of thrusters for one.
        v_c: [3] velocity of the water, m/s, in W.
        Dv_c: [3] its material derivative, m/s^2, in W.
        water: the medium; fresh water if left out.

    Raises:
        ValueError: the vehicle has no links.
    """
    water = Water() if water is None else water
    flow, flow_rate = (jnp.broadcast_to(jnp.asarray(x, nu.dtype), (3,)) for x in (v_c, Dv_c))
    state = VehicleState(
        p=p, q=q, nu=nu, force_before=jnp.zeros(0), thrust=jnp.zeros(0), joints=joints
    )
    forces = join_forces(params, state, flow, flow_rate, water)
    moved = rigid_body.matrix_times(forces.M[:6, 6:], joint_acceleration)
    right = forces.force[:6] + wrench - moved
    return spd_solve.solve(forces.M[:6, :6], right[:, None])[:, 0]
