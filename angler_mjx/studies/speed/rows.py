"""What a measurement of speed is: a row, how its calls are timed, and the file that keeps it.

A row is one JSON line. It holds what was timed, where, and what the device itself can do, so that a
number can be judged without asking who measured it. A row without a number says why it has none.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from jax import monitoring
from jax.stages import Compiled
from pydantic import ConfigDict, Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, format_path, parse_json, parse_model, read_text
from angler_mjx.progress import Progress
from angler_mjx.runs.provenance import peak_memory_bytes

MAX_BYTES = 1 << 26
"""Of a file of rows."""
MIN_REPEATS = 10
"""Fewer tell little about the spread."""
DURATION = "s"
"""Unit of rows that hold seconds: less is faster. In all other units more is."""


type Count = Annotated[int, Field(ge=0, le=10**12)]
type Amount = Annotated[float, Field(ge=0, le=1e30)]
type Rate = Annotated[float, Field(gt=0, le=1e30)]
type Word = Annotated[str, Field(max_length=1000)]


@dataclass(frozen=True, kw_only=True)
class SpeedRow:
    """One measurement."""

    workload: str
    inside: str
    """What the timed region holds."""
    worlds: int
    robots: int
    unit: str
    median: float | None
    low: float | None
    high: float | None
    """Median, least and greatest rate over the repeats, in ``unit``; None if it was refused.

    Seconds in rows of `DURATION`.
    """
    repeats: int
    compile_s: float | None
    cached_programs: int = 0
    """How many programs came out of the compile cache: above 0, ``compile_s`` is not the whole."""
    devices: int = 1
    """Each of them has ``worlds``; the rate is that of all together."""
    engine: str | None = None
    kernels: str | None = None
    controller: str | None = None
    """The stack of controllers, in simulations."""
    flops: float | None = None
    """Floating-point operations for one of ``unit``; None where they cannot be counted."""
    flops_from: str | None = None
    """Which program they were counted in, or why they were not."""
    least_bytes: float | None = None
    """Device memory for one of ``unit`` that has to move whatever the program does between: its
    arguments read once, its results written once."""
    program_bytes: int | None = None
    """Device memory of the program by XLA's account: arguments, results and temporaries."""
    xla_flops: float | None = None
    """Operations of the whole timed program on one device by XLA's own cost analysis, which counts
    the body of a loop once however often it runs, and nothing inside kernels."""
    xla_bytes: float | None = None
    """Bytes that its operations touch, by the same account."""
    device_peak_bytes: int | None = None
    """Most device memory in use in this process so far."""
    host_peak_bytes: int = field(default_factory=peak_memory_bytes)
    """Most host memory in use in this process so far."""
    active_share: float | None = None
    """Share of the counted steps in all that the robots could have lived in the timed region."""
    extra: dict[str, float] = field(default_factory=dict)
    """What only this workload has to say."""
    refused: str | None = None
    """Why there is no number."""
    out_of_memory: bool = False
    """Whether that was for want of memory."""
    at_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))


