"""Models of a vehicle file and of a thruster file.

Every group of numbers carries its ``source``. The base frame of a vehicle file has its axes as F
(x forward, y left, z up) and an origin chosen by the file; everything under ``parameter_sets`` is
about the centre of mass.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel
from angler_mjx.quantities import Coordinate, Sign
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.checks import Matrix
from angler_mjx.robot.vehicles.rotor_config import Positive, Rotor, RotorResponse, Source

type Vector3 = tuple[Coordinate, Coordinate, Coordinate]
type Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+$", max_length=64)]
type Fraction = Annotated[float, Field(ge=0, le=1)]


class Capsule(FileModel):
    """A cylinder with half-spheres at its ends, in the base frame."""

    from_m: Vector3
    """One end of the axis."""
    to_m: Vector3
    """The other end."""
    radius_m: Positive
    """Of the cylinder and its ends."""

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        # MuJoCo takes no capsule without a length; files give millimetres.
        if math.dist(self.from_m, self.to_m) < 1e-3:
            raise ValueError("from_m and to_m: must be at least 1 mm apart, also for a ball")
        return self


class Base(FileModel):
    """Where the centre of mass lies in the base frame."""

    center_of_mass_m: Vector3
    """In the base frame."""
    source: Source


class HullTable(FileModel):
    """Outer shape: for distances, and for how buoyancy fades at the surface."""

    height_m: Positive
    """Height over which buoyancy fades from full to none as the hull leaves the water."""
    capsules: Annotated[tuple[Capsule, ...], Field(min_length=1, max_length=64)]
    """Together they are the hull; distances are to them."""
    source: Source


class Thruster(FileModel):
    """One thruster, in the base frame."""

    name: Name
    """For faults of thrusters, and in tables."""
    position_m: Vector3
    """Of the rotor."""
    direction: Annotated[tuple[float, float, float], AfterValidator(checks.check_unit_vector)]
    """Unit vector of the force on the vehicle at positive thrust (PWM above neutral)."""
    spin: Sign
    """+1 if the rotor turns right-handed about ``direction`` at positive thrust."""


class Thrusters(FileModel):
    """Where the thrusters are and where they push."""

    layout: Annotated[tuple[Thruster, ...], Field(min_length=1, max_length=64)]
    """In the order of the signals."""
    source: Source

    @field_validator("layout")
    @classmethod
    def _check_distinct(cls, value: tuple[Thruster, ...]) -> tuple[Thruster, ...]:
        checks.check_distinct_names("thruster", [thruster.name for thruster in value])
        return value


class _Shape(FileModel):
    name: Name
    """Of the geometry in the MuJoCo model."""
    rgba: tuple[Fraction, Fraction, Fraction, Fraction]
    """Colour, and opacity."""


class Box(_Shape):
    """A visible box: centre and full edge lengths, in the base frame."""

    shape: Literal["box"]
    position_m: Vector3
    """Centre."""
    size_m: tuple[Positive, Positive, Positive]
    """Full edges."""


class Cylinder(_Shape):
    """A visible cylinder between two points of the base frame."""

    shape: Literal["cylinder"]
    from_m: Vector3
    """One end of the axis."""
    to_m: Vector3
    """The other end."""
    radius_m: Positive
    """Of the cylinder."""


class Sphere(_Shape):
    """A visible sphere, in the base frame."""

    shape: Literal["sphere"]
    position_m: Vector3
    """Centre."""
    radius_m: Positive
    """Of the sphere."""


type Shape = Annotated[Box | Cylinder | Sphere, Field(discriminator="shape")]


class Visual(FileModel):
    """What a viewer shows; nothing of it enters the physics."""

    shapes: Annotated[tuple[Shape, ...], Field(max_length=256)]
    """For viewers."""
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


class Buoyancy(FileModel):
    """Displaced volume and where its centre lies, from the centre of mass."""

    volume_m3: Positive
    """Fully submerged."""
    center_of_buoyancy_m: Vector3
    """From the centre of mass."""
    source: Source


class AddedMass(FileModel):
    """Added mass at the centre of mass, in F, as positive numbers."""

    coefficients: Annotated[Matrix, BeforeValidator(checks.check_added_mass)]
    """Six diagonal values or a full 6 x 6 matrix; kg, kg m, kg m^2."""
    source: Source


class Damping(FileModel):
    """Diagonal damping at the centre of mass, in F, as positive numbers."""

    linear: Annotated[tuple[float, ...], AfterValidator(checks.check_damping)]
    """N s/m (first three), N m s/rad."""
    quadratic: Annotated[tuple[float, ...], AfterValidator(checks.check_damping)]
    """N s^2/m^2 (first three), N m s^2/rad^2."""
    source: Source

    @model_validator(mode="after")
    def _check_damped(self) -> Self:
        free = [
            i
            for i, pair in enumerate(zip(self.linear, self.quadratic, strict=True))
            if pair == (0, 0)
        ]
        if free:
            raise ValueError(
                f"no damping at all on axis {free[0]} of [u v w p q r]; "
                "give a linear or a quadratic coefficient above zero"
            )
        return self


class ArduSub(FileModel):
    """How the vehicle is known to the ArduSub firmware."""

    frame: Literal["vectored", "vectored_6dof"]
    """Its frame there; thrusters must stand in ``layout`` as that frame numbers its motors."""
    source: Source


class ParameterSet(FileModel):
    """One published or identified set of coefficients of the vehicle."""

    description: str
    """For people."""
    rigid_body: RigidBody
    buoyancy: Buoyancy
    added_mass: AddedMass
    damping: Damping


class VehicleConfig(FileModel):
    """A vehicle file."""

    name: Name
    """Of the vehicle, in tables."""
    description: str
    """For people."""
    default_set: str
    """The parameter set that is used where none is named."""
    base: Base
    hull: HullTable
    thrusters: Thrusters
    rotor: Rotor
    visual: Visual
    ardusub: ArduSub | None = None
    """None: no real ArduSub can steer it."""
    parameter_sets: Annotated[dict[Name, ParameterSet], Field(min_length=1)]
    """By name."""

    @model_validator(mode="after")
    def _check_default(self) -> Self:
        if self.default_set not in self.parameter_sets:
            raise ValueError(
                f"default_set = {format_value(self.default_set)} is none of "
                + ", ".join(self.parameter_sets)
            )
        return self

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
        chosen = self.rotor.response if name is None else name
        if chosen == "third_order" and self.rotor.third_order is None:
            raise ConfigError(
                f"vehicle {self.name!r} has no table [rotor.third_order]: add it to its file, or "
                'use rotor_response = "first_order"'
            )
        return chosen

    def find_health(self, health: Mapping[str, float]) -> tuple[float, ...]:
        """Return the share of its thrust that each thruster gives, in the order of ``layout``.

        Args:
            health: shares in [0, 1] by thruster name; the others give all of theirs.

        Raises:
            ConfigError: the vehicle has no thruster of a name, or a share is out of range.
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
