"""URDF files into `ForeignVehicle`; plugins for Gazebo in them are read by `plugins`."""

from dataclasses import replace

import numpy as np

from angler_mjx.errors import format_value
from angler_mjx.robot.importing import plugins
from angler_mjx.robot.importing.foreign_vehicle import (
    ForeignBody,
    ForeignVehicle,
    JointKind,
    JointLink,
    Shape,
    pose_of,
)
from angler_mjx.robot.importing.meshes import read_mesh_box
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.packages import Packages
from angler_mjx.robot.importing.xml_tree import Element

type _Rgba = tuple[float, float, float, float]

_KINDS: dict[str, JointKind] = {
    "fixed": "fixed",
    "revolute": "revolute",
    "prismatic": "prismatic",
    "continuous": "continuous",
    "floating": "other",
    "planar": "other",
}


def read_urdf(root: Element, packages: Packages, notes: Notes) -> ForeignVehicle:
    """Read the tree of a URDF file, expanded if it was xacro.

    Raises:
        ConfigError: a fault of the file; names file, line and element.
    """
    vehicle = ForeignVehicle(name=root.attribute("name"), format="URDF", location=root.location)
    colors = {
        material.attribute("name", ""): _read_color(material)
        for material in root.find_all("material")
    }
    for link in root.find_all("link"):
        body = _read_link(link, colors, packages, notes)
        if body.name in vehicle.bodies:
            link.fail("this name occurs twice; rename one of them")
        vehicle.bodies[body.name] = body
    for element in root.find_all("joint"):
        vehicle.joints.append(_read_joint(element, vehicle))
    for gazebo in root.find_all("gazebo"):
        gazebo.attribute("reference", "")
        plugins.read_plugins(gazebo, vehicle, notes)
    return vehicle


def read_origin(element: Element | None) -> np.ndarray:
    """Return the pose [4, 4] of an <origin>; the identity for None."""
    if element is None:
        return np.eye(4)
    zero = (0.0, 0.0, 0.0)
    return pose_of(
        element.attribute_numbers("xyz", 3, zero), element.attribute_numbers("rpy", 3, zero)
    )


def _read_color(material: Element) -> _Rgba | None:
    """Return the colour of a <material>; None where it has none, as with a texture."""
    color = material.find("color")
    if color is None:
        return None
    r, g, b, a = (min(max(x, 0.0), 1.0) for x in color.attribute_numbers("rgba", 4))
    return r, g, b, a


def _read_link(
    link: Element, colors: dict[str, _Rgba | None], packages: Packages, notes: Notes
) -> ForeignBody:
    body = ForeignBody(name=link.attribute("name"), element=link)
    inertial = link.find("inertial")
    if inertial is not None:
        _read_inertial(inertial, body)
    for tag, shapes in (("collision", body.shapes), ("visual", body.visuals)):
        for element in link.find_all(tag):
            element.attribute("name", "")
            shape = _read_shape(element, packages, notes)
            material = element.find("material") if tag == "visual" else None
            if material is not None:
                # A material is stated where it is first used, or named alone.
                name, color = material.attribute("name", ""), _read_color(material)
                colors.setdefault(name, color)
                color = color or colors[name]
                shape = shape if shape is None else replace(shape, rgba=color)
            if shape is not None:
                shapes.append(shape)
    return body


