"""What a spot check found, kept for the page: its numbers out of the folder that it wrote.

    angler spotcheck runs/reef --episodes 8 --out runs/spot
    python -m angler_experiments.spotcheck_result runs/spot --json docs/validation/spotcheck.json

Needs no ArduSub: everything is in ``spotcheck.json`` and ``gaps.csv``.
"""

import csv
import json as json_text
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from angler_mjx.errors import ConfigError
from angler_mjx.testing.validation.results import Number, write

HEAD = ("flown by", "against", "same outcome", "track, m", "way, m", "endpoint, m")


def read_gaps(folder: Path) -> list[dict[str, str]]:
    """Rows of ``gaps.csv``: one for each robot, level and reference.

    Raises:
        ConfigError: there are none.
    """
    path = folder / "gaps.csv"
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not rows:
        raise ConfigError(f"{path}: holds no flights; finish the spot check with --resume")
    return rows


def add_up(rows: list[dict[str, str]]) -> dict[tuple[str, str], dict[str, float]]:
    """By level and reference: robots, how many ended otherwise, medians of the distances."""
    found = {}
    for pair in dict.fromkeys((row["level"], row["against"]) for row in rows):
        mine = [row for row in rows if (row["level"], row["against"]) == pair]
        alike = [row for row in mine if row["outcome"] == row["other_outcome"]]
        sums = {"robots": float(len(mine)), "other_outcome": float(len(mine) - len(alike))}
        for name, held in (("track_rms_m", mine), ("path_rms_m", mine), ("endpoint_m", alike)):
            values = np.array([float(row[name]) for row in held])
            half, ninety = np.nanquantile(values, [0.5, 0.9]) if values.size else (np.nan, np.nan)
            sums |= {name: float(half), f"{name}_90": float(ninety)}
        found[pair] = sums
    return found


def to_markdown(sums: dict[tuple[str, str], dict[str, float]], autopilot: str) -> str:
    """The table, and what its columns are."""
    lines = [" | ".join(HEAD), " | ".join(["---", "---", *["---:"] * (len(HEAD) - 2)])]
    for (level, reference), one in sums.items():
        alike = one["robots"] - one["other_outcome"]
        cells = [level, reference, f"{alike:.0f} of {one['robots']:.0f}"]
        cells += [
            f"{one[name]:.3f}, {one[f'{name}_90']:.2f}"
            for name in ("track_rms_m", "path_rms_m", "endpoint_m")
        ]
        lines.append(" | ".join(cells))
    body = "\n".join(f"| {line} |" for line in lines)
    return (
        f"{body}\n\nArduSub {autopilot}. `recorded` is the batch run itself. Track is the root "
        "mean square distance of the two at the same time, way that to the other's way, endpoint "
        "lies between the places where those ended that ended alike; each median, and nine of ten "
        "below."
    )


def main(folder: Annotated[Path, tyro.conf.Positional], json: Path) -> None:
    """Write what a spot check found as a result that `angler validate` puts on its page.

    Args:
        folder: of the spot check.
        json: file for the result.
    """
    table = folder / "spotcheck.json"
    try:
        held: dict[str, Any] = json_text.loads(table.read_text(encoding="utf-8"))
        origin, autopilot = held["provenance"], held["asked"]["ardusub"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{table}: is no table of a spot check ({error})") from error
    sums = add_up(read_gaps(folder))
    numbers = {}
    for (level, reference), one in sums.items():
        name = f"{level}.{reference}"
        numbers[f"{name}.other_outcome"] = Number(
            value=one["other_outcome"], unit="robots", worse="count"
        )
        numbers[f"{name}.track_median"] = Number(
            value=one["track_rms_m"], unit="m", worse="behaviour"
        )
    written = datetime.fromtimestamp(table.stat().st_mtime, UTC)
    kept = ("versions", "python", "platform", "cpu_count", "backend", "device", "commit")
    about = {name: origin[name] for name in kept} | {"ardusub": True}
    about["at_utc"] = written.isoformat(timespec="seconds")
    result = {name: number.model_dump() for name, number in numbers.items()}
    text = to_markdown(sums, autopilot)
    write(json, {"about": about, "numbers": result, "text": text})
    print(text)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except ConfigError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
