"""The vehicles with arms that the physics is tested on, their states, and Pinocchio's model."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pinocchio as pin

from angler_mjx.robot.vehicles import library, mjcf, params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics.mjx_engine import BodyInertia, MjxPhysics

from .recursive import Chain, frame, to_matrix

SHIPPED = "bluerov2_heavy_alpha5"


@dataclass(frozen=True)
class Armed:
    config: VehicleConfig
    set_name: str
    params: VehicleParams
    engine: MjxPhysics
    body: BodyInertia

    @property
    def chain(self) -> Chain:
        return Chain(self.config, self.set_name)

    @property
    def count(self) -> int:
        return len(self.config.joints)


def build(config: VehicleConfig, set_name: str) -> Armed:
    engine, body = mjx_engine.build_engine([mjcf.to_spec(config, set_name, shapes=False)])
    return Armed(config, set_name, params.build_vehicle(config, set_name, 16.0), engine, body)


def changed(edit) -> VehicleConfig:
    """The shipped vehicle with its tables edited."""
    data = library.load_vehicle(SHIPPED).model_dump()
    data["links"], data["joints"] = list(data["links"]), list(data["joints"])
    edit(data)
    return VehicleConfig.model_validate(data)


def branched() -> VehicleConfig:
    """An arm with a branch: skewed axes and poses, full added mass, a link fixed to a link."""

    def edit(data):
        for table in data["parameter_sets"]["wu2018"].values():
            if isinstance(table, dict) and "coefficients" in table:
                half = np.random.default_rng(5).normal(size=(6, 6))
                half *= np.sqrt([2, 2, 2, 0.02, 0.02, 0.02])
                added = half.T @ half + np.diag([5.5, 12.7, 14.57, 0.12, 0.12, 0.12])
                table["coefficients"] = (0.5 * (added + added.T)).tolist()
        half = np.random.default_rng(6).normal(size=(6, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
        mast = {
            **data["links"][2],
            "name": "mast",
            "parent": "upper_arm",
            "joint": "tilt",
            "position_m": (0.05, -0.02, 0.03),
            "rpy_rad": (0.4, -0.7, 1.1),
            "water": {
                **data["links"][2]["water"],
                "added_mass": (0.1 * half.T @ half).tolist(),
            },
        }
        lamp = {**data["links"][1], "name": "lamp", "parent": "mast", "joint": None}
        lamp["position_m"], lamp["rpy_rad"] = (0.1, 0.02, -0.03), (-0.3, 0.2, 0.5)
        tilt = {**data["joints"][1], "name": "tilt", "axis": (0.6, 0.0, -0.8), "zero": 0.3}
        # Neither parents nor joints stand in the order of the tree.
        data["links"] = [lamp, mast, *data["links"]]
        data["joints"] = [*data["joints"], tilt]
        data["name"] = "branched"

    return changed(edit)


def sample_states(armed: Armed, count: int, seed: int) -> dict[str, np.ndarray]:
    """States [count]: half of them near the surface."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(count, 4))
    p = rng.normal(size=(count, 3)) * 20
    p[:, 2] = np.where(np.arange(count) % 2, rng.uniform(-0.5, 0.3, count), -np.abs(p[:, 2]))
    joints = armed.config.find_joints()
    return {
        "p": p,
        "q": q / np.linalg.norm(q, axis=1, keepdims=True),
        "nu": rng.normal(size=(count, 6)),
        "theta": np.stack([rng.uniform(j.lower, j.upper, count) for j in joints], axis=1),
        "speed": rng.normal(size=(count, len(joints))),
        "flow": rng.normal(size=(count, 3)),
        "flow_rate": rng.normal(size=(count, 3)),
    }


def motion(theta, speed) -> JointMotion:
    return JointMotion(position=jnp.asarray(theta), velocity=jnp.asarray(speed))


def in_vacuum(vehicle: VehicleParams) -> VehicleParams:
    """The vehicle without what water of no density still adds."""
    links = replace(vehicle.links, M_A=jnp.zeros_like(vehicle.links.M_A))
    none = {name: jnp.zeros_like(getattr(vehicle, name)) for name in ("M_A", "D_l", "D_q")}
    return replace(vehicle, **none, links=links)


def mujoco_inertia_and_force(
    model: mujoco.MjModel, p, q, nu, theta, speed
) -> tuple[np.ndarray, np.ndarray]:
    """M [n, n] and f [n] of M xi' = f by MuJoCo, whose velocity has v in W."""
    data = mujoco.MjData(model)
    R, T = to_matrix(q), np.eye(model.nv)
    T[:3, :3] = R.T
    data.qpos[:], data.qvel[:] = [*p, *q, *theta], [*(R @ nu[:3]), *nu[3:], *speed]
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    M = T @ M @ T.T
    turning = np.zeros(model.nv)
    turning[:3] = np.cross(nu[3:], nu[:3])
    return M, -T @ data.qfrc_bias - M @ turning


def to_pinocchio(chain: Chain) -> pin.Model:
    """The dry vehicle as a model of Pinocchio, from the numbers of the file."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    base = chain.base
    model.appendBodyToJoint(
        root, pin.Inertia(base.mass, np.zeros(3), base.inertia), pin.SE3.Identity()
    )
    model.gravity.linear = np.array([0, 0, -9.81])

    def add(name, joint_number, placement):
        link, body = chain.links[name], chain.bodies[name]
        offset = np.array(link.position_m)
        if link.parent == "base":
            offset = offset - chain.config.base.center_of_mass_m
        here = placement * pin.SE3(frame(link.rpy_rad), offset)
        joint = chain.tables.get(link.joint)
        if joint is not None:
            kinds = {
                "revolute": pin.JointModelRevoluteUnaligned,
                "prismatic": pin.JointModelPrismaticUnaligned,
            }
            kind = kinds[joint.type](np.array(joint.axis))
            joint_number = model.addJoint(joint_number, kind, here, joint.name)
            here = pin.SE3.Identity()
        inertia = pin.Inertia(body.mass, body.com, body.inertia)
        model.appendBodyToJoint(joint_number, inertia, here)
        for child in chain.links.values():
            if child.parent == name:
                add(child.name, joint_number, here)

    for link in chain.links.values():
        if link.parent == "base":
            add(link.name, root, pin.SE3.Identity())
    return model


def pinocchio_columns(model: pin.Model, names: list[str]) -> np.ndarray:
    """Where Pinocchio has our velocities [n]: base first, then joints by name."""
    return np.array([*range(6), *(model.joints[model.getJointId(name)].idx_v for name in names)])


def cast(tree, dtype):
    """A tree of arrays in another float type."""
    return jax.tree.map(
        lambda leaf: (
            jnp.asarray(np.asarray(leaf), dtype)
            if jnp.issubdtype(leaf.dtype, jnp.floating)
            else leaf
        ),
        tree,
    )
