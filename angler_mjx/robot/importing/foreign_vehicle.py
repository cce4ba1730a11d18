"""Vehicle as a foreign file describes it: bodies, joints, thrusters, water; SI units and radians.

Poses are homogeneous matrices [4, 4]. Axes of a body are those of its file: x forward, y left, z up
in all formats that are read.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from angler_mjx.robot.importing.notes import Location
from angler_mjx.robot.importing.xml_tree import Element

type ShapeKind = Literal["box", "cylinder", "sphere"]
type JointKind = Literal["fixed", "revolute", "prismatic", "continuous", "other"]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Solid of a body's collision or visual."""

    kind: ShapeKind
    size: tuple[float, ...]
    """Edge lengths of a box; radius and length of a cylinder along z; radius of a sphere; m."""
    pose: np.ndarray
    """[4, 4] pose in the body's frame."""
    element: Element
    rgba: tuple[float, float, float, float] | None = None

    @property
    def volume_m3(self) -> float:
        """Return the volume."""
        match self.kind:
            case "box":
                return float(np.prod(self.size))
            case "cylinder":
                return float(np.pi * self.size[0] ** 2 * self.size[1])
        return float(4 / 3 * np.pi * self.size[0] ** 3)

    @property
    def half_extents_m(self) -> np.ndarray:
        """Return half the edge lengths [3] of the box around the shape, along its axes."""
        match self.kind:
            case "box":
                return np.array(self.size) / 2
            case "cylinder":
                return np.array([self.size[0], self.size[0], self.size[1] / 2])
        return np.full(3, self.size[0])


@dataclass(kw_only=True)
class ForeignBody:
    """Rigid body: a link."""

    name: str
    element: Element
    mass_kg: float = 0.0
    center_of_mass_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia_kgm2: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """[3, 3] about the centre of mass, along the axes of the body's frame."""
    inertial: Element | None = None
    """Element of mass and inertia."""
    shapes: list[Shape] = field(default_factory=list)
    """Collision shapes."""
    visuals: list[Shape] = field(default_factory=list)
    volume_m3: float | None = None
    """Displaced volume; None where only shapes tell."""
    center_of_buoyancy_m: np.ndarray | None = None
    """[3] in the body's frame."""
    water: Element | None = None
    """Element of the volume."""


@dataclass(kw_only=True)
class JointLink:
    """Joint between two bodies."""

    name: str
    kind: JointKind
    parent: str
    child: str
    pose: np.ndarray
    """[4, 4] pose of the child's frame in that of the parent."""
    axis: np.ndarray
    """[3] axis in the child's frame."""
    element: Element
    axis_offset_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """[3] point of the axis in the child's frame."""
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    damping: float = 0.0
    friction: float = 0.0
    mimicked: str | None = None
    """Joint that it follows; None: it moves by itself."""
    file_kind: str = ""
    """Type as the file names it."""


@dataclass(kw_only=True)
class ThrusterMount:
    """Thruster on a body."""

    name: str
    body: str
    position_m: np.ndarray
    """[3] in the body's frame."""
    direction: np.ndarray
    """[3] of the force on the vehicle at positive command, in the body's frame; any length."""
    element: Element
    spin: int | None = None
    """As in vehicle files; None: the file does not say."""
    order: int | None = None
    """Number among the signals; None: order of the file."""
    lag_s: float | None = None
    max_thrust_n: float | None = None
    min_thrust_n: float | None = None
    curve_n: np.ndarray | None = None
    """[n] thrust at `thrust_curves.CURVE_PWM_US`; None: the thruster file has it."""
    joint: str | None = None


@dataclass(kw_only=True)
class FinMount:
    """Fin on a body: a foil with lift and drag."""

    body: str
    element: Element
    position_m: np.ndarray
    """[3] centre of pressure, in the body's frame."""
    forward: np.ndarray
    """[3] of the chord, any length."""
    upward: np.ndarray
    """[3] of the lift at positive angles of attack."""
    area_m2: float
    lift_slope: float
    """1/rad."""
    stall_rad: float | None = None
    drag_slope: float | None = None
    """Drag coefficient per radian of the angle of attack."""


@dataclass(kw_only=True)
class Hydrodynamics:
    """Added mass and damping at the origin of a body's frame, along its axes; positive numbers."""

    body: str
    element: Element
    added_mass: np.ndarray | None = None
    """[6, 6]; None: not stated."""
    linear: np.ndarray | None = None
    """[6, 6]."""
    quadratic: np.ndarray | None = None
    """[6, 6] of |v_j| v_j."""
    products: dict[str, float] = field(default_factory=dict)
    """Derivatives of the wrench by products of two velocities, such as ``Y_uv``, as they are in
    vehicle files."""
    names: dict[tuple[str, int, int], str] = field(default_factory=dict)
    """Names of the file for entries off the diagonal, by table, row and column."""


@dataclass(kw_only=True)
class ForeignVehicle:
    """Vehicle as read from a foreign file."""

    name: str
    format: str
    location: Location
    bodies: dict[str, ForeignBody] = field(default_factory=dict)
    joints: list[JointLink] = field(default_factory=list)
    thrusters: list[ThrusterMount] = field(default_factory=list)
    hydrodynamics: list[Hydrodynamics] = field(default_factory=list)
    density_kgpm3: float | None = None
    """Density of the water that the file states; None: it states none."""
    density_location: Location | None = None
    fins: dict[str, Element] = field(default_factory=dict)
    """Bodies that plugins use as fins."""
    fin_mounts: list[FinMount] = field(default_factory=list)
    """Fins whose lift is read."""
    size_m: tuple[float, float, float] | None = None
    """Length, width and height that the file states; None: it states none."""
    size_location: Location | None = None
    root: str | None = None
    """Body that the file names as the vehicle's; None: the one without a parent."""


def pose_of(position_m: tuple[float, ...], rpy_rad: tuple[float, ...]) -> np.ndarray:
    """Return the pose [4, 4] of a position [3] and roll, pitch and yaw [3]: about z, then y, x."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    pose = np.eye(4)
    pose[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    pose[:3, 3] = position_m
    return pose


def quaternion_pose(position_m: tuple[float, ...], wxyz: tuple[float, ...]) -> np.ndarray:
    """Return the pose [4, 4] of a position [3] and a quaternion [4] of any length."""
    w, x, y, z = np.asarray(wxyz) / np.linalg.norm(wxyz)
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = position_m
    return pose


def invert_pose(pose: np.ndarray) -> np.ndarray:
    """Return the inverse [4, 4] of a pose."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def roll_pitch_yaw(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation [3, 3]."""
    pitch = float(np.arcsin(np.clip(-rotation[2, 0], -1, 1)))
    if abs(rotation[2, 0]) > 1 - 1e-12:
        return 0.0, pitch, float(np.arctan2(-rotation[0, 1], rotation[1, 1]))
    roll = float(np.arctan2(rotation[2, 1], rotation[2, 2]))
    return roll, pitch, float(np.arctan2(rotation[1, 0], rotation[0, 0]))
