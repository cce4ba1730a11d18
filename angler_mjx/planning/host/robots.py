"""Robots as joints and bodies of Pinocchio.

Each robot is two joints, its place (x, y, z) and its heading, and below them whatever bodies it
has: the capsules of its hull and, where it has one, an arm with joints of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from angler_mjx._moved import renamed as _renamed
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.link_hull import ON_BASE, LinkCapsules
from angler_mjx.robot.vehicles.link_params import LinkParams, mount_m, rotation_matrix
from angler_mjx.robot.vehicles.links import BASE, Joint
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.posture import hull_capsules

TIP = "end_effector"
"""Frame of the end effector of an arm."""


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
        cls,
        vehicle: VehicleParams,
        arm: tuple[pin.Model, pin.GeometryModel] | None = None,
        joints: Sequence[float] | None = None,
    ) -> Self:
        """Build the hull of a vehicle file, with an arm or without.

        Args:
            vehicle: its own links are part of the hull in one posture, unless there is an ``arm``.
            arm: that moves, as `build_arm` builds it from a vehicle file.
            joints: [J] the posture, rad or m; home if left out.
        """
        posture = None
        if vehicle.links is not None and arm is None:
            posture = jnp.asarray(vehicle.links.home if joints is None else joints)[None]
        one = jax.tree.map(lambda leaf: np.asarray(leaf)[None], vehicle)
        a, b, r = (np.asarray(part, float)[0] for part in hull_capsules(one, posture))
        return cls(capsule_a_m=a, capsule_b_m=b, capsule_r_m=r, arm=arm)

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


def build_arm(config: VehicleConfig) -> tuple[pin.Model, pin.GeometryModel]:
    """Return the links of a vehicle file as an arm: `PlannedRobot.arm`.

    Joints are named ``joint/NAME`` and have the limits of the file and its order in q; bodies are
    named ``link/NAME/M``.
    """
    model, geometry = pin.Model(), pin.GeometryModel()
    tables = {joint.name: joint for joint in config.joints}
    at = {BASE: (0, pin.SE3.Identity())}
    for link in config.find_links(None):
        joint, placement = at[link.parent]
        placement = placement * pin.SE3(rotation_matrix(link.rpy_rad), mount_m(config, link))
        if link.joint is not None:
            joint = _add_joint(model, joint, placement, tables[link.joint])
            placement = pin.SE3.Identity()
        at[link.name] = joint, placement
        for count, capsule in enumerate(link.capsules):
            ends = np.array(capsule.from_m), np.array(capsule.to_m)
            shape, in_link = _capsule_geometry(*ends, capsule.radius_m)
            name = f"link/{link.name}/{count + 1}"
            # Of a body on the base appendModel reads the frame, which has no default.
            frame = model.getFrameId(model.names[joint])
            geometry.addGeometryObject(
                pin.GeometryObject(name, joint, frame, placement * in_link, shape)
            )
    return model, geometry


def team_arms(problem: Problem) -> list[tuple[pin.Model, pin.GeometryModel]]:
    """Return the arms of the team of a problem, as `build_arm` makes them.

    Bodies are named ``link/L/M`` by the number of the link. Frame `TIP` is that of the end
    effector, where there is one.

    Raises:
        ValueError: no robot has links.
    """
    arms = problem.team.arms
    if arms is None:
        raise ValueError("no robot of the team has links")
    rows: list[tuple[LinkParams, LinkCapsules]] = [
        jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], (arms.links, arms.capsules))
        for i in range(problem.robots)
    ]
    return [_build_links(links, capsules, problem.joint_names) for links, capsules in rows]


def _build_links(
    links: LinkParams, capsules: LinkCapsules, names: Sequence[str]
) -> tuple[pin.Model, pin.GeometryModel]:
    """Return links of a robot as an arm; one without mass has no bodies."""
    model, geometry, tree = pin.Model(), pin.GeometryModel(), links.tree
    at = {ON_BASE: (0, pin.SE3.Identity())}
    for link, (parent, j) in enumerate(zip(tree.parents, tree.joints, strict=True)):
        joint, placement = at[parent]
        mount = pin.SE3(_rotation(links.rotation[link]), np.asarray(links.position_m[link], float))
        placement = placement * mount
        if j >= 0:
            joint = _add_param_joint(model, joint, placement, links, j, f"joint/{names[j]}")
            placement = pin.SE3.Identity()
        at[link] = joint, placement
    if tree.end_effector >= 0:
        joint, placement = at[tree.end_effector]
        tip = pin.SE3(
            _rotation(links.end_effector_rotation), np.asarray(links.end_effector_m, float)
        )
        model.addFrame(pin.Frame(TIP, joint, 0, placement * tip, pin.FrameType.OP_FRAME))
    for count, link in enumerate(np.asarray(capsules.link)):
        if link == ON_BASE:
            continue  # padding
        joint, placement = at[int(link)]
        a, b = (np.asarray(end, float)[count] for end in (capsules.a_m, capsules.b_m))
        shape, in_link = _capsule_geometry(a, b, float(capsules.r_m[count]))
        frame = model.getFrameId(model.names[joint])
        name = f"link/{link}/{count + 1}"
        geometry.addGeometryObject(
            pin.GeometryObject(name, joint, frame, placement * in_link, shape)
        )
    return model, geometry


def _rotation(matrix: ArrayLike) -> np.ndarray:
    """Return a rotation [3, 3] of float32 as one of float64."""
    left, _, right = np.linalg.svd(np.asarray(matrix, float))
    rotation: np.ndarray = left @ right
    return rotation


def _add_param_joint(
    model: pin.Model, parent: int, placement: pin.SE3, links: LinkParams, j: int, name: str
) -> int:
    """Add joint ``j`` of a robot; see `_add_bounded_joint`."""
    axis = np.asarray(links.axis, float)[j]
    numbers = (links.max_effort, links.max_speed, links.lower, links.upper)
    bounds = [np.asarray(values, float)[j : j + 1] for values in numbers]
    slides, zero = links.tree.slides[j], float(links.zero[j])
    return _add_bounded_joint(
        model, parent, placement, axis / np.linalg.norm(axis), slides, zero, name, bounds
    )


def _add_joint(model: pin.Model, parent: int, placement: pin.SE3, joint: Joint) -> int:
    """Add the joint of a vehicle file; see `_add_bounded_joint`."""
    numbers = (joint.actuator.max_effort, joint.actuator.max_speed, joint.lower, joint.upper)
    bounds = [np.array([number]) for number in numbers]
    slides = joint.type == "prismatic"
    name = f"joint/{joint.name}"
    return _add_bounded_joint(
        model, parent, placement, np.array(joint.axis), slides, joint.zero, name, bounds
    )


def _add_bounded_joint(
    model: pin.Model,
    parent: int,
    placement: pin.SE3,
    axis: np.ndarray,
    slides: bool,
    zero: float,
    name: str,
    bounds: Sequence[np.ndarray],
) -> int:
    """Add a joint whose link lies at ``placement`` at the position ``zero``.

    Args:
        model: of the arm.
        parent: joint that carries it.
        placement: of the link.
        axis: [3] unit vector, in the link's frame.
        slides: whether the joint is prismatic.
        zero: position at which the link lies so, rad or m.
        name: of the joint.
        bounds: [1] each: effort, speed, lower and upper limit.
    """
    if slides:
        kind = pin.JointModelPrismaticUnaligned(axis)
        back = pin.SE3(np.eye(3), -zero * axis)
    else:
        kind = pin.JointModelRevoluteUnaligned(axis)
        back = pin.SE3(pin.AngleAxis(-zero, axis).matrix(), np.zeros(3))
    number = int(model.addJoint(parent, kind, placement * back, name, *bounds))
    model.addJointFrame(number)
    return number


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


def arm_reach_m(model: pin.Model, geometry: pin.GeometryModel, count: int) -> np.ndarray:
    """Return bounds [count] of the distance of bodies' origins from their robots' centres.

    Those of arms in any posture: the lengths between joints added up. 0 for bodies of hulls.
    """
    reach = np.zeros(count)
    for body, item in enumerate(geometry.geometryObjects[:count]):
        length, joint = float(np.linalg.norm(item.placement.translation)), item.parentJoint
        while not model.names[joint].endswith("_heading"):
            offset = np.linalg.norm(model.jointPlacements[joint].translation)
            length, joint = length + float(offset) + _travel_m(model, joint), model.parents[joint]
            reach[body] = length
    return reach


def _travel_m(model: pin.Model, joint: int) -> float:
    """Return how far a joint moves its link from the neutral posture; 0 of one that turns."""
    if "Prismatic" not in model.joints[joint].shortname():
        return 0.0
    row = model.joints[joint].idx_q
    limits = model.lowerPositionLimit[row], model.upperPositionLimit[row]
    return float(np.max(np.abs(limits)))


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
