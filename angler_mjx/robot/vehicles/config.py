"""Models of a vehicle file and of a thruster file.

Every group of numbers carries its ``source``. The base frame of a vehicle file has its axes as F
(x forward, y left, z up) and an origin chosen by the file; everything under ``parameter_sets`` is
about the centre of mass.
"""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel
from angler_mjx.quantities import Sign
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.checks import Matrix
from angler_mjx.robot.vehicles.derivatives import read_product
from angler_mjx.robot.vehicles.fin_config import Fins
from angler_mjx.robot.vehicles.hull import Capsule, Name, Vector3
from angler_mjx.robot.vehicles.links import (
    EndEffector,
    Joint,
    Link,
    LinkNumbers,
    check_tree,
    order_joints,
    order_links,
)
from angler_mjx.robot.vehicles.rotor_config import Number, Positive, Rotor, RotorResponse, Source
from angler_mjx.robot.vehicles.trim_config import (
    Ballast,
    MovingMass,
    MovingMasses,
    Tank,
    check_inertia,
)
from angler_mjx.robot.vehicles.uncertainty import Uncertainty

type Fraction = Annotated[float, Field(ge=0, le=1)]

MAX_BODIES = 16
"""Max number of bodies of a hull."""
_BODY_TOLERANCE, _BODY_CENTER_M = 1e-3, 1e-3
"""Differences of the bodies of a hull from its volume and its centre of buoyancy."""


class Base(FileModel):
    """Position of the centre of mass in the base frame."""

    center_of_mass_m: Vector3
    """[3] centre of mass in the base frame, m."""
    source: Source


class HullTable(FileModel):
    """Outer shape: for distances, and for the fading of buoyancy at the surface."""

    height_m: Positive
    """Height over which buoyancy fades from full to none as the hull leaves the water."""
    capsules: Annotated[tuple[Capsule, ...], Field(min_length=1, max_length=64)]
    """Capsules that together form the hull; distances are to them."""
    source: Source


class ThrustCurve(FileModel):
    """Static thrust of one thruster against its PWM, at any voltage."""

    pwm_us: Annotated[tuple[Annotated[int, Field(ge=0, le=10_000)], ...], Field(min_length=2)]
    """PWM values; rising, 1100 to 1900 at least."""
    thrust_n: Annotated[tuple[Number, ...], Field(min_length=2)]
    """Thrust at each; not falling. Power is that of the vehicle's thruster file at this thrust, and
    beyond its ends grows as the 3/2 of the thrust."""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if len(self.pwm_us) != len(self.thrust_n):
            raise ValueError(f"thrust_n needs {len(self.pwm_us)} values, one for each of pwm_us")
        if np.any(np.diff(self.pwm_us) <= 0) or np.any(np.diff(self.thrust_n) < 0):
            raise ValueError("pwm_us must increase, and thrust_n must not fall")
        if self.pwm_us[0] > checks.PWM_LOW_US or self.pwm_us[-1] < checks.PWM_HIGH_US:
            raise ValueError(
                f"pwm_us runs from {self.pwm_us[0]} to {self.pwm_us[-1]}; it must cover "
                f"{checks.PWM_LOW_US} to {checks.PWM_HIGH_US}"
            )
        if not self.thrust_n[0] < 0 < self.thrust_n[-1]:
            raise ValueError("thrust_n must be negative at the first PWM and positive at the last")
        return self


class Thruster(FileModel):
    """Thruster in the base frame."""

    name: Name
    """Name for faults of thrusters and tables."""
    position_m: Vector3
    """[3] position of the rotor, m."""
    direction: Annotated[tuple[float, float, float], AfterValidator(checks.check_unit_vector)]
    """Unit vector of the force on the vehicle at positive thrust (PWM above neutral)."""
    spin: Sign
    """+1 if the rotor turns right-handed about ``direction`` at positive thrust."""
    time_constant_s: Positive | None = None
    """Lag of first order of its thrust; that of all rotors if left out."""
    curve: ThrustCurve | None = None
    """Thrust by PWM where it differs from that of the thruster file of ``rotor``."""


