"""The obstacles table of a scenario file: explicit and sampled obstacles.

Lengths in metres, angles in degrees, all positions and directions in W (x east, y north, z up).
"""

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.quantities import Coordinate, PositiveLength, Speed

type Vector = tuple[Coordinate, Coordinate, Coordinate]
type Velocity = tuple[Speed, Speed, Speed]
type Span = tuple[PositiveLength, PositiveLength]
type SpeedSpan = tuple[Speed, Speed]
type Component = Annotated[float, Field(ge=-1e6, le=1e6)]
type Axis = tuple[Component, Component, Component]
type Angle = Annotated[float, Field(ge=-36_000, le=36_000)]
type Period = Annotated[float, Field(ge=0.01, le=1e6)]
Fraction = Annotated[float, Field(ge=0, le=1)]


class StaticMotion(FileModel):
    """No motion."""

    type: Literal["static"] = "static"


class DriftMotion(FileModel):
    """Drift with the water."""

    type: Literal["drift"] = "drift"
    relative_velocity_mps: Velocity = (0.0, 0.0, 0.0)
    """Velocity at the start relative to the water there; zero for the velocity of the water."""


class StraightMotion(FileModel):
    """Motion at constant speed, reflected by the bounds of the world."""

    type: Literal["straight"] = "straight"
    velocity_mps: Velocity
    """Velocity at the start; east, north, up."""


class SineMotion(FileModel):
    """Sinusoidal motion about the obstacle's position."""

    type: Literal["sine"] = "sine"
    amplitude_m: Vector
    """Amplitude; east, north, up."""
    period_s: Period
    """Period of the oscillation."""
    phase_deg: Angle = 0.0
    """Phase at t = 0; 0 in the middle."""


class CircleMotion(FileModel):
    """Circular motion about the obstacle's position, anticlockwise about the axis."""

    type: Literal["circle"] = "circle"
    radius_m: PositiveLength
    """Radius of the circle."""
    period_s: Period
    """Period of a full turn."""
    clockwise: bool = False
    """Whether the motion is clockwise."""
    phase_deg: Angle = 0.0
    """Angle at t = 0, from east (from north where the axis is nearly east)."""
    axis: Axis = (0.0, 0.0, 1.0)
    """Axis of the circle, in W; of any length."""

    @model_validator(mode="after")
    def _check_axis(self) -> Self:
        if math.hypot(*self.axis) < 1e-9:
            raise ValueError("axis must not be zero")
        return self


type Motion = Annotated[
    StaticMotion | DriftMotion | StraightMotion | SineMotion | CircleMotion,
    Field(discriminator="type"),
]


class _PositionedTable(FileModel):
    position_m: Vector
    """Centre at the start; for sine and circle, the centre of the motion."""
    rpy_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw: rotations about x, then y, then z of the world."""
    motion: Motion = StaticMotion()
    """Motion of the obstacle."""
    mass_kg: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Mass; that of the displaced water if left out. Used for drifting obstacles only."""


class SphereConfig(_PositionedTable):
    """A sphere."""

    type: Literal["sphere"] = "sphere"
    radius_m: PositiveLength
    """Radius of the sphere."""


class BoxConfig(_PositionedTable):
    """A box; ``size_m`` is its full length along its own x, y and z."""

    type: Literal["box"] = "box"
    size_m: tuple[PositiveLength, PositiveLength, PositiveLength]
    """Full edge lengths."""


class CapsuleConfig(_PositionedTable):
    """A capsule along its own z; ``length_m`` is that of the axis, without the caps."""

    type: Literal["capsule"] = "capsule"
    radius_m: PositiveLength
    """Radius of the caps."""
    length_m: PositiveLength
    """Length of the axis."""


type ExplicitConfig = Annotated[
    SphereConfig | BoxConfig | CapsuleConfig, Field(discriminator="type")
]


class DynamicConfig(FileModel):
    """Drifting spheres and cubes, sampled for each world."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "cube_share": "cube_fraction",
        "rise_share": "rise_fraction",
        "sink_share": "sink_fraction",
    }

    count: int = Field(default=0, ge=0, le=4096)
    """Number in each world."""
    radius_m: Span = (0.4, 0.75)
    """Min and max radius, of the sphere or of the bounding sphere of the cube."""
    cube_fraction: Fraction = 0.5
    """Probability of a cube; the others are spheres."""
    rise_fraction: Fraction = 0.2
    """Probability of a body lighter than water."""
    sink_fraction: Fraction = 0.2
    """Probability of a body heavier than water; the rest are neutral."""
    vertical_speed_mps: SpeedSpan = (0.02, 0.1)
    """Min and max steady speed at which light bodies rise and heavy ones sink; it sets their mass.
    (Density is impractical as a parameter: a sphere of 0.5 m radius that is 0.1 % lighter than
    water already rises at 0.17 m/s.)"""

    @model_validator(mode="after")
    def _check_spans(self) -> Self:
        if not 0 < self.radius_m[0] <= self.radius_m[1]:
            raise ValueError(f"radius_m = {self.radius_m}: needs 0 < low <= high")
        if not 0 <= self.vertical_speed_mps[0] <= self.vertical_speed_mps[1]:
            raise ValueError(
                f"vertical_speed_mps = {self.vertical_speed_mps}: needs 0 <= low <= high"
            )
        if self.rise_fraction + self.sink_fraction > 1:
            raise ValueError("rise_fraction and sink_fraction add up to more than 1")
        return self


class ObstaclesConfig(FileModel):
    """Obstacles of a scenario beside the cells of its grid."""

    dynamic: DynamicConfig = DynamicConfig()
    """Sampled obstacles."""
    explicit: tuple[ExplicitConfig, ...] = ()
    """Obstacles listed in the file."""
