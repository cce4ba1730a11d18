"""Bounds of what stands in files: numbers beyond them mean a slip of unit or of the finger."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

MAX_COORDINATE_M = 20_000.0
"""Longest length and farthest place in a file: float32 tells places there apart by 2 mm, and no sea
is deeper than 11 km."""
MAX_SPEED_MPS = 20.0
"""Fastest water and obstacle in a file: the fastest tidal stream, Saltstraumen, makes 10 m/s."""

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


def _reject_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("must be a number")
    return value


type SchemaVersion = Annotated[Literal[1], BeforeValidator(_reject_bool)]
type Sign = Annotated[Literal[-1, 1], BeforeValidator(_reject_bool)]
"""For ``Literal`` alone, true is 1."""
