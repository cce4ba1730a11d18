"""MuJoCo MJX behind one module: the inertia and the bias force of a vehicle's multibody model.

Owns everything that touches ``mujoco.mjx``: the model that a fleet shares, the fields in which its
vehicles differ, and the inertia and force that the step needs. MJX's own integrators, contacts,
actuators and fluid model are not used; no MuJoCo fluid attribute is ever set.

MJX compiles part of a model into its programs, the places of the mass matrix that can be other
than zero among it: for a body that MuJoCo calls simple, whose inertia is diagonal in its own frame,
these are the diagonal alone. A fleet has one program, so its models are made alike first: none is
simple.

A free joint's velocity in MuJoCo is the linear velocity in the world and the angular velocity in
the body; ours is ``nu``, both in the body. The conversion happens here, once.

Vehicles with links take their dry terms from `angler_mjx.robot.vehicles.link_motion`; their model
is compiled all the same, for what checks it.
"""

import contextlib
import importlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from angler_kernels import quaternion
from angler_kernels.rigid_body import matrix_times

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from mujoco import mjx


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class BodyInertia:
    """What of MuJoCo's model differs between the vehicles of a fleet: masses and inertias, mainly.

    Found by comparing the models. Empty where all are the same, or where nobody computes with MJX.
    """

    fields: dict[str, jax.Array]
    """By MuJoCo's names and in its shapes; nested ones with a dot, as ``stat.meanmass``."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MjxPhysics:
    """What all vehicles of a fleet share: one MJX model and an empty state to work on."""

    model: "mjx.Model"
    """mjx.Model of the first variant; the fields of `BodyInertia` are replaced for each robot."""
    data: "mjx.Data"
    """mjx.Data, the scratch of one evaluation."""

    def with_gravity(self, gravity_mps2: float) -> "MjxPhysics":
        """The same engine in a field of gravity of so much, m/s^2, along -z."""
        before = self.model.opt.gravity
        gravity = jnp.asarray([0.0, 0.0, -gravity_mps2], before.dtype)
        return replace(self, model=self.model.tree_replace({"opt.gravity": gravity}))

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
        v_world = quaternion.rotate(q, nu[:3])
        M, bias = _inertia_and_bias(
            self, body, jnp.concatenate([p, q]), jnp.concatenate([v_world, nu[3:]])
        )
        R = quaternion.to_matrix(q)
        zero = jnp.zeros_like(R)
        T = jnp.block([[R.T, zero], [zero, jnp.eye(3, dtype=R.dtype)]])
        T_M = jnp.sum(T[:, :, None] * M[None, :, :], axis=1)
        M_RB = jnp.sum(T_M[:, None, :] * T[None, :, :], axis=2)
        turning = jnp.cross(nu[3:], nu[:3])
        turning = jnp.concatenate([turning, jnp.zeros_like(turning)])
        return M_RB, -matrix_times(T, bias) - matrix_times(M_RB, turning)


def build_engine(specs: Sequence[mujoco.MjSpec]) -> tuple[MjxPhysics, BodyInertia]:
    """The engine of a fleet, and in what its variants differ.

    Args:
        specs: one a variant, each a single free body, with or without links; names are of no
            account.

    Returns:
        The engine, and the fields that differ, [n_variant] leading.

    Raises:
        ValueError: a model is no free body with links, or they differ in what MJX compiles in.
    """
    # MJX itself takes the first device of all processes, which another process may own.
    device = jax.local_devices()[0]
    models = [import_mjx().put_model(model, device=device) for model in compile_models(specs)]
    engine = MjxPhysics(model=models[0], data=import_mjx().make_data(models[0], device=device))
    return engine, BodyInertia(fields=jax.device_put(_differing_fields(models)))


def empty_inertia(specs: Sequence[mujoco.MjSpec]) -> BodyInertia:
    """Build what other engines need of MJX; arguments and errors as of `build_engine`."""
    compile_models(specs)
    return BodyInertia(fields={})


def compile_models(specs: Sequence[mujoco.MjSpec]) -> list[mujoco.MjModel]:
    """The models of a fleet in MuJoCo's general form, so that one program fits all.

    Arguments as of `build_engine`.

    Raises:
        ValueError: a model is no free body with links.
    """
    return [_compile_general(spec) for spec in specs]


_AXIS_CYCLE = np.full(4, 0.5)
"""Quaternion that takes x to y, y to z and z to x: exact in any float type."""


def _compile_general(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """A model without names of its own, and without bodies that MuJoCo takes for simple ones.

    A body may be simple where the axes of its inertia are its own; the same inertia with its axes
    in another order is not.
    """
    spec = spec.copy()
    spec.modelname = "vehicle"
    for kind in (spec.bodies[1:], spec.joints):
        for i, element in enumerate(kind):
            element.name = f"{type(element).__name__}_{i}"
    model = spec.compile()
    is_free = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    if not is_free or model.nq != model.nv + 1 or (model.body_rootid[1:] != 1).any():
        raise ValueError(
            "every vehicle must be one free body, (7, 6, 2) as nq, nv, nbody, and links on it: "
            f"{(model.nq, model.nv, model.nbody)}"
        )
    if not _is_special(model).any():
        return model
    for i, body in enumerate(spec.bodies[1:], 1):
        if not _is_special(model)[i - 1]:
            continue
        axes = np.zeros(4)
        mujoco.mju_mulQuat(axes, model.body_iquat[i], _AXIS_CYCLE)
        body.fullinertia = np.full(6, np.nan)  # as MuJoCo says: not given
        body.inertia, body.iquat = np.roll(model.body_inertia[i], -1), axes
    model = spec.compile()
    if _is_special(model).any():
        raise ValueError("MuJoCo takes a vehicle for a simple body whatever axes its inertia has")
    return model


def _is_special(model: mujoco.MjModel) -> np.ndarray:
    """Return bool [n_body]: bodies that are simple, or whose inertia is along their own axes."""
    special: np.ndarray = (model.body_simple[1:] != 0) | (model.body_sameframe[1:] != 0)
    return special


def _differing_fields(models: Sequence["mjx.Model"]) -> dict[str, np.ndarray]:
    """Arrays [n_model, ...] of all fields of mjx.Models that are not the same in all.

    Raises:
        ValueError: they differ in what is no array of numbers to compute with.
    """
    out = {}
    for same_field in zip(*map(_list_fields, models), strict=True):
        name, values = same_field[0][0], [value for _, value in same_field]
        arrays = [np.asarray(value) for value in values]
        if all(_is_same_array(arrays[0], array) for array in arrays[1:]):
            continue
        if not isinstance(values[0], jax.Array) or len({array.shape for array in arrays}) > 1:
            raise ValueError(
                f"vehicles of one fleet differ in MuJoCo's {name}, which MJX compiles into its "
                f"program: {', '.join(str(array)[:40] for array in arrays)}; fly them in runs of "
                'their own, or with engine = "fused"'
            )
        out[name] = np.stack(arrays)
    return out


def _list_fields(node: "DataclassInstance", prefix: str = "") -> Iterator[tuple[str, object]]:
    """All fields of a model, and of what it holds, by their names."""
    for field in fields(node):
        value = getattr(node, field.name)
        if is_dataclass(value) and not isinstance(value, type):
            yield from _list_fields(value, f"{prefix}{field.name}.")
        else:
            yield f"{prefix}{field.name}", value


def _is_same_array(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two arrays hold the same; NaN is the same as NaN."""
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


@cache
def import_mjx() -> ModuleType:
    """MJX, loaded when it is first needed: that takes longer than to load JAX itself."""
    with contextlib.redirect_stdout(io.StringIO()):  # it prints that Warp is missing
        return importlib.import_module("mujoco.mjx")


def _inertia_and_bias(
    engine: MjxPhysics, body: BodyInertia, qpos: jax.Array, qvel: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """M [n, n] and bias [n] of M v' + bias = 0 of the free vehicle, in MuJoCo's coordinates."""
    mjx = import_mjx()
    model = engine.model.tree_replace(body.fields)
    data = engine.data.replace(qpos=qpos, qvel=qvel)
    data = mjx.kinematics(model, data)
    data = mjx.com_pos(model, data)
    data = mjx.crb(model, data)
    data = mjx.com_vel(model, data)
    data = mjx.rne(model, data)
    return mjx.full_m(model, data), data.qfrc_bias