class Thrusters(FileModel):
    """Positions and directions of the thrusters."""

    layout: Annotated[tuple[Thruster, ...], Field(max_length=64)]
    """Thrusters in the order of the signals; empty of a glider."""
    source: Source

    @field_validator("layout")
    @classmethod
    def _check_distinct(cls, value: tuple[Thruster, ...]) -> tuple[Thruster, ...]:
        checks.check_distinct_names("thruster", [thruster.name for thruster in value])
        return value


class _Shape(FileModel):
    name: Name
    """Name of the geometry in the MuJoCo model."""
    rgba: tuple[Fraction, Fraction, Fraction, Fraction]
    """Colour and opacity."""


class Box(_Shape):
    """Visible box: centre and full edge lengths, in the base frame."""

    shape: Literal["box"]
    position_m: Vector3
    """[3] centre, m."""
    size_m: tuple[Positive, Positive, Positive]
    """[3] full edge lengths, m."""


class Cylinder(_Shape):
    """Visible cylinder between two points of the base frame."""

    shape: Literal["cylinder"]
    from_m: Vector3
    """[3] one end of the axis, m."""
    to_m: Vector3
    """[3] other end of the axis, m."""
    radius_m: Positive
    """Radius of the cylinder, m."""


class Sphere(_Shape):
    """Visible sphere, in the base frame."""

    shape: Literal["sphere"]
    position_m: Vector3
    """[3] centre, m."""
    radius_m: Positive
    """Radius of the sphere, m."""


type Shape = Annotated[Box | Cylinder | Sphere, Field(discriminator="shape")]


class Visual(FileModel):
    """Shapes for viewers; the physics ignores them."""

    shapes: Annotated[tuple[Shape, ...], Field(max_length=256)]
    """Shapes for viewers."""
    source: Source

    @field_validator("shapes")
    @classmethod
    def _check_distinct(cls, value: tuple[Shape, ...]) -> tuple[Shape, ...]:
        checks.check_distinct_names("shape", [shape.name for shape in value])
        return value


class RigidBody(FileModel):
    """Dry mass and inertia, about the centre of mass."""

    mass_kg: Positive
    """Dry mass."""
    inertia_kgm2: Annotated[Matrix, BeforeValidator(checks.check_inertia)]
    """Three diagonal values or a full 3 x 3 matrix."""
    source: Source


class BuoyantBody(FileModel):
    """Body of a hull, such as a float of a catamaran."""

    volume_m3: Positive
    """Displaced volume, fully submerged, m^3."""
    center_m: Vector3
    """[3] centre of that volume from the centre of mass, m."""
    height_m: Positive
    """Height over which its buoyancy fades from full to none as it leaves the water, m."""


class Buoyancy(FileModel):
    """Displaced volume and its centre, from the centre of mass."""

    volume_m3: Positive
    """Displaced volume, fully submerged, m^3."""
    center_of_buoyancy_m: Vector3
    """[3] centre of buoyancy from the centre of mass, m."""
    bodies: Annotated[tuple[BuoyantBody, ...], Field(max_length=MAX_BODIES)] = ()
    """Bodies that this volume is made of, each of which leaves the water by itself; left out, the
    hull leaves it as one."""
    source: Source

    @model_validator(mode="after")
    def _check_bodies(self) -> Self:
        if not self.bodies:
            return self
        volumes = np.array([body.volume_m3 for body in self.bodies])
        total = float(volumes.sum())
        if abs(total - self.volume_m3) > _BODY_TOLERANCE * self.volume_m3:
            raise ValueError(
                f"bodies displace {total:g} m^3 together, and volume_m3 is {self.volume_m3:g}; "
                "make them equal"
            )
        center = volumes @ np.array([body.center_m for body in self.bodies]) / total
        if np.abs(center - np.array(self.center_of_buoyancy_m)).max() > _BODY_CENTER_M:
            raise ValueError(
                f"the centre of the bodies is {[round(float(x), 6) for x in center]}, and "
                f"center_of_buoyancy_m is {list(self.center_of_buoyancy_m)}; make them equal"
            )
        return self


