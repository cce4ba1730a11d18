"""Physical parameters of the links of one robot: a pytree of arrays beside `VehicleParams`.

Links and joints stand in the order of the simulator, depth first. Vectors of a link are in the
link's frame. The pose of a link's frame is that in its parent's frame with its joint at ``zero``;
of links on the base, from the base's centre of mass, in F.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.links import BASE, Joint, Link, WaterCylinder
from angler_mjx.robot.vehicles.thrusters import FloatArray

STRIPS = 5
"""Strips into which each cylinder is cut for its drag."""


@dataclass(frozen=True, kw_only=True)
class LinkTree:
    """Topology of the links of a fleet: what its programs are compiled for."""

    parents: tuple[int, ...]
    """[L] number of each link's parent, less than its own; -1 for the base."""
    joints: tuple[int, ...]
    """[L] number of each link's joint; -1 for a link fixed to its parent."""
    slides: tuple[bool, ...]
    """[J] whether each joint is prismatic."""
    grippers: tuple[bool, ...] = ()
    """[J] whether each joint is that of a gripper."""
    end_effector: int = -1
    """Number of the link that carries the end effector; -1 where there is none."""
    joint_names: tuple[str, ...] = field(default=(), compare=False)
    """[J] names of the joints; programs do not depend on them."""

    @property
    def moves(self) -> np.ndarray:
        """Return bool [L, J]: whether a joint moves a link."""
        mask = np.zeros((len(self.parents), len(self.slides)), bool)
        for link, (parent, joint) in enumerate(zip(self.parents, self.joints, strict=True)):
            if parent >= 0:
                mask[link] = mask[parent]
            if joint >= 0:
                mask[link, joint] = True
        return mask

    @property
    def carries(self) -> np.ndarray:
        """Return bool [J, J]: whether the joint of a column moves the axis of that of a row."""
        mask = np.array([self.moves[self.joints.index(j)] for j in range(len(self.slides))])
        return mask.reshape(2 * (len(self.slides),)) & ~np.eye(len(self.slides), dtype=bool)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LinkParams:
    """Links [L] and joints [J] of one robot; cylinders [C] of each link.

    Links with fewer cylinders than others have some without area.
    """

    position_m: jax.Array
    """[L, 3] origin of each link's frame, m."""
    rotation: jax.Array
    """[L, 3, 3] rotation from each link's frame."""
    axis: jax.Array
    """[J, 3] axis of each joint, in the frame of its link."""
    zero: jax.Array
    """[J] position of each joint at which its link lies as these say, rad or m."""
    mass_kg: jax.Array
    """[L] dry mass; 0 for a link that this robot does not have."""
    center_of_mass_m: jax.Array
    """[L, 3] centre of mass."""
    inertia_kgm2: jax.Array
    """[L, 3, 3] about the centre of mass."""
    volume_m3: jax.Array
    """[L] displaced volume, fully submerged."""
    center_of_buoyancy_m: jax.Array
    """[L, 3] centre of buoyancy."""
    fade_height_m: jax.Array
    """[L] height over which buoyancy fades at the surface: diameter of a ball of the volume."""
    M_A: jax.Array
    """[L, 6, 6] added mass at the centre of mass, without that of the cylinders; kg, kg m,
    kg m^2."""
    added_volume: jax.Array
    """[L, 6, 6] added mass of the cylinders there over the water's density; m^3, m^4, m^5."""
    cylinder_m: jax.Array
    """[L, C, 3] centre of each cylinder that drags, m."""
    cylinder_axis: jax.Array
    """[L, C, 3] unit vector of its axis."""
    cylinder_length_m: jax.Array
    """[L, C] length, which is cut into `STRIPS` strips."""
    normal_area_m2: jax.Array
    """[L, C] half the drag area of a strip across the axis."""
    axial_area_m2: jax.Array
    """[L, C] half the drag area of a strip along the axis."""
    lower: jax.Array
    """[J] lower limit, rad or m."""
    upper: jax.Array
    """[J] upper limit, rad or m."""
    home: jax.Array
    """[J] position at the start, rad or m."""
    max_speed: jax.Array
    """[J] speed that the servo asks for at most, rad/s or m/s."""
    max_effort: jax.Array
    """[J] effort of the motor at most, N m or N."""
    stiffness: jax.Array
    """[J] effort of the servo by error of position."""
    damping: jax.Array
    """[J] effort of the servo by error of speed."""
    viscous_friction: jax.Array
    """[J] friction by speed."""
    coulomb_friction: jax.Array
    """[J] friction at any speed, N m or N."""
    armature: jax.Array
    """[J] inertia on the joint alone: 1 for a joint that this robot does not have, else 0."""
    end_effector_m: jax.Array
    """[3] origin of the end effector's frame, in the frame of its link."""
    end_effector_rotation: jax.Array
    """[3, 3] rotation from the end effector's frame, to the frame of its link."""
    tree: LinkTree = field(metadata={"static": True})
    """Topology, the same for all robots of a fleet."""


