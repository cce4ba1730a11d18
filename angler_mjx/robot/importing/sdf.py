"""SDF files into `ForeignVehicle`; plugins of Gazebo in them are read by `plugins`."""

from dataclasses import dataclass, field

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.robot.importing import plugins
from angler_mjx.robot.importing.foreign_vehicle import (
    ForeignBody,
    ForeignVehicle,
    Hydrodynamics,
    JointKind,
    JointLink,
    Shape,
    invert_pose,
    pose_of,
    quaternion_pose,
)
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.packages import Packages
from angler_mjx.robot.importing.urdf import read_mesh
from angler_mjx.robot.importing.xml_tree import Element, read_xml

_KINDS: dict[str, JointKind] = {
    "fixed": "fixed",
    "revolute": "revolute",
    "prismatic": "prismatic",
    "continuous": "continuous",
    "ball": "other",
    "universal": "other",
    "screw": "other",
    "revolute2": "other",
    "gearbox": "other",
}
_AXES = "xyzpqr"
_ENDLESS = 1e15
"""Limits beyond it are none: SDF's default is 1e16."""
MAX_MODELS = 20
"""Max depth of models in models."""


@dataclass(eq=False)
class _Frame:
    """Named frame: its pose in another one."""

    pose: np.ndarray
    relative_to: str
    element: Element


