"""Fleet-size file: a task, team sizes, conditions, and the required precision of the answer."""

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
    """Span of team sizes, of which those are flown that the answer depends on."""

    from_: Size = Field(default=1, alias="from")
    """Smallest team size [robots]."""
    to: Size
    """Largest team size [robots]; above `from`."""

    @model_validator(mode="after")
    def _require_rising(self) -> Self:
        if self.to <= self.from_:
            raise ValueError(f"to = {self.to}: must be above from = {self.from_}")
        return self


class SizeConfig(FileModel):
    """Key of the scenario that holds the team size."""

    key: str = Field(default="fleet.0.count", min_length=1, max_length=200)
    """Dotted key; entries of lists by their index from 0."""


class BudgetConfig(FileModel):
    """Limits of the worlds that are flown."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "most_minutes": "max_minutes",
        "most_worlds": "max_worlds",
    }

    batch: int = Field(default=256, ge=1, le=100_000)
    """Number of worlds of one size and condition between two evaluations of the answer."""
    max_worlds: int = Field(default=4096, ge=1, le=MAX_WORLDS)
    """Max number of worlds of one size and condition, at least one batch; rounded up to whole
    batches."""
    max_minutes: float | None = Field(default=None, gt=0.0, le=1e6)
    """Wall-clock time after the start or resumption of the study from which no batch begins; no
    limit if left out. The only key by which two runs of a study may end differently."""

    @model_validator(mode="after")
    def _require_whole_batch(self) -> Self:
        if self.max_worlds < self.batch:
            raise ValueError(f"max_worlds = {self.max_worlds}: must hold one batch of {self.batch}")
        return self


class ConditionConfig(FileModel):
    """Worlds and robots of one kind."""

    name: Name
    """Name in tables and figures, unique in the file."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that differ in the condition; tables are merged."""


class FleetSizeConfig(FileModel):
    """A whole fleet-size file."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "share": "fraction",
    }

    schema_version: SchemaVersion = 1
    """Version of the file format."""
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    """Name of the study; also of its folder, unless `--out` names one."""
    description: str = ""
    """Free text for readers."""
    scenario: str
    """Scenario that is flown: a shipped one, or a file, relative to the folder of this file."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that differ in this study; tables are merged. Keys that this file
    replaces by keys of its own, such as worlds or seed, are refused with the key to use."""
    sizes: tuple[Size, ...] | SpanConfig
    """Team sizes [robots]: an increasing list, all of which are flown, or a span, { from = 1,
    to = 64 }, of which those are flown that the answer depends on."""
    size: SizeConfig = SizeConfig()
    deadline_s: float = Field(gt=0.0, le=1e7)
    """Time limit of the task from the start of a world; at most the scenario's time.horizon_s."""
    fraction: float = Field(default=1.0, gt=0.0, le=1.0)
    """Fraction of the team that must arrive; only for scenarios without a task, where each robot
    has a goal."""
    arrivals: int | None = Field(default=None, ge=1, le=1024)
    """Number of robots that must arrive, of any team size; in place of `fraction`."""
    probability: float = Field(default=0.95, ge=0.01, le=0.999)
    """Required probability to meet the deadline."""
    confidence: float = Field(default=0.95, ge=0.5, le=0.999)
    """Confidence of the interval of the answer."""
    within: int = Field(default=1, ge=0, le=1024)
    """Required precision: the interval of the answer holds at most 2 within + 1 sizes of the
    file."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Seed of the worlds; world i is the same in all sizes and conditions, as far as they allow."""
    budget: BudgetConfig = BudgetConfig()
    axis: dict[Name, dict[Name, Changes]] = Field(default_factory=dict)
    """Axes of the conditions: values by name, each with keys of the scenario, as `set` has.
    Conditions are all combinations, at most 64 with those of `condition`."""
    condition: tuple[ConditionConfig, ...] = ()
    """Conditions by name; with axes, each is combined with all of their combinations."""

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
        """Return the sizes that can be the answer, increasing."""
        if isinstance(self.sizes, SpanConfig):
            return tuple(range(self.sizes.from_, self.sizes.to + 1))
        return self.sizes

    def required_arrivals(self, robots: int) -> int:
        """Return the number of robots of a team that must arrive, of a scenario without a task."""
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
