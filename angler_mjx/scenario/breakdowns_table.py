"""The table of a scenario file on robots that break down: fraction and times."""

from collections.abc import Mapping
from typing import ClassVar, Self

from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.scenario.tables import TimeConfig


class BreakdownsConfig(FileModel):
    """Robots that break down in flight, for good; their episode ends as `failed`.

    Each robot is sampled independently: the number of failures varies between worlds, and another
    robot in the fleet changes nothing for those before it. No other sample changes.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "share": "fraction",
    }

    fraction: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a robot breaks down; 0 for none."""
    earliest_s: float = Field(default=0.0, ge=0.0, le=86400.0)
    """Start of the interval in which times are uniformly sampled. A robot ends with the first
    control period that is over at its time or later, if its episode lasts that long."""
    latest_s: float | None = Field(default=None, gt=0.0, le=86400.0)
    """End of the interval; the horizon if left out."""

    @model_validator(mode="after")
    def _check_times_used(self) -> Self:
        unused_keys = self.model_fields_set - {"fraction"}
        if self.fraction == 0.0 and (self.earliest_s > 0.0 or self.latest_s is not None):
            raise ValueError(
                f"{', '.join(sorted(unused_keys))}: no robot breaks down; give fraction"
            )
        return self

    def span_s(self, horizon_s: float) -> tuple[float, float]:
        """Return the earliest and the latest time, s."""
        return self.earliest_s, horizon_s if self.latest_s is None else self.latest_s


def check_breakdowns(breakdowns: BreakdownsConfig, time: TimeConfig) -> None:
    """Refuse an empty interval, and times that no episode reaches.

    Raises:
        ValueError: naming the key and its value.
    """
    earliest, latest = breakdowns.span_s(time.horizon_s)
    if latest > time.horizon_s:
        raise ValueError(
            f"breakdowns.latest_s = {latest:g}: episodes end at time.horizon_s = "
            f"{time.horizon_s:g}; take at most that, or leave it out"
        )
    if earliest > latest:
        key = "time.horizon_s" if breakdowns.latest_s is None else "breakdowns.latest_s"
        raise ValueError(
            f"breakdowns.earliest_s = {earliest:g}: later than {key} = {latest:g}; "
            "the earlier time comes first"
        )
