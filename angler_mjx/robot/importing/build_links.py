"""Links and joints of an arm, from groups of bodies that joints move."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from angler_mjx.errors import format_value
from angler_mjx.robot.importing.cover import capsule_table, cover_shape
from angler_mjx.robot.importing.foreign_vehicle import (
    ForeignVehicle,
    JointLink,
    Shape,
    roll_pitch_yaw,
)
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.numbers import (
    SMALLEST_SHAPE_M,
    inertia_rows,
    round_number,
    round_vector,
    source_of,
    to_name,
)
from angler_mjx.robot.importing.rigid_groups import Group, shapes_of

MAX_JOINTS, MAX_CYLINDERS, MAX_CAPSULES = 6, 16, 16
"""As in vehicle files."""
NORMAL_DRAG, AXIAL_DRAG, ADDED_MASS = 1.1, 0.01, 1.0
"""Coefficients of a long circular cylinder."""
_STIFFNESS, _DAMPING = {"revolute": 4.5, "prismatic": 2000.0}, {"revolute": 0.25, "prismatic": 0.05}
"""Stiffness of a servo over its effort, and damping over its stiffness: as those of the shipped
arm."""
_SPEED, _EFFORT = 0.5, 10.0
MAX_EFFORT = 1e4
"""Max effort of a joint, N m or N; files write 1e6 for none."""
_GRIPPER = re.compile(r"grip|finger|jaw|claw", re.I)


def build_arm(vehicle: ForeignVehicle, groups: Sequence[Group], notes: Notes) -> dict[str, Any]:
    """Return the tables links and joints; empty for a vehicle without an arm.

    Args:
        vehicle: as read.
        groups: the base first.
        notes: list to add to.

    Raises:
        ConfigError: there are more joints than a vehicle file holds.
    """
    moved = groups[1:]
    if not moved:
        return {}
    if len(moved) > MAX_JOINTS:
        joint = moved[MAX_JOINTS].joint
        assert joint is not None
        joint.element.fail(
            f"joint {format_value(joint.name)}: vehicle files hold {MAX_JOINTS} joints, this file "
            f"has {len(moved)}; make the others fixed"
        )
    names = {id(group): to_name(group.root.rpartition("/")[2]) for group in moved}
    links, joints = [], []
    for group in moved:
        assert group.joint is not None
        assert group.parent is not None
        location = group.joint.element.location
        pose = group.parent.poses[group.joint.parent] @ group.joint.pose
        if np.any(group.joint.axis_offset_m):
            group.joint.element.fail(
                "its axis does not pass through the origin of its child; move "
                "the child's frame there"
            )
        shapes = shapes_of(group, vehicle, SMALLEST_SHAPE_M, notes)
        link = {
            "name": names[id(group)],
            **({} if group.parent is groups[0] else {"parent": names[id(group.parent)]}),
            "joint": to_name(group.joint.name.rpartition("/")[2]),
            "position_m": round_vector(pose[:3, 3]),
            "rpy_rad": round_vector(np.array(roll_pitch_yaw(pose[:3, :3]))),
            **_build_capsules(shapes, notes),
            "source": str(location),
            "rigid_body": {
                "mass_kg": round_number(group.mass_kg),
                "center_of_mass_m": round_vector(group.center_of_mass_m),
                "inertia_kgm2": inertia_rows(group.inertia_kgm2),
                "source": source_of("mass and inertia of", vehicle, group),
            },
            "buoyancy": _build_buoyancy(vehicle, group, shapes, group.joint, notes),
            "water": _build_water(shapes, group.joint, notes),
        }
        links.append(link)
        joints.append(_build_joint(group.joint, notes))
    notes.add("assumed", "arm: no end effector; name one as [end_effector]")
    return {"links": links, "joints": joints}


def _build_capsules(shapes: Sequence[tuple[Shape, np.ndarray]], notes: Notes) -> dict[str, Any]:
    capsules = [capsule for shape, pose in shapes for capsule in cover_shape(shape, pose)]
    if not capsules:
        return {}
    notes.add(
        "converted",
        "collision shapes of links: capsules of their extents or more",
        *(shape.element.location for shape, _ in shapes),
    )
    if len(capsules) > MAX_CAPSULES:
        notes.add(
            "dropped",
            f"capsules of a link after the first {MAX_CAPSULES}",
            shapes[-1][0].element.location,
        )
    return {"capsules": [capsule_table(capsule) for capsule in capsules[:MAX_CAPSULES]]}


def _build_buoyancy(
    vehicle: ForeignVehicle,
    group: Group,
    shapes: Sequence[tuple[Shape, np.ndarray]],
    joint: JointLink,
    notes: Notes,
) -> dict[str, Any]:
    bodies = [(vehicle.bodies[name], pose) for name, pose in group.poses.items()]
    parts = [
        (
            body.volume_m3,
            (pose @ np.append(_first(body.center_of_buoyancy_m, body.center_of_mass_m), 1.0))[:3],
        )
        for body, pose in bodies
        if body.volume_m3
    ]
    if not parts:
        parts = [(shape.volume_m3, pose[:3, 3]) for shape, pose in shapes]
        notes.add(
            "assumed",
            "displaced volume of links: that of their collision shapes; none where there are none",
            joint.element.location,
        )
    volume = sum(part for part, _ in parts)
    center = (
        sum((part * point for part, point in parts), np.zeros(3)) / volume
        if volume
        else (group.center_of_mass_m)
    )
    return {
        "volume_m3": round_number(volume),
        "center_of_buoyancy_m": round_vector(center),
        "source": source_of("volumes of", vehicle, group),
    }


def _first(*values: np.ndarray | None) -> np.ndarray:
    return next(value for value in values if value is not None)


def _build_water(
    shapes: Sequence[tuple[Shape, np.ndarray]], joint: JointLink, notes: Notes
) -> dict[str, Any]:
    """Return the table of cylinders: each shape as one along its longest edge."""
    if len(shapes) > MAX_CYLINDERS:
        notes.add(
            "dropped",
            f"drag and added mass of the shapes of a link after the first {MAX_CYLINDERS}",
            shapes[-1][0].element.location,
        )
    cylinders = []
    for shape, pose in shapes[:MAX_CYLINDERS]:
        half = shape.half_extents_m
        axis = int(np.argmax(half))
        along = pose[:3, axis] * max(half[axis], 1e-3)
        cylinders.append(
            {
                "from_m": round_vector(pose[:3, 3] - along),
                "to_m": round_vector(pose[:3, 3] + along),
                "radius_m": round_number(float(np.delete(half, axis).mean())),
                "normal_drag": NORMAL_DRAG,
                "axial_drag": AXIAL_DRAG,
                "added_mass": ADDED_MASS,
            }
        )
    notes.add(
        "assumed",
        f"drag and added mass of links: their shapes as cylinders, with {NORMAL_DRAG:g} across, "
        f"{AXIAL_DRAG:g} along and {ADDED_MASS:g} of the displaced water",
        joint.element.location,
    )
    return {"cylinders": cylinders, "source": "assumed: collision shapes as long cylinders"}


def _build_joint(joint: JointLink, notes: Notes) -> dict[str, Any]:
    location = joint.element.location
    lower, upper = joint.lower or 0.0, joint.upper or 0.0
    speed, effort = joint.velocity or 0.0, joint.effort or 0.0
    if speed <= 0:
        notes.add("assumed", f"speed of joints that state none: {_SPEED:g} rad/s or m/s", location)
    if effort <= 0:
        notes.add("assumed", f"effort of joints that state none: {_EFFORT:g} N m or N", location)
    if effort > MAX_EFFORT:
        notes.add(
            "converted",
            f"effort {effort:g} of joint {joint.name}: {MAX_EFFORT:g}, the most that is taken over",
            location,
        )
        effort = MAX_EFFORT
    speed, effort = (speed if speed > 0 else _SPEED), (effort if effort > 0 else _EFFORT)
    stiffness = _STIFFNESS[joint.kind] * effort
    notes.add(
        "assumed",
        "servos of joints: stiffness and damping over effort as those of the shipped arm",
        location,
    )
    home = min(max(0.0, lower), upper)
    if home != 0:
        notes.add(
            "assumed", f"home of joint {joint.name}: {home:g}, its limit nearest to 0", location
        )
    is_gripper = bool(_GRIPPER.search(joint.name))
    if is_gripper:
        notes.add("assumed", f"joint {joint.name} is a gripper's, by its name", location)
    length = float(np.linalg.norm(joint.axis))
    if not length > 1e-9:
        joint.element.fail("its axis has length zero; write a unit vector")
    return {
        "name": to_name(joint.name.rpartition("/")[2]),
        "type": joint.kind,
        "axis": round_vector(joint.axis / length, 16),
        "lower": lower,
        "upper": upper,
        "home": home,
        **({"is_gripper": True} if is_gripper else {}),
        "source": str(location),
        "actuator": {
            "max_speed": speed,
            "max_effort": effort,
            "stiffness": stiffness,
            "damping": stiffness * _DAMPING[joint.kind],
            "viscous_friction": max(joint.damping, 0.0),
            "coulomb_friction": max(joint.friction, 0.0),
            "source": f"{location}: limits; stiffness and damping assumed",
        },
    }
