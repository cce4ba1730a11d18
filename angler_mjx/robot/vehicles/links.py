"""Models of links and joints in a vehicle file: an arm, or any tree of bodies on the vehicle.

A link is a rigid body with a frame of its own. ``position_m`` and ``rpy_rad`` place that frame in
the frame of its parent, another link or the base, with its joint at ``zero``. A joint moves its
link along or about an axis through the origin of the link's frame. A link without a joint is fixed
to its parent.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from angler_mjx.errors import format_value
from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.checks import Matrix
from angler_mjx.robot.vehicles.hull import Capsule, Name, Vector3
from angler_mjx.robot.vehicles.rotor_config import Number, Positive, Source

BASE = "base"
"""Name of the vehicle's own body as a parent."""

type NotNegative = Annotated[float, Field(ge=0, le=checks.LARGEST)]
type Angles = tuple[Number, Number, Number]


class LinkBody(FileModel):
    """Dry mass and inertia of a link, in the link's frame."""

    mass_kg: Positive
    """Dry mass."""
    center_of_mass_m: Vector3
    """[3] centre of mass, m."""
    inertia_kgm2: Annotated[Matrix, BeforeValidator(checks.check_inertia)]
    """Three diagonal values or a full 3 x 3 matrix, about the centre of mass."""
    source: Source


class LinkBuoyancy(FileModel):
    """Displaced volume of a link and its centre, in the link's frame."""

    volume_m3: NotNegative
    """Displaced volume, fully submerged, m^3."""
    center_of_buoyancy_m: Vector3
    """[3] centre of buoyancy, m."""
    source: Source


class WaterCylinder(FileModel):
    """Cylinder of which strips drag the water and carry some of it along, in the link's frame."""

    from_m: Vector3
    """[3] one end of the axis, m."""
    to_m: Vector3
    """[3] other end of the axis, m."""
    radius_m: Positive
    """Radius, m."""
    normal_drag: NotNegative
    """Drag coefficient across the axis, by the area length times diameter."""
    axial_drag: NotNegative
    """Drag coefficient along the axis, by the wetted area of the side."""
    added_mass: NotNegative
    """Added mass across the axis over that of the displaced water; 1 for a long circular
    cylinder."""

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        checks.check_apart(self.from_m, self.to_m)
        return self


class LinkWater(FileModel):
    """Drag and added mass of a link."""

    cylinders: Annotated[tuple[WaterCylinder, ...], Field(max_length=16)] = ()
    """Cylinders in the water."""
    added_mass: Annotated[Matrix, BeforeValidator(checks.check_added_mass)] | None = None
    """Further added mass at the centre of mass along the link's axes: six diagonal values or a full
    6 x 6 matrix; kg, kg m, kg m^2. None: that of the cylinders alone."""
    source: Source


