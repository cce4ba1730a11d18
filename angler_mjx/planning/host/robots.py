"""Robots as joints and bodies of Pinocchio.

Each robot is two joints, its place (x, y, z) and its heading, and below them whatever bodies it
has: the capsules of its hull and, where it has one, an arm with joints of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import coal
import numpy as np
import pinocchio as pin

from angler_mjx._moved import renamed as _renamed
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.vehicles.params import VehicleParams


@dataclass(frozen=True, kw_only=True)
class PlannedRobot:
    """The bodies of one robot."""

    capsule_a_m: np.ndarray
    """[c, 3] one end of the axis of each capsule, from the centre of mass, body frame."""
    capsule_b_m: np.ndarray
    """[c, 3] the other end."""
    capsule_r_m: np.ndarray
    """[c]."""
    arm: tuple[pin.Model, pin.GeometryModel] | None = None
    """Model and geometry model of Pinocchio (from MJCF or URDF, fixed base), from the centre of
    mass, body frame."""

    @classmethod
    def of(
        cls, vehicle: VehicleParams, arm: tuple[pin.Model, pin.GeometryModel] | None = None
    ) -> Self:
        """Build the hull of a vehicle file, with an arm or without."""
        return cls(
            capsule_a_m=np.asarray(vehicle.capsule_a_m, float),
            capsule_b_m=np.asarray(vehicle.capsule_b_m, float),
            capsule_r_m=np.asarray(vehicle.capsule_r_m, float),
            arm=arm,
        )

    @classmethod
    def from_radius(cls, radius_m: float) -> Self:
        """Build a sphere about the centre of mass."""
        return cls(
            capsule_a_m=np.zeros((1, 3)),
            capsule_b_m=np.zeros((1, 3)),
            capsule_r_m=np.array([float(radius_m)]),
        )


def team_hulls(problem: Problem) -> list[PlannedRobot]:
    """Return the hulls of the team of a problem."""
    hulls = problem.team
    rows = zip(hulls.capsule_a_m, hulls.capsule_b_m, hulls.capsule_r_m, strict=True)
    return [
        PlannedRobot(
            capsule_a_m=np.asarray(a, float),
            capsule_b_m=np.asarray(b, float),
            capsule_r_m=np.asarray(r, float),
        )
        for a, b, r in rows
    ]


def build_model(robots: Sequence[PlannedRobot]) -> tuple[pin.Model, pin.GeometryModel, list[int]]:
    """Build model and geometry model of a team, and the offset of each robot in q.

    Bodies are named ``robot_N_capsule_M``, and those of arms ``robot_N_`` and their own name.
    """
    model, geometry, first = pin.Model(), pin.GeometryModel(), []
    for number, robot in enumerate(robots):
        base, name = pin.SE3.Identity(), f"robot_{number}"
        joint = model.addJoint(0, pin.JointModelTranslation(), base, f"{name}_place")
        heading_joint = model.addJoint(joint, pin.JointModelRZ(), base, f"{name}_heading")
        first.append(int(model.joints[joint].idx_q))
        rows = zip(robot.capsule_a_m, robot.capsule_b_m, robot.capsule_r_m, strict=True)
        unique = dict.fromkeys((tuple(a), tuple(b), float(r)) for a, b, r in rows)
        for count, (a, b, r) in enumerate(unique):
            shape, placement = _capsule_geometry(np.array(a), np.array(b), r)
            geometry.addGeometryObject(
                pin.GeometryObject(f"{name}_capsule_{count}", heading_joint, placement, shape)
            )
        if robot.arm is not None:
            model, geometry = _attach_arm(model, geometry, name, heading_joint, robot.arm)
    return model, geometry, first


def owner_index(name: str) -> int:
    """Return the index of the robot that a body belongs to."""
    return int(name.split("_")[1])


def _attach_arm(
    model: pin.Model,
    geometry: pin.GeometryModel,
    name: str,
    joint: int,
    arm: tuple[pin.Model, pin.GeometryModel],
) -> tuple[pin.Model, pin.GeometryModel]:
    """Attach an arm below a robot's heading, to model and geometry model."""
    arm_model, bodies = (part.copy() for part in arm)
    for index in range(1, arm_model.njoints):
        arm_model.names[index] = f"{name}_{arm_model.names[index]}"
    for frame in arm_model.frames:
        frame.name = f"{name}_{frame.name}"
    for item in bodies.geometryObjects:
        item.name = f"{name}_{item.name}"
    base = pin.Frame(f"{name}_base", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
    at = model.addFrame(base)
    combined: tuple[pin.Model, pin.GeometryModel] = pin.appendModel(
        model, arm_model, geometry, bodies, at, pin.SE3.Identity()
    )
    return combined


def _capsule_geometry(
    a: np.ndarray, b: np.ndarray, r: float
) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """Return geometry and placement of a capsule by the ends of its axis."""
    axis = b - a
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return coal.Sphere(r), pin.SE3(np.eye(3), a)
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis / length).matrix()
    return coal.Capsule(r, length), pin.SE3(rotation, 0.5 * (a + b))


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