class StoredRow(FileModel):
    """Fields of a stored row that charts, tables and comparisons read.

    Others may stand beside them; rows of earlier versions lack some.
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
    extra: dict[str, object] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _require_spread(self) -> Self:
        numbers = [x for x in (self.low, self.median, self.high) if x is not None]
        if len(numbers) not in (0, 3):
            raise ValueError("low, median, high: give all three, or null for each")
        if sorted(numbers) != numbers:
            raise ValueError(f"low, median, high = {numbers}: must rise")
        return self


WARM_S = 1.0
"""Work before the first turn that counts."""


def check_repeats(repeats: int) -> None:
    """Refuse to measure without a spread.

    Raises:
        ConfigError: there would be too few repeats.
    """
    if repeats < MIN_REPEATS:
        raise ConfigError(
            f"--repeats {repeats}: must be at least {MIN_REPEATS}, for a median and a spread"
        )


def seconds_of[T](call: Callable[..., T], *arguments: object) -> tuple[float, T]:
    """Wall time until the result of a call is complete on the device, and the result."""
    begun = time.perf_counter()
    result: T = jax.block_until_ready(call(*arguments))
    return time.perf_counter() - begun, result


def iterate_turns(repeats: int, progress: Progress | None = None) -> Iterator[bool]:
    """Turns of a measurement, each with whether it counts: the first never, nor any in a second.

    A processor that was idle first has to raise its clock.

    Args:
        repeats: turns that count.
        progress: receives each turn, outside its time.
    """
    progress = progress or Progress()
    progress.start(repeats, unit="turns")
    begun, counted = time.perf_counter(), 0
    yield False
    progress.advance(0)
    while counted < repeats:
        warm = time.perf_counter() - begun >= WARM_S
        yield warm
        counted += warm
        progress.advance(warm)


class RateFields(TypedDict):
    """Fields of a row that come from the rates of its repeats."""

    median: float
    low: float
    high: float
    repeats: int


class CostFields(TypedDict, total=False):
    """Fields of a row that XLA gives for a compiled program."""

    xla_flops: float | None
    xla_bytes: float | None
    program_bytes: int


def summarise_rates(rates: list[float]) -> RateFields:
    """The fields of a row that come from the rates of its repeats."""
    return {
        "median": float(np.median(rates)),
        "low": min(rates),
        "high": max(rates),
        "repeats": len(rates),
    }


def read_program_costs(program: Compiled) -> CostFields:
    """The fields of a row that XLA says of a compiled program; none where it says nothing.

    Args:
        program: compiled; one device's part of it is told of.
    """
    fields: CostFields = {}
    if cost := program.cost_analysis():
        fields["xla_flops"] = cost.get("flops")
        fields["xla_bytes"] = cost.get("bytes accessed")
    if memory := program.memory_analysis():
        whole = memory.argument_size_in_bytes + memory.output_size_in_bytes
        whole += memory.temp_size_in_bytes - memory.alias_size_in_bytes
        fields["program_bytes"] = whole
    return fields


def moved_bytes(program: Compiled) -> int | None:
    """Arguments and results of a compiled program on one device; None where XLA does not say."""
    memory = program.memory_analysis()
    return memory.argument_size_in_bytes + memory.output_size_in_bytes if memory else None


@jax.jit
def _is_all_finite(tree: object) -> jax.Array:
    leaves = [x for x in jax.tree.leaves(tree) if jnp.issubdtype(x.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in leaves]))


def all_finite(tree: object) -> bool:
    """Whether every float of a tree of device arrays is finite."""
    return bool(_is_all_finite(tree))


HITS, REQUESTS = "cache_hits", "compile_requests_use_cache"


@cache
def cache_events() -> Counter[str]:
    """Return counts of JAX's events of the compile cache since this was first called.

    `HITS` counts programs that came out of it, `REQUESTS` all that it was searched for.
    """
    counts: Counter[str] = Counter()

    def count(event: str, **ignored: str | int) -> None:
        folder, _, name = event.rpartition("/")
        if folder == "/jax/compilation_cache":
            counts[name] += 1

    monitoring.register_event_listener(count)
    return counts


def peak_device_bytes() -> int | None:
    """Most memory of the first device in use so far; None where the backend does not say."""
    stats = jax.local_devices()[0].memory_stats() or {}
    peak = stats.get("peak_bytes_in_use")
    return None if peak is None else int(peak)


def append_row(row: SpeedRow, conditions: Mapping[str, object], out: Path) -> None:
    """Append a row to a JSON-lines file.

    Args:
        row: what was measured.
        conditions: device, versions and commit.
        out: file; made if there is none.

    Raises:
        ConfigError: the file cannot be written.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("a", encoding="utf-8") as file:
            file.write(json.dumps({**asdict(row), **conditions}, allow_nan=False) + "\n")
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from error


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return all rows of a file, oldest first: fields of `SpeedRow`, and where it was measured.

    Raises:
        ConfigError: the file cannot be read, or a line of it is no row.
    """
    return list(_parse_rows(read_text(path, MAX_BYTES), path))


def _parse_rows(text: str, path: Path) -> Iterator[dict[str, Any]]:
    absent = {name: None for name in SpeedRow.__dataclass_fields__} | {
        "out_of_memory": False,
        "devices": 1,
        "extra": {},
    }
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        where = f"{format_path(path)}, line {number}"
        fields = parse_json(line, where)
        row = parse_model(StoredRow, fields, source=f"{where}: is no row of a benchmark")
        if isinstance(fields, dict):  # else it is no row
            yield (
                absent
                | {"device": None, "commit": None}
                | fields
                | _convert_first_version(row.workload)
            )


def _convert_first_version(workload: str) -> dict[str, str]:
    """Rows of the first version named the engine in the workload, and no kernels."""
    engine, _, rest = workload.partition("/")
    name, _, part = rest.partition("/")
    if engine != "mjx" or part not in ("simulation", "worlds"):
        return {}
    if part == "worlds":
        return {"workload": f"preparation/{name}"}
    return {"workload": name, "engine": engine, "kernels": "xla"}
