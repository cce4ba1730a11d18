"""Bounds of what stands in files: numbers beyond them mean a slip of unit or of the finger."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

FARTHEST_M = 20_000.0
"""Longest length and farthest place in a file: float32 tells places there apart by 2 mm, and no sea
is deeper than 11 km."""
FASTEST_MPS = 20.0
"""Fastest water and obstacle in a file: the fastest tidal stream, Saltstraumen, makes 10 m/s."""

type Place = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
type Length = Annotated[float, Field(ge=0, le=FARTHEST_M)]
type PositiveLength = Annotated[float, Field(gt=0, le=FARTHEST_M)]


def no_faster(value: float) -> float:
    """Check a speed, of either sign."""
    if abs(value) > FASTEST_MPS:
        raise ValueError(
            f"faster than {FASTEST_MPS:g} m/s; the fastest tidal stream on Earth makes 10 m/s"
        )
    return value


type Speed = Annotated[float, AfterValidator(no_faster)]


def _number(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("must be a number")
    return value


type SchemaVersion = Annotated[Literal[1], BeforeValidator(_number)]
type Sign = Annotated[Literal[-1, 1], BeforeValidator(_number)]
"""For ``Literal`` alone, true is 1."""