@dataclass(eq=False)
class _Reader:
    """Links, joints and frames of the models of a file."""

    vehicle: ForeignVehicle
    packages: Packages
    notes: Notes
    version: float
    frames: dict[str, _Frame] = field(default_factory=dict)
    joints: list[tuple[Element, str]] = field(default_factory=list)
    models: list[Element] = field(default_factory=list)

    def add_model(self, model: Element, prefix: str, frame: str, level: int) -> None:
        """Add the links, joints and frames of a model, in its frame of that name."""
        if level > MAX_MODELS:
            model.fail("models hold each other without end; break the cycle of includes")
        self.models.append(model)
        for link in model.find_all("link"):
            self._add_link(link, prefix, frame)
        for tag in ("frame", "joint"):
            for element in model.find_all(tag):
                name = prefix + element.attribute("name")
                pose, base = _read_pose(element)
                if tag == "frame":
                    attached = element.attribute("attached_to", "")
                    base = base or attached
                else:
                    self.joints.append((element, prefix))
                    child = element.find("child")
                    if child is None:
                        element.fail("has no <child>; add it")
                    base = base or child.text.strip()
                self.frames[name] = _Frame(pose, prefix + base if base else frame, element)
        for nested in model.find_all("model"):
            inner = prefix + nested.attribute("name") + "::"
            self._nest(nested, nested, prefix, inner, frame, level)
        for include in model.find_all("include"):
            self._include(include, prefix, frame, level)
        for tag in ("static", "enable_wind", "self_collide", "allow_auto_disable", "plugin"):
            if tag != "plugin":
                self._note_flag(model, tag)

    def _note_flag(self, model: Element, tag: str) -> None:
        element = model.find(tag)
        if element is not None and element.text.strip().lower() not in ("", "0", "false"):
            self.notes.add("dropped", f"<{tag}> = {element.text.strip()}", element.location)

    def _nest(
        self, model: Element, holder: Element, prefix: str, inner: str, frame: str, level: int
    ) -> None:
        pose, base = _read_pose(holder)
        name = inner + "__model__"
        self.frames[name] = _Frame(pose, prefix + base if base else frame, holder)
        self.add_model(model, inner, name, level + 1)

    def _include(self, include: Element, prefix: str, frame: str, level: int) -> None:
        uri = include.find("uri")
        if uri is None:
            include.fail("has no <uri>; add it")
        text = uri.text.strip()
        name = text if "://" in text or "/" in text else f"model://{text}"
        path = self.packages.locate(name, uri)
        if path.is_dir():
            path = path / "model.sdf"
        if not path.is_file():
            uri.fail(f"{format_value(text)}: there is no file {path}; add it")
        root = read_xml(path)
        root.read_attributes.update(root.attributes)
        model = root.find("model")
        if model is None:
            uri.fail(f"{path} holds no <model>; name a file that does")
        is_merged = include.attribute("merge", "false").lower() in ("1", "true")
        label = include.find("name")
        title = model.attribute("name") if label is None else label.text.strip()
        self._nest(
            model, include, prefix, prefix if is_merged else f"{prefix}{title}::", frame, level
        )

    def _add_link(self, link: Element, prefix: str, frame: str) -> None:
        name = prefix + link.attribute("name")
        if name in self.vehicle.bodies:
            link.fail("this name occurs twice; rename one of them")
        pose, base = _read_pose(link)
        self.frames[name] = _Frame(pose, prefix + base if base else frame, link)
        body = ForeignBody(name=name, element=link)
        self.vehicle.bodies[name] = body
        inertial = link.find("inertial")
        if inertial is None:
            body.mass_kg, body.inertia_kgm2 = 1.0, np.eye(3)
            self.notes.add(
                "assumed",
                "links without <inertial>: 1 kg and 1 kg m^2, SDF's default",
                link.location,
            )
        else:
            self._read_inertial(inertial, body)
        for tag, shapes in (("collision", body.shapes), ("visual", body.visuals)):
            for element in link.find_all(tag):
                element.attribute("name", "")
                shape = self._read_shape(element)
                if shape is not None:
                    shapes.append(shape)

    def _read_inertial(self, inertial: Element, body: ForeignBody) -> None:
        if inertial.attribute("auto", "false").lower() in ("1", "true"):
            inertial.fail('auto="true" is not computed; write mass and inertia')
        pose, _ = _read_pose(inertial)
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        body.inertial = inertial
        body.mass_kg = 1.0 if mass is None else mass.number()
        if mass is None or inertia is None:
            self.notes.add(
                "assumed",
                "mass 1 kg or inertia 1 kg m^2, SDF's default, where <inertial> leaves it out",
                inertial.location,
            )
        body.center_of_mass_m = pose[:3, 3]
        tensor = np.eye(3)
        if inertia is not None:
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
                entry = inertia.find(f"i{'xyz'[i]}{'xyz'[j]}")
                value = float(i == j) if entry is None else entry.number()
                tensor[i, j] = tensor[j, i] = value
        body.inertia_kgm2 = pose[:3, :3] @ tensor @ pose[:3, :3].T
        added = inertial.find("fluid_added_mass")
        if added is not None:
            self._read_added_mass(added, body)

    def _read_added_mass(self, element: Element, body: ForeignBody) -> None:
        matrix = np.zeros((6, 6))
        for i in range(6):
            for j in range(i, 6):
                entry = element.find(_AXES[i] + _AXES[j])
                if entry is not None:
                    matrix[i, j] = matrix[j, i] = entry.number()
        self.vehicle.hydrodynamics.append(
            Hydrodynamics(body=body.name, element=element, added_mass=matrix)
        )
        self.notes.add(
            "converted",
            "<fluid_added_mass>: positive as in vehicle files, at the origin of its link",
            element.location,
        )

    def _read_shape(self, element: Element) -> Shape | None:
        pose, _ = _read_pose(element)
        geometry = element.find("geometry")
        if geometry is None:
            element.fail("has no <geometry>; add it")
        for solid in geometry.find_all("box", "cylinder", "sphere", "capsule", "mesh"):
            numbers = {child.tag: child for child in solid.find_all("size", "radius", "length")}
            match solid.tag:
                case "box" if "size" in numbers:
                    size = numbers["size"].numbers(3)
                    return Shape(kind="box", size=size, pose=pose, element=solid)
                case "cylinder" | "capsule" if {"radius", "length"} <= numbers.keys():
                    size = (numbers["radius"].number(), numbers["length"].number())
                    return Shape(kind="cylinder", size=size, pose=pose, element=solid)
                case "sphere" if "radius" in numbers:
                    size = (numbers["radius"].number(),)
                    return Shape(kind="sphere", size=size, pose=pose, element=solid)
                case "mesh":
                    uri, scale = solid.find("uri"), solid.find("scale")
                    if uri is None:
                        solid.fail("has no <uri>; add it")
                    factors = (1.0, 1.0, 1.0) if scale is None else scale.numbers(3)
                    return read_mesh(
                        uri,
                        uri.text.strip(),
                        factors,
                        pose,
                        self.packages,
                        self.notes,
                        element.tag == "visual",
                    )
            solid.fail("lacks its size, radius or length; add it")
        kinds = ", ".join(f"<{child.tag}>" for child in geometry.read().children)
        self.notes.add(
            "dropped",
            f"geometry {kinds or 'without shape'} of a {element.tag}: box, "
            "cylinder, sphere and mesh are read",
            element.location,
        )
        return None

    def pose_in_model(self, name: str, element: Element) -> np.ndarray:
        """Return the pose [4, 4] of a frame in the outermost model.

        Raises:
            ConfigError: there is no such frame, or frames are relative to each other in a loop.
        """
        pose = np.eye(4)
        for _ in range(len(self.frames) + 1):
            short = name.rpartition("::")[2]
            if name == "" or short == "world":
                return pose
            frame = self.frames.get(name)
            if frame is None and short == "__model__":
                return pose
            if frame is None:
                element.fail(f"frame {format_value(name)} does not exist; correct the name")
            pose = frame.pose @ pose
            name = frame.relative_to
        element.fail("frames are relative to each other in a loop; break it")

    def add_joints(self) -> None:
        """Add the joints, once all frames are there."""
        for element, prefix in self.joints:
            self._add_joint(element, prefix)

    def _add_joint(self, element: Element, prefix: str) -> None:
        kind = element.attribute("type")
        if kind not in _KINDS:
            element.fail(f"type = {format_value(kind)}: write one of {', '.join(_KINDS)}")
        ends = []
        for tag in ("parent", "child"):
            end = element.find(tag)
            if end is None:
                element.fail(f"has no <{tag}>; add it")
            name = end.text.strip()
            if name == "world":
                self.notes.add(
                    "dropped", f"joint {element.attribute('name')} to the world", element.location
                )
                element.read()
                return
            body = self._find_body(prefix + name)
            if body is None:
                end.fail(f"{format_value(name)}: there is no such link; correct the name")
            ends.append(body)
        parent, child = (self.pose_in_model(name, element) for name in ends)
        name = prefix + element.attribute("name")
        frame = invert_pose(child) @ self.pose_in_model(name, element)
        axis = element.find("axis")
        joint = JointLink(
            name=name,
            kind=_KINDS[kind],
            file_kind=kind,
            parent=ends[0],
            child=ends[1],
            pose=invert_pose(parent) @ child,
            axis=np.array([0.0, 0.0, 1.0]),
            axis_offset_m=np.where(np.abs(frame[:3, 3]) < 1e-9, 0.0, frame[:3, 3]),
            element=element,
        )
        if axis is not None:
            self._read_axis(axis, joint, child, frame, prefix)
        self.vehicle.joints.append(joint)

    def _read_axis(
        self, axis: Element, joint: JointLink, child: np.ndarray, frame: np.ndarray, prefix: str
    ) -> None:
        xyz = axis.find("xyz")
        vector, turn = np.array([0.0, 0.0, 1.0]), frame[:3, :3]
        if xyz is not None:
            vector = np.array(xyz.numbers(3))
            base = xyz.attribute("expressed_in", "")
            if base:
                turn = child[:3, :3].T @ self.pose_in_model(prefix + base, xyz)[:3, :3]
        old = axis.find("use_parent_model_frame")
        in_model = self.version < 1.5 if old is None else old.text.strip() in ("1", "true")
        if in_model:
            turn = child[:3, :3].T
            self.notes.add("converted", "axes of joints in the frame of the model", axis.location)
        joint.axis = turn @ vector
        mimic = axis.find("mimic")
        if mimic is not None:
            mimic.read()
            joint.mimicked = mimic.attribute("joint")
        limit, dynamics = axis.find("limit"), axis.find("dynamics")
        for name in ("lower", "upper", "effort", "velocity"):
            entry = None if limit is None else limit.find(name)
            if entry is not None:
                value = (
                    float(entry.text)
                    if entry.text.strip().lower().endswith("inf")
                    else (entry.number())
                )
                if abs(value) < _ENDLESS:
                    setattr(joint, name, value)
        if dynamics is not None:
            for name in ("damping", "friction"):
                entry = dynamics.find(name)
                if entry is not None:
                    setattr(joint, name, entry.number())

    def _find_body(self, name: str) -> str | None:
        """Return the link of a name, or that of the frame of it."""
        for _ in range(len(self.frames) + 1):
            if name in self.vehicle.bodies:
                return name
            frame = self.frames.get(name)
            if frame is None:
                return None
            name = frame.relative_to
        return None


