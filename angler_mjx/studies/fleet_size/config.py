"""What a fleet-size file says: a task, sizes of teams, conditions, and when the answer is good."""

import itertools
import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Self

from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import format_value
from angler_mjx.files import FileModel
from angler_mjx.quantities import SchemaVersion
from angler_mjx.scenario.editing import Changes
from angler_mjx.studies.grid import find_reserved_key

MAX_CONDITIONS = 64
MAX_WORLDS = 1_000_000

type Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f|,]+$")]
type Size = Annotated[int, Field(ge=1, le=1024)]

RESERVED_KEYS = {
    "name": "name",
    "description": "description",
    "schema_version": "schema_version",
    "worlds": "budget.max_worlds",
    "seed": "seed",
}
"""Keys of a scenario that a fleet-size file says by keys of its own."""


class SpanConfig(FileModel):
    """All sizes from one to another."""

    from_: Size = Field(default=1, alias="from")
    """The smallest team."""
    to: Size
    """The largest team."""

    @model_validator(mode="after")
    def _require_rising(self) -> Self:
        if self.to <= self.from_:
            raise ValueError(f"to = {self.to}: must be above from = {self.from_}")
        return self


class SizeConfig(FileModel):
    """What the size of a team is in the scenario."""

    key: str = Field(default="fleet.0.count", min_length=1, max_length=200)
    """The key that it sets; entries of lists by their index from 0."""


class BudgetConfig(FileModel):
    """How much is flown."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "most_minutes": "max_minutes",
        "most_worlds": "max_worlds",
    }

    batch: int = Field(default=256, ge=1, le=100_000)
    """Worlds of one size and condition that are flown before the answer is looked at again."""
    max_worlds: int = Field(default=4096, ge=1, le=MAX_WORLDS)
    """Of one size and condition; whole batches."""
    max_minutes: float | None = Field(default=None, gt=0.0, le=1e6)
    """No batch begins later than this after the study, or its resumption, began; no limit if left
    out. The only setting by which two runs of a study may end differently."""

    @model_validator(mode="after")
    def _require_whole_batch(self) -> Self:
        if self.max_worlds < self.batch:
            raise ValueError(f"max_worlds = {self.max_worlds}: must hold one batch of {self.batch}")
        return self


class ConditionConfig(FileModel):
    """One kind of worlds and robots."""

    name: Name
    """As tables and figures call it."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that are otherwise here; tables are merged."""


