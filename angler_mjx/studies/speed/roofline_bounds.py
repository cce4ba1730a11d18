"""One definition of the roofline for rows of many days: bounds worked out again from their fields.

A row keeps the bound of its own day: with the limits of its device as they were measured then, and
with the operations as they were counted then. Both have become better known. In a table or a chart
the limits of a device are the greatest that any row measured on it, and operations count where they
were counted as `angler_mjx.studies.speed.flops` does now; other rows have no bound.
"""

from typing import Any

COUNTED = ("loops as often as they run", "branches as the cheapest")
"""What rows say of operations that are counted by today's definition."""

type Machine = tuple[Any, ...]


def with_bounds(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same rows, each with ``bound`` by one definition: its highest rate, or None."""
    copies, multiply_adds = (
        _greatest_by_machine(rows, name) for name in ("copy_bytes_per_s", _FMA)
    )
    return [{**row, "bound": _row_bound(row, copies, multiply_adds)} for row in rows]


_FMA = "fma_flops_per_s"


def _row_bound(
    row: dict[str, Any], copies: dict[Machine, float], multiply_adds: dict[Machine, float]
) -> float | None:
    machine = _machine_key(row)
    counted = str(row["flops_from"] or "")
    if machine not in copies or not any(text in counted for text in COUNTED):
        return None
    limits = []
    if row["flops"]:
        if machine not in multiply_adds:
            return None
        limits.append(multiply_adds[machine] / row["flops"])
    if row["least_bytes"]:
        limits.append(copies[machine] / row["least_bytes"])
    return row["devices"] * min(limits) if limits else None


def _greatest_by_machine(rows: list[dict[str, Any]], name: str) -> dict[Machine, float]:
    greatest: dict[Machine, float] = {}
    for row in rows:
        if row.get(name):
            greatest[_machine_key(row)] = max(greatest.get(_machine_key(row), 0.0), row[name])
    return greatest


def _machine_key(row: dict[str, Any]) -> Machine:
    """A GPU by its name; processors are all named "cpu", so by their cores as well."""
    cpu = row["device"] == "cpu"
    return (row["device"], row.get("cpu_count") if cpu else None)
