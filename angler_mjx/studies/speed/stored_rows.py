"""What a line of a file of rows must hold, for those who read such files."""

from typing import Annotated, Any, Self

from pydantic import ConfigDict, Field, model_validator

from angler_mjx.files import FileModel

type Count = Annotated[int, Field(ge=0, le=10**12)]
type Amount = Annotated[float, Field(ge=0, le=1e30)]
type Rate = Annotated[float, Field(gt=0, le=1e30)]
type Word = Annotated[str, Field(max_length=1000)]


class StoredRow(FileModel):
    """The fields of a row that charts, tables and comparisons read; others may stand beside them.

    Rows of earlier versions lack some.
    """

    model_config = ConfigDict(extra="ignore")

    workload: Annotated[str, Field(min_length=1, max_length=200)]
    unit: Word
    worlds: Annotated[int, Field(ge=1, le=10**9)]
    robots: Annotated[int, Field(ge=0, le=10**9)]
    devices: Annotated[int, Field(ge=1, le=10**6)] = 1
    median: Rate | None
    low: Rate | None
    high: Rate | None
    compile_s: Amount | None = None
    cached_programs: Count | None = None
    flops: Amount | None = None
    least_bytes: Amount | None = None
    bound: Amount | None = None
    flops_from: str | None = None
    copy_bytes_per_s: Amount | None = None
    fma_flops_per_s: Amount | None = None
    processor: Word | None = None
    cpu_count: Count | None = None
    engine: Word | None = None
    kernels: Word | None = None
    controller: Word | None = None
    device: Word | None = None
    driver: Word | None = None
    commit: Word | None = None
    repeats: Count | None = None
    refused: str | None = None
    extra: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _require_spread(self) -> Self:
        numbers = [x for x in (self.low, self.median, self.high) if x is not None]
        if len(numbers) not in (0, 3):
            raise ValueError("low, median, high: give all three, or null for each")
        if sorted(numbers) != numbers:
            raise ValueError(f"low, median, high = {numbers}: must rise")
        return self
