"""MuJoCo MJX behind one module: the inertia and the bias force of a vehicle's multibody model.

Owns everything that touches ``mujoco.mjx``: the model that a fleet shares, the inertias in which
its vehicles differ, and the inertia and force that the step needs. MJX's own integrators, contacts,
actuators and fluid model are not used; no MuJoCo fluid attribute is ever set.

A free joint's velocity in MuJoCo is the linear velocity in the world and the angular velocity in
the body; ours is ``nu``, both in the body. The conversion happens here, once.
"""

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from angler_kernels import quaternion
from angler_kernels.rigid_body import matrix_times


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class BodyInertia:
    """The fields of an mjx.Model in which vehicles differ; MuJoCo's names and shapes."""

    body_mass: jax.Array
    body_inertia: jax.Array
    body_iquat: jax.Array
    body_ipos: jax.Array
    body_subtreemass: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MjxEngine:
    """What all vehicles of a fleet share: one MJX model and an empty state to work on."""

    model: Any
    """mjx.Model of the first variant; the fields of `BodyInertia` are replaced for each robot."""
    data: Any
    """mjx.Data, the scratch of one evaluation."""

    def inertia_and_force(
        self, body: BodyInertia, p: jax.Array, q: jax.Array, nu: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Inertia of the dry vehicle, and the force of gravity and rotation on it, both in F.

        With T = blkdiag(R^T, 1) from MuJoCo's velocity v to nu and nu' = T v' - [omega x v; 0],
        M v' + bias = T^T w becomes (T M T^T) nu' = w - T bias - T M T^T [omega x v; 0].

        Args:
            body: of one vehicle.
            p: [3] m in W.
            q: [4].
            nu: [6] in F.

        Returns:
            M_RB [6, 6] and f [6] of M_RB nu' = f + (wrenches on the vehicle, in F).
        """
        M, bias = _inertia_and_bias(self, body, p, q, nu)
        R = quaternion.to_matrix(q)
        zero = jnp.zeros_like(R)
        T = jnp.block([[R.T, zero], [zero, jnp.eye(3, dtype=R.dtype)]])
        T_M = jnp.sum(T[:, :, None] * M[None, :, :], axis=1)
        M_RB = jnp.sum(T_M[:, None, :] * T[None, :, :], axis=2)
        turning = jnp.cross(nu[3:], nu[:3])
        turning = jnp.concatenate([turning, jnp.zeros_like(turning)])
        return M_RB, -matrix_times(T, bias) - matrix_times(M_RB, turning)


def build(models: Sequence[mujoco.MjModel]) -> tuple[MjxEngine, BodyInertia]:
    """The engine of a fleet and the inertias of its variants.

    Args:
        models: one compiled model a variant, each a single free body.

    Returns:
        The engine, and the inertias with a leading axis [n_variant].

    Raises:
        ValueError: a model is not one free body.
    """
    bodies = inertias(models)
    # MJX itself takes the first device of all processes, which another process may own.
    here = jax.local_devices()[0]
    model = _mjx().put_model(models[0], device=here)
    return MjxEngine(model=model, data=_mjx().make_data(model, device=here)), bodies


def inertias(models: Sequence[mujoco.MjModel]) -> BodyInertia:
    """The inertias of a fleet's variants; arguments and what is refused as of `build`."""
    shapes = {(m.nq, m.nv, m.nbody) for m in models}
    if shapes != {(7, 6, 2)}:
        raise ValueError(
            f"every vehicle must be one free body, (7, 6, 2) as nq, nv, nbody: {shapes}"
        )
    dtype = jnp.result_type(float)
    stacked = {
        field.name: np.stack([np.asarray(getattr(m, field.name), dtype) for m in models])
        for field in fields(BodyInertia)
    }
    return BodyInertia(**jax.device_put(stacked))


@cache
def _mjx() -> Any:
    """MJX, loaded when it is first needed: that takes longer than to load JAX itself."""
    with contextlib.redirect_stdout(io.StringIO()):  # it prints that Warp is missing
        from mujoco import mjx
    return mjx


def _inertia_and_bias(
    engine: MjxEngine, body: BodyInertia, p: jax.Array, q: jax.Array, nu: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """M [6, 6] and bias [6] of M v' + bias = 0 of the free vehicle, in MuJoCo's coordinates."""
    mjx = _mjx()
    v_world = quaternion.rotate(q, nu[:3])
    model = engine.model.replace(
        **{field.name: getattr(body, field.name) for field in fields(body)}
    )
    data = engine.data.replace(
        qpos=jnp.concatenate([p, q]), qvel=jnp.concatenate([v_world, nu[3:]])
    )
    data = mjx.kinematics(model, data)
    data = mjx.com_pos(model, data)
    data = mjx.crb(model, data)
    data = mjx.com_vel(model, data)
    data = mjx.rne(model, data)
    return mjx.full_m(model, data), data.qfrc_bias
