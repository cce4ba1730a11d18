"""MuJoCo model of a vehicle file: one free body with its mass, its inertia and a visible shape.

The body's origin is the centre of mass. Water is not in the model: buoyancy, added mass, damping
and thrust are the simulator's own terms, so no fluid attribute of MuJoCo is ever set (its fluid
models have no added-mass inertia, and MJX may compute another model than the requested one).
"""

import logging

import mujoco
import numpy as np

from angler_mjx.robot.vehicles.config import Box, Cylinder, Sphere, VehicleConfig
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.robot.vehicles.thrusters import FloatArray

# A T200 is 0.1 m across its nozzle and about as long; only looks depend on these.
_NOZZLE_RADIUS_M = 0.05
_NOZZLE_HALF_LENGTH_M = 0.045
# Thrusters are coloured by their sense of rotation, as the propellers of the kit are.
_SPIN_RGBA = {1: (0.10, 0.65, 0.30, 0.9), -1: (0.90, 0.45, 0.10, 0.9)}
_HULL_RGBA = (0.35, 0.65, 0.95, 0.12)
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
    config: VehicleConfig, parameter_set: str | None, *, shapes: bool = True
) -> mujoco.MjSpec:
    """Build the MuJoCo model of a vehicle.

    Body and joint carry the vehicle's name; each thruster is a geom and a site of its own name,
    the site's z axis along positive thrust. Other geoms are ``hull/...`` and ``shape/...``: a name
    in a file holds no slash, so they cannot meet a thruster's.

    Args:
        config: Vehicle file.
        parameter_set: Name of one of its sets; None for its default.
        shapes: Whether to add light, geoms and sites; the physics needs none.

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
    if not shapes:
        return spec
    _add_light(spec)
    center = np.asarray(config.base.center_of_mass_m)
    _add_shapes(body, config, center)
    _add_thrusters(body, config, center)
    return spec


def to_xml(config: VehicleConfig, parameter_set: str | None) -> str:
    """Return the MuJoCo model of a vehicle as MJCF text; see ``to_spec``."""
    spec = to_spec(config, parameter_set)
    spec.compile()
    text: str = spec.to_xml()
    return text


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
    for i, capsule in enumerate(config.hull.capsules):
        body.add_geom(
            name=f"hull/{i + 1}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*(capsule.from_m - center), *(capsule.to_m - center)],
            size=[capsule.radius_m, 0, 0],
            rgba=_HULL_RGBA,
            group=_HULL_GROUP,
            contype=0,
            conaffinity=0,
        )
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