def read_sdf(root: Element, packages: Packages, notes: Notes) -> ForeignVehicle:
    """Read the tree of an SDF file.

    Raises:
        ConfigError: a fault of the file; names file, line and element.
    """
    try:
        version = float(root.attribute("version", "1.6"))
    except ValueError:
        root.fail(f"version = {format_value(root.attributes['version'])}: write a number")
    worlds = root.find_all("world")
    holder = worlds[0] if worlds else root
    holder.attribute("name", "")
    model = _find_model(holder)
    vehicle = ForeignVehicle(
        name=model.attribute("name"), format=f"SDF {version:g}", location=root.location
    )
    reader = _Reader(vehicle, packages, notes, version)
    pose, _ = _read_pose(model)
    if np.any(np.abs(pose - np.eye(4)) > 1e-12):
        notes.add("dropped", "pose of the model in the world", model.location)
    reader.add_model(model, "", "", 0)
    reader.add_joints()
    if worlds:
        plugins.read_plugins(holder, vehicle, notes)
    for each in reader.models:
        plugins.read_plugins(each, vehicle, notes)
    return vehicle


def _find_model(holder: Element) -> Element:
    models = [child for child in holder.children if child.tag == "model"]
    driven = [model for model in models if any(child.tag == "plugin" for child in model.children)]
    chosen = driven if len(models) > 1 else models
    if not models:
        raise ConfigError(
            f"{holder.location.file}:{holder.location.line}: <{holder.tag}> holds no <model>; give "
            "the file of the model"
        )
    if len(chosen) != 1:
        models[1].fail(
            f"the file holds {len(models)} models, {len(driven)} of them with plugins; give a file "
            "with one vehicle"
        )
    chosen[0].is_read = True
    return chosen[0]


def _read_pose(holder: Element) -> tuple[np.ndarray, str]:
    """Return the pose [4, 4] of an element, and the frame that it is in; "" for the default."""
    element = holder.find("pose")
    if element is None:
        return np.eye(4), ""
    base = element.attribute("relative_to", element.attribute("frame", ""))
    layout = element.attribute("rotation_format", "euler_rpy")
    scale = np.pi / 180 if element.attribute("degrees", "false").lower() in ("1", "true") else 1.0
    if not element.text.strip():
        return np.eye(4), base
    if layout == "quat_xyzw":
        *position, x, y, z, w = element.numbers(7)
        return quaternion_pose(tuple(position), (w, x, y, z)), base
    values = element.numbers(6)
    return pose_of(values[:3], tuple(scale * x for x in values[3:])), base