def build_tree(config: VehicleConfig) -> LinkTree:
    """Return the topology of a vehicle's links."""
    links, joints = config.find_links(None), config.find_joints()
    tip = config.end_effector
    links_by_name = {link.name: i for i, link in enumerate(links)}
    joints_by_name = {joint.name: j for j, joint in enumerate(joints)}
    return LinkTree(
        parents=tuple(links_by_name.get(link.parent, -1) for link in links),
        joints=tuple(-1 if link.joint is None else joints_by_name[link.joint] for link in links),
        slides=tuple(joint.type == "prismatic" for joint in joints),
        grippers=tuple(joint.is_gripper for joint in joints),
        end_effector=-1 if tip is None else links_by_name[tip.link],
        joint_names=tuple(joint.name for joint in joints),
    )


def build_links(config: VehicleConfig, parameter_set: str | None) -> LinkParams | None:
    """Compile the links of a vehicle file; None for a vehicle that has none.

    Args:
        config: vehicle file.
        parameter_set: name of one of its sets; None for its default.

    Raises:
        ConfigError: the vehicle has no such set.
    """
    links, joints = config.find_links(parameter_set), config.find_joints()
    if not links:
        return None
    tip = config.end_effector
    numbers: dict[str, object] = {
        "position_m": [mount_m(config, link) for link in links],
        "rotation": [rotation_matrix(link.rpy_rad) for link in links],
        "mass_kg": [link.rigid_body.mass_kg for link in links],
        "center_of_mass_m": [link.rigid_body.center_of_mass_m for link in links],
        "inertia_kgm2": [link.rigid_body.inertia_kgm2 for link in links],
        "volume_m3": [link.buoyancy.volume_m3 for link in links],
        "center_of_buoyancy_m": [link.buoyancy.center_of_buoyancy_m for link in links],
        "fade_height_m": [_ball_diameter(link.buoyancy.volume_m3) for link in links],
        "M_A": [np.zeros((6, 6)) if (m := link.water.added_mass) is None else m for link in links],
        "added_volume": [_added_volume(link) for link in links],
        **_lay_cylinders(links),
        **_joint_numbers(joints),
        "end_effector_m": np.zeros(3) if tip is None else tip.position_m,
        "end_effector_rotation": rotation_matrix((0.0, 0.0, 0.0) if tip is None else tip.rpy_rad),
    }
    dtype = jax.numpy.result_type(float)
    arrays = {name: jax.device_put(np.asarray(x, dtype)) for name, x in numbers.items()}
    return LinkParams(**arrays, tree=build_tree(config))


def mount_m(config: VehicleConfig, link: Link) -> FloatArray:
    """Return the origin [3] m of a link from its parent's, or from the base's centre of mass."""
    origin = config.base.center_of_mass_m if link.parent == BASE else (0.0, 0.0, 0.0)
    mount: FloatArray = np.asarray(link.position_m) - np.asarray(origin)
    return mount


