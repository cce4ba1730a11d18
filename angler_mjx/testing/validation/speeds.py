"""Table of speeds: the latest rows of benchmarks/results.jsonl, each with its commit."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from angler_mjx.studies.speed import rows as speed
from angler_mjx.studies.speed.chart import device_name, format_rate
from angler_mjx.studies.speed.compare import select_latest

RESULTS_PATH = Path("benchmarks/results.jsonl")
SCENARIO = "reef_fleet"


def is_traceable(row: dict[str, Any]) -> bool:
    """Return whether a row names its commit, and the tree was unchanged."""
    return bool(row["commit"]) and not str(row["commit"]).endswith("-changed")


def build_speed_table(results: Path) -> str:
    """Return simulation and preparation speeds of the demo's scenario by device and size.

    Args:
        results: file of rows; rows without a commit or from a changed tree are left out.

    Raises:
        ConfigError: the file cannot be read.
    """
    rows = select_latest([row for row in speed.read_rows(results) if is_traceable(row)])
    rows_by_setup: dict[tuple[str, int, int], dict[str, dict[str, Any]]] = defaultdict(dict)
    for row in rows:
        if row["workload"] == SCENARIO:
            name = str(row["engine"])
        elif row["workload"] == f"preparation/{SCENARIO}":
            name = "preparation"
        else:
            continue
        rows_by_setup[device_name(row), row["worlds"], row["robots"]][name] = row
    head = (
        "| device | worlds x robots | mjx, vehicle-steps/s | fused, vehicle-steps/s "
        "| drawing and planning, worlds/s |\n| --- | ---: | ---: | ---: | ---: |"
    )
    lines = [
        f"| {device} | {worlds:,} x {robots} | "
        + " | ".join(
            _format_cell(rows_by_engine.get(name)) for name in ("mjx", "fused", "preparation")
        )
        + " |"
        for (device, worlds, robots), rows_by_engine in sorted(rows_by_setup.items())
    ]
    return "\n".join([head, *lines])


def _format_cell(row: dict[str, Any] | None) -> str:
    return "-" if row is None else f"{format_rate(row['median'])} ({row['commit'][:7]})"
