"""Two sets of rows side by side: ratios of their medians, with what the spread makes of them."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.studies.speed import rows as speed

type Key = tuple[Hashable, ...]
type Fields = dict[str, Any]
"""Of a row, as `rows.read_rows` gives them."""

SIZE = ("workload", "engine", "kernels", "worlds", "robots", "devices", "unit")
"""Fields that two rows must have alike to be compared at all."""


@dataclass(frozen=True, kw_only=True)
class SpeedRatio:
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
    repeats: int | None
    """Of the side with fewer; None where a row does not say."""

    @property
    def ratio(self) -> float:
        """Above 1 the second is faster."""
        return _speed_ratio(self.unit, self.before, self.after)

    @property
    def beyond_spread(self) -> bool:
        """Whether all repeats of one side are on the same side of all repeats of the other."""
        return self.low > 1.0 or self.high < 1.0


@dataclass(frozen=True, kw_only=True)
class SpeedComparison:
    """Ratios of the rows that can be compared, and a line on each row that cannot."""

    ratios: list[SpeedRatio]
    left_out: list[str]
    machines: str
    """The two machines whose rates are compared, where they differ; else empty."""


def compare_rows(a: str, b: str, results: Path) -> SpeedComparison:
    """Ratios b / a of all workloads that both sides have; of seconds a / b.

    Seconds of compiling are compared within one host: processor and number of cores. Rates of the
    same workload on several devices or hosts are compared within each; where either side has one,
    these two are compared.

    Args:
        a: a file of rows, or the beginning of a commit in ``results``.
        b: the same.
        results: file in which commits are looked for.

    Raises:
        ConfigError: one is neither, or they have nothing in common.
    """
    first, second = (_read_side(name, results) for name in (a, b))
    # Two machines can be compared if it is clear which two.
    is_clear = all(len(_list_machines(rows)) == 1 for rows in (first, second))
    key = _size_and_host if is_clear else _size_and_machine
    before, after = (_last_by_key(rows, key) for rows in (first, second))
    ratios = [_build_ratio(before[each], after[each]) for each in before if each in after]
    left_out = [*_explain_left_out(a, before, b, after), *_explain_left_out(b, after, a, before)]
    if not ratios:
        raise ConfigError(
            f"--compare {a} {b}: no workload of the same engine and size in both, nor one of "
            f"one host where hosts matter; {'; '.join(left_out)}"
        )
    differ = is_clear and _list_machines(first) != _list_machines(second)
    machines = ""
    if differ:
        machines = (
            f"rates of {a} on {_format_machine(first[0])}; of {b} on {_format_machine(second[0])}"
        )
    return SpeedComparison(
        ratios=ratios,
        left_out=left_out,
        machines=machines,
    )


def select_latest(rows: list[Fields]) -> list[Fields]:
    """The last row with a number of each workload, size, engine and device, in order of coming.

    Of seconds of compiling, also of each host.
    """
    numbered = [row for row in rows if row["median"]]
    return list(_last_by_key(numbered, lambda row: (*_size_and_host(row), row["device"])).values())


def host_name(row: Fields) -> str:
    """Processor and number of cores of the machine that a row was measured on."""
    return f"{row.get('processor') or 'unknown processor'}, {row.get('cpu_count') or '?'} cores"


def _read_side(name: str, results: Path) -> list[Fields]:
    if Path(name).is_file():
        rows = speed.read_rows(Path(name))
    else:
        rows = [row for row in speed.read_rows(results) if _is_of(row, name)]
    rows = [row for row in rows if row["median"]]
    if not rows:
        raise ConfigError(
            f"--compare {name}: is no file with rows, and no row of {results} is of such a commit"
        )
    return rows


def _is_of(row: Fields, commit: str) -> bool:
    return bool(commit) and str(row["commit"] or "").startswith(commit)


def _list_machines(rows: list[Fields]) -> set[Key]:
    """Devices of rows, with their drivers; processors by their hosts."""
    return {(*_machine_key(row), row.get("driver")) for row in rows if not _is_duration(row)} or {
        ()
    }


def _machine_key(row: Fields) -> Key:
    return (row["device"], host_name(row) if row["device"] == "cpu" else None)


def _size_key(row: Fields) -> Key:
    """Return what two compared rows have alike; kernels of a GPU were Triton's before 0.3."""
    return tuple("cuda" if row[name] == "triton" else row[name] for name in SIZE)


def _size_and_host(row: Fields) -> Key:
    """The key within which rows are compared if each side is of one machine."""
    return (*_size_key(row), (row["device"], host_name(row)) if _is_duration(row) else None)


def _size_and_machine(row: Fields) -> Key:
    return (*_size_and_host(row), *_machine_key(row))


def _is_duration(row: Fields) -> bool:
    return bool(row["unit"] == speed.DURATION)


def _last_by_key(rows: list[Fields], key: Callable[[Fields], Key]) -> dict[Key, Fields]:
    """The last row of each key."""
    return {key(row): row for row in rows}


def _explain_left_out(
    name: str, rows: dict[Key, Fields], other: str, others: dict[Key, Fields]
) -> list[str]:
    """Say of each row of one side that has none to be compared with what it is, and why."""
    return [
        f"{_format_row(row)} in {name}: {_explain_missing(row, other, list(others.values()))}"
        for key, row in rows.items()
        if key not in others
    ]


def _format_row(row: Fields) -> str:
    engine = "/".join(part for part in (row["engine"], row["kernels"]) if part)
    devices = "" if row["devices"] == 1 else f"{row['devices']} devices x "
    return f"{row['workload']} {engine}".strip() + f", {devices}{row['worlds']:,} x {row['robots']}"


def _explain_missing(row: Fields, other: str, others: list[Fields]) -> str:
    alike = [each for each in others if _size_key(each) == _size_key(row)]
    if not alike:
        return f"{other} has no such row"
    hosts = " and ".join(sorted({_format_machine(each) for each in alike}))
    return f"measured on {_format_machine(row)}, in {other} on {hosts}"


def _format_machine(row: Fields) -> str:
    device = "" if row["device"] in (None, "cpu") else f"{row['device']}, "
    return f"{device}{host_name(row)}"


def _speed_ratio(unit: str, before: float, after: float) -> float:
    """How many times as fast the second is: of rates the quotient, of seconds its inverse."""
    return before / after if unit == speed.DURATION else after / before


def _build_ratio(before: Fields, after: Fields) -> SpeedRatio:
    unit = after["unit"]
    slow, fast = ("high", "low") if unit == speed.DURATION else ("low", "high")
    repeats = [row["repeats"] for row in (before, after)]
    return SpeedRatio(
        workload=after["workload"],
        engine=after["engine"],
        kernels=after["kernels"],
        worlds=after["worlds"],
        robots=after["robots"],
        devices=after["devices"],
        unit=unit,
        before=before["median"],
        after=after["median"],
        low=_speed_ratio(unit, before[fast], after[slow]),
        high=_speed_ratio(unit, before[slow], after[fast]),
        repeats=None if None in repeats else min(repeats),
    )
