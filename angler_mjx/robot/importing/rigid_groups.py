"""Bodies of a foreign vehicle joined into rigid groups: the base, and the links of an arm."""

import re
from dataclasses import dataclass, field

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.robot.importing.foreign_vehicle import (
    ForeignBody,
    ForeignVehicle,
    JointLink,
    Shape,
    ThrusterMount,
)
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.vehicles.checks import SMALLEST

THRUSTER_NAME = re.compile(r"thruster|propell?er|(?:^|[_/])prop(?:$|[_0-9])", re.I)
_LIGHT = 0.01
"""Fraction of the vehicle's mass below which an impossible inertia is left out with a note."""
_TOLERANCE = 1e-6


@dataclass(kw_only=True)
class Group:
    """Bodies that no joint moves against each other."""

    root: str
    joint: JointLink | None
    """Joint that moves the group; None: the base."""
    parent: "Group | None"
    poses: dict[str, np.ndarray] = field(default_factory=dict)
    """[4, 4] poses of its bodies in the frame of ``root``."""
    mass_kg: float = 0.0
    center_of_mass_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia_kgm2: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """[3, 3] about the centre of mass, along the axes of ``root``."""


def is_named_thruster(joint: JointLink) -> bool:
    """Return whether a joint or its child has the name of a thruster."""
    return bool(THRUSTER_NAME.search(joint.name) or THRUSTER_NAME.search(joint.child))


def find_thrusters(vehicle: ForeignVehicle, notes: Notes) -> None:
    """Take links and joints with names of thrusters as thrusters, if no plugin names any.

    Raises:
        ConfigError: there are none.
    """
    if vehicle.thrusters:
        return
    for joint in vehicle.joints:
        if is_named_thruster(joint):
            is_fixed = joint.kind == "fixed"
            axis = np.array([1.0, 0.0, 0.0]) if is_fixed else joint.axis
            vehicle.thrusters.append(
                ThrusterMount(
                    name=joint.name,
                    body=joint.child,
                    position_m=np.zeros(3),
                    direction=axis,
                    element=joint.element,
                    joint=joint.name,
                )
            )
            notes.add(
                "assumed",
                "no plugin names thrusters: links and joints with thruster, propeller or prop in "
                "their name push along the "
                + ("x axis of their link" if is_fixed else "axis of their joint"),
                joint.element.location,
            )
    if not vehicle.thrusters:
        raise ConfigError(
            f"{vehicle.location.file}: no thruster: neither a thruster plugin nor a joint or link "
            "with thruster or propeller in its name; add one"
        )


def join_bodies(vehicle: ForeignVehicle, notes: Notes) -> list[Group]:
    """Return the rigid groups, the base first, parents before their children.

    Raises:
        ConfigError: joints form no tree, a body cannot exist, or a joint has no limits.
    """
    below = _find_tree(vehicle)
    root = _find_root(vehicle, below, notes)
    moving = {mount.body for mount in vehicle.thrusters}
    base = Group(root=root, joint=None, parent=None, poses={root: np.eye(4)})
    groups, rows = [base], [(root, base)]
    while rows:
        name, group = rows.pop(0)
        for joint in below.get(name, []):
            if _is_free(joint, vehicle, moving, notes):
                branch = Group(root=joint.child, joint=joint, parent=group)
                branch.poses[joint.child] = np.eye(4)
                groups.append(branch)
                rows.append((joint.child, branch))
            else:
                group.poses[joint.child] = group.poses[name] @ joint.pose
                rows.append((joint.child, group))
    notes.add(
        "assumed",
        f"axes of {root}: x forward, y left, z up; its origin is that of the base frame",
        vehicle.bodies[root].element.location,
    )
    total = sum(body.mass_kg for body in vehicle.bodies.values())
    for body in vehicle.bodies.values():
        _check_body(body, total, notes)
    for group in groups:
        _add_masses(group, vehicle)
    names = {name for group in groups for name in group.poses}
    for name in vehicle.bodies.keys() - names:
        notes.add(
            "dropped",
            f"link {name}: no joint joins it to {root}",
            vehicle.bodies[name].element.location,
        )
    return groups


def _find_tree(vehicle: ForeignVehicle) -> dict[str, list[JointLink]]:
    """Return joints by their parent."""
    below: dict[str, list[JointLink]] = {}
    parents: dict[str, JointLink] = {}
    for joint in vehicle.joints:
        if joint.child in parents:
            joint.element.fail(
                f"link {format_value(joint.child)} is the child of joint "
                f"{format_value(parents[joint.child].name)} already; loops are not read"
            )
        parents[joint.child] = joint
        below.setdefault(joint.parent, []).append(joint)
    for joint in vehicle.joints:
        name, steps = joint.parent, 0
        while name in parents:
            name, steps = parents[name].parent, steps + 1
            if steps > len(vehicle.joints):
                joint.element.fail("is in a loop of joints; every chain must end at one link")
    return below


def _find_root(vehicle: ForeignVehicle, below: dict[str, list[JointLink]], notes: Notes) -> str:
    children = {joint.child for joint in vehicle.joints}
    roots = [name for name in vehicle.bodies if name not in children]
    if vehicle.root is not None:
        return vehicle.root
    roots = [name for name in roots if below.get(name) or len(vehicle.bodies) == 1] or roots
    if not roots:
        raise ConfigError(f"{vehicle.location.file}: holds no links; give a file of a vehicle")
    if len(roots) > 1:
        vehicle.bodies[roots[1]].element.fail(
            f"{', '.join(roots[:4])} have no parent; join them by a fixed joint"
        )
    root = roots[0]
    body, joints = vehicle.bodies[root], below.get(root, [])
    if root == "world" and not body.mass_kg and len(joints) == 1:
        notes.add("dropped", f"joint {joints[0].name} to the world", joints[0].element.location)
        return joints[0].child
    return root


