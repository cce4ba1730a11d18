"""Models that vehicles and their links share: names, points and capsules of hulls."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.quantities import Coordinate
from angler_mjx.robot.vehicles import checks
from angler_mjx.robot.vehicles.rotor_config import Positive

type Vector3 = tuple[Coordinate, Coordinate, Coordinate]
type Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+$", max_length=64)]


class Capsule(FileModel):
    """Cylinder with half-spheres at its ends, in the frame of its body."""

    from_m: Vector3
    """[3] one end of the axis, m."""
    to_m: Vector3
    """[3] other end of the axis, m."""
    radius_m: Positive
    """Radius of the cylinder and its ends, m."""

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        checks.check_apart(self.from_m, self.to_m)
        return self