class FleetSizeConfig(FileModel):
    """A whole fleet-size file."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "share": "fraction",
    }

    schema_version: SchemaVersion = 1
    """Of this form of files."""
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    """Of the study's folder, if it is given none."""
    description: str = ""
    """For people."""
    scenario: str
    """That is flown: a shipped one, or a file, from the folder of this one."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that are otherwise in this study; tables are merged."""
    sizes: tuple[Size, ...] | SpanConfig
    """Of teams: a list, all of which are flown; or { from = 1, to = 64 }, of which those are flown
    that the answer hangs on."""
    size: SizeConfig = SizeConfig()
    deadline_s: float = Field(gt=0.0, le=1e7)
    """The task is to be done by then, from the start of a world."""
    fraction: float = Field(default=1.0, gt=0.0, le=1.0)
    """Where the scenario has no task but a goal for each robot: the share of the team that is to
    arrive."""
    arrivals: int | None = Field(default=None, ge=1, le=1024)
    """Instead of a share: so many robots are to arrive, however many set off."""
    probability: float = Field(default=0.95, ge=0.01, le=0.999)
    """With which the deadline is to be met."""
    confidence: float = Field(default=0.95, ge=0.5, le=0.999)
    """Of the interval of the answer."""
    within: int = Field(default=1, ge=0, le=1024)
    """The answer is sharp enough where its interval holds at most 2 within + 1 sizes of the
    file."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Of the worlds: world i is the same for all sizes and conditions, as far as they allow."""
    budget: BudgetConfig = BudgetConfig()
    axis: dict[Name, dict[Name, Changes]] = Field(default_factory=dict)
    """Things that differ, each with its values by name; a value holds keys of the scenario, as set
    does. Conditions are all combinations."""
    condition: tuple[ConditionConfig, ...] = ()
    """Conditions that are no combination; combined with axes where both are given."""

    @model_validator(mode="after")
    def _require_one_measure(self) -> Self:
        if self.arrivals is not None and "fraction" in self.model_fields_set:
            raise ValueError("fraction and arrivals: give one of them, not both")
        if self.arrivals is not None and self.arrivals > self.all_sizes()[-1]:
            raise ValueError(
                f"arrivals = {self.arrivals}: no team of sizes has so many robots; give fewer"
            )
        return self

    @field_validator("sizes")
    @classmethod
    def _require_increasing(
        cls, sizes: tuple[int, ...] | SpanConfig
    ) -> tuple[int, ...] | SpanConfig:
        if isinstance(sizes, tuple):
            if not sizes:
                raise ValueError("there is none; give one or more")
            pairs = itertools.pairwise(sizes)
            bad = next((b for a, b in pairs if b <= a), None)
            if bad is not None:
                raise ValueError(f"must increase, and {bad} does not; sort them, each once")
        return sizes

    @model_validator(mode="after")
    def _check_conditions(self) -> Self:
        count = max(len(self.condition), 1)
        for name, values in self.axis.items():
            if not values:
                raise ValueError(f"axis.{name}: has no values; give one or more, or leave it out")
            count *= len(values)
        if count > MAX_CONDITIONS:
            raise ValueError(
                f"axis and condition: make {count} conditions; {MAX_CONDITIONS} are the most"
            )
        names = [entry.name for entry in self.condition]
        duplicate = next((name for name in names if names.count(name) > 1), None)
        if duplicate is not None:
            raise ValueError(
                f"condition {format_value(duplicate)} is there twice; give each its own name"
            )
        return self

    @model_validator(mode="after")
    def _refuse_reserved_keys(self) -> Self:
        tables = [("set", self.set)]
        tables += [
            (f"condition {format_value(entry.name)}, set", entry.set) for entry in self.condition
        ]
        tables += [
            (f"axis.{axis}.{name}", table)
            for axis, values in self.axis.items()
            for name, table in values.items()
        ]
        for where, table in tables:
            if fault := find_reserved_key(table, RESERVED_KEYS):
                raise ValueError(f"{where}.{fault}")
        return self

    def all_sizes(self) -> tuple[int, ...]:
        """Sizes that can be the answer, increasing."""
        if isinstance(self.sizes, SpanConfig):
            return tuple(range(self.sizes.from_, self.sizes.to + 1))
        return self.sizes

    def required_arrivals(self, robots: int) -> int:
        """Robots of a team that have to arrive; of a task with several jobs nobody asks."""
        if self.arrivals is not None:
            return self.arrivals
        return max(1, math.ceil(self.fraction * robots - 1e-9))

    def smoke(self) -> "FleetSizeConfig":
        """The same with two sizes and a few worlds, to see that it runs.

        The smallest size, which is likely to be too few, and the one in the middle of
        `first_sizes`, which may be enough.
        """
        first = self.first_sizes()
        sizes = tuple(sorted({first[0], first[len(first) // 2]}))
        budget = BudgetConfig(batch=4, max_worlds=4)
        return self.model_copy(update={"sizes": sizes, "budget": budget})

    def first_sizes(self) -> tuple[int, ...]:
        """Sizes that are flown whatever the answer is: all of a list, or powers of two of a span.

        A span's ends are among them.
        """
        if not isinstance(self.sizes, SpanConfig):
            return self.sizes
        low, high = self.sizes.from_, self.sizes.to
        powers = {2**k for k in range(11) if low < 2**k < high}
        return tuple(sorted({low, high, *powers}))