def _read_inertial(inertial: Element, body: ForeignBody) -> None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None:
        inertial.fail(f"link {format_value(body.name)} has no <mass>; add it or remove <inertial>")
    pose = read_origin(inertial.find("origin"))
    body.inertial = mass
    body.mass_kg = mass.attribute_number("value")
    body.center_of_mass_m = pose[:3, 3]
    if inertia is not None:
        body.inertial = inertia
        xx, xy, xz, yy, yz, zz = (
            inertia.attribute_number(name, 0.0 if name[1] != name[2] else None)
            for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body.inertia_kgm2 = pose[:3, :3] @ tensor @ pose[:3, :3].T


def _read_shape(element: Element, packages: Packages, notes: Notes) -> Shape | None:
    """Return the solid of a <collision> or <visual>; None where there is nothing to hold."""
    pose = read_origin(element.find("origin"))
    geometry = element.find("geometry")
    is_visual = element.tag == "visual"
    if geometry is None:
        element.fail("has no <geometry>; add it")
    for solid in geometry.find_all("box", "cylinder", "sphere", "capsule", "mesh"):
        match solid.tag:
            case "box":
                return Shape(
                    kind="box", size=solid.attribute_numbers("size", 3), pose=pose, element=solid
                )
            case "cylinder" | "capsule":
                size = (solid.attribute_number("radius"), solid.attribute_number("length"))
                return Shape(kind="cylinder", size=size, pose=pose, element=solid)
            case "sphere":
                radius = solid.attribute_number("radius")
                return Shape(kind="sphere", size=(radius,), pose=pose, element=solid)
        scale = solid.attribute_numbers("scale", 3, (1.0, 1.0, 1.0))
        return read_mesh(
            solid, solid.attribute("filename"), scale, pose, packages, notes, is_visual
        )
    element.fail("its <geometry> holds no box, cylinder, sphere or mesh; add one")


def read_mesh(
    element: Element,
    filename: str,
    scale: tuple[float, ...],
    pose: np.ndarray,
    packages: Packages,
    notes: Notes,
    is_visual: bool,
) -> Shape | None:
    """Return the box around the mesh of a collision; None for visuals and formats not read.

    Raises:
        ConfigError: the mesh of a collision is missing.
    """
    label = filename.rpartition("/")[2]
    if is_visual:
        notes.add(
            "dropped", f"mesh {label} of a visual: vehicle files hold no meshes", element.location
        )
        return None
    path = packages.locate(filename, element)
    if not path.is_file():
        element.fail(
            f"mesh {format_value(filename)}: there is no file {path}; add it, or write a box "
            "in its place"
        )
    corners = read_mesh_box(path)
    if corners is None:
        notes.add(
            "dropped",
            f"mesh {label} of a collision: only STL and OBJ are read; write a box for its hull",
            element.location,
        )
        return None
    low, high = np.sort(np.array(corners) * np.array(scale), axis=0)
    center = np.eye(4)
    center[:3, 3] = (low + high) / 2
    notes.add("converted", f"mesh {label} of a collision: the box around it", element.location)
    return Shape(kind="box", size=tuple((high - low).tolist()), pose=pose @ center, element=element)


def _read_joint(element: Element, vehicle: ForeignVehicle) -> JointLink:
    kind = element.attribute("type")
    if kind not in _KINDS:
        element.fail(f"type = {format_value(kind)}: write one of {', '.join(_KINDS)}")
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            element.fail(f"has no <{tag}>; add it")
        name = end.attribute("link")
        if name not in vehicle.bodies:
            end.fail(f"link = {format_value(name)}: there is no such link; correct the name")
        ends.append(name)
    axis = element.find("axis")
    xyz = (1.0, 0.0, 0.0) if axis is None else axis.attribute_numbers("xyz", 3)
    joint = JointLink(
        name=element.attribute("name"),
        kind=_KINDS[kind],
        file_kind=kind,
        parent=ends[0],
        child=ends[1],
        pose=read_origin(element.find("origin")),
        axis=np.array(xyz),
        element=element,
    )
    limit = element.find("limit")
    if limit is not None:
        joint.lower = limit.attribute_number("lower", 0.0)
        joint.upper = limit.attribute_number("upper", 0.0)
        joint.effort = limit.attribute_number("effort", 0.0)
        joint.velocity = limit.attribute_number("velocity", 0.0)
    mimic = element.find("mimic")
    if mimic is not None:
        mimic.read()
        joint.mimicked = mimic.attribute("joint")
    dynamics = element.find("dynamics")
    if dynamics is not None:
        joint.damping = dynamics.attribute_number("damping", 0.0)
        joint.friction = dynamics.attribute_number("friction", 0.0)
    return joint