class AddedMass(FileModel):
    """Added mass at the centre of mass, in F, as positive numbers."""

    coefficients: Annotated[Matrix, BeforeValidator(checks.check_added_mass)]
    """Six diagonal values or a full 6 x 6 matrix; kg, kg m, kg m^2."""
    source: Source


type DampingTable = Annotated[
    tuple[float, ...] | Matrix, BeforeValidator(checks.check_damping_table)
]


class Damping(FileModel):
    """Damping at the centre of mass, in F.

    Wrench of the water: -(linear + quadratic |nu|) nu, with entry [i][j] of ``quadratic`` times
    |nu_j| nu_j, and ``products``.
    """

    linear: DampingTable
    """Six diagonal values or a full 6 x 6 matrix, positive on the diagonal; N s/m (first three),
    N m s/rad."""
    quadratic: DampingTable
    """Six diagonal values or a full 6 x 6 matrix, of |nu_j| nu_j; N s^2/m^2 (first three),
    N m s^2/rad^2."""
    products: dict[str, Number] = Field(default_factory=dict)
    """Derivatives of the wrench by products of two velocities, such as Y_uv of the lift of a hull:
    force of X Y Z K M N, velocities of u v w p q r, in F; with the sign of the wrench. Without what
    is in the added mass."""
    source: Source

    @model_validator(mode="after")
    def _check_damped(self) -> Self:
        pairs = zip(self.linear_diagonal, self.quadratic_diagonal, strict=True)
        free = [i for i, pair in enumerate(pairs) if pair == (0, 0)]
        if free:
            raise ValueError(
                f"no damping at all on axis {free[0]} of [u v w p q r]; "
                "give a linear or a quadratic coefficient above zero"
            )
        for name in self.products:
            read_product(name)
        checks.check_passive(self.linear_matrix)
        return self

    @property
    def linear_matrix(self) -> np.ndarray:
        """Return linear damping [6, 6]."""
        return _to_matrix(self.linear)

    @property
    def quadratic_matrix(self) -> np.ndarray:
        """Return quadratic damping [6, 6]."""
        return _to_matrix(self.quadratic)

    @property
    def linear_diagonal(self) -> tuple[float, ...]:
        """Return the diagonal [6] of linear damping."""
        return tuple(np.diag(self.linear_matrix).tolist())

    @property
    def quadratic_diagonal(self) -> tuple[float, ...]:
        """Return the diagonal [6] of quadratic damping."""
        return tuple(np.diag(self.quadratic_matrix).tolist())

    @property
    def couples_axes(self) -> bool:
        """Return whether damping of one axis depends on another."""
        full = any(isinstance(table[0], tuple) for table in (self.linear, self.quadratic))
        return full or any(value != 0.0 for value in self.products.values())


def _to_matrix(table: tuple[float, ...] | Matrix) -> np.ndarray:
    values = np.asarray(table, np.float64)
    return np.diag(values) if values.ndim == 1 else values


class ArduSub(FileModel):
    """Identity of the vehicle in the ArduSub firmware."""

    frame: Literal["vectored", "vectored_6dof"]
    """Frame of the firmware; ``layout`` must list thrusters in the motor order of that frame."""
    source: Source


