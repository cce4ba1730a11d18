"""MJCF files into `ForeignVehicle`: compiled by MuJoCo, with lines by the names of elements.

MuJoCo resolves defaults, angles, frames and inertias from shapes. A thruster is an actuator that
pushes at a site.
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.importing.foreign_vehicle import (
    ForeignBody,
    ForeignVehicle,
    JointLink,
    Shape,
    ThrusterMount,
    quaternion_pose,
)
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.packages import Packages
from angler_mjx.robot.importing.rigid_groups import THRUSTER_NAME
from angler_mjx.robot.importing.xml_tree import Element, read_xml

_POSE = {"name", "class", "childclass", "pos", "quat", "euler", "axisangle", "xyaxes", "zaxis"}
_GEOM = {"type", "size", "fromto", "mesh", "mass", "density", "rgba", "contype", "conaffinity",
         "group", "material", "shellinertia", "fitscale"}  # fmt: skip
_JOINT = {"type", "axis", "range", "limited", "damping", "frictionloss", "ref", "actuatorfrcrange",
          "actuatorfrclimited", "armature"}  # fmt: skip
_ACTUATOR = {"site", "gear", "ctrlrange", "ctrllimited", "forcerange", "forcelimited", "gainprm",
             "dyntype", "dynprm", "gaintype", "biastype", "kp", "joint"}  # fmt: skip
_READ: dict[str, set[str]] = {
    "worldbody": set(),
    "body": _POSE | {"gravcomp"},
    "frame": _POSE,
    "inertial": {*_POSE, "mass", "diaginertia", "fullinertia"},
    "geom": _POSE | _GEOM,
    "joint": _POSE | _JOINT,
    "freejoint": {"name"},
    "site": _POSE | {"size", "type", "rgba", "group"},
    "actuator": set(),
    "general": {"name", "class"} | _ACTUATOR,
    "motor": {"name", "class"} | _ACTUATOR,
    "option": {"density"},
    "compiler": {"angle", "eulerseq", "meshdir", "assetdir", "texturedir", "autolimits",
                 "coordinate", "inertiafromgeom", "balanceinertia", "boundmass", "boundinertia",
                 "settotalmass"},
    "default": {"class"},
    "asset": set(),
    "mesh": {"name", "class", "file", "scale", "refpos", "refquat", "inertia", "vertex"},
    "include": {"file"},
    "mujocoinclude": set(),
}  # fmt: skip
"""Tags and attributes that the compiled model carries into the vehicle; the rest is listed."""

_TEXTS = {"name", "class", "childclass", "mesh", "material", "site", "joint", "file"}
MIN_DENSITY_KGPM3 = 500.0
"""Fluids of less density are no water."""
_MAX_INCLUDES = 20


def read_mjcf(root: Element, packages: Packages, notes: Notes) -> ForeignVehicle:
    """Read the tree of an MJCF file.

    Raises:
        ConfigError: a fault of the file; names file, line and element, or has MuJoCo's message.
    """
    path = root.location.file
    names = dict[tuple[str, str], Element]()
    roots = list[Element]()
    _mark_read(root, packages, names, roots, 0)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        text = " ".join(str(error).split())
        raise ConfigError(f"{path}: MuJoCo cannot compile it: {text}; correct it there") from error
    reader = _Reader(model, root, names, notes)
    return reader.read()


def _mark_read(
    element: Element,
    packages: Packages,
    names: dict[tuple[str, str], Element],
    roots: list[Element],
    level: int,
) -> None:
    """Mark what the compiled model has, index elements by name, and check the files they name."""
    folders = _asset_folders(element)
    stack = [element]
    while stack:
        each = stack.pop()
        kind = "actuator" if each.tag in ("general", "motor") else each.tag
        if "name" in each.attributes:
            names[(kind, each.attributes["name"])] = each
        if each.tag in _READ:
            each.is_read = True
            each.read_attributes |= _READ[each.tag]
        for name, value in each.attributes.items():
            if name not in _TEXTS and "nan" in value.lower().split():
                each.fail(f'{name} = "{value}": write finite numbers')
        if "file" in each.attributes:
            _check_file(each, packages, folders, names, roots, level)
        stack += each.children


def _asset_folders(root: Element) -> dict[str, str]:
    """Return the folders of meshes and other assets, relative to the file."""
    folders = {"mesh": "", "texture": "", "hfield": "", "skin": ""}
    for compiler in root.find_all("compiler"):
        common = compiler.attributes.get("assetdir", "")
        folders = {key: common or value for key, value in folders.items()}
        folders["mesh"] = compiler.attributes.get("meshdir", folders["mesh"])
        folders["texture"] = compiler.attributes.get("texturedir", folders["texture"])
    return folders


def _check_file(
    element: Element,
    packages: Packages,
    folders: dict[str, str],
    names: dict[tuple[str, str], Element],
    roots: list[Element],
    level: int,
) -> None:
    name = element.attributes["file"]
    path = packages.locate(str(Path(folders.get(element.tag, "")) / name), element)
    if not path.is_file():
        element.fail(f'file = "{name}": there is no file {path}; add it, or remove the element')
    if element.tag != "include":
        return
    if level >= _MAX_INCLUDES:
        element.fail("includes itself without end; break the cycle")
    included = read_xml(path)
    included.is_read = True
    roots.append(included)
    element.children.append(included)
    _mark_read(included, packages, names, roots, level + 1)


class _Reader:
    """Bodies, joints and thrusters of a compiled model."""

    def __init__(
        self,
        model: Any,
        root: Element,
        names: dict[tuple[str, str], Element],
        notes: Notes,
    ) -> None:
        self._model, self._root, self._names, self._notes = model, root, names, notes

    def read(self) -> ForeignVehicle:
        """Return the vehicle: the body with the free joint, and all below it."""
        model = self._model
        base = self._find_base()
        vehicle = ForeignVehicle(
            name=self._root.attribute("model", model.body(base).name or "vehicle"),
            format="MJCF",
            location=self._root.location,
        )
        vehicle.root = self._body_name(base)
        chosen = [i for i in range(model.nbody) if model.body_rootid[i] == base]
        for i in chosen:
            self._add_body(i, vehicle)
            if i != base:
                vehicle.joints.append(self._build_joint(i))
        self._read_density(vehicle)
        self._add_geoms(set(chosen), vehicle)
        self._add_buoyancy(chosen, vehicle)
        self._add_thrusters(set(chosen), vehicle)
        self._note_others(chosen)
        return vehicle

    def _read_density(self, vehicle: ForeignVehicle) -> None:
        density = float(self._model.opt.density)
        if density >= MIN_DENSITY_KGPM3:
            vehicle.density_kgpm3, vehicle.density_location = density, self._root.location
        elif density > 0:
            self._notes.add("dropped", f"density {density:g} kg/m^3: no water", self._root.location)

    def _find_base(self) -> int:
        free = mujoco.mjtJoint.mjJNT_FREE
        bodies = [int(self._model.jnt_bodyid[j]) for j in range(self._model.njnt)
                  if self._model.jnt_type[j] == free]  # fmt: skip
        if len(bodies) != 1:
            self._root.fail(
                f"{len(bodies)} bodies have a free joint; the vehicle is the only one, so give it "
                "<freejoint/>" + (", and no other body" if bodies else "")
            )
        return bodies[0]

    def _body_name(self, i: int) -> str:
        return self._model.body(i).name or f"body_{i}"

    def _element(self, kind: str, name: str) -> Element:
        return self._names.get((kind, name), self._root)

    def _add_body(self, i: int, vehicle: ForeignVehicle) -> None:
        model, name = self._model, self._body_name(i)
        pose = quaternion_pose(tuple(model.body_ipos[i]), tuple(model.body_iquat[i]))
        turn, element = pose[:3, :3], self._element("body", name)
        vehicle.bodies[name] = ForeignBody(
            name=name,
            element=element,
            mass_kg=float(model.body_mass[i]),
            center_of_mass_m=pose[:3, 3],
            inertia_kgm2=turn @ np.diag(model.body_inertia[i]) @ turn.T,
        )
        if not any(child.tag == "inertial" for child in element.children) and model.body_mass[i]:
            self._notes.add(
                "converted",
                "mass and inertia of bodies without <inertial>: those of their shapes, by MuJoCo",
                element.location,
            )

    def _build_joint(self, i: int) -> JointLink:
        model, name = self._model, self._body_name(i)
        count, first = int(model.body_jntnum[i]), int(model.body_jntadr[i])
        element = self._element("body", name)
        joint = JointLink(
            name=f"{name}_joint",
            kind="fixed",
            file_kind="fixed",
            parent=self._body_name(int(model.body_parentid[i])),
            child=name,
            pose=quaternion_pose(tuple(model.body_pos[i]), tuple(model.body_quat[i])),
            axis=np.array([1.0, 0.0, 0.0]),
            element=element,
        )
        if count == 0:
            return joint
        if count > 1:
            element.fail(f"has {count} joints; split it into bodies with one joint each")
        joint.name = model.joint(first).name or joint.name
        joint.element = self._element("joint", joint.name)
        hinge, slide = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
        kind = int(model.jnt_type[first])
        joint.kind = "revolute" if kind == hinge else "prismatic" if kind == slide else "other"
        joint.file_kind = {hinge: "hinge", slide: "slide"}.get(kind, "ball")
        joint.axis = model.jnt_axis[first].copy()
        joint.axis_offset_m = model.jnt_pos[first].copy()
        if model.jnt_limited[first]:
            joint.lower, joint.upper = map(float, model.jnt_range[first])
        dof = int(model.jnt_dofadr[first])
        joint.damping = float(model.dof_damping[dof])
        joint.friction = float(model.dof_frictionloss[dof])
        if model.jnt_actfrclimited[first]:
            joint.effort = float(np.max(np.abs(model.jnt_actfrcrange[first])))
        if joint.kind in ("revolute", "prismatic") and joint.lower is None:
            joint.kind = "continuous"
        if model.qpos0[model.jnt_qposadr[first]]:
            self._notes.add("dropped", "reference position (ref) of joints", joint.element.location)
        return joint

    def _add_geoms(self, chosen: set[int], vehicle: ForeignVehicle) -> None:
        model = self._model
        geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in chosen]
        colliding = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
        if geoms and not colliding:
            self._notes.add(
                "assumed",
                "no geom collides: all of them are taken as the hull",
                self._root.location,
            )
        for g in geoms:
            shape = self._build_shape(g)
            if shape is not None:
                body = vehicle.bodies[self._body_name(int(model.geom_bodyid[g]))]
                body.visuals.append(shape)
                if g in colliding or not colliding:
                    body.shapes.append(shape)

    def _build_shape(self, g: int) -> Shape | None:
        model, name = self._model, self._model.geom(g).name
        body = self._element("body", self._body_name(int(model.geom_bodyid[g])))
        element = self._names.get(("geom", name), body)
        kind, size = int(model.geom_type[g]), [float(x) for x in model.geom_size[g]]
        types = mujoco.mjtGeom
        common: dict[str, Any] = {
            "pose": quaternion_pose(tuple(model.geom_pos[g]), tuple(model.geom_quat[g])),
            "element": element,
            "rgba": tuple(min(max(float(x), 0.0), 1.0) for x in model.geom_rgba[g]),
        }
        if kind == types.mjGEOM_BOX:
            return Shape(kind="box", size=tuple(2 * x for x in size), **common)
        if kind == types.mjGEOM_SPHERE:
            return Shape(kind="sphere", size=(size[0],), **common)
        if kind == types.mjGEOM_CYLINDER:
            return Shape(kind="cylinder", size=(size[0], 2 * size[1]), **common)
        if kind == types.mjGEOM_CAPSULE:
            length = 2 * (size[1] + size[0])
            self._notes.add(
                "converted", "capsules: cylinders of their whole length", element.location
            )
            return Shape(kind="cylinder", size=(size[0], length), **common)
        if kind == types.mjGEOM_MESH:
            half = model.geom_aabb[g][3:]
            center = np.eye(4)
            center[:3, 3] = model.geom_aabb[g][:3]
            self._notes.add("converted", "meshes: the boxes around them", element.location)
            common["pose"] = common["pose"] @ center
            return Shape(kind="box", size=tuple((2 * half).tolist()), **common)
        self._notes.add(
            "dropped",
            f"geom of type {types(kind).name}: box, cylinder, capsule, sphere and mesh are read",
            element.location,
        )
        return None

    def _add_buoyancy(self, chosen: list[int], vehicle: ForeignVehicle) -> None:
        """Take gravity compensation as buoyancy at the centre of mass."""
        density = vehicle.density_kgpm3 or 1000.0
        for i in chosen:
            factor = float(self._model.body_gravcomp[i])
            if factor:
                body = vehicle.bodies[self._body_name(i)]
                body.volume_m3 = factor * body.mass_kg / density
                body.center_of_buoyancy_m = body.center_of_mass_m
                body.water = body.element
                self._notes.add(
                    "converted",
                    f"gravcomp of bodies: a volume that carries as much at {density:g} kg/m^3",
                    body.element.location,
                )

    def _add_thrusters(self, chosen: set[int], vehicle: ForeignVehicle) -> None:
        model = self._model
        for a in range(model.nu):
            name = model.actuator(a).name
            element = self._element("actuator", name)
            site = int(model.actuator_trnid[a][0])
            gear = model.actuator_gear[a]
            at_site = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_SITE
            if not at_site or int(model.site_bodyid[site]) not in chosen:
                self._notes.add(
                    "dropped",
                    f"actuator {name}: it pushes at no site of the vehicle",
                    element.location,
                )
                continue
            if not np.any(gear[:3]):
                element.fail(
                    f'gear = "{" ".join(f"{x:g}" for x in gear)}": the actuator pushes '
                    "along no axis; write a force"
                )
            if np.any(gear[3:]):
                self._notes.add(
                    "dropped",
                    "torques in the gear of thrusters (reaction torque)",
                    element.location,
                )
            vehicle.thrusters.append(self._build_thruster(a, name or f"thruster_{a + 1}", site))
        if vehicle.thrusters:
            return
        for s in range(model.nsite):
            name = model.site(s).name
            if int(model.site_bodyid[s]) in chosen and THRUSTER_NAME.search(name):
                element = self._element("site", name)
                self._notes.add(
                    "assumed",
                    "no actuator pushes at a site: sites with thruster in "
                    "their name push along their z axis",
                    element.location,
                )
                vehicle.thrusters.append(self._mount(name, s, np.array([0.0, 0.0, 1.0]), element))

    def _build_thruster(self, a: int, name: str, site: int) -> ThrusterMount:
        model, element = self._model, self._element("actuator", name)
        gear, gain = model.actuator_gear[a][:3], float(model.actuator_gainprm[a][0])
        # A negative gain pushes against the gear.
        mount = self._mount(name, site, -gear if gain < 0 else gear, element)
        low, high = -np.inf, np.inf
        if model.actuator_ctrllimited[a]:
            low, high = (abs(gain) * float(x) for x in model.actuator_ctrlrange[a])
        if model.actuator_forcelimited[a]:
            force = sorted(float(x) * (-1 if gain < 0 else 1) for x in model.actuator_forcerange[a])
            low, high = max(low, force[0]), min(high, force[1])
        length = float(np.linalg.norm(gear))
        mount.min_thrust_n = length * low if np.isfinite(low) else None
        mount.max_thrust_n = length * high if np.isfinite(high) else None
        dynamics = mujoco.mjtDyn
        if int(model.actuator_dyntype[a]) in (
            int(dynamics.mjDYN_FILTER),
            int(dynamics.mjDYN_FILTEREXACT),
        ):
            mount.lag_s = float(model.actuator_dynprm[a][0])
        return mount

    def _mount(self, name: str, site: int, axis: np.ndarray, element: Element) -> ThrusterMount:
        model = self._model
        pose = quaternion_pose(tuple(model.site_pos[site]), tuple(model.site_quat[site]))
        return ThrusterMount(
            name=name,
            body=self._body_name(int(model.site_bodyid[site])),
            position_m=pose[:3, 3],
            direction=pose[:3, :3] @ axis,
            element=element,
        )

    def _note_others(self, chosen: list[int]) -> None:
        model = self._model
        for i in range(1, model.nbody):
            if i not in chosen:
                name = self._body_name(i)
                self._notes.add(
                    "dropped",
                    f"body {name}: no part of the vehicle",
                    self._element("body", name).location,
                )
        if model.opt.viscosity > 0 or np.any(model.geom_fluid):
            self._notes.add(
                "dropped",
                "MuJoCo's fluid forces (viscosity, fluidshape): drag and added mass are estimated",
                self._root.location,
            )
