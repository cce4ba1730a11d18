"""Models of rotors in a vehicle file: response of thrust to its command, and reaction torque."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles import checks

type RotorResponse = Literal["first_order", "third_order"]
type Positive = Annotated[float, Field(gt=0), AfterValidator(checks.check_positive)]
type Number = Annotated[float, Field(ge=-checks.LARGEST, le=checks.LARGEST)]
type Source = Annotated[str, Field(min_length=1)]
"""Origin of the numbers."""


class LagTable(FileModel):
    """First-order lag of the rotors."""

    time_constant_s: Positive
    """Time constant of the thrust, s."""
    source: Source


class ThirdOrder(FileModel):
    """Transfer function of the rotors from settled to present thrust, highest power of s first."""

    numerator: tuple[Number, Number, Number]
    """Coefficients of s^2, s and 1."""
    denominator: tuple[Positive, Positive, Positive, Positive]
    """Coefficients of s^3, s^2, s and 1."""
    source: Source

    @model_validator(mode="after")
    def _check_settles(self) -> Self:
        a_3, a_2, a_1, a_0 = self.denominator
        if not a_2 * a_1 > a_3 * a_0:
            raise ValueError(
                f"denominator = {list(self.denominator)}: the rotor would swing for ever; "
                "the product of the two middle numbers must exceed that of the outer ones"
            )
        if self.numerator[-1] != a_0:
            raise ValueError(
                f"numerator ends with {self.numerator[-1]:g} and denominator with {a_0:g}: "
                "they must be equal, or thrust would not settle at the thruster table's"
            )
        return self


class ReactionTorque(FileModel):
    """Torque about the rotor's axis per newton of thrust."""

    coefficient_m: Annotated[float, Field(ge=0, le=100)]
    """Newton metres per newton of thrust."""
    source: Source


class Rotor(FileModel):
    """Common properties of all thrusters of the vehicle."""

    model: str
    """Name of a shipped thruster file, or a path to one, relative to the vehicle file."""
    response: RotorResponse = "first_order"
    """Response of the rotors where a fleet does not choose another."""
    lag: LagTable
    third_order: ThirdOrder | None = None
    reaction_torque: ReactionTorque

    @model_validator(mode="after")
    def _check_third_order(self) -> Self:
        if self.response == "third_order" and self.third_order is None:
            raise ValueError('response = "third_order" needs a table [rotor.third_order]')
        return self