def rotation_matrix(rpy_rad: Sequence[float]) -> FloatArray:
    """Return the rotation [3, 3] of roll, pitch and yaw [3]: about z, then y, then x."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy_rad), np.cos(rpy_rad)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    rotation: FloatArray = about_z @ about_y @ about_x
    return rotation


def _joint_numbers(joints: Sequence[Joint]) -> dict[str, object]:
    n = len(joints)
    numbers: dict[str, object] = {
        name: np.reshape([getattr(joint, name) for joint in joints], n)
        for name in ("zero", "lower", "upper", "home")
    }
    numbers |= {
        name: np.reshape([getattr(joint.actuator, name) for joint in joints], n)
        for name in (
            "max_speed",
            "max_effort",
            "stiffness",
            "damping",
            "viscous_friction",
            "coulomb_friction",
        )
    }
    axes = np.reshape([joint.axis for joint in joints], (n, 3))
    return {**numbers, "axis": axes, "armature": np.zeros(n)}


def _ball_diameter(volume_m3: float) -> float:
    return float(max(np.cbrt(6.0 / np.pi * volume_m3), 1e-3))


def _added_volume(link: Link) -> FloatArray:
    """Return [6, 6] of the cylinders at the centre of mass, each carrying water across its axis."""
    total = np.zeros((6, 6))
    for cylinder in link.water.cylinders:
        start, end = np.asarray(cylinder.from_m), np.asarray(cylinder.to_m)
        axis, length = _axis_and_length(cylinder)
        volume = cylinder.added_mass * np.pi * cylinder.radius_m**2 * length
        across = np.eye(3) - np.outer(axis, axis)
        arm = _skew(0.5 * (start + end) - link.rigid_body.center_of_mass_m)
        block = volume * across
        total[:3, :3] += block
        total[:3, 3:] -= block @ arm
        total[3:, :3] += arm @ block
        total[3:, 3:] += volume * length**2 / 12.0 * across - arm @ block @ arm
    return total


def _lay_cylinders(links: Sequence[Link]) -> dict[str, object]:
    """Return the arrays of cylinders [L, C]."""
    shape = (len(links), max(1, *(len(link.water.cylinders) for link in links)))
    center, axis, lengths = np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape)
    normal, axial = np.zeros(shape), np.zeros(shape)
    for i, link in enumerate(links):
        for j, cylinder in enumerate(link.water.cylinders):
            axis[i, j], length = _axis_and_length(cylinder)
            center[i, j] = 0.5 * (np.asarray(cylinder.from_m) + np.asarray(cylinder.to_m))
            side = 2.0 * cylinder.radius_m * length / STRIPS
            lengths[i, j] = length
            normal[i, j] = 0.5 * cylinder.normal_drag * side
            axial[i, j] = 0.5 * cylinder.axial_drag * np.pi * side
    return {
        "cylinder_m": center,
        "cylinder_axis": axis,
        "cylinder_length_m": lengths,
        "normal_area_m2": normal,
        "axial_area_m2": axial,
    }


def _axis_and_length(cylinder: WaterCylinder) -> tuple[FloatArray, float]:
    ends = np.asarray(cylinder.to_m) - np.asarray(cylinder.from_m)
    length = float(np.linalg.norm(ends))
    return ends / length, length


def _skew(vector: FloatArray) -> FloatArray:
    """Return [3, 3] that takes a vector to its cross product with ``vector`` [3]."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def absent_links(links: LinkParams) -> LinkParams:
    """Return the links of a robot without any, in arrays of the shapes of ``links``.

    Massless links on joints that nothing moves, which have an inertia of their own.
    """
    nothing: LinkParams = jax.tree.map(np.zeros_like, links)
    kept = (
        "rotation",
        "position_m",
        "axis",
        "cylinder_axis",
        "end_effector_m",
        "end_effector_rotation",
    )
    ones = ("fade_height_m", "upper", "armature")
    fields: dict[str, Any] = {name: getattr(links, name) for name in kept}
    fields |= {name: np.ones_like(getattr(links, name)) for name in ones}
    return replace(nothing, **fields, lower=-fields["upper"])


def pad_links(variants: Sequence[LinkParams | None]) -> list[LinkParams | None]:
    """Return the links of the variants of a fleet, of one topology, in arrays of common shapes.

    None stands for a vehicle without links, in ``variants``, and everywhere in the result if all
    are.
    """
    armed = [links for links in variants if links is not None]
    if not armed:
        return list(variants)
    cylinders = max(links.normal_area_m2.shape[1] for links in armed)
    absent = absent_links(_pad_cylinders(armed[0], cylinders))
    return [absent if links is None else _pad_cylinders(links, cylinders) for links in variants]


def _pad_cylinders(links: LinkParams, cylinders: int) -> LinkParams:
    more = cylinders - links.normal_area_m2.shape[1]
    names = (
        *("cylinder_m", "cylinder_axis", "cylinder_length_m"),
        *("normal_area_m2", "axial_area_m2"),
    )
    return replace(links, **{name: _pad_second(getattr(links, name), more) for name in names})


def _pad_second(array: jax.Array, more: int) -> Any:
    return np.pad(array, ((0, 0), (0, more), *((0, 0),) * (array.ndim - 2)))
