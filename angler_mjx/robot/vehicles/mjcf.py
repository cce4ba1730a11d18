"""MuJoCo model of a vehicle file: a free body and its links, with masses, inertias and shapes.

The body's origin is the centre of mass. Water is not in the model: buoyancy, added mass, damping
and thrust are the simulator's own terms, so no fluid attribute of MuJoCo is ever set (its fluid
models have no added-mass inertia, and MJX may compute another model than the requested one).
"""

import logging
from collections.abc import Sequence

import mujoco
import numpy as np

from angler_mjx.robot.vehicles.config import Box, Cylinder, Sphere, VehicleConfig
from angler_mjx.robot.vehicles.hull import Capsule
from angler_mjx.robot.vehicles.link_params import mount_m, rotation_matrix
from angler_mjx.robot.vehicles.links import BASE, Joint, Link
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.robot.vehicles.thrusters import FloatArray

# A T200 is 0.1 m across its nozzle and about as long; only looks depend on these.
_NOZZLE_RADIUS_M = 0.05
_NOZZLE_HALF_LENGTH_M = 0.045
# Thrusters are coloured by their sense of rotation, as the propellers of the kit are.
_SPIN_RGBA = {1: (0.10, 0.65, 0.30, 0.9), -1: (0.90, 0.45, 0.10, 0.9)}
_HULL_RGBA = (0.35, 0.65, 0.95, 0.12)
_LINK_RGBA = (0.20, 0.20, 0.22, 1.0)
# MuJoCo's viewers show geom groups 0 to 2 and hide 3 to 5 until they are switched on.
_SHAPE_GROUP = 1
_HULL_GROUP = 2


def _log_warning(message: str) -> None:
    """Log a warning of MuJoCo.

    Without a handler MuJoCo appends it to MUJOCO_LOG.TXT in the working folder.
    """
    logging.getLogger(__name__).warning("MuJoCo: %s", message)


if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(_log_warning)


def to_spec(
    config: VehicleConfig,
    parameter_set: str | None,
    *,
    shapes: bool = True,
    absent_links: VehicleConfig | None = None,
) -> mujoco.MjSpec:
    """Build the MuJoCo model of a vehicle.

    Body and joint carry the vehicle's name; each thruster is a geom and a site of its own name,
    the site's z axis along positive thrust. Links are bodies, and joints joints, of the names
    ``link/...`` and ``joint/...``. Other geoms are ``hull/...`` and ``shape/...``: a name in a file
    holds no slash, so they cannot meet a thruster's.

    Args:
        config: Vehicle file.
        parameter_set: Name of one of its sets; None for its default.
        shapes: Whether to add light, geoms and sites; the physics needs none.
        absent_links: Vehicle file with the links of other robots of the fleet, for a vehicle that
            has none: they are added practically without mass, on joints with an inertia of their
            own, so that one program fits all.

    Raises:
        ConfigError: the vehicle has no such set.
    """
    chosen = config.find_set(parameter_set)
    spec = mujoco.MjSpec()
    spec.modelname = config.name
    spec.comment = (
        f"{config.description}; parameter set {parameter_set or config.default_set}. "
        "Dry rigid body only: water and thrust are not in this file."
    )
    spec.option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    if config.links or absent_links is not None:
        spec.compiler.degree = False  # of the zeros of joints
    inertia = chosen.rigid_body.inertia_kgm2
    diagonal = [inertia[i][i] for i in range(3)]
    products = [inertia[0][1], inertia[0][2], inertia[1][2]]
    body = spec.worldbody.add_body(
        name=config.name,
        mass=chosen.rigid_body.mass_kg,
        ipos=[0.0, 0.0, 0.0],
        fullinertia=[*diagonal, *products],  # MuJoCo's order: xx yy zz xy xz yz
        explicitinertial=True,
    )
    body.add_freejoint(name=config.name)
    center = np.asarray(config.base.center_of_mass_m)
    if config.links or absent_links is None:
        _add_links(body, config, config.find_links(parameter_set), shapes=shapes)
    else:
        _add_absent_links(body, absent_links)
    if not shapes:
        return spec
    _add_light(spec)
    _add_shapes(body, config, center)
    _add_thrusters(body, config, center)
    return spec


def to_xml(config: VehicleConfig, parameter_set: str | None) -> str:
    """Return the MuJoCo model of a vehicle as MJCF text; see ``to_spec``."""
    spec = to_spec(config, parameter_set)
    spec.compile()
    text: str = spec.to_xml()
    return text


def _add_links(
    base: mujoco.MjsBody,
    config: VehicleConfig,
    links: Sequence[Link],
    *,
    shapes: bool,
) -> dict[str, mujoco.MjsJoint]:
    """Add the bodies of links to that of the base, and return their joints by name."""
    tables = {joint.name: joint for joint in config.joints}
    bodies, joints = {BASE: base}, {}
    for link in links:
        inertia = link.rigid_body.inertia_kgm2
        rotation = rotation_matrix(link.rpy_rad)
        body = bodies[link.parent].add_body(
            name=f"link/{link.name}",
            pos=mount_m(config, link),
            quat=_to_quaternion(rotation),
            mass=link.rigid_body.mass_kg,
            ipos=link.rigid_body.center_of_mass_m,
            fullinertia=[*np.diag(inertia), inertia[0][1], inertia[0][2], inertia[1][2]],
            explicitinertial=True,
        )
        bodies[link.name] = body
        if link.joint is not None:
            joints[link.joint] = _add_joint(body, tables[link.joint])
        if shapes:
            _add_capsules(body, f"hull/{link.name}", link.capsules, np.zeros(3), _LINK_RGBA)
    return joints


