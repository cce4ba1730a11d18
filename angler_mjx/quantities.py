"""Bounds of values in files: values beyond them indicate a wrong unit or a typing error."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

MAX_COORDINATE_M = 20_000.0
"""Max length and coordinate in a file: float32 resolves positions there to 2 mm, and no sea is
deeper than 11 km."""
MAX_SPEED_MPS = 20.0
"""Max speed of water and obstacles in a file: the fastest tidal stream, Saltstraumen, reaches 10
m/s."""

type Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
type Length = Annotated[float, Field(ge=0, le=MAX_COORDINATE_M)]
type PositiveLength = Annotated[float, Field(gt=0, le=MAX_COORDINATE_M)]


def check_speed(value: float) -> float:
    """Check a speed, of either sign."""
    if abs(value) > MAX_SPEED_MPS:
        raise ValueError(
            f"faster than {MAX_SPEED_MPS:g} m/s; the fastest tidal stream on Earth makes 10 m/s"
        )
    return value


type Speed = Annotated[float, AfterValidator(check_speed)]


def _reject_bool[T](value: T) -> T:
    if isinstance(value, bool):
        raise ValueError("must be a number")
    return value


type SchemaVersion = Annotated[Literal[1], BeforeValidator(_reject_bool)]
type Sign = Annotated[Literal[-1, 1], BeforeValidator(_reject_bool)]
"""A sign; validated before ``Literal``, which accepts true as 1."""