class ParameterSet(FileModel):
    """Published or identified set of coefficients of the vehicle."""

    description: str
    """Description for people."""
    rigid_body: RigidBody
    buoyancy: Buoyancy
    added_mass: AddedMass
    damping: Damping
    links: dict[Name, LinkNumbers] = Field(default_factory=dict)
    """Numbers of links that this set has otherwise, by name of the link."""
    uncertainty: Uncertainty | None = None
    """Spread of the set's numbers, of identified sets; None: nothing is known of it."""

    @model_validator(mode="after")
    def _check_volume(self) -> Self:
        spread = self.uncertainty and self.uncertainty.volume_m3
        if spread and 5.0 * spread >= self.buoyancy.volume_m3:
            raise ValueError(
                f"uncertainty.volume_m3 = {spread:g}: five standard deviations reach beyond "
                f"buoyancy.volume_m3 = {self.buoyancy.volume_m3:g}"
            )
        return self


class VehicleConfig(FileModel):
    """Vehicle file."""

    name: Name
    """Name of the vehicle, in tables."""
    description: str
    """Description for people."""
    default_set: str
    """Parameter set that is used where none is named."""
    planar: bool = False
    """Whether it moves in the plane of the surface: heave, roll and pitch are held, at the height
    and level at which it starts."""
    base: Base
    hull: HullTable
    thrusters: Thrusters
    fins: Fins | None = None
    """Fins and control surfaces."""
    ballast: Ballast | None = None
    """Ballast tanks."""
    moving_masses: MovingMasses | None = None
    """Masses that move along an axis of the vehicle."""
    rotor: Rotor | None = None
    """Common properties of all thrusters; left out where there are none."""
    visual: Visual
    ardusub: ArduSub | None = None
    """ArduSub frame; None: real ArduSub cannot steer the vehicle."""
    links: Annotated[tuple[Link, ...], Field(max_length=16)] = ()
    """Links of an arm, in any order."""
    joints: Annotated[tuple[Joint, ...], Field(max_length=6)] = ()
    """Joints of the links, in any order."""
    end_effector: EndEffector | None = None
    """End effector; None: the vehicle takes no targets of one."""
    parameter_sets: Annotated[dict[Name, ParameterSet], Field(min_length=1)]
    """Parameter sets by name."""

    @model_validator(mode="after")
    def _check_default(self) -> Self:
        if self.default_set not in self.parameter_sets:
            raise ValueError(
                f"default_set = {format_value(self.default_set)} is not among "
                + ", ".join(self.parameter_sets)
            )
        return self

    @model_validator(mode="after")
    def _check_links(self) -> Self:
        check_tree(self.links, self.joints)
        names = [link.name for link in self.links]
        if self.end_effector is not None and self.end_effector.link not in names:
            raise ValueError(
                f"end_effector.link = {format_value(self.end_effector.link)}: no such link; there "
                "is " + (", ".join(names) or "none")
            )
        for label, chosen in self.parameter_sets.items():
            masses = chosen.uncertainty.link_mass if chosen.uncertainty else {}
            keys = [f"links.{name}" for name in chosen.links]
            keys += [f"uncertainty.link_mass.{name}" for name in masses]
            for key in keys:
                if key.rpartition(".")[2] not in names:
                    raise ValueError(
                        f"parameter_sets.{label}.{key}: no such link; there is "
                        + (", ".join(names) or "none")
                    )
        return self

    @model_validator(mode="after")
    def _check_actuators(self) -> Self:
        checks.check_distinct_names("actuator", list(self.actuator_names))
        return self

    @model_validator(mode="after")
    def _check_planar(self) -> Self:
        if self.planar and (self.links or self.fins or self.ballast or self.moving_masses):
            raise ValueError(
                "planar = true: a vehicle that is held level has neither arm nor fins, ballast or "
                "moving masses"
            )
        return self

    @model_validator(mode="after")
    def _check_propelled(self) -> Self:
        if self.thrusters.layout and self.rotor is None:
            raise ValueError("rotor: missing; thrusters need the table [rotor]")
        if not self.thrusters.layout and self.rotor is not None:
            raise ValueError("rotor: there are no thrusters; leave the table [rotor] out")
        if not self.actuator_names:
            raise ValueError("thrusters.layout: empty, and there is no other actuator")
        return self

    @model_validator(mode="after")
    def _check_trim(self) -> Self:
        if not self.tanks and not self.masses:
            return self
        for label, chosen in self.parameter_sets.items():
            try:
                check_inertia(
                    self.tanks,
                    self.masses,
                    self.base.center_of_mass_m,
                    chosen.rigid_body.mass_kg,
                    chosen.rigid_body.inertia_kgm2,
                )
            except ValueError as error:
                raise ValueError(f"parameter_sets.{label}: {error}") from error
        return self

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Return the names of thrusters, fins, tanks and masses, in the order of their signals."""
        parts = (self.thrusters, self.fins, self.ballast, self.moving_masses)
        return tuple(item.name for part in parts if part is not None for item in part.layout)

    @property
    def tanks(self) -> tuple[Tank, ...]:
        """Return the ballast tanks."""
        return self.ballast.layout if self.ballast else ()

    @property
    def masses(self) -> tuple[MovingMass, ...]:
        """Return the moving masses."""
        return self.moving_masses.layout if self.moving_masses else ()

    @property
    def published_sets(self) -> tuple[str, ...]:
        """Return the names of the sets as published: those without a stated uncertainty."""
        sets = self.parameter_sets.items()
        return tuple(name for name, chosen in sets if chosen.uncertainty is None)

    def find_links(self, name: str | None) -> list[Link]:
        """Return the links in the simulator's order, with the numbers of a parameter set.

        Args:
            name: of the set; None for the default one.

        Raises:
            ConfigError: the vehicle has no set of that name.
        """
        changes = self.find_set(name).links
        return [
            link.model_copy(update=changes[link.name].groups()) if link.name in changes else link
            for link in order_links(self.links)
        ]

    def find_joints(self) -> list[Joint]:
        """Return the joints in the simulator's order."""
        return order_joints(self.links, self.joints)

    def find_set(self, name: str | None) -> ParameterSet:
        """Return the named parameter set, or the default one for None.

        Raises:
            ConfigError: the vehicle has no set of that name.
        """
        chosen = self.default_set if name is None else name
        if chosen not in self.parameter_sets:
            raise ConfigError(
                f"vehicle {self.name!r} has no parameter set {format_value(chosen)}; "
                f"it has {', '.join(self.parameter_sets)}"
            )
        return self.parameter_sets[chosen]

    def find_response(self, name: RotorResponse | None) -> RotorResponse:
        """Return the named response of the rotors, or the file's own for None.

        Raises:
            ConfigError: the vehicle file has no numbers for it.
        """
        if self.rotor is None:
            return "first_order"
        chosen = self.rotor.response if name is None else name
        if chosen == "third_order" and self.rotor.third_order is None:
            raise ConfigError(
                f"vehicle {self.name!r} has no table [rotor.third_order]: add it to its file, or "
                'use rotor_response = "first_order"'
            )
        return chosen

    def find_health(self, health: Mapping[str, float]) -> tuple[float, ...]:
        """Return the fraction of its thrust that each thruster gives, in the order of ``layout``.

        Args:
            health: fractions in [0, 1] by thruster name; 1 for thrusters that are not listed.

        Raises:
            ConfigError: the vehicle has no thruster of a name, or a fraction is out of range.
        """
        names = [thruster.name for thruster in self.thrusters.layout]
        for name, fraction in health.items():
            if name not in names:
                raise ConfigError(
                    f"vehicle {self.name!r} has no thruster {format_value(name)}; it has "
                    + ", ".join(names)
                )
            if not 0.0 <= fraction <= 1.0:
                raise ConfigError(
                    f"thruster {name!r} of vehicle {self.name!r}: health {fraction} is not between "
                    "0 (dead) and 1 (sound)"
                )
        return tuple(health.get(name, 1.0) for name in names)
