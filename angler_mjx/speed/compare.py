"""Two sets of rows side by side: ratios of their medians, with what the spread makes of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.speed import rows as speed

type Key = tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """One workload on both sides."""

    workload: str
    engine: str | None
    kernels: str | None
    worlds: int
    robots: int
    devices: int
    unit: str
    before: float
    after: float
    low: float
    high: float
    """Least and greatest ratio that the repeats of both sides allow."""

    @property
    def ratio(self) -> float:
        """Above 1 the second is faster."""
        return self.after / self.before

    @property
    def beyond_spread(self) -> bool:
        """Whether all repeats of one side are on the same side of all repeats of the other."""
        return self.low > 1.0 or self.high < 1.0


def compare(a: str, b: str, results: Path) -> list[Ratio]:
    """Ratios b / a of all workloads that both sides have.

    Args:
        a: a file of rows, or the beginning of a commit in ``results``.
        b: the same.
        results: file in which commits are looked for.

    Raises:
        ConfigError: one is neither, or they have nothing in common.
    """
    first, second = (_side(name, results) for name in (a, b))
    # Two machines can be compared if it is clear which two.
    one_each = len(_devices(first)) == 1 and len(_devices(second)) == 1
    before, after = (_by_key(rows, with_device=not one_each) for rows in (first, second))
    common = [key for key in before if key in after]
    if not common:
        raise ConfigError(f"--compare {a} {b}: no workload of the same engine and size in both")
    return [_ratio(before[key], after[key]) for key in common]


def latest(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The last row with a number of each workload, size, engine and device, in order of coming."""
    return list(_by_key([row for row in rows if row["median"]], with_device=True).values())


def _side(name: str, results: Path) -> list[dict[str, Any]]:
    if Path(name).is_file():
        rows = speed.read(Path(name))
    else:
        rows = [row for row in speed.read(results) if _is_of(row, name)]
    rows = [row for row in rows if row["median"]]
    if not rows:
        raise ConfigError(
            f"--compare {name}: is no file with rows, and no row of {results} is of such a commit"
        )
    return rows


def _is_of(row: dict[str, Any], commit: str) -> bool:
    return bool(commit) and str(row["commit"] or "").startswith(commit)


def _devices(rows: list[dict[str, Any]]) -> set[Any]:
    return {(row["device"], row.get("driver")) for row in rows}


def _by_key(rows: list[dict[str, Any]], *, with_device: bool) -> dict[Key, dict[str, Any]]:
    """The last row of each key."""
    names = ("workload", "engine", "kernels", "worlds", "robots", "devices", "unit")
    found: dict[Key, dict[str, Any]] = {}
    for row in rows:
        key = tuple(row[name] for name in names)
        found[(*key, row["device"]) if with_device else key] = row
    return found


def _ratio(before: dict[str, Any], after: dict[str, Any]) -> Ratio:
    return Ratio(
        workload=after["workload"],
        engine=after["engine"],
        kernels=after["kernels"],
        worlds=after["worlds"],
        robots=after["robots"],
        devices=after["devices"],
        unit=after["unit"],
        before=before["median"],
        after=after["median"],
        low=after["low"] / before["high"],
        high=after["high"] / before["low"],
    )
