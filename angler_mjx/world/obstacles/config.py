"""What a scenario file may say about obstacles: some by hand, some drawn.

Lengths in metres, angles in degrees, all places and directions in W (x east, y north, z up).
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
    """Stays where it is."""

    type: Literal["static"] = "static"


class DriftMotion(FileModel):
    """Moves as the water moves it."""

    type: Literal["drift"] = "drift"
    relative_velocity_mps: Velocity = (0.0, 0.0, 0.0)
    """Velocity at the start relative to the water there; zero: it starts with the water."""


class StraightMotion(FileModel):
    """Moves at constant speed and is thrown back by the bounds of the world."""

    type: Literal["straight"] = "straight"
    velocity_mps: Velocity
    """At the start; east, north, up."""


class SineMotion(FileModel):
    """Swings about its position."""

    type: Literal["sine"] = "sine"
    amplitude_m: Vector
    """East, north, up."""
    period_s: Period
    """Of a whole swing."""
    phase_deg: Angle = 0.0
    """At t = 0; 0 in the middle."""


class CircleMotion(FileModel):
    """Goes round its position, anticlockwise about the axis."""

    type: Literal["circle"] = "circle"
    radius_m: PositiveLength
    """Of the circle."""
    period_s: Period
    """Of a whole turn."""
    clockwise: bool = False
    """The other way round."""
    phase_deg: Angle = 0.0
    """Angle at t = 0, from east (from north where the axis is nearly east)."""
    axis: Axis = (0.0, 0.0, 1.0)
    """About which it goes, in W; of any length."""

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
    """Centre at the start; of the swing or circle for those motions."""
    rpy_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw: turned about x, then y, then z of the world."""
    motion: Motion = StaticMotion()
    """How it moves."""
    mass_kg: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """As heavy as the water it displaces if left out; matters for drifting ones only."""


class SphereConfig(_PositionedTable):
    """A sphere."""

    type: Literal["sphere"] = "sphere"
    radius_m: PositiveLength
    """Of the sphere."""


class BoxConfig(_PositionedTable):
    """A box; ``size_m`` is its full length along its own x, y and z."""

    type: Literal["box"] = "box"
    size_m: tuple[PositiveLength, PositiveLength, PositiveLength]
    """Full edges."""


class CapsuleConfig(_PositionedTable):
    """A capsule along its own z; ``length_m`` is that of the axis, without the caps."""

    type: Literal["capsule"] = "capsule"
    radius_m: PositiveLength
    """Of the caps."""
    length_m: PositiveLength
    """Of the axis."""


type ExplicitConfig = Annotated[
    SphereConfig | BoxConfig | CapsuleConfig, Field(discriminator="type")
]


class DynamicConfig(FileModel):
    """Drifting spheres and cubes, drawn anew for each world."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "cube_share": "cube_fraction",
        "rise_share": "rise_fraction",
        "sink_share": "sink_fraction",
    }

    count: int = Field(default=0, ge=0, le=4096)
    """Number in each world."""
    radius_m: Span = (0.4, 0.75)
    """Lowest and highest radius, of the sphere or of the sphere around the cube."""
    cube_fraction: Fraction = 0.5
    """Probability of a cube; the others are spheres."""
    rise_fraction: Fraction = 0.2
    """Probability of one lighter than water."""
    sink_fraction: Fraction = 0.2
    """Probability of one heavier than water; the rest are neutral."""
    vertical_speed_mps: SpeedSpan = (0.02, 0.1)
    """Lowest and highest steady speed at which the light ones rise and the heavy ones sink; it
    sets their mass. (Density would be an awkward knob: a sphere of 0.5 m radius that is 0.1 %
    lighter than water already rises at 0.17 m/s.)"""

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
    """The obstacles of a scenario beside the cells of its grid."""

    dynamic: DynamicConfig = DynamicConfig()
    """Those that are drawn."""
    explicit: tuple[ExplicitConfig, ...] = ()
    """Those that stand where the file says."""