def _is_free(joint: JointLink, vehicle: ForeignVehicle, moving: set[str], notes: Notes) -> bool:
    """Return whether a joint moves a link of an arm; the others are fixed where they stand."""
    location = joint.element.location
    if joint.kind == "fixed":
        notes.add("converted", "fixed joints: their links are part of what carries them", location)
        return False
    if joint.child in moving:
        notes.add(
            "converted",
            f"{joint.file_kind} joints of thrusters: fixed, their links are part of the vehicle",
            location,
        )
        return False
    if joint.kind == "continuous" and is_named_thruster(joint):
        notes.add(
            "dropped",
            f"joint {joint.name} has the name of a thruster, but no plugin drives it: fixed",
            location,
        )
        return False
    if joint.mimicked is not None:
        notes.add(
            "dropped",
            f"joint {joint.name} follows {joint.mimicked}: vehicle files hold no such joints; "
            "fixed at 0",
            location,
        )
        return False
    if joint.child in vehicle.fins:
        notes.add("converted", f"joint {joint.name} of a fin: fixed at 0", location)
        return False
    if joint.kind == "other":
        joint.element.fail(
            f"type = {format_value(joint.file_kind)}: only fixed, revolute and prismatic joints "
            "are read; make it fixed"
        )
    if joint.kind == "continuous" or joint.lower is None or joint.upper is None:
        joint.element.fail(
            f"{joint.file_kind} joint {format_value(joint.name)} has no limits; write lower and "
            "upper, or make it fixed"
        )
    if joint.lower == joint.upper:
        notes.add("converted", "joints with equal limits: fixed", location)
        return False
    if joint.lower > joint.upper:
        joint.element.fail(f"lower = {joint.lower:g} is above upper = {joint.upper:g}; swap them")
    return True


def _check_body(body: ForeignBody, total_kg: float, notes: Notes) -> None:
    element = body.inertial or body.element
    if body.mass_kg < 0:
        element.fail(
            f"link {format_value(body.name)}: mass = {body.mass_kg:g}; it must be positive"
        )
    if body.mass_kg == 0:
        if np.any(body.inertia_kgm2 != 0):
            notes.add(
                "dropped", f"inertia of link {body.name}, which has no mass", element.location
            )
            body.inertia_kgm2 = np.zeros((3, 3))
        else:
            notes.add("converted", "links without mass: frames only", element.location)
        return
    low, middle, high = np.linalg.eigvalsh(body.inertia_kgm2)
    if low >= -_TOLERANCE * abs(high) and low + middle >= high * (1 - _TOLERANCE):
        return
    moments = f"{low:.4g}, {middle:.4g}, {high:.4g}"
    if body.mass_kg > _LIGHT * total_kg:
        element.fail(
            f"link {format_value(body.name)}: no rigid body has principal moments {moments}; none "
            "may be negative, and the two smaller ones must add up to at least the largest"
        )
    notes.add(
        "dropped",
        f"inertia of link {body.name}: no rigid body has principal moments {moments}; taken as a "
        "point",
        element.location,
    )
    body.inertia_kgm2 = np.zeros((3, 3))


def _add_masses(group: Group, vehicle: ForeignVehicle) -> None:
    """Set mass, centre of mass and inertia of a group from its bodies."""
    bodies = [(vehicle.bodies[name], pose) for name, pose in group.poses.items()]
    group.mass_kg = sum(body.mass_kg for body, _ in bodies)
    if group.mass_kg <= 0:
        element = vehicle.bodies[group.root].inertial or vehicle.bodies[group.root].element
        element.fail(
            f"link {format_value(group.root)} and what is fixed to it have no mass; write an "
            "<inertial> with mass and inertia"
        )
    centers = [(pose @ np.append(body.center_of_mass_m, 1.0))[:3] for body, pose in bodies]
    weighted = sum(
        (body.mass_kg * center for (body, _), center in zip(bodies, centers, strict=True)),
        np.zeros(3),
    )
    group.center_of_mass_m = weighted / group.mass_kg
    for (body, pose), center in zip(bodies, centers, strict=True):
        r = center - group.center_of_mass_m
        turned = pose[:3, :3] @ body.inertia_kgm2 @ pose[:3, :3].T
        group.inertia_kgm2 = (
            group.inertia_kgm2 + turned + body.mass_kg * (r @ r * np.eye(3) - np.outer(r, r))
        )
    if not np.linalg.eigvalsh(group.inertia_kgm2)[0] >= SMALLEST:
        root = vehicle.bodies[group.root]
        (root.inertial or root.element).fail(
            f"link {format_value(group.root)} and what is fixed to it have an inertia of zero "
            "about an axis; write positive ixx, iyy and izz"
        )


def shapes_of(
    group: Group, vehicle: ForeignVehicle, smallest_m: float, notes: Notes
) -> list[tuple[Shape, np.ndarray]]:
    """Return the collision shapes of a group with their poses [4, 4] in its frame."""
    found = []
    for name, pose in group.poses.items():
        for shape in vehicle.bodies[name].shapes:
            if min(shape.size) <= 0:
                shape.element.fail(f"size {list(shape.size)}: lengths must be positive")
            if np.linalg.norm(shape.half_extents_m) < smallest_m:
                notes.add("dropped", "collision shapes below 1 mm", shape.element.location)
            else:
                found.append((shape, pose @ shape.pose))
    return found