def _add_joint(body: mujoco.MjsBody, joint: Joint) -> mujoco.MjsJoint:
    """Add a joint without limits, friction and springs: these are the simulator's own."""
    kinds = {"revolute": mujoco.mjtJoint.mjJNT_HINGE, "prismatic": mujoco.mjtJoint.mjJNT_SLIDE}
    return body.add_joint(
        name=f"joint/{joint.name}", type=kinds[joint.type], axis=joint.axis, ref=joint.zero
    )


_ABSENT_KG = 1e-12
"""Mass [kg] and inertia [kg m^2] of an absent link: MuJoCo takes nothing below 1e-15."""


def _add_absent_links(base: mujoco.MjsBody, config: VehicleConfig) -> None:
    links = [
        link.model_copy(
            update={
                "rigid_body": link.rigid_body.model_copy(
                    update={
                        "mass_kg": _ABSENT_KG,
                        "center_of_mass_m": (0.0, 0.0, 0.0),
                        "inertia_kgm2": tuple(map(tuple, (_ABSENT_KG * np.eye(3)).tolist())),
                    }
                )
            }
        )
        for link in config.find_links(None)
    ]
    for joint in _add_links(base, config, links, shapes=False).values():
        joint.armature = 1.0


def _to_quaternion(rotation: FloatArray) -> FloatArray:
    """Return the quaternion wxyz of a rotation [3, 3]."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).reshape(9))
    return quaternion


def _add_light(spec: mujoco.MjSpec) -> None:
    spec.visual.headlight.ambient = [0.35, 0.4, 0.45]
    spec.visual.headlight.diffuse = [0.6, 0.6, 0.6]
    spec.add_texture(
        name="water",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.55, 0.80, 0.90],
        rgb2=[0.02, 0.12, 0.25],
        width=256,
        height=1536,
    )


def _add_shapes(body: mujoco.MjsBody, config: VehicleConfig, center: FloatArray) -> None:
    _add_capsules(body, "hull", config.hull.capsules, center, _HULL_RGBA)
    for shape in config.visual.shapes:
        match shape:
            case Box():
                geometry = {
                    "type": mujoco.mjtGeom.mjGEOM_BOX,
                    "pos": shape.position_m - center,
                    "size": np.asarray(shape.size_m) / 2,
                }
            case Cylinder():
                geometry = {
                    "type": mujoco.mjtGeom.mjGEOM_CYLINDER,
                    "fromto": [*(shape.from_m - center), *(shape.to_m - center)],
                    "size": [shape.radius_m, 0, 0],
                }
            case Sphere():
                geometry = {
                    "type": mujoco.mjtGeom.mjGEOM_SPHERE,
                    "pos": shape.position_m - center,
                    "size": [shape.radius_m, 0, 0],
                }
        body.add_geom(
            name=f"shape/{shape.name}",
            rgba=shape.rgba,
            group=_SHAPE_GROUP,
            contype=0,
            conaffinity=0,
            **geometry,
        )


def _add_capsules(
    body: mujoco.MjsBody,
    prefix: str,
    capsules: Sequence[Capsule],
    center: FloatArray,
    rgba: tuple[float, ...],
) -> None:
    for i, capsule in enumerate(capsules):
        body.add_geom(
            name=f"{prefix}/{i + 1}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*(capsule.from_m - center), *(capsule.to_m - center)],
            size=[capsule.radius_m, 0, 0],
            rgba=rgba,
            group=_HULL_GROUP,
            contype=0,
            conaffinity=0,
        )


def _add_thrusters(body: mujoco.MjsBody, config: VehicleConfig, center: FloatArray) -> None:
    for thruster in config.thrusters.layout:
        position = thruster.position_m - center
        axis = np.asarray(thruster.direction)
        body.add_geom(
            name=thruster.name,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            fromto=[
                *(position - _NOZZLE_HALF_LENGTH_M * axis),
                *(position + _NOZZLE_HALF_LENGTH_M * axis),
            ],
            size=[_NOZZLE_RADIUS_M, 0, 0],
            rgba=_SPIN_RGBA[thruster.spin],
            group=_SHAPE_GROUP,
            contype=0,
            conaffinity=0,
        )
        body.add_site(name=thruster.name, pos=position, quat=_z_to(axis), size=[0.01, 0, 0])


def _z_to(axis: FloatArray) -> FloatArray:
    """Return quaternion wxyz of the shortest rotation that takes the z axis to ``axis`` (unit)."""
    # Half-way formula; straight down has no shortest turn, so it is a half turn about x.
    if axis[2] < -1 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    quaternion = np.array([1 + axis[2], -axis[1], axis[0], 0.0])
    unit: FloatArray = quaternion / np.linalg.norm(quaternion)
    return unit