class Link(FileModel):
    """Rigid body on the vehicle or on another link."""

    name: Name
    """Name of the link."""
    parent: Name = BASE
    """Name of the link that carries it; ``base`` is the vehicle."""
    joint: Name | None = None
    """Joint that moves it; None: fixed to its parent."""
    position_m: Vector3
    """[3] origin of the link's frame in the parent's frame, m."""
    rpy_rad: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the link's frame in the parent's frame: about z, then y, then x."""
    capsules: Annotated[tuple[Capsule, ...], Field(max_length=16)] = ()
    """Capsules of the link's hull, in the link's frame."""
    source: Source
    rigid_body: LinkBody
    buoyancy: LinkBuoyancy
    water: LinkWater


class LinkNumbers(FileModel):
    """Numbers of a link that a parameter set has otherwise than the table of the link."""

    rigid_body: LinkBody | None = None
    """None: as in the table of the link."""
    buoyancy: LinkBuoyancy | None = None
    """None: as in the table of the link."""
    water: LinkWater | None = None
    """None: as in the table of the link."""

    def groups(self) -> dict[str, FileModel]:
        """Return the groups that are not None, by name."""
        groups = {"rigid_body": self.rigid_body, "buoyancy": self.buoyancy, "water": self.water}
        return {name: group for name, group in groups.items() if group is not None}


class Actuator(FileModel):
    """Motor, servo and friction of a joint: N m and rad, or N and m of a prismatic one."""

    max_speed: Positive
    """Speed that the servo asks for at most, rad/s or m/s."""
    max_effort: Positive
    """Torque or force of the motor at most, N m or N."""
    stiffness: NotNegative
    """Effort of the servo by error of position, N m/rad or N/m."""
    damping: NotNegative
    """Effort of the servo by error of speed, N m s/rad or N s/m."""
    viscous_friction: NotNegative = 0.0
    """Friction by speed, N m s/rad or N s/m."""
    coulomb_friction: NotNegative = 0.0
    """Friction of a moving joint at any speed, N m or N."""
    source: Source

    @model_validator(mode="after")
    def _check_damped(self) -> Self:
        if self.stiffness > 0 and self.damping == 0:
            raise ValueError("damping = 0 with a stiffness: the servo would swing for ever")
        return self


class Joint(FileModel):
    """Joint between a link and its parent: radians, or metres of a prismatic one."""

    name: Name
    """Name of the joint, as in commands and messages."""
    type: Literal["revolute", "prismatic"]
    """Whether the link turns about the axis or slides along it."""
    axis: Annotated[tuple[float, float, float], AfterValidator(checks.check_unit_vector)]
    """Unit vector of the axis, in the link's frame."""
    lower: Number
    """Lower limit, rad or m."""
    upper: Number
    """Upper limit, rad or m."""
    zero: Number = 0.0
    """Position at which the link's frame lies as ``position_m`` and ``rpy_rad`` say, rad or m."""
    home: Number
    """Position at the start, held where nothing else is commanded; rad or m."""
    is_gripper: bool = False
    """Whether it opens and closes a gripper, and is no means to place the end effector."""
    source: Source
    actuator: Actuator

    @model_validator(mode="after")
    def _check_limits(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(
                f"lower = {self.lower:g} and upper = {self.upper:g}: lower must be below upper"
            )
        if not self.lower <= self.home <= self.upper:
            raise ValueError(
                f"home = {self.home:g}: must lie between lower = {self.lower:g} and "
                f"upper = {self.upper:g}"
            )
        return self


class EndEffector(FileModel):
    """Frame on a link that targets of the end effector are about."""

    link: Name
    """Link that carries it."""
    position_m: Vector3
    """[3] origin in the link's frame, m."""
    rpy_rad: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw in the link's frame: about z, then y, then x."""
    source: Source


def check_tree(links: Sequence[Link], joints: Sequence[Joint]) -> None:
    """Check that links and joints form a tree on the base.

    Raises:
        ValueError: a name occurs twice, a parent or joint does not exist, parents form a loop, or a
            joint moves no link or several.
    """
    checks.check_distinct_names("links: link", [BASE, *(link.name for link in links)])
    checks.check_distinct_names("joints: joint", [joint.name for joint in joints])
    names = {link.name for link in links}
    for i, link in enumerate(links):
        if link.parent != BASE and link.parent not in names:
            raise ValueError(
                f"links.{i}.parent = {format_value(link.parent)}: no such link; there is "
                + ", ".join([BASE, *sorted(names)])
            )
        _check_joint(i, link, joints)
    moved = [link.joint for link in links if link.joint is not None]
    for j, joint in enumerate(joints):
        if moved.count(joint.name) != 1:
            raise ValueError(
                f"joints.{j}.name = {format_value(joint.name)}: must be the joint of one link; it "
                f"is that of {moved.count(joint.name)}"
            )
    _check_no_loop(links)


def _check_joint(i: int, link: Link, joints: Sequence[Joint]) -> None:
    names = [joint.name for joint in joints]
    if link.joint is not None and link.joint not in names:
        raise ValueError(
            f"links.{i}.joint = {format_value(link.joint)}: no such joint; there is "
            + (", ".join(names) or "none")
        )


def _check_no_loop(links: Sequence[Link]) -> None:
    parents = {link.name: link.parent for link in links}
    for i, link in enumerate(links):
        name = link.name
        for _ in links:
            name = parents.get(name, BASE)
        if name != BASE:
            raise ValueError(
                f"links.{i}.parent = {format_value(link.parent)}: the link carries itself in a "
                "loop of joints; every chain of parents must end at the base"
            )


def order_links(links: Sequence[Link]) -> list[Link]:
    """Return links in the order of the simulator: depth first, a parent before its children."""

    def below(parent: str) -> list[Link]:
        rows = [[link, *below(link.name)] for link in links if link.parent == parent]
        return [link for row in rows for link in row]

    return below(BASE)


def order_joints(links: Sequence[Link], joints: Sequence[Joint]) -> list[Joint]:
    """Return joints in the order of the links that they move, as states and commands have them."""
    by_name = {joint.name: joint for joint in joints}
    return [by_name[link.joint] for link in order_links(links) if link.joint is not None]
